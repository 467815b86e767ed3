"""One checkpoint file holds all a run needs to go on."""

from __future__ import annotations

import dataclasses
import io
from pathlib import Path
from typing import Any

import torch

from composenet.config import from_dict, to_dict
from composenet.errors import WeightsError
from composenet.files import write_atomic
from composenet.training.config import TrainingConfig

FORMAT = "composenet.checkpoint/1"


@dataclasses.dataclass
class Progress:
    """What was done so far. scenes: scenes drawn, so that a resumed run sees new ones. source:
    where they came from, in words."""

    step: int = 0
    frames: int = 0
    scenes: int = 0
    seconds: float = 0.0
    source: str = ""

    def notes(self, device: torch.device, seed: int) -> dict[str, Any]:
        """What a weights file says of the run that made it."""
        return {
            "steps": self.step,
            "frames": self.frames,
            "training_minutes": round(self.seconds / 60, 1),
            "device": device.type,
            "seed": seed,
        }


def write_state(path: Path, state: dict[str, Any]) -> None:
    """Write atomically: a crash leaves the previous file whole. Raises DataError where it cannot be
    written."""
    data = io.BytesIO()
    torch.save(state, data)
    write_atomic(path, data.getvalue())


def read_state(path: Path, form: str, keys: set[str]) -> dict[str, Any]:
    """What `write_state` wrote, with "format" form and all the keys. Raises WeightsError."""
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:
        reason = str(error).strip().splitlines()[0][:200]
        raise WeightsError(
            f"{path}: not a readable checkpoint ({reason}); delete it or name another --out"
        ) from None
    if not isinstance(state, dict) or state.get("format") != form:
        raise WeightsError(f"{path}: not a {form} file; delete it or name another --out")
    if missing := keys - set(state):
        raise WeightsError(f"{path}: the checkpoint lacks {min(missing)!r}; delete it")
    return state


def save_checkpoint(
    path: Path,
    config: TrainingConfig,
    progress: Progress,
    model: dict[str, Any],
    average: dict[str, Any],
    optimizer: dict[str, Any],
) -> None:
    """Write atomically."""
    state = {
        "format": FORMAT,
        "config": to_dict(config),
        "progress": dataclasses.asdict(progress),
        "model": model,
        "average": average,
        "optimizer": optimizer,
    }
    write_state(path, state)


def load_checkpoint(path: Path) -> dict[str, Any]:
    """The checkpoint with config and progress as records. Raises WeightsError."""
    data = read_state(path, FORMAT, {"config", "progress", "model", "average", "optimizer"})
    data["config"] = from_dict(data["config"], TrainingConfig)
    data["progress"] = Progress(**data["progress"])
    return data
