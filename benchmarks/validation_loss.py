"""The loss on validation scenes, of the shipped weights and of others, paired: of the detector and
the second look, or with `--parts objects` of completion and pose, on true boxes that are moved at
random and looked at again.

python benchmarks/validation_loss.py WEIGHTS... [--start 400] [--scenes 100] [--out FILE.json]
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Literal

import numpy as np
import torch
import tyro
from rich.progress import track

from composenet.errors import DataError
from composenet.metrics.report import RunInfo
from composenet.network.weights import default_weights, load_weights, weights_id
from composenet.training.config import TrainingConfig
from composenet.training.data import SceneSource, fixed_batches
from composenet.training.step import LossModule, weighted_sum
from composenet.training.targets import TrainingBatch

Parts = Literal["detector", "objects"]
FRAMES = 4
"""Of each scene, all in one batch: they are alike, so that only scenes are independent."""


@torch.no_grad()
def losses_of(weights: Path, batches: list[TrainingBatch], parts: Parts) -> np.ndarray:
    """(B,) weighted sum of what these parts are trained for. Raises DataError for weights that want
    other volumes than the batches hold."""
    network, model, _ = load_weights(weights)
    if model.volume != TrainingConfig().model.volume:
        raise DataError(
            f"{weights}: made for other volumes than the shipped weights, so that losses do not "
            "compare"
        )
    config = TrainingConfig(model=model, parts=parts, max_crops=10)
    module = LossModule(config)
    module.network = network
    module.eval()
    sums = []
    for i, batch in enumerate(track(batches, weights.name)):
        losses, _ = module(batch, True, torch.Generator().manual_seed(i))
        sums.append(float(weighted_sum(losses, config)))
    return np.array(sums)


def main(
    weights: tyro.conf.Positional[tuple[Path, ...]],
    start: int = 400,
    scenes: int = 100,
    parts: Parts = "detector",
    out: Path | None = None,
) -> None:
    """Mean loss of each, and its difference from that of the shipped weights, over scenes."""
    config = TrainingConfig(batch_frames=FRAMES)
    batches = fixed_batches(SceneSource("val"), config, scenes, start, frames=FRAMES)
    shipped = losses_of(default_weights(), batches, parts)
    rows = [{"weights": weights_id(default_weights()), "loss": round(float(shipped.mean()), 4)}]
    for path in weights:
        loss = losses_of(path, batches, parts)
        difference = loss - shipped
        error = difference.std(ddof=1) / len(difference) ** 0.5
        rows.append(
            {
                "weights": weights_id(path),
                "loss": round(float(loss.mean()), 4),
                "difference": round(float(difference.mean()), 4),
                "standard_error": round(float(error), 4),
            }
        )
    for row in rows:
        print(row)
    if out is not None:
        files = " ".join(map(str, weights))
        options = f"--start {start} --scenes {scenes} --parts {parts}"
        command = f"python benchmarks/validation_loss.py {files} {options}"
        data = f"val, scenes {start} to {start + scenes - 1}"
        info = asdict(RunInfo(data, 0, command, weights_id(default_weights())))
        out.write_text(json.dumps(info | {"losses": rows}, indent=2) + "\n")


if __name__ == "__main__":
    tyro.cli(main)
