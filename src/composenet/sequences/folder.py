"""The plain folder: one file a frame, matched by name.

```
depth/NAME.png           uint16, millimetres, 0 = no measurement
color/NAME.{jpg,png}     optional; the folder may be called rgb/
pose/NAME.txt            optional: 4x4, camera to world, metres; or poses/
camera-intrinsics.txt    optional: 3x3, of the depth images
gravity-direction.txt    optional: 3 numbers, pointing down in the world
```
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from composenet.errors import SequenceError
from composenet.sequences.source import (
    COLOR_SUFFIXES,
    DEPTH_SUFFIXES,
    Source,
    SourceFrame,
    images_by_stem,
    in_order,
    posed,
    read_gravity,
    read_intrinsics,
    read_numbers,
    with_pose,
    without_colour,
)

INTRINSICS_FILE = "camera-intrinsics.txt"
POSES_FILE = "pose/NAME.txt (4x4, camera to world, metres)"
_COLOR_FOLDERS = ("color", "rgb")
_POSE_FOLDERS = ("pose", "poses")


def matches(path: Path) -> bool:
    """Whether the folder looks like this format."""
    return (path / "depth").is_dir()


def read_source(path: Path) -> Source:
    """The recording of a plain folder. Raises SequenceError."""
    frames, warnings = matched_frames(path)
    frames, has_poses = frames_with_poses(path, frames)
    return Source(
        path=path,
        frames=frames,
        has_poses=has_poses,
        K=read_intrinsics(path / INTRINSICS_FILE, 3),
        intrinsics_file=INTRINSICS_FILE,
        poses_file=POSES_FILE,
        depth_scale=1000.0,
        gravity=read_gravity(path),
        warnings=warnings,
    )


def matched_frames(path: Path) -> tuple[tuple[SourceFrame, ...], tuple[str, ...]]:
    """Frames of the depth and colour folders, and warnings, as `framed` makes them. Raises
    SequenceError when there is no depth image."""
    depth = images_by_stem(path / "depth", DEPTH_SUFFIXES)
    color_folder = _first(path, _COLOR_FOLDERS)
    if not depth:
        others = sorted({p.suffix for p in (path / "depth").iterdir() if p.is_file()})
        found = f", but {' '.join(others)}" if any(others) else ""
        raise SequenceError(
            f"{path / 'depth'}: no depth image (*.png, 16 bits) in it{found}; write depth as "
            "16-bit PNG in millimetres"
        )
    return framed(depth, images_by_stem(color_folder, COLOR_SUFFIXES), color_folder)


def framed(
    depth: Mapping[str, Path], color: Mapping[str, Path], color_folder: Path
) -> tuple[tuple[SourceFrame, ...], tuple[str, ...]]:
    """Frames of images by name, in the natural order of their names, and warnings.

    A colour image without depth is a frame with a problem, unless no name matches at all:
    then colour is left out.
    """
    warnings: tuple[str, ...] = ()
    if color and not depth.keys() & color.keys():
        warnings = (f"{color_folder}: no file has the name of a depth image; colour left out",)
        color = {}
    names = in_order(depth.keys() | color.keys())
    frames = tuple(
        SourceFrame(
            index=index,
            name=name,
            depth=depth.get(name),
            color=color.get(name),
            problem=None if name in depth else "no depth image",
        )
        for index, name in enumerate(names)
    )
    if color:
        where = color_folder.resolve().name
        warnings = without_colour(frames, f"no file of their name in {where}/")
    return frames, warnings


def _first(path: Path, names: Sequence[str]) -> Path:
    """The first of these folders that is there, else where it should be."""
    found = (path / name for name in names if (path / name).is_dir())
    return next(found, path / names[0])


def frames_with_poses(
    path: Path, frames: tuple[SourceFrame, ...]
) -> tuple[tuple[SourceFrame, ...], bool]:
    """The frames with their poses, and whether the recording has any."""
    folder = _first(path, _POSE_FOLDERS)
    files = {file.stem: file for file in folder.glob("*.txt")}
    return with_pose_files(frames, files, f"no file of its name in {folder.name}/")


def with_pose_files(
    frames: tuple[SourceFrame, ...], files: Mapping[str, Path], lacking: str
) -> tuple[tuple[SourceFrame, ...], bool]:
    """The frames with the poses of files by name, and whether there are any files. lacking: what
    is said of a frame that has none."""
    if not files:
        return frames, False
    return tuple(_with_pose_file(frame, files.get(frame.name), lacking) for frame in frames), True


def _with_pose_file(frame: SourceFrame, path: Path | None, lacking: str) -> SourceFrame:
    if frame.problem or path is None:
        return posed(frame, None, lacking)
    try:
        return with_pose(frame, read_numbers(path, 16, "a 4x4 pose").reshape(4, 4))
    except SequenceError:
        return replace(frame, problem="pose is not a 4x4 matrix")
