"""Depth images compressed by RVL (Wilson, Fast Lossless Depth Image Compression, ISS 2017), as ROS
packs them: width and height, then runs of pixels without and with depth in turn. Of a run without
there is its length; of one with, its length and every pixel's difference from the one before that
has depth, its sign in the lowest bit. Numbers are in groups of three bits, the lowest first, each
behind a bit that says whether more follow; eight such groups make a word, the first in its highest
bits.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from composenet.errors import SequenceError
from composenet.sequences.images import possible_size

_SIZE_BYTES = 8
_MAX_BITS = 32  # of a number


def size(data: bytes) -> tuple[int, int]:
    """(width, height). Raises SequenceError."""
    if len(data) < _SIZE_BYTES:
        raise SequenceError("image is truncated or corrupt")
    width, height = np.frombuffer(data, "<u4", count=2)
    return int(width), int(height)


def decoded(data: bytes) -> NDArray[np.uint16]:
    """(H, W), 0 where nothing was measured. Raises SequenceError."""
    width, height = possible_size(size(data))
    words = np.frombuffer(data, "<u4", count=(len(data) - _SIZE_BYTES) // 4, offset=_SIZE_BYTES)
    pixels = np.zeros(width * height, np.uint16)
    if not _unpack(words, pixels):
        raise SequenceError("image is truncated or corrupt")
    return pixels.reshape(height, width)


@numba.njit(cache=True, nogil=True)
def _unpack(words, pixels):  # type: ignore[no-untyped-def]
    """Fill in the pixels, which are 0; whether the words hold all of them."""
    at, pixel, depth = 0, 0, 0
    while pixel < len(pixels):
        without, at = _number(words, at)
        pixel += without
        if at < 0 or pixel >= len(pixels):
            return at >= 0 and pixel == len(pixels)
        count, at = _number(words, at)
        if at < 0 or pixel + count > len(pixels):
            return False
        for _ in range(count):
            step, at = _number(words, at)
            if at < 0:
                return False
            depth += -(step >> 1) - 1 if step & 1 else step >> 1
            pixels[pixel] = depth & 0xFFFF
            pixel += 1
    return True


@numba.njit(cache=True, nogil=True)
def _number(words, at):  # type: ignore[no-untyped-def]
    """The number whose first group of bits is number `at` of all, and where the next one begins,
    -1 where the words end before, or no such number was written."""
    value = np.int64(0)
    for shift in range(0, _MAX_BITS, 3):
        if at >= 8 * len(words):
            return np.int64(0), -1
        bits = np.int64(words[at // 8] >> np.uint32(28 - 4 * (at % 8))) & 15
        at += 1
        value |= (bits & 7) << shift
        if bits < 8:
            return value, at
    return np.int64(0), -1
