"""ScanNet's `.sens` file, version 4: a whole recording in one file, read where it lies.

Little-endian: a header with intrinsics and sizes, then each frame's pose, times, and compressed
images. The file may be gigabytes: only the frames' heads are read to know what it holds.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from composenet.errors import SequenceError
from composenet.sequences.images import PackedImage, Packing
from composenet.sequences.source import (
    Source,
    SourceFrame,
    checked_K,
    read_gravity,
    with_pose,
    without_colour,
)

_VERSION = 4
_MAX_NAME = 4096  # bytes; a corrupt file may claim any length
_COLOR_PACKINGS: dict[int, Packing] = {0: "rgb", 1: "file", 2: "file"}
_DEPTH_PACKINGS: dict[int, Packing] = {0: "uint16", 1: "zlib uint16"}
_HEADER = struct.Struct("<64f2i4IfQ")  # 4 matrices, 2 packings, 2 sizes, units a metre, frames
_FRAME = struct.Struct("<16f4Q")  # camera to world, 2 times, bytes of colour and depth


@dataclass(frozen=True)
class _Header:
    """What stands before the frames. K_depth: None where it is no intrinsics matrix."""

    K_depth: NDArray[np.float64] | None
    color_packing: Packing | None
    depth_packing: Packing
    color_size: tuple[int, int]
    depth_size: tuple[int, int]
    depth_scale: float
    frames: int
    warnings: tuple[str, ...]


def matches(path: Path) -> bool:
    """Whether the file is called as this format's are."""
    return path.is_file() and path.suffix.lower() == ".sens"


def read_source(path: Path) -> Source:
    """The recording of a `.sens` file. Raises SequenceError."""
    with path.open("rb") as file:
        header = _read_header(path, file)
        frames = tuple(_read_frames(path, file, header))
    if not frames:
        raise SequenceError(f"{path}: no frame in it")
    warnings = list(header.warnings)
    if missing := header.frames - len(frames):
        warnings.append(f"{missing} of its {header.frames} frames are missing or damaged")
    if header.color_packing:
        warnings += without_colour(frames, "the file has none of them")
    return Source(
        path=path,
        frames=frames,
        has_poses=True,
        K=header.K_depth,
        intrinsics_file="the file's header",
        poses_file="poses in the file",
        depth_scale=header.depth_scale,
        gravity=read_gravity(path.parent),
        warnings=tuple(warnings),
    )


def _read_header(path: Path, file: BinaryIO) -> _Header:
    version = _unpacked(path, file, struct.Struct("<I"))[0]
    if version != _VERSION:
        raise SequenceError(f"{path}: not a .sens file of version {_VERSION} (it says {version})")
    length = _unpacked(path, file, struct.Struct("<Q"))[0]
    if length > _MAX_NAME:
        raise SequenceError(f"{path}: not a .sens file (a sensor name of {length} bytes)")
    file.seek(length, 1)
    *matrices, color, depth, wc, hc, wd, hd, scale, frames = _unpacked(path, file, _HEADER)
    warnings = []
    try:
        K = checked_K(path, np.array(matrices[32:48]).reshape(4, 4)[:3, :3])
    except SequenceError:
        K = None
    if not (np.isfinite(scale) and scale > 0):
        warnings.append(f"{scale:g} depth units a metre, as it says, are impossible: 1000 taken")
        scale = 1000.0
    if color not in _COLOR_PACKINGS:
        warnings.append("colour is compressed in an unknown way and left out")
    if depth not in _DEPTH_PACKINGS:
        raise SequenceError(
            f"{path}: depth compression {depth} cannot be read (0: none, 1: zlib); export it with "
            "ScanNet's own reader and track the folder"
        )
    return _Header(
        K_depth=K,
        color_packing=_COLOR_PACKINGS.get(color),
        depth_packing=_DEPTH_PACKINGS[depth],
        color_size=(wc, hc),
        depth_size=(wd, hd),
        depth_scale=float(scale),
        frames=frames,
        warnings=tuple(warnings),
    )


def _read_frames(path: Path, file: BinaryIO, header: _Header) -> Iterator[SourceFrame]:
    """The frames until one has no depth, or images beyond the file's end."""
    length = path.stat().st_size
    for index in range(header.frames):
        head = file.read(_FRAME.size)
        if len(head) < _FRAME.size:
            return
        *numbers, _, _, color_bytes, depth_bytes = _FRAME.unpack(head)
        at_color = file.tell()
        at_depth = at_color + color_bytes
        if not depth_bytes or at_depth + depth_bytes > length:
            return
        color = None
        if color_bytes and header.color_packing:
            color = PackedImage(
                path, at_color, color_bytes, header.color_packing, header.color_size
            )
        frame = SourceFrame(
            index=index,
            name=str(index),
            depth=PackedImage(path, at_depth, depth_bytes, header.depth_packing, header.depth_size),
            color=color,
        )
        yield with_pose(frame, np.array(numbers).reshape(4, 4))
        file.seek(at_depth + depth_bytes)


def _unpacked(path: Path, file: BinaryIO, what: struct.Struct) -> tuple:
    data = file.read(what.size)
    if len(data) < what.size:
        raise SequenceError(f"{path}: not a .sens file: it ends within its header")
    return what.unpack(data)
