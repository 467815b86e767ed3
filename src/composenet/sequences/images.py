"""Depth and colour images from disk: files, and parts of a file that holds many."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from composenet.errors import SequenceError

_MAX_PIXELS = 64_000_000  # a corrupt header may claim any size
_MAX_BYTES = 256_000_000  # likewise, of a packed image
_SATURATED = 65535  # what sensors write for "out of range"
_DEPTH_MODES = ("I;16", "I;16B", "I;16L", "I")
Packing = Literal["file", "rgb", "uint16", "zlib uint16"]


class ImageWithin(Protocol):
    """An image that is no file of its own."""

    @property
    def known_size(self) -> tuple[int, int] | None:
        """(width, height), None where only the image says it."""

    def open(self) -> Image.Image:
        """The image. Raises what decoders raise, and SequenceError."""


@dataclass(frozen=True)
class PackedImage:
    """An image within a larger file. packing: the bytes of an image file, or pixels row by row.
    size: width, height; an image file says its own."""

    path: Path
    offset: int
    length: int
    packing: Packing
    size: tuple[int, int]

    @property
    def known_size(self) -> tuple[int, int] | None:
        """(width, height), None of an image file."""
        return None if self.packing == "file" else self.size

    def open(self) -> Image.Image:
        """The image. Raises what decoders raise, and SequenceError where it claims to be huge."""
        if self.length > _MAX_BYTES:
            raise SequenceError(f"image claims to be of {self.length:,} bytes")
        with self.path.open("rb") as file:
            file.seek(self.offset)
            data = file.read(self.length)
        if self.packing == "file":
            return Image.open(BytesIO(data))
        width, height = possible_size(self.size)
        if self.packing == "rgb":
            return Image.frombytes("RGB", self.size, data)
        if self.packing == "zlib uint16":
            data = zlib.decompressobj().decompress(data, 2 * width * height)
        return Image.fromarray(np.frombuffer(data, "<u2").reshape(height, width))


ImageSource = Path | ImageWithin


def image_size(source: ImageSource) -> tuple[int, int]:
    """(width, height) from the header alone. Raises SequenceError."""
    known = None if isinstance(source, Path) else source.known_size
    if known is not None:
        return possible_size(known)
    with _opened(source) as image:
        return image.size


def read_depth(source: ImageSource) -> NDArray[np.uint16]:
    """(H, W) uint16 depth in the file's units, saturated values (65535) set to 0.

    Raises SequenceError: unreadable, truncated, or not a 16-bit grey image.
    """
    with _opened(source) as image:
        if image.mode not in _DEPTH_MODES:
            raise SequenceError(f"depth is not a 16-bit grey image (mode {image.mode})")
        raw = _decoded(image)
    return np.where((raw > 0) & (raw < _SATURATED), raw, 0).astype(np.uint16)


def read_color(source: ImageSource, width: int, height: int) -> NDArray[np.uint8]:
    """(height, width, 3) uint8, stretched to the asked size. Raises SequenceError."""
    with _opened(source) as image:
        _decoded(image)
        try:
            rgb = image.convert("RGB")
        except ValueError:
            raise SequenceError("color image has no RGB form") from None
        if rgb.size != (width, height):
            rgb = rgb.resize((width, height), Image.Resampling.BILINEAR)
        return np.array(rgb)


def _opened(source: ImageSource) -> Image.Image:
    try:
        image = Image.open(source) if isinstance(source, Path) else source.open()
    except SequenceError:
        raise
    except FileNotFoundError:
        raise SequenceError("image is missing") from None
    except PermissionError:
        raise SequenceError("image may not be read (permission denied)") from None
    except Exception:  # decoders raise many kinds on corrupt bytes
        raise SequenceError("image is corrupt or of an unknown kind") from None
    try:
        possible_size(image.size)
    except SequenceError:
        image.close()
        raise
    return image


def possible_size(size: tuple[int, int]) -> tuple[int, int]:
    """The size. Raises SequenceError where no image has it."""
    if not 0 < size[0] * size[1] <= _MAX_PIXELS:
        raise SequenceError(f"image claims to be {size[0]}x{size[1]}")
    return size


def _decoded(image: Image.Image) -> NDArray:
    try:
        return np.array(image)
    except Exception:  # decoders raise many kinds on corrupt bytes
        raise SequenceError("image is truncated or corrupt") from None
