"""Blocks of 8^3 voxels by their place, in a hash table with open addressing.

After Niessner et al. 2013 ("Real-time 3D reconstruction at scale using voxel hashing"). A table is
two arrays of a power of two: `keys` (T,) int64, -1 where free, and `slots` (T,) int32, the block's
number. Voxel (i, j, k) of the field is the cube [i, i + 1] x [j, j + 1] x [k, k + 1] in units of
its edge, and lies in block (i // 8, j // 8, k // 8).
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from composenet.records import FloatArray

SIDE = 8
"""voxels a side of a block"""
FREE = -1
_FULLEST = 0.5  # share of the table's places that may be taken
_REACH = 1 << 20  # blocks to either side


def empty_table(size: int) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """keys and slots of a table of `size` places, a power of two."""
    return np.full(size, FREE, np.int64), np.zeros(size, np.int32)


@numba.njit(cache=True, nogil=True)
def block_key(x, y, z):
    """One number for a block's place."""
    return ((x + _REACH) << 42) | ((y + _REACH) << 21) | (z + _REACH)


@numba.njit(cache=True, nogil=True)
def place_of(keys, key):
    """Where in the table a key is, or would be."""
    mask = len(keys) - 1
    mixed = (key ^ (key >> 21)) * 73856093 ^ (key >> 42) * 83492791
    place = (mixed ^ (mixed >> 17)) & mask
    while keys[place] != FREE and keys[place] != key:
        place = (place + 1) & mask
    return place


@numba.njit(cache=True, nogil=True)
def block_at(keys, slots, x, y, z):
    """The number of the block at a place, or -1."""
    return block_of(keys, slots, block_key(x, y, z))


@numba.njit(cache=True, nogil=True)
def block_of(keys, slots, key):
    """The number of the block with this key, or -1."""
    place = place_of(keys, key)
    return slots[place] if keys[place] != FREE else -1


@numba.njit(cache=True, nogil=True)
def fill_table(keys, slots, coords):
    """Enter blocks (N, 3) int32 by their number."""
    for n in range(len(coords)):
        key = block_key(coords[n, 0], coords[n, 1], coords[n, 2])
        place = place_of(keys, key)
        keys[place] = key
        slots[place] = n


@numba.njit(cache=True, nogil=True)
def allocate_along_rays(
    keys,
    slots,
    coords,
    count: int,
    points: FloatArray,
    T: FloatArray,
    voxel_m: float,
    band_m: float,
) -> tuple[int, bool]:
    """Enter the blocks that rays pass within band_m of their points. points: (H, W, 3) camera
    axes, z = 0 for none. T: T_body_camera. coords: (C, 3), of which `count` are taken.

    Returns how many are, and False where the table is full: grow it and call again.
    """
    height, width = points.shape[:2]
    steps = int(np.ceil(2 * band_m / voxel_m))
    eye, end = T[:3, 3], np.empty(3)
    last = np.int64(FREE)
    for v in range(height):
        for u in range(width):
            p = points[v, u]
            if p[2] <= 0:
                continue
            length = np.sqrt(p[0] ** 2 + p[1] ** 2 + p[2] ** 2)
            for k in range(3):
                end[k] = T[k, 0] * p[0] + T[k, 1] * p[1] + T[k, 2] * p[2]
            for step in range(steps + 1):
                s = (1 + (2 * step / steps - 1) * band_m / length) / (voxel_m * SIDE)
                x = int(np.floor(eye[0] / (voxel_m * SIDE) + s * end[0]))
                y = int(np.floor(eye[1] / (voxel_m * SIDE) + s * end[1]))
                z = int(np.floor(eye[2] / (voxel_m * SIDE) + s * end[2]))
                key = block_key(x, y, z)
                if key == last:
                    continue
                last = key
                place = place_of(keys, key)
                if keys[place] != FREE:
                    continue
                if count == len(coords) or count > _FULLEST * len(keys):
                    return count, False
                keys[place] = key
                slots[place] = count
                coords[count, 0] = x
                coords[count, 1] = y
                coords[count, 2] = z
                count += 1
    return count, True
