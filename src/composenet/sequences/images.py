"""Depth and colour images from disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from composenet.errors import SequenceError

_MAX_PIXELS = 64_000_000  # a corrupt header may claim any size
_SATURATED = 65535  # what sensors write for "out of range"
_DEPTH_MODES = ("I;16", "I;16B", "I;16L", "I")


def image_size(path: Path) -> tuple[int, int]:
    """(width, height) from the header alone. Raises SequenceError."""
    with _opened(path) as image:
        return image.size


def read_depth(path: Path) -> NDArray[np.uint16]:
    """(H, W) uint16 depth in the file's units, saturated values (65535) set to 0.

    Raises SequenceError: unreadable, truncated, or not a 16-bit grey image.
    """
    with _opened(path) as image:
        if image.mode not in _DEPTH_MODES:
            raise SequenceError(f"depth is not a 16-bit grey image (mode {image.mode})")
        raw = _decoded(image)
    return np.where((raw > 0) & (raw < _SATURATED), raw, 0).astype(np.uint16)


def read_color(path: Path, width: int, height: int) -> NDArray[np.uint8]:
    """(height, width, 3) uint8, stretched to the asked size. Raises SequenceError."""
    with _opened(path) as image:
        _decoded(image)
        try:
            rgb = image.convert("RGB")
        except ValueError:
            raise SequenceError("color image has no RGB form") from None
        if rgb.size != (width, height):
            rgb = rgb.resize((width, height), Image.Resampling.BILINEAR)
        return np.array(rgb)


def _opened(path: Path) -> Image.Image:
    try:
        image = Image.open(path)
    except FileNotFoundError:
        raise SequenceError("image is missing") from None
    except PermissionError:
        raise SequenceError("image may not be read (permission denied)") from None
    except Exception:  # decoders raise many kinds on corrupt bytes
        raise SequenceError("image is corrupt or of an unknown kind") from None
    if image.size[0] * image.size[1] > _MAX_PIXELS:
        image.close()
        raise SequenceError(f"image claims to be {image.size[0]}x{image.size[1]}")
    return image


def _decoded(image: Image.Image) -> NDArray:
    try:
        return np.array(image)
    except Exception:  # decoders raise many kinds on corrupt bytes
        raise SequenceError("image is truncated or corrupt") from None
