"""Give the backbone of a network more channels, for further training; it says what it said.

python benchmarks/widen_channels.py 24 48 64 96 128 --out FILE.safetensors [--weights FILE]
composenet train --start-from FILE.safetensors ...   (with these backbone_channels in its --config)
"""

from __future__ import annotations

from pathlib import Path

import torch
import tyro

from composenet.network.weights import default_weights, load_weights, save_weights
from composenet.training.widen import widened


def main(
    channels: tyro.conf.Positional[tuple[int, ...]], out: Path, weights: Path | None = None
) -> None:
    """Write the weights with these channels at the resolutions of the backbone, finest first."""
    torch.manual_seed(0)
    network, model, notes = load_weights(weights or default_weights())
    wide, model = widened(network, model, channels)
    save_weights(wide, model, out, notes)


if __name__ == "__main__":
    tyro.cli(main)
