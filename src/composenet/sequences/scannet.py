"""Exported ScanNet, and sequences with ground truth as we write them.

```
depth/N.png              uint16, millimetres
color/N.{jpg,png}        may differ from depth in size, and be of another camera
pose/N.txt               4x4, camera to world; invalid ones are -inf
intrinsic/intrinsic_depth.txt    4x4 (intrinsic_color and the extrinsics are not used:
                                 poses are those of the depth camera; `registration`)
annotations.json         only what we write (generated, or annotated by a user): then the world is
                         z-up, its floor at z = 0
```
"""

from __future__ import annotations

import json
from pathlib import Path

from composenet.sequences.folder import POSES_FILE, frames_with_poses, matched_frames
from composenet.sequences.source import Source, read_gravity, read_intrinsics

INTRINSICS_FILE = "intrinsic/intrinsic_depth.txt"


def matches(path: Path) -> bool:
    """Whether the folder looks like this format."""
    return (path / "depth").is_dir() and (path / "intrinsic").is_dir()


def read_source(path: Path) -> Source:
    """The recording of an exported ScanNet scene. Raises SequenceError."""
    frames, warnings = matched_frames(path)
    frames, has_poses = frames_with_poses(path, frames)
    return Source(
        path=path,
        frames=frames,
        has_poses=has_poses,
        K=read_intrinsics(path / INTRINSICS_FILE, 4),
        intrinsics_file=INTRINSICS_FILE,
        poses_file=POSES_FILE,
        depth_scale=1000.0,
        gravity=read_gravity(path),
        levelled=has_poses and _is_levelled(path / "annotations.json"),
        warnings=warnings,
    )


def _is_levelled(annotations: Path) -> bool:
    """Whether they are ours, and not somebody's labels of the same name."""
    try:
        data = json.loads(annotations.read_text())
    except (OSError, ValueError):
        return False
    return isinstance(data, dict) and ("generator_version" in data or data.get("levelled") is True)
