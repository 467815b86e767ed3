"""Which format a recording has, told from what its folder holds."""

from __future__ import annotations

from pathlib import Path

from composenet.errors import SequenceError
from composenet.sequences import folder, open3d, scannet, sens, seven_scenes, tum
from composenet.sequences.source import Source

_FORMATS = (tum, scannet, open3d, folder, seven_scenes, sens)
"""The first that matches reads it."""


def read_source(path: Path) -> Source:
    """What a recording holds, before any image is opened. Raises SequenceError where it is none
    that is known, or cannot be read."""
    if not path.exists():
        raise SequenceError(
            f"{path}: no such folder or file; a recording is a folder with depth/*.png in it"
        )
    try:
        return _read(path)
    except OSError as error:
        raise SequenceError(f"{path}: cannot be read ({error.strerror})") from None


def _read(path: Path) -> Source:
    for kind in _FORMATS:
        if kind.matches(path):
            return kind.read_source(path)
    if not path.is_dir():
        raise SequenceError(f"{path}: is a file, neither a folder nor called *.sens (ScanNet)")
    for entry in sorted(path.iterdir()):
        if any(kind.matches(entry) for kind in _FORMATS):
            raise SequenceError(f"{path}: {entry.name} in it is a recording; give that")
    raise SequenceError(
        f"{path}: neither a depth/ folder nor depth.txt (TUM RGB-D) nor *.depth.png (7-Scenes) in "
        "it"
    )
