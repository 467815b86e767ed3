"""What Open3D's recorders write, and the poses that its reconstruction system adds.

```
depth/N.png              uint16, millimetres
color/N.{jpg,png}        of the depth images' size
camera_intrinsic.json    intrinsic_matrix: 9 numbers, column by column
scene/trajectory.log     optional: of frame N a line `N N N+1`, then 4x4, camera to world, metres
```
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from composenet.errors import SequenceError
from composenet.sequences.folder import matched_frames
from composenet.sequences.source import (
    Source,
    SourceFrame,
    checked_K,
    read_gravity,
    read_text,
    with_pose,
)

INTRINSICS_FILE = "camera_intrinsic.json"
POSES_FILE = "scene/trajectory.log"
_LINES = 5  # of a pose


def matches(path: Path) -> bool:
    """Whether the folder looks like this format."""
    return (path / "depth").is_dir() and (path / INTRINSICS_FILE).is_file()


def read_source(path: Path) -> Source:
    """The recording of such a folder. Raises SequenceError."""
    frames, warnings = matched_frames(path)
    poses = _read_trajectory(path / POSES_FILE)
    if poses:
        frames = tuple(_posed(frame, poses.get(frame.index)) for frame in frames)
    return Source(
        path=path,
        frames=frames,
        has_poses=bool(poses),
        K=_read_intrinsics(path / INTRINSICS_FILE),
        intrinsics_file=INTRINSICS_FILE,
        poses_file=POSES_FILE,
        depth_scale=1000.0,
        gravity=read_gravity(path),
        warnings=warnings,
    )


def _read_intrinsics(path: Path) -> NDArray[np.float64]:
    try:
        numbers = np.array(json.loads(read_text(path))["intrinsic_matrix"], dtype=float)
        K = numbers.reshape(3, 3).T
    except (ValueError, KeyError, TypeError):
        raise SequenceError(
            f"{path}: no intrinsic_matrix of 9 numbers in it, as Open3D writes it"
        ) from None
    return checked_K(path, K)


def _read_trajectory(path: Path) -> dict[int, NDArray[np.float64]]:
    """Poses (4, 4) by frame; empty if there is no such file. Raises SequenceError."""
    if not path.is_file():
        return {}
    lines = [line.split() for line in read_text(path).splitlines() if line.strip()]
    poses = {}
    try:
        for at in range(0, len(lines), _LINES):
            frame = int(lines[at][0])
            poses[frame] = np.array(lines[at + 1 : at + _LINES], dtype=float).reshape(4, 4)
    except ValueError:
        raise SequenceError(
            f"{path}: not as Open3D writes it (line {at + 1} and the next: `N N N+1`, a 4x4 pose)"
        ) from None
    return poses


def _posed(frame: SourceFrame, T: NDArray[np.float64] | None) -> SourceFrame:
    if frame.problem:
        return frame
    if T is None:
        return replace(frame, problem=f"no pose: none of its number in {POSES_FILE}")
    return with_pose(frame, T)
