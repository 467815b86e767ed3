"""One checkpoint file holds all a run needs to go on."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import Any

import torch

from composenet.config import from_dict, to_dict
from composenet.errors import WeightsError
from composenet.training.config import TrainingConfig

FORMAT = "composenet.checkpoint/1"


@dataclasses.dataclass
class Progress:
    """What was done so far. scenes: scenes drawn, so that a resumed run sees new ones."""

    step: int = 0
    frames: int = 0
    scenes: int = 0
    seconds: float = 0.0


def save_checkpoint(
    path: Path,
    config: TrainingConfig,
    progress: Progress,
    model: dict[str, Any],
    average: dict[str, Any],
    optimizer: dict[str, Any],
) -> None:
    """Write atomically: a crash leaves the previous file whole."""
    partial = path.with_name(path.name + ".partial")
    torch.save(
        {
            "format": FORMAT,
            "config": to_dict(config),
            "progress": dataclasses.asdict(progress),
            "model": model,
            "average": average,
            "optimizer": optimizer,
        },
        partial,
    )
    os.replace(partial, path)


def load_checkpoint(path: Path) -> dict[str, Any]:
    """The checkpoint with config and progress as records. Raises WeightsError."""
    try:
        data = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:
        reason = str(error).strip().splitlines()[0][:200]
        raise WeightsError(f"{path}: not a readable checkpoint ({reason})") from None
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise WeightsError(f"{path}: not a {FORMAT} file; delete it or name another --out")
    missing = {"config", "progress", "model", "average", "optimizer"} - set(data)
    if missing:
        raise WeightsError(f"{path}: the checkpoint lacks {min(missing)!r}; delete it")
    data["config"] = from_dict(data["config"], TrainingConfig)
    data["progress"] = Progress(**data["progress"])
    return data
