"""What a format's reader tells about a recording, and the text files they share."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from composenet.errors import SequenceError
from composenet.geometry.rigid import is_rigid
from composenet.geometry.transform import rigid_T
from composenet.records import FloatArray
from composenet.sequences.images import ImageSource
from composenet.sequences.registration import ColorCamera

_MAX_POSE_NUMBER = 1e9  # metres; larger ones overflow sooner or later
COLOR_SUFFIXES = (".png", ".jpg", ".jpeg")
DEPTH_SUFFIXES = (".png",)
_DECIMAL = re.compile(r"\d+(\.\d+)?")


@dataclass(frozen=True)
class SourceFrame:
    """One frame on disk. index: its place in the recording, skipped frames counted.

    T_source_camera: (4, 4), in the recording's own world, None where it has no poses.
    problem: why the frame cannot be used, None while it can.
    """

    index: int
    name: str
    depth: ImageSource | None
    color: ImageSource | None = None
    T_source_camera: FloatArray | None = None
    timestamp_s: float | None = None
    problem: str | None = None


@dataclass(frozen=True)
class Source:
    """A recording on disk, before any image is read.

    K: (3, 3) intrinsics of the depth images as they lie there, None where the recording does
    not say. intrinsics_file, poses_file: where they and the poses belong. depth_scale: depth units
    a metre. color_camera: of the colour images, where that is another camera and the recording says
    so. gravity: (3,) direction of gravity in the recording's world, if it says. levelled: its
    world is z-up with the floor at z = 0 by construction.
    """

    path: Path
    frames: tuple[SourceFrame, ...]
    has_poses: bool
    K: FloatArray | None
    intrinsics_file: str
    poses_file: str
    depth_scale: float
    gravity: FloatArray | None = None
    levelled: bool = False
    color_camera: ColorCamera | None = None
    warnings: tuple[str, ...] = ()

    def without_poses(self) -> Source:
        """The recording as if it had none: a frame with nothing wrong but its pose is usable."""

        def usable(frame: SourceFrame) -> SourceFrame:
            gone = isinstance(frame.depth, Path) and not frame.depth.is_file()
            problem = frame.problem if frame.depth is None or gone else None
            return replace(frame, T_source_camera=None, problem=problem)

        frames = tuple(map(usable, self.frames))
        return replace(self, frames=frames, has_poses=False, gravity=None, levelled=False)


def read_text(path: Path) -> str:
    """Text of a file, undecodable bytes replaced, without a byte order mark. Raises
    SequenceError."""
    try:
        return path.read_text(encoding="utf-8-sig", errors="replace")
    except OSError as error:
        raise SequenceError(f"{path}: cannot be read ({error.strerror})") from None


def read_numbers(path: Path, count: int, what: str) -> NDArray[np.float64]:
    """The `count` numbers of a text file, but for comments (# to the end of a line). Raises
    SequenceError when it holds anything else."""
    lines = (line.partition("#")[0] for line in read_text(path).splitlines())
    words = " ".join(lines).replace(",", " ").split()
    try:
        values = np.array([float(word) for word in words])
    except ValueError:
        values = np.zeros(0)
    if len(values) != count:
        raise SequenceError(f"{path}: expected {what} ({count} numbers)")
    return values


def read_intrinsics(path: Path, size: int) -> NDArray[np.float64] | None:
    """(3, 3) intrinsics from a `size` x `size` matrix file, None if there is no such file.

    Raises SequenceError when it is no intrinsics matrix.
    """
    if not path.is_file():
        return None
    numbers = read_numbers(path, size * size, f"a {size}x{size} intrinsics matrix")
    return checked_K(path, numbers.reshape(size, size)[:3, :3])


def checked_K(path: Path, K: FloatArray) -> NDArray[np.float64]:
    """The (3, 3) matrix of a file. Raises SequenceError when it is no intrinsics matrix."""
    usable = np.isfinite(K).all() and K[0, 0] > 0 and K[1, 1] > 0
    if not usable or not np.allclose(K[2], [0, 0, 1], atol=1e-6):
        raise SequenceError(f"{path}: not an intrinsics matrix (fx 0 cx, 0 fy cy, 0 0 1 expected)")
    return make_K(K[0, 0], K[1, 1], K[0, 2], K[1, 2])


def make_K(fx: float, fy: float, cx: float, cy: float) -> NDArray[np.float64]:
    """(3, 3) intrinsics matrix."""
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def read_gravity(folder: Path) -> NDArray[np.float64] | None:
    """Unit direction of gravity from `gravity-direction.txt`, None if there is no such file."""
    path = folder / "gravity-direction.txt"
    if not path.is_file():
        return None
    gravity = read_numbers(path, 3, "the direction of gravity")
    length = np.linalg.norm(gravity)
    if not (np.isfinite(length) and length > 0):
        raise SequenceError(f"{path}: {gravity} is no direction")
    return gravity / length


def with_pose(frame: SourceFrame, T: FloatArray) -> SourceFrame:
    """The frame with a camera-to-world pose, or with the problem that the pose has.

    Rotations are accepted within 1 % of orthonormal and made exact.
    """
    if not (np.abs(T) < _MAX_POSE_NUMBER).all():
        return replace(frame, problem="pose is not finite (NaN or inf)")
    if not is_rigid(T):
        return replace(frame, problem="pose is not rigid (a rotation and a translation expected)")
    return replace(frame, T_source_camera=rigid_T(T))


def posed(frame: SourceFrame, T: FloatArray | None, lacking: str) -> SourceFrame:
    """The frame with its pose. Without one that is its problem, and `lacking` says why; a problem
    that it has already stays."""
    if frame.problem:
        return frame
    return with_pose(frame, T) if T is not None else replace(frame, problem=f"no pose: {lacking}")


def images_by_stem(folder: Path, suffixes: tuple[str, ...]) -> dict[str, Path]:
    """Image files of a folder by name without suffix; empty if there is no folder. Hidden ones
    (`._1.png`, which some file systems keep beside `1.png`) are none."""
    if not folder.is_dir():
        return {}
    shown = (path for path in folder.iterdir() if not path.name.startswith("."))
    files = sorted(path for path in shown if path.suffix.lower() in suffixes and path.is_file())
    return {path.stem: path for path in reversed(files)}


def without_colour(frames: Sequence[SourceFrame], why: str) -> tuple[str, ...]:
    """A warning where frames of a recording that has colour have none."""
    lacking = [frame.name for frame in frames if frame.depth and not frame.color]
    return (counted(lacking, f"without colour: {why}"),) if lacking else ()


def counted(names: Sequence[str], what: str) -> str:
    """`2 frames WHAT (first NAME)`."""
    frames, first = ("1 frame", "") if len(names) == 1 else (f"{len(names)} frames", "first ")
    return f"{frames} {what} ({first}{names[0]})"


def in_order(names: Iterable[str]) -> list[str]:
    """Names of frames as they follow each other: by value where all are decimal numbers (times
    perhaps, some with fewer digits), else `2` before `10` and `frame-2` before `frame-10`."""
    given = list(names)
    if all(_DECIMAL.fullmatch(name) for name in given):
        return sorted(given, key=lambda name: (Decimal(name), name))
    return sorted(given, key=natural_key)


def natural_key(name: str) -> list[tuple[int, int, str]]:
    """Sorts `2` before `10` and `frame-2` before `frame-10`."""
    parts = re.split(r"(\d+)", name)
    return [(1, int(p), "") if p.isdecimal() else (0, 0, p) for p in parts]
