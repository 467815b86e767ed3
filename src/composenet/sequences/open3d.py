"""What Open3D's recorders write, and the poses that its reconstruction system adds.

```
depth/N.png              uint16, millimetres
color/N.{jpg,png}        of the depth images' size
camera_intrinsic.json    or intrinsic.json; intrinsic_matrix: 9 numbers, column by column
scene/trajectory.log     optional: of the N-th depth image, from 0 on, a line `N N N+1`, then 4x4,
                         camera to world, metres; without it pose/N.txt as in a plain folder
```
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from composenet.errors import SequenceError
from composenet.sequences import folder
from composenet.sequences.source import (
    Source,
    SourceFrame,
    checked_K,
    posed,
    read_gravity,
    read_text,
)

INTRINSICS_FILES = ("camera_intrinsic.json", "intrinsic.json")  # of one recorder and the others
POSES_FILE = "scene/trajectory.log"
_LINES = 5  # of a pose


def matches(path: Path) -> bool:
    """Whether the folder looks like this format: a plain one whose intrinsics are Open3D's."""
    plain = folder.matches(path) and not (path / folder.INTRINSICS_FILE).is_file()
    return plain and _intrinsics_file(path).is_file()


def read_source(path: Path) -> Source:
    """The recording of such a folder. Raises SequenceError."""
    frames, warnings = folder.matched_frames(path)
    poses = _read_trajectory(path / POSES_FILE)
    if poses:
        frames, has_poses = _with_poses(path / POSES_FILE, frames, poses), True
    else:
        frames, has_poses = folder.frames_with_poses(path, frames)
    intrinsics = _intrinsics_file(path)
    return Source(
        path=path,
        frames=frames,
        has_poses=has_poses,
        K=_read_intrinsics(intrinsics),
        intrinsics_file=intrinsics.name,
        poses_file=f"{POSES_FILE} or {folder.POSES_FILE}",
        depth_scale=1000.0,
        gravity=read_gravity(path),
        warnings=warnings,
    )


def _intrinsics_file(path: Path) -> Path:
    """The first that is there, else where it should be."""
    found = (path / name for name in INTRINSICS_FILES if (path / name).is_file())
    return next(found, path / INTRINSICS_FILES[0])


def _read_intrinsics(path: Path) -> NDArray[np.float64]:
    try:
        numbers = np.array(json.loads(read_text(path))["intrinsic_matrix"], dtype=float)
        K = numbers.reshape(3, 3).T
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError):
        raise SequenceError(
            f"{path}: no intrinsic_matrix of 9 numbers in it, as Open3D writes it"
        ) from None
    return checked_K(path, K)


def _read_trajectory(path: Path) -> dict[int, NDArray[np.float64]]:
    """Poses (4, 4) by the place of their depth image; empty if there is no such file. Raises
    SequenceError."""
    if not path.is_file():
        return {}
    lines = [
        (number, line.split())
        for number, line in enumerate(read_text(path).splitlines(), start=1)
        if line.strip()
    ]
    poses = {}
    for at in range(0, len(lines), _LINES):
        try:
            rows = [words for _, words in lines[at + 1 : at + _LINES]]
            poses[int(lines[at][1][0])] = np.array(rows, dtype=float).reshape(4, 4)
        except ValueError:
            raise SequenceError(
                f"{path}: not as Open3D writes it: `N N N+1`, then a 4x4 pose expected from line "
                f"{lines[at][0]} on"
            ) from None
    return poses


def _with_poses(
    path: Path, frames: tuple[SourceFrame, ...], poses: dict[int, NDArray[np.float64]]
) -> tuple[SourceFrame, ...]:
    """The frames with the poses of their places among those with depth. Raises SequenceError where
    there are more: then nobody knows whose they are."""
    places = {frame.index: place for place, frame in enumerate(f for f in frames if f.depth)}
    if max(poses) >= len(places):
        raise SequenceError(
            f"{path}: has a pose of depth image number {max(poses)}, but there are only "
            f"{len(places)}, from 0 on; were some removed since?"
        )
    return tuple(
        posed(frame, poses.get(places.get(frame.index, -1)), f"none of its place in {POSES_FILE}")
        for frame in frames
    )
