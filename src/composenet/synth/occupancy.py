"""Solid occupancy of a shape on the cells of its own box (CONVENTIONS.md).

Watertight shapes: rays along all three axes, several a cell, are cut into inside and outside by
the winding number, which also unites overlapping parts. A cell is occupied when the rays through
it lie inside for half of their length or more; besides, every inside stretch shorter than one
and a half cells occupies the cell of its midpoint, so thin boards and legs never vanish.

Other shapes (CAD with holes and sheets): generalised winding number (Jacobson et al. 2013) above
one half, and the cells of all surface that this solid does not reach. That takes about a
second and is kept: stretched copies of a mesh fill the same cells of their boxes.
"""

from __future__ import annotations

from functools import lru_cache

import igl
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from composenet.synth.shape import Shape

_RAYS = 2  # rays a cell and direction
_RAYS_THIN = 6  # the same for rods thinner than about half a cell
_THIN_SECTION = 0.6  # cells^2
_JITTER0, _JITTER1 = 0.0137 * 2**0.5, 0.0119 * 3**0.5  # of the spacing: rays avoid edges
_SHORT = 1.5  # cells
_BLOCK = 4  # cells, a power of 2: largest block that may share one winding number


def occupancy(shape: Shape, cells: int = 64) -> NDArray[np.bool_]:
    """Which of (cells, cells, cells) [ix, iy, iz] over the shape's tight box are solid."""
    if not shape.watertight:
        return _kept_by_winding(shape.prototype or shape, cells).copy()
    points, _ = _in_cells(shape, cells)
    return _solid_by_rays(points, shape.faces, shape.face_part, cells)


@lru_cache(maxsize=512)
def _kept_by_winding(shape: Shape, cells: int) -> NDArray[np.bool_]:
    points, cell_m = _in_cells(shape, cells)
    return _solid_by_winding(points, shape.faces, cell_m, cells)


def _in_cells(shape: Shape, cells: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(V, 3) vertices where cell i spans [i, i + 1], and the size of a cell (3,) in metres."""
    low = shape.vertices.min(axis=0).astype(np.float64)
    size = np.maximum(shape.extents_m, 1e-6)
    return (shape.vertices - low) / size * cells, size / cells


def _solid_by_rays(
    points: NDArray[np.float64], faces: NDArray[np.int32], part: NDArray[np.int32], cells: int
) -> NDArray[np.bool_]:
    thin = _thin_parts(points, faces, part)[part]
    solid = np.zeros((cells, cells, cells), dtype=bool)
    for chosen, rays in ((faces[~thin], _RAYS), (faces[thin], _RAYS_THIN)):
        if len(chosen) == 0:
            continue
        filled = np.zeros(solid.shape, dtype=np.float32)
        for axis in range(3):  # rays along x, y, z; cyclic, so faces keep their orientation
            order = np.array([axis + 1, axis + 2, axis]) % 3
            filled = _cycled(filled)  # so that the cells of a ray lie side by side
            _cast(points[:, order][chosen], rays, filled)
        solid |= filled >= 0.5 * 3
    return solid


@njit(cache=True)
def _cycled(grid):  # type: ignore[no-untyped-def]
    """[x, y, z] -> [y, z, x], copied, some of a row at a time so that they stay at hand."""
    nx, ny, nz = grid.shape
    out = np.empty((ny, nz, nx), grid.dtype)
    for y in range(ny):
        for begin in range(0, nz, 16):
            for x in range(nx):
                for z in range(begin, min(begin + 16, nz)):
                    out[y, z, x] = grid[x, y, z]
    return out


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
def _crossing(a0, a1, b0, b1, row):  # type: ignore[no-untyped-def]
    """First coordinate where the edge a-b crosses the row; the same for b-a to the last bit."""
    if a1 > b1 or (a1 == b1 and a0 > b0):
        a0, a1, b0, b1 = b0, b1, a0, a1
    return a0 + (row - a1) * (b0 - a0) / (b1 - a1)


@njit(cache=True)
def _all_crossings(corners, side, spacing, shift0, shift1):  # type: ignore[no-untyped-def]
    """Crossings of side * side rays with triangles (F, 3, 3). Returns for each the ray, the
    height, and +1 where a ray going up enters, -1 where it leaves."""
    room, count = 4 * side * side, 0
    ray, height, turn = (
        np.empty(room, np.int32),
        np.empty(room, np.float32),
        np.empty(room, np.int8),
    )
    for f in range(len(corners)):
        a0, a1, a2 = corners[f, 0]
        b0, b1, b2 = corners[f, 1]
        c0, c1, c2 = corners[f, 2]
        normal = (b0 - a0) * (c1 - a1) - (b1 - a1) * (c0 - a0)
        if normal == 0.0:
            continue
        slope0 = ((b2 - a2) * (c1 - a1) - (b1 - a1) * (c2 - a2)) / normal
        slope1 = ((b0 - a0) * (c2 - a2) - (b2 - a2) * (c0 - a0)) / normal
        bottom, top = min(a2, b2, c2), max(a2, b2, c2)
        first = max(int(np.ceil((min(a1, b1, c1) - shift1) / spacing)), 0)
        last = min(int(np.floor((max(a1, b1, c1) - shift1) / spacing)), side - 1)
        for j in range(first, last + 1):
            row = shift1 + j * spacing
            near, far = np.inf, -np.inf
            if (a1 <= row) != (b1 <= row):
                x = _crossing(a0, a1, b0, b1, row)
                near, far = min(near, x), max(far, x)
            if (b1 <= row) != (c1 <= row):
                x = _crossing(b0, b1, c0, c1, row)
                near, far = min(near, x), max(far, x)
            if (c1 <= row) != (a1 <= row):
                x = _crossing(c0, c1, a0, a1, row)
                near, far = min(near, x), max(far, x)
            if near >= far:
                continue
            if count + side > room:
                room *= 2
                ray = np.append(ray, np.empty_like(ray))
                height = np.append(height, np.empty_like(height))
                turn = np.append(turn, np.empty_like(turn))
            for i in range(max(int(np.ceil((near - shift0) / spacing)), 0), side):
                x = shift0 + i * spacing
                if x >= far:
                    break
                z = a2 + slope0 * (x - a0) + slope1 * (row - a1)
                ray[count] = i * side + j
                height[count] = min(max(z, bottom), top)
                turn[count] = -1 if normal > 0 else 1
                count += 1
    return ray[:count], height[:count], turn[:count]


@njit(cache=True)
def _fill_stretch(low, high, share, i, j, filled):  # type: ignore[no-untyped-def]
    """Add one inside stretch of a ray to its cells, those at [i, j]; a short one fills a cell."""
    cells = filled.shape[2]
    low, high = max(low, 0.0), min(high, float(cells))
    if high <= low:
        return
    first, last = int(low), min(int(high), cells - 1)
    filled[i, j, first] += share * (min(high, first + 1.0) - low)
    for k in range(first + 1, last):
        filled[i, j, k] += share
    if last > first:
        filled[i, j, last] += share * (high - last)
    if high - low < _SHORT:
        filled[i, j, min(int((low + high) / 2), cells - 1)] = np.inf


@njit(cache=True)
def _cast(corners, rays, filled):  # type: ignore[no-untyped-def]
    """Rays along the last coordinate of the triangles (F, 3, 3), in cell units. Adds the inside
    share of each cell to filled (cells,)*3, and infinity to the cells of short stretches."""
    side, spacing, share = filled.shape[0] * rays, 1.0 / rays, 1.0 / (rays * rays)
    shift0, shift1 = (0.5 + _JITTER0) * spacing, (0.5 + _JITTER1) * spacing
    ray, height, turn = _all_crossings(corners, side, spacing, shift0, shift1)
    first = np.zeros(side * side + 1, np.int64)
    for r in ray:
        first[r + 1] += 1
    first = np.cumsum(first)
    free, z, turns = first.copy(), np.empty_like(height), np.empty_like(turn)
    for n in range(len(ray)):  # insertion sort within each ray: few crossings
        slot = free[ray[n]]
        free[ray[n]] += 1
        while slot > first[ray[n]] and z[slot - 1] > height[n]:
            z[slot], turns[slot] = z[slot - 1], turns[slot - 1]
            slot -= 1
        z[slot], turns[slot] = height[n], turn[n]
    for r in range(side * side):
        if first[r] == first[r + 1]:
            continue
        i, j = r // side // rays, r % side // rays
        winding, entered = 0, 0.0
        for n in range(first[r], first[r + 1]):
            before, winding = winding, winding + turns[n]
            if before <= 0 < winding:
                entered = z[n]
            elif winding <= 0 < before:
                _fill_stretch(entered, z[n], share, i, j, filled)


def _solid_by_winding(
    points: NDArray[np.float64],
    faces: NDArray[np.int32],
    cell_m: NDArray[np.float64],
    cells: int,
) -> NDArray[np.bool_]:
    """Blocks of cells without any surface have one winding number; the others are divided."""
    padded = -(-cells // _BLOCK) * _BLOCK
    surface = np.zeros((padded, padded, padded), dtype=bool)
    surface[:cells, :cells, :cells] = _surface_cells(points, faces, cells)
    solid, open_blocks = np.zeros_like(surface), np.ones((padded // _BLOCK,) * 3, dtype=bool)
    size = _BLOCK
    while size >= 1:
        per_side = padded // size
        touched = surface.reshape(per_side, size, per_side, size, per_side, size).any((1, 3, 5))
        asked = open_blocks & ~touched if size > 1 else open_blocks
        queries = (np.argwhere(asked) + 0.5) * size * cell_m
        winding = igl.fast_winding_number(points * cell_m, faces.astype(np.int64), queries)
        inside = np.zeros_like(asked)
        inside[asked] = np.abs(winding) > 0.5
        solid |= _divided(inside, size)
        open_blocks = _divided(open_blocks & touched, 2)
        size //= 2
    solid, surface = solid[:cells, :cells, :cells], surface[:cells, :cells, :cells]
    return solid | (surface & ~binary_dilation(solid, np.ones((3, 3, 3), dtype=bool)))


def _divided(blocks: NDArray[np.bool_], times: int) -> NDArray[np.bool_]:
    """Every block as times^3 blocks of the same value."""
    return blocks.repeat(times, axis=0).repeat(times, axis=1).repeat(times, axis=2)


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
