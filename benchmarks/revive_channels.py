"""Start the silent channels of a network anew, for further training.

python benchmarks/revive_channels.py --out FILE.safetensors [--weights FILE] [--scenes 8]
composenet train --start-from FILE.safetensors ...
"""

from __future__ import annotations

from pathlib import Path

import torch
import tyro

from composenet.network.weights import default_weights, load_weights, save_weights
from composenet.training.config import TrainingConfig
from composenet.training.data import SceneSource, fixed_batches
from composenet.training.revive import revive_silent
from composenet.training.validation import validate


def main(out: Path, weights: Path | None = None, scenes: int = 8) -> None:
    """Write the weights with their silent channels begun anew; validation before and after."""
    torch.manual_seed(0)
    network, model, notes = load_weights(weights or default_weights())
    config, cpu = TrainingConfig(model=model), torch.device("cpu")
    batches = fixed_batches(SceneSource("val"), config, scenes)
    before = validate(network, batches, config, cpu)
    for layer, count in revive_silent(network, config, batches).items():
        print(f"{layer:32} {count:4}")
    after = validate(network, batches, config, cpu)
    for name in before:
        print(f"{name:16} {before[name]:8.4f} {after[name]:8.4f}")
    save_weights(network, model, out, notes)


if __name__ == "__main__":
    tyro.cli(main)
