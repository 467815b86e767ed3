"""Any RGB-D recording as levelled frames: `open_sequence`."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from composenet.sequences.options import SequenceOptions

if TYPE_CHECKING:
    from composenet.sequences.leveling import level_camera
    from composenet.sequences.odometry import Odometry
    from composenet.sequences.recording import RecordedSequence, open_sequence

__all__ = ["Odometry", "RecordedSequence", "SequenceOptions", "level_camera", "open_sequence"]

_MODULES = {
    "Odometry": "odometry",
    "RecordedSequence": "recording",
    "level_camera": "leveling",
    "open_sequence": "recording",
}


def __getattr__(name: str) -> Any:
    """Import on first use: compiled loops take their time, which `--help` has not."""
    if name not in _MODULES:
        raise AttributeError(f"module 'composenet.sequences' has no attribute {name!r}")
    return getattr(import_module(f"composenet.sequences.{_MODULES[name]}"), name)
