"""Which format a recording has, told from what its folder holds."""

from __future__ import annotations

from pathlib import Path

from composenet.errors import SequenceError
from composenet.sequences import folder, open3d, ros, scannet, sens, seven_scenes, tum
from composenet.sequences.source import Source

_FORMATS = (tum, scannet, open3d, folder, seven_scenes, sens, ros)
"""The first that matches reads it."""


def is_known(path: Path) -> bool:
    """Whether it looks like a recording of any format."""
    return any(kind.matches(path) for kind in _FORMATS)


def read_source(path: Path, depth_topic: str | None = None) -> Source:
    """What a recording holds, before any image is opened. depth_topic: of a ROS recording, whose
    cameras have names. Raises SequenceError where it is none that is known, or cannot be read."""
    if not path.exists():
        raise SequenceError(
            f"{path}: no such folder or file; a recording is a folder with depth/*.png in it"
        )
    try:
        return _read(path, depth_topic)
    except OSError as error:
        raise SequenceError(f"{path}: cannot be read ({error.strerror})") from None


def _read(path: Path, depth_topic: str | None) -> Source:
    for kind in _FORMATS:
        if not kind.matches(path):
            continue
        if kind is ros:
            return ros.read_source(path, depth_topic)
        if depth_topic is not None:
            raise SequenceError(f"{path}: is no ROS recording, which alone has a --depth-topic")
        return kind.read_source(path)
    if not path.is_dir():
        raise SequenceError(
            f"{path}: is a file, neither a folder nor called *.sens (ScanNet), *.bag, *.mcap or "
            "*.db3 (ROS)"
        )
    for entry in sorted(path.iterdir()):
        if is_known(entry):
            raise SequenceError(f"{path}: {entry.name} in it is a recording; give that")
    raise SequenceError(
        f"{path}: neither a depth/ folder nor depth.txt (TUM RGB-D) nor *.depth.png (7-Scenes) in "
        "it"
    )
