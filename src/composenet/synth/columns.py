"""Shapes as columns: which heights their surface reaches over each small square of the floor.

With it a chair may stand with its seat below a table top: the two overlap in plan, yet no
surface of the one comes near a surface of the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numba
import numpy as np
from numpy.typing import NDArray

from composenet.synth.shape import Shape

CELL_M = 0.025
_LEVELS = 64

Place = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Columns:
    """bits: (nx, ny) uint64 over the shape's footprint, from its corner at low x and y. Bit k is
    set where surface lies k to k + 1 cells above the shape's underside (all above in the last).
    """

    bits: NDArray[np.uint64]
    extents_m: NDArray[np.float64]


@lru_cache(maxsize=64)
def columns_of(shape: Shape) -> Columns:
    """The columns of a shape; kept, as one shape is tried at many places."""
    size = shape.extents_m
    points = (shape.vertices.astype(np.float64) - shape.vertices.min(axis=0)) / CELL_M
    bits = np.zeros(np.ceil(size[:2] / CELL_M).astype(int) + 1, dtype=np.uint64)
    _raster(points, shape.faces, bits)
    return Columns(bits, size)


def as_place(values: NDArray[np.float64]) -> Place:
    """(x, y, yaw) of an array (3,)."""
    return float(values[0]), float(values[1]), float(values[2])


def meet(a: Columns, place_a: Place, b: Columns, place_b: Place) -> bool:
    """Whether two things standing on one level at (x, y, yaw) of their centres come closer to
    each other than about a cell. Never misses surfaces that cross."""
    return bool(
        _meet(
            a.bits, a.extents_m, np.array(place_a), b.bits, b.extents_m, np.array(place_b), CELL_M
        )
    )


@numba.njit(cache=True, nogil=True)
def _raster(points, faces, bits):  # type: ignore[no-untyped-def]
    """Marks the cells of surface samples at most half a cell apart."""
    for face in faces:
        a, b, c = points[face[0]], points[face[1]], points[face[2]]
        reach = max(np.abs(b - a).max(), np.abs(c - a).max(), np.abs(c - b).max())
        steps = int(np.ceil(2 * reach)) + 1
        for i in range(steps + 1):
            for j in range(steps + 1 - i):
                s, t = i / steps, j / steps
                x = a[0] + (b[0] - a[0]) * s + (c[0] - a[0]) * t
                y = a[1] + (b[1] - a[1]) * s + (c[1] - a[1]) * t
                z = a[2] + (b[2] - a[2]) * s + (c[2] - a[2]) * t
                level = min(max(int(z), 0), _LEVELS - 1)
                bits[max(int(x), 0), max(int(y), 0)] |= np.uint64(1) << np.uint64(level)


@numba.njit(cache=True, nogil=True)
def _meet(bits_a, size_a, at_a, bits_b, size_b, at_b, cell):  # type: ignore[no-untyped-def]
    """Each cell of a against the nine cells of b about its centre: points of one cell of a lie
    within them, whatever the angle."""
    ca, sa = np.cos(at_a[2]), np.sin(at_a[2])
    cb, sb = np.cos(at_b[2]), np.sin(at_b[2])
    for i in range(bits_a.shape[0]):
        for j in range(bits_a.shape[1]):
            column = bits_a[i, j]
            if column == 0:
                continue
            x, y = (i + 0.5) * cell - size_a[0] / 2, (j + 0.5) * cell - size_a[1] / 2
            dx = at_a[0] + ca * x - sa * y - at_b[0]
            dy = at_a[1] + sa * x + ca * y - at_b[1]
            k = int(np.floor((cb * dx + sb * dy + size_b[0] / 2) / cell))
            m = int(np.floor((-sb * dx + cb * dy + size_b[1] / 2) / cell))
            for p in range(max(k - 1, 0), min(k + 2, bits_b.shape[0])):
                for q in range(max(m - 1, 0), min(m + 2, bits_b.shape[1])):
                    if column & bits_b[p, q]:
                        return True
    return False


@lru_cache(maxsize=64)
def height_map(shape: Shape, cells: int = 24) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Height of the shape's upper side above its centre, (cells, cells) over its footprint
    [ix, iy], and the size of a cell (2,), metres."""
    cell = shape.extents_m[:2] / cells
    corners = shape.vertices[shape.faces].astype(np.float64)
    tops = np.full((cells, cells), -np.inf)
    _drop(corners, shape.extents_m[:2], tops)
    return tops, cell


@numba.njit(cache=True, nogil=True)
def _drop(corners, extents, tops):  # type: ignore[no-untyped-def]
    cells = len(tops)
    cx, cy = extents[0] / cells, extents[1] / cells
    for f in range(len(corners)):
        x = (corners[f, :, 0] + extents[0] / 2) / cx - 0.5
        y = (corners[f, :, 1] + extents[1] / 2) / cy - 0.5
        area = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0])
        if abs(area) < 1e-12:
            continue
        for i in range(max(0, int(np.ceil(x.min()))), min(cells - 1, int(x.max())) + 1):
            for j in range(max(0, int(np.ceil(y.min()))), min(cells - 1, int(y.max())) + 1):
                b = ((i - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (j - y[0])) / area
                c = ((x[1] - x[0]) * (j - y[0]) - (i - x[0]) * (y[1] - y[0])) / area
                if b >= 0 and c >= 0 and b + c <= 1:
                    p, q, r = corners[f, 0, 2], corners[f, 1, 2], corners[f, 2, 2]
                    z = p + b * (q - p) + c * (r - p)
                    tops[i, j] = max(tops[i, j], z)
