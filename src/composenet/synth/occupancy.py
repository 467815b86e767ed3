"""Solid occupancy of a shape on the cells of its own box (CONVENTIONS.md).

Watertight shapes: rays along all three axes, several a cell, are cut into inside and outside by
the winding number, which also unites overlapping parts. A cell is occupied when the rays through
it lie inside for half of their length or more; besides, every inside stretch too short to fill
half of any cell occupies the cell of its midpoint, so thin boards and legs never vanish.

Other shapes (CAD with holes and sheets): generalised winding number (Jacobson et al. 2013) above
one half, and the cells of all surface that this solid does not reach.
"""

from __future__ import annotations

import igl
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from composenet.synth.shape import Shape

_RAYS = 2  # rays a cell and direction
_RAYS_THIN = 6  # the same for rods thinner than about half a cell
_THIN_SECTION = 0.6  # cells^2
_JITTER = (0.0137 * np.sqrt(2), 0.0119 * np.sqrt(3))  # of a cell: rays avoid edges and vertices
_WINDING_CELLS = 48


def occupancy(shape: Shape, cells: int = 64) -> NDArray[np.bool_]:
    """Which of (cells, cells, cells) [ix, iy, iz] over the shape's tight box are solid."""
    low = shape.vertices.min(axis=0).astype(np.float64)
    size = np.maximum(shape.extents_m, 1e-6)
    points = (shape.vertices - low) / size * cells  # cell units: cell i spans [i, i + 1]
    if shape.watertight:
        return _solid_by_rays(points, shape.faces, shape.face_part, cells)
    return _solid_by_winding(points, shape.faces, size / cells, cells)


def _solid_by_rays(
    points: NDArray[np.float64], faces: NDArray[np.int32], part: NDArray[np.int32], cells: int
) -> NDArray[np.bool_]:
    thin = _thin_parts(points, faces, part)[part]
    solid = np.zeros((cells, cells, cells), dtype=bool)
    for chosen, rays in ((faces[~thin], _RAYS), (faces[thin], _RAYS_THIN)):
        if len(chosen) == 0:
            continue
        filled = np.zeros(solid.shape, dtype=np.float32)
        for axis in range(3):  # rays along z, x, y: cyclic, so faces keep their orientation
            order = np.roll((0, 1, 2), -axis)
            fill, short = _cast(
                np.ascontiguousarray(points[:, order]), chosen, cells, rays, *_JITTER
            )
            back = np.argsort(order)
            filled += fill.transpose(back)
            solid |= short.transpose(back)
        solid |= filled >= 0.5 * 3
    return solid


def _thin_parts(
    points: NDArray[np.float64], faces: NDArray[np.int32], part: NDArray[np.int32]
) -> NDArray[np.bool_]:
    """(parts,) whether the mean cross-section (volume over length, in cells) is that of a rod."""
    corners = points[faces]
    count = int(part.max()) + 1
    signed = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    volume = np.bincount(part, signed, count)
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, part, corners.min(axis=1))
    np.maximum.at(high, part, corners.max(axis=1))
    length = np.linalg.norm(high - low, axis=1)
    return volume < _THIN_SECTION * np.maximum(length, 1e-9)


@njit(cache=True)
def _cross_row(a, b, row):  # type: ignore[no-untyped-def]
    """First coordinate where the edge a-b crosses the row; equal for b-a, to the last bit."""
    if a[1] > b[1] or (a[1] == b[1] and a[0] > b[0]):
        a, b = b, a
    return a[0] + (row - a[1]) * (b[0] - a[0]) / (b[1] - a[1])


@njit(cache=True)
def _crossings(points, faces, side, spacing, shift0, shift1, start, height, turn):  # type: ignore[no-untyped-def]
    """Crossings of the rays (side x side) with all faces: appended at start[column], which
    advances; with empty height only counted. turn: +1 where a ray going up enters."""
    write = len(height) > 0
    for face in faces:
        a, b, c = points[face[0]], points[face[1]], points[face[2]]
        u0, u1, u2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        v0, v1, v2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        normal = u0 * v1 - u1 * v0
        if normal == 0.0:
            continue
        slope0, slope1 = (u2 * v1 - u1 * v2) / normal, (u0 * v2 - u2 * v0) / normal
        bottom, top = min(a[2], b[2], c[2]), max(a[2], b[2], c[2])
        first = max(int(np.ceil((min(a[1], b[1], c[1]) - shift1) / spacing)), 0)
        last = min(int(np.floor((max(a[1], b[1], c[1]) - shift1) / spacing)), side - 1)
        for j in range(first, last + 1):
            row = shift1 + j * spacing
            near, far = np.inf, -np.inf
            for p, q in ((a, b), (b, c), (c, a)):
                if (p[1] <= row) != (q[1] <= row):
                    x = _cross_row(p, q, row)
                    near, far = min(near, x), max(far, x)
            if near > far:
                continue
            i = max(int(np.ceil((near - shift0) / spacing)), 0)
            while i < side and shift0 + i * spacing < far:
                x = shift0 + i * spacing
                column = i * side + j
                if write:
                    z = a[2] + slope0 * (x - a[0]) + slope1 * (row - a[1])
                    height[start[column]] = min(max(z, bottom), top)
                    turn[start[column]] = -1 if normal > 0 else 1
                start[column] += 1
                i += 1


@njit(cache=True)
def _fill_stretch(low, high, cells, share, fill, short):  # type: ignore[no-untyped-def]
    """Add one inside stretch of a ray to its cells (cells,)."""
    low, high = max(low, 0.0), min(high, float(cells))
    if high <= low:
        return
    first, last = int(low), min(int(high), cells - 1)
    enough = False
    for k in range(first, last + 1):
        overlap = min(high, k + 1.0) - max(low, float(k))
        fill[k] += share * overlap
        enough = enough or overlap >= 0.5
    if not enough:
        short[min(int((low + high) / 2), cells - 1)] = True


@njit(cache=True)
def _cast(points, faces, cells, rays, shift0, shift1):  # type: ignore[no-untyped-def]
    """Rays along the last axis. points: cell units. Returns the inside share of each cell
    (cells,)*3 float32 and the cells of short stretches (cells,)*3 bool."""
    side, spacing, share = cells * rays, 1.0 / rays, 1.0 / (rays * rays)
    shift0, shift1 = spacing / 2 + shift0 / rays, spacing / 2 + shift1 / rays
    ends = np.zeros(side * side, np.int64)
    none_height, none_turn = np.empty(0, np.float32), np.empty(0, np.int8)
    _crossings(points, faces, side, spacing, shift0, shift1, ends, none_height, none_turn)
    total = 0
    for column in range(side * side):
        total, ends[column] = total + ends[column], total
    height, turn = np.empty(total, np.float32), np.empty(total, np.int8)
    if total > 0:
        _crossings(points, faces, side, spacing, shift0, shift1, ends, height, turn)
    fill = np.zeros((cells, cells, cells), np.float32)
    short = np.zeros((cells, cells, cells), np.bool_)
    begin = 0
    for column in range(side * side):
        end = ends[column]
        i, j = column // side // rays, column % side // rays
        for k in range(begin + 1, end):  # insertion sort: a few crossings a ray
            h, t, m = height[k], turn[k], k - 1
            while m >= begin and height[m] > h:
                height[m + 1], turn[m + 1] = height[m], turn[m]
                m -= 1
            height[m + 1], turn[m + 1] = h, t
        winding, entered = 0, 0.0
        for k in range(begin, end):
            before, winding = winding, winding + turn[k]
            if before <= 0 < winding:
                entered = height[k]
            elif winding <= 0 < before:
                _fill_stretch(entered, height[k], cells, share, fill[i, j], short[i, j])
        begin = end
    return fill, short


def _solid_by_winding(
    points: NDArray[np.float64],
    faces: NDArray[np.int32],
    cell_m: NDArray[np.float64],
    cells: int,
) -> NDArray[np.bool_]:
    coarse = min(_WINDING_CELLS, cells)
    steps = (np.arange(coarse) + 0.5) * cells / coarse
    queries = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    winding = igl.fast_winding_number(points * cell_m, faces.astype(np.int64), queries * cell_m)
    nearest = np.arange(cells) * coarse // cells
    inside = (np.abs(winding) > 0.5).reshape(coarse, coarse, coarse)
    solid = inside[np.ix_(nearest, nearest, nearest)]
    surface = _surface_cells(points, faces, cells)
    return solid | (surface & ~binary_dilation(solid, np.ones((3, 3, 3), dtype=bool)))


@njit(cache=True)
def _surface_cells(points, faces, cells):  # type: ignore[no-untyped-def]
    """(cells,)*3 bool: cells that hold a surface sample, samples at most half a cell apart."""
    touched = np.zeros((cells, cells, cells), np.bool_)
    cell = np.empty(3, np.int64)
    for face in faces:
        a, b, c = points[face[0]], points[face[1]], points[face[2]]
        reach = max(np.abs(b - a).max(), np.abs(c - a).max(), np.abs(c - b).max())
        steps = int(np.ceil(2 * reach)) + 1
        for i in range(steps + 1):
            for j in range(steps + 1 - i):
                sample = a + (b - a) * (i / steps) + (c - a) * (j / steps)
                for axis in range(3):
                    cell[axis] = min(max(int(sample[axis]), 0), cells - 1)
                touched[cell[0], cell[1], cell[2]] = True
    return touched
