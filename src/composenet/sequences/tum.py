"""TUM RGB-D.

```
depth.txt                `timestamp file`; images uint16, 5000 units a metre
rgb.txt                  `timestamp file`, optional
groundtruth.txt          `timestamp tx ty tz qx qy qz qw`, camera to world, optional
camera-intrinsics.txt    3x3, ours: the format has no place for them
```
Depth and colour images are paired by time, at most 0.02 s apart. Poses are interpolated between two
that are at most 0.15 s apart, or equal; else the nearest holds for 0.02 s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from composenet.errors import SequenceError
from composenet.sequences.source import (
    Source,
    SourceFrame,
    posed,
    read_gravity,
    read_intrinsics,
    read_text,
    without_colour,
)
from composenet.sequences.stamps import MAX_GAP_S, Trajectory, nearest, paired_or_nearest

INTRINSICS_FILE = "camera-intrinsics.txt"
_POSES_APART_S = 0.15


def matches(path: Path) -> bool:
    """Whether the folder looks like this format."""
    return (path / "depth.txt").is_file()


def read_source(path: Path) -> Source:
    """The recording of a TUM RGB-D folder. Raises SequenceError."""
    depth_s, depth_files = _read_stream(path / "depth.txt")
    if not len(depth_s):
        raise SequenceError(f"{path / 'depth.txt'}: no `timestamp file` line in it")
    color_s, color_files = _read_stream(path / "rgb.txt")
    pose_s, poses = _read_trajectory(path / "groundtruth.txt")
    color_at = paired_or_nearest(depth_s, color_s)
    frames = []
    for index, file in enumerate(depth_files):
        frame = SourceFrame(
            index=index,
            name=Path(file).stem,
            depth=path / file,
            color=path / color_files[color_at[index]] if color_at[index] >= 0 else None,
            timestamp_s=float(depth_s[index]),
            problem=None if _is_file(path / file) else "no depth image",
        )
        frames.append(frame)
    if len(poses):
        frames = _posed(frames, depth_s, pose_s, poses)
    return Source(
        path=path,
        frames=tuple(frames),
        has_poses=len(poses) > 0,
        K=read_intrinsics(path / INTRINSICS_FILE, 3),
        intrinsics_file=INTRINSICS_FILE,
        poses_file="groundtruth.txt",
        depth_scale=5000.0,
        gravity=read_gravity(path),
        warnings=without_colour(frames, f"rgb.txt has none within {MAX_GAP_S} s of them")
        if color_files
        else (),
    )


def _read_stream(path: Path) -> tuple[NDArray[np.float64], list[str]]:
    """Timestamps and files of a `timestamp file` list in time order; empty if missing."""
    entries = []
    for words in _lines(path):
        time = _floats(words[:1])
        if len(words) >= 2 and time is not None and np.isfinite(time[0]):
            entries.append((float(time[0]), words[1]))
    entries.sort()
    return np.array([time for time, _ in entries]), [file for _, file in entries]


def _read_trajectory(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Timestamps (N,), rising, and rows (N, 7) `tx ty tz qx qy qz qw`; lines of other shape, and of
    a time that had one, dropped. Raises SequenceError where all are."""
    rows, lines = [], _lines(path)
    for words in lines:
        row = _floats(words)
        if row is not None and len(row) == 8 and np.isfinite(row[0]):
            rows.append(row)
    if lines and not rows:
        raise SequenceError(
            f"{path}: none of its {len(lines)} lines is `timestamp tx ty tz qx qy qz qw`, 8 "
            f"numbers with spaces between (the first: {' '.join(lines[0])[:80]!r})"
        )
    table = np.array(rows).reshape(-1, 8)
    times_s, order = np.unique(table[:, 0], return_index=True)
    return times_s, table[order, 1:]


def _posed(
    frames: Sequence[SourceFrame],
    depth_s: NDArray[np.float64],
    pose_s: NDArray[np.float64],
    poses: NDArray[np.float64],
) -> list[SourceFrame]:
    """The frames with their poses, or what is wrong with the one nearest in time."""
    problems = [_problem(pose) for pose in poses]
    known = np.where([[problem is None] for problem in problems], poses, np.nan)
    way = Trajectory(pose_s, known, _POSES_APART_S, MAX_GAP_S)
    lacking = (
        f"none within {MAX_GAP_S} s, nor two around it within {_POSES_APART_S} s of each other"
    )
    found = []
    for frame, time_s, near in zip(frames, depth_s, nearest(depth_s, pose_s), strict=True):
        if near >= 0 and problems[near] and not frame.problem:
            found.append(replace(frame, problem=problems[near]))
        else:
            found.append(posed(frame, way.at(time_s), lacking))
    return found


def _problem(pose: NDArray[np.float64]) -> str | None:
    """What is wrong with a line of a trajectory, if anything is."""
    norm = float(np.sqrt(np.square(np.clip(pose[3:], -2, 2)).sum()))
    if not np.isfinite(pose).all():
        return "pose is not finite (NaN or inf)"
    if not 0.9 < norm < 1.1:
        return "pose is not rigid (a unit quaternion expected)"
    return None


def _lines(path: Path) -> list[list[str]]:
    if not path.is_file():
        return []
    lines = (line.split() for line in read_text(path).splitlines() if not line.startswith("#"))
    return [words for words in lines if words]


def _floats(words: list[str]) -> NDArray[np.float64] | None:
    try:
        return np.array([float(word) for word in words])
    except ValueError:
        return None


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # a garbled name: too long, or with a zero byte
        return False
