"""How many channels of the network say nothing, by part.

python benchmarks/silent_channels.py [--weights FILE] [--scenes 8] [--out FILE.json]
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import torch
import tyro

from composenet.metrics.report import RunInfo
from composenet.network.weights import default_weights, load_weights, weights_id
from composenet.training.config import TrainingConfig
from composenet.training.data import SceneSource, fixed_batches
from composenet.training.silent import watched
from composenet.training.validation import validate

PARTS = ("backbone", "detection", "boxes", "objects")


def main(weights: Path | None = None, scenes: int = 8, out: Path | None = None) -> None:
    """Print the silent share of every layer of some size, and of every part."""
    torch.manual_seed(0)
    path = weights or default_weights()
    network, model, _ = load_weights(path)
    config = TrainingConfig(model=model)
    with watched(network) as channels:
        batches = fixed_batches(SceneSource("val"), config, scenes)
        validate(network, batches, config, torch.device("cpu"))
    for layer, silent in channels.silent.items():
        print(f"{layer:32} {int(silent.sum()):4} of {len(silent)}")
    shares = {part: round(100 * channels.share(part), 1) for part in PARTS}
    print("silent, %:", shares, "all:", round(100 * channels.share(), 1))
    if out is not None:
        other = f" --weights {weights}" if weights else ""
        command = f"python benchmarks/silent_channels.py --scenes {scenes}{other}"
        info = asdict(RunInfo(f"val, {scenes} scenes", 0, command, weights_id(path)))
        out.write_text(json.dumps(info | {"silent_percent": shares}, indent=2) + "\n")


if __name__ == "__main__":
    tyro.cli(main)
