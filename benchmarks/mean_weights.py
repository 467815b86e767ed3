"""The mean of several weights of one network that began from the same ones: the noise of single
runs cancels (Izmailov et al. 2018).

python benchmarks/mean_weights.py WEIGHTS WEIGHTS... --out FILE.safetensors

So several processes can train without waiting for one another: each alone, with a seed of its own.
"""

from __future__ import annotations

from pathlib import Path

import torch
import tyro

from composenet.errors import WeightsError
from composenet.network.weights import load_weights, save_weights


def main(weights: tyro.conf.Positional[tuple[Path, ...]], out: Path) -> None:
    """Write the mean; raises WeightsError where the networks or their configurations differ."""
    loaded = [load_weights(path) for path in weights]
    network, config, _ = loaded[0]
    for path, (_, other, _) in zip(weights, loaded, strict=True):
        if other != config:
            raise WeightsError(f"{path}: its configuration is not that of {weights[0]}")
    states = [net.state_dict() for net, *_ in loaded]
    mean = {}
    for name, value in states[0].items():
        every = torch.stack([state[name] for state in states])
        mean[name] = every.mean(dim=0) if value.is_floating_point() else value
    network.load_state_dict(mean)
    save_weights(network, config, out, {"mean_of": [notes for *_, notes in loaded]})


if __name__ == "__main__":
    tyro.cli(main)
