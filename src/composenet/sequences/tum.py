"""TUM RGB-D.

```
depth.txt                `timestamp file`; images uint16, 5000 units a metre
rgb.txt                  `timestamp file`, optional
groundtruth.txt          `timestamp tx ty tz qx qy qz qw`, camera to world, optional
camera-intrinsics.txt    3x3, ours: the format has no place for them
```
Streams are joined by nearest timestamp, at most 0.02 s apart.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from composenet.errors import SequenceError
from composenet.geometry.transform import make_T, rotation_from_quaternion
from composenet.sequences.source import (
    Source,
    SourceFrame,
    read_gravity,
    read_intrinsics,
    read_text,
    with_pose,
    without_colour,
)

INTRINSICS_FILE = "camera-intrinsics.txt"
MAX_GAP_S = 0.02


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
    color_at, pose_at = nearest(depth_s, color_s), nearest(depth_s, pose_s)
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
        if len(poses) and not frame.problem:
            frame = _posed(frame, poses[pose_at[index]] if pose_at[index] >= 0 else None)
        frames.append(frame)
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


def nearest(
    at_s: NDArray[np.float64], stream_s: NDArray[np.float64], max_gap_s: float = MAX_GAP_S
) -> NDArray[np.int64]:
    """For each of the times (N,), the index of the stream's nearest, -1 beyond the gap.

    The stream (M,) need not be sorted and may be empty.
    """
    if not len(stream_s):
        return np.full(len(at_s), -1)
    order = np.argsort(stream_s, kind="stable")
    ordered = stream_s[order]
    right = np.clip(np.searchsorted(ordered, at_s), 0, len(ordered) - 1)
    left = np.maximum(right - 1, 0)
    closer = np.where(np.abs(ordered[left] - at_s) <= np.abs(ordered[right] - at_s), left, right)
    return np.where(np.abs(ordered[closer] - at_s) <= max_gap_s, order[closer], -1)


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
    """Timestamps (N,) and rows (N, 7) `tx ty tz qx qy qz qw`; lines of other shape dropped. Raises
    SequenceError where all are."""
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
    return table[:, 0], table[:, 1:]


def _posed(frame: SourceFrame, row: NDArray[np.float64] | None) -> SourceFrame:
    if row is None:
        return replace(frame, problem=f"no pose within {MAX_GAP_S} s")
    x, y, z, w = row[3:]
    norm = float(np.sqrt(np.square(np.clip(row[3:], -2, 2)).sum()))
    if not np.isfinite(row).all():
        return replace(frame, problem="pose is not finite (NaN or inf)")
    if not 0.9 < norm < 1.1:
        return replace(frame, problem="pose is not rigid (a unit quaternion expected)")
    return with_pose(frame, make_T(rotation_from_quaternion([w, x, y, z]), row[:3]))


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
