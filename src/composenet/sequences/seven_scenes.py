"""7-Scenes, and what 3DMatch made of other recordings: the files of a frame side by side.

```
NAME.depth.png           uint16, millimetres, 0 or 65535 = no measurement
NAME.color.{jpg,png}     optional
NAME.pose.txt            optional: 4x4, camera to world, metres
camera-intrinsics.txt    3x3, of the depth images: here or, as in 3DMatch, in the folder above;
                         7-Scenes has none (its depth camera's are 585, 585, 320, 240)
gravity-direction.txt    optional: 3 numbers, pointing down in the world
```
"""

from __future__ import annotations

from pathlib import Path

from composenet.sequences.folder import INTRINSICS_FILE, framed, with_pose_files
from composenet.sequences.source import (
    COLOR_SUFFIXES,
    DEPTH_SUFFIXES,
    Source,
    images_by_stem,
    read_gravity,
    read_intrinsics,
)

_DEPTH, _COLOR, _POSE = ".depth", ".color", ".pose.txt"


def matches(path: Path) -> bool:
    """Whether the folder looks like this format."""
    return bool(_images(path, _DEPTH, DEPTH_SUFFIXES))


def read_source(path: Path) -> Source:
    """The recording of such a folder. Raises SequenceError."""
    color = _images(path, _COLOR, COLOR_SUFFIXES)
    frames, warnings = framed(_images(path, _DEPTH, DEPTH_SUFFIXES), color, path)
    poses = {file.name.removesuffix(_POSE): file for file in path.glob(f"[!.]*{_POSE}")}
    frames, has_poses = with_pose_files(frames, poses, f"no file NAME{_POSE}")
    here, above = (folder / INTRINSICS_FILE for folder in (path, path.resolve().parent))
    return Source(
        path=path,
        frames=frames,
        has_poses=has_poses,
        K=read_intrinsics(here if here.is_file() else above, 3),
        intrinsics_file=INTRINSICS_FILE,
        poses_file=f"NAME{_POSE} (4x4, camera to world, metres)",
        depth_scale=1000.0,
        gravity=read_gravity(path),
        warnings=warnings,
    )


def _images(path: Path, kind: str, suffixes: tuple[str, ...]) -> dict[str, Path]:
    """Images of a kind by the name of their frame."""
    files = images_by_stem(path, suffixes)
    return {stem.removesuffix(kind): file for stem, file in files.items() if stem.endswith(kind)}
