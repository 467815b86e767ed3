"""Rays through a field of signed distances in blocks, to the surface they meet from outside."""

from __future__ import annotations

import numba
import numpy as np

from composenet.baselines.voxel_blocks import SIDE, block_at, block_key, block_of

TSDF, WEIGHT, LIGHT, OWN = range(4)
"""The channels of a voxel: distance / truncation, frames seen, brightness, share of those frames
in which it was the body's own."""
MIN_OWN = 0.5
"""a voxel that was the body's own in no larger share of its frames is not shown"""
_TILE = 8  # pixels
_NEAR_M = 0.1
_CAUTION = 0.7  # of the distance to the surface, in one step
_EXACT = 0.01  # voxels
_MIN_CORNERS = 0.5  # of the eight voxels around a point, by their weight in the interpolation


@numba.njit(cache=True, nogil=True, error_model="numpy")
def depth_ranges(coords, shown, block_m, T, height, width, fx, fy, cx, cy):
    """(H / 8, W / 8) least z-depth of the blocks (N, 3) at each tile of the image, infinite where
    there are none, and the largest of those that are shown (N,), 0 where there are none.
    T: T_camera_body."""
    rows, columns = (height + _TILE - 1) // _TILE, (width + _TILE - 1) // _TILE
    near, far = np.full((rows, columns), np.inf), np.zeros((rows, columns))
    radius = block_m * np.sqrt(3.0) / 2
    p = np.empty(3)
    for n in range(len(coords)):
        for k in range(3):
            p[k] = T[k, 3]
            for j in range(3):
                p[k] += T[k, j] * (coords[n, j] + 0.5) * block_m
        low, high = max(p[2] - radius, _NEAR_M), p[2] + radius + block_m / SIDE  # a voxel more
        top, bottom, left, right = tiles_of(p, radius, rows, columns, fx, fy, cx, cy)
        for row in range(top, bottom):
            for column in range(left, right):
                near[row, column] = min(near[row, column], low)
                if shown[n]:
                    far[row, column] = max(far[row, column], high)
    return near, far


@numba.njit(cache=True, nogil=True, error_model="numpy")
def farthest(depth):
    """(H / 8, W / 8) largest depth (H, W) in each tile of the image."""
    height, width = depth.shape
    far = np.zeros(((height + _TILE - 1) // _TILE, (width + _TILE - 1) // _TILE))
    for v in range(height):
        for u in range(width):
            far[v // _TILE, u // _TILE] = max(far[v // _TILE, u // _TILE], depth[v, u])
    return far


@numba.njit(cache=True, nogil=True, error_model="numpy")
def tiles_of(p, radius, rows, columns, fx, fy, cx, cy):
    """The tiles that a sphere about p (3,), camera axes, may fall on: rows from the first number
    up to the second, columns from the third up to the fourth."""
    low, high = p[2] - radius, p[2] + radius
    if high < _NEAR_M:
        return 0, 0, 0, 0
    if low <= _NEAR_M:
        return 0, rows, 0, columns
    left = _tile(fx, cx, p[0] - radius, low, high, False, columns)
    right = _tile(fx, cx, p[0] + radius, low, high, True, columns)
    top = _tile(fy, cy, p[1] - radius, low, high, False, rows)
    bottom = _tile(fy, cy, p[1] + radius, low, high, True, rows)
    return top, bottom + 1, left, right + 1


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _tile(focal, centre, aside, low, high, upper, count):
    """The tile of a sphere's rim, outwards; -1 or `count` where that is outside the image."""
    a, b = focal * aside / low + centre, focal * aside / high + centre
    pixel = max(a, b) + 1 if upper else min(a, b) - 1
    tile = int(np.floor(pixel / _TILE))
    return min(tile, count - 1) if upper else max(tile, 0)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def blended(keys, slots, voxels, channel, x, y, z):
    """A channel of the voxels around a place (in voxels), trilinear; voxels that were never seen
    are left out, and it is NaN where they are the most."""
    x, y, z = x - 0.5, y - 0.5, z - 0.5
    i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    a, b, c = x - i, y - j, z - k
    bx, by, bz = i >> 3, j >> 3, k >> 3
    block = block_at(keys, slots, bx, by, bz)
    if (i & 7) < 7 and (j & 7) < 7 and (k & 7) < 7:
        first = ((i & 7) << 6) | ((j & 7) << 3) | (k & 7)
        return np.nan if block < 0 else _within(voxels[block], first, channel, a, b, c)
    total, weights = 0.0, 0.0
    for corner in range(8):
        di, dj, dk = corner >> 2, (corner >> 1) & 1, corner & 1
        cx, cy, cz = (i + di) >> 3, (j + dj) >> 3, (k + dk) >> 3
        number = block
        if cx != bx or cy != by or cz != bz:
            number = block_at(keys, slots, cx, cy, cz)
        if number < 0:
            continue
        inner = (((i + di) & 7) << 6) | (((j + dj) & 7) << 3) | ((k + dk) & 7)
        if voxels[number, inner, WEIGHT] > 0:
            weight = (a if di else 1 - a) * (b if dj else 1 - b) * (c if dk else 1 - c)
            total += weight * voxels[number, inner, channel]
            weights += weight
    return total / weights if weights >= _MIN_CORNERS else np.nan


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _within(block, first, channel, a, b, c):
    """`blended` where one block (512, 4) holds all eight voxels, from `first` on."""
    total, weights = 0.0, 0.0
    for di in range(2):
        for dj in range(2):
            share = (a if di else 1 - a) * (b if dj else 1 - b)
            for dk in range(2):
                inner = first + (di << 6) + (dj << 3) + dk
                if block[inner, WEIGHT] > 0:
                    weight = share * (c if dk else 1 - c)
                    total += weight * block[inner, channel]
                    weights += weight
    return total / weights if weights >= _MIN_CORNERS else np.nan


@numba.njit(cache=True, nogil=True, error_model="numpy")
def cast_rays(
    keys, slots, voxels, voxel_m, truncation_m, near, far, T, height, width, fx, fy, cx, cy
):
    """The body's surface at every pixel: points and unit normals (H, W, 3) float32 in camera axes,
    0 where there is none, and brightness (H, W), NaN there. near, far: from `depth_ranges`.
    T: T_body_camera."""
    points = np.zeros((height, width, 3), np.float32)
    normals = np.zeros((height, width, 3), np.float32)
    light = np.full((height, width), np.nan, np.float32)
    ox, oy, oz = T[0, 3] / voxel_m, T[1, 3] / voxel_m, T[2, 3] / voxel_m
    tiles = near.shape[1]
    for n in range(near.size * _TILE**2):  # tile by tile: neighbouring rays read the same voxels
        tile, inner = n // _TILE**2, n % _TILE**2
        row, column = tile // tiles, tile % tiles
        v, u = row * _TILE + inner // _TILE, column * _TILE + inner % _TILE
        low, high = near[row, column], far[row, column]
        if low >= high or v >= height or u >= width:
            continue
        x, y = (u - cx) / fx, (v - cy) / fy
        dx = (T[0, 0] * x + T[0, 1] * y + T[0, 2]) / voxel_m
        dy = (T[1, 0] * x + T[1, 1] * y + T[1, 2]) / voxel_m
        dz = (T[2, 0] * x + T[2, 1] * y + T[2, 2]) / voxel_m
        z = _met(keys, slots, voxels, truncation_m / voxel_m, ox, oy, oz, dx, dy, dz, low, high)
        if z <= 0:
            continue
        px, py, pz = ox + z * dx, oy + z * dy, oz + z * dz
        if not blended(keys, slots, voxels, OWN, px, py, pz) > MIN_OWN:
            continue
        gx = gy = gz = 0.0
        for side in (-1.0, 1.0):
            gx += side * blended(keys, slots, voxels, TSDF, px + side, py, pz)
            gy += side * blended(keys, slots, voxels, TSDF, px, py + side, pz)
            gz += side * blended(keys, slots, voxels, TSDF, px, py, pz + side)
        length = np.sqrt(gx * gx + gy * gy + gz * gz)
        if not length > 1e-6:
            continue
        light[v, u] = blended(keys, slots, voxels, LIGHT, px, py, pz)
        points[v, u, 0], points[v, u, 1], points[v, u, 2] = x * z, y * z, z
        for k in range(3):
            normals[v, u, k] = (T[0, k] * gx + T[1, k] * gy + T[2, k] * gz) / length
    return points, normals, light


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _met(keys, slots, voxels, truncation, ox, oy, oz, dx, dy, dz, low, high):
    """z-depth at which a ray (in voxels a metre of depth) passes from outside to inside; 0 where
    it does not. What is behind a surface's back stays hidden."""
    length = np.sqrt(dx * dx + dy * dy + dz * dz)
    per_x, per_y, per_z = 1 / dx, 1 / dy, 1 / dz  # infinite along an axis is never the way out
    z, before, before_z = low, np.nan, low
    block, last = -1, -1
    while z < high:
        x, y, w = ox + z * dx, oy + z * dy, oz + z * dz
        i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(w))
        key = block_key(i >> 3, j >> 3, k >> 3)
        if key != last:
            block, last = block_of(keys, slots, key), key
        if block < 0:
            way = _way_out(x, i, per_x)
            way = min(way, _way_out(y, j, per_y))
            z += min(way, _way_out(w, k, per_z)) + 1e-3 / length
            before = np.nan
            continue
        inner = ((i & 7) << 6) | ((j & 7) << 3) | (k & 7)
        value = np.float64(voxels[block, inner, TSDF])
        if voxels[block, inner, WEIGHT] <= 0:
            value = np.nan
        elif abs(value) * truncation < 2:
            value = blended(keys, slots, voxels, TSDF, x, y, w)
        if value <= 0:
            if not before > 0:
                return 0.0
            for _ in range(3):  # regula falsi
                nearer = before_z + (z - before_z) * before / (before - value)
                x, y, w = ox + nearer * dx, oy + nearer * dy, oz + nearer * dz
                there = blended(keys, slots, voxels, TSDF, x, y, w)
                if there > 0:
                    before_z, before = nearer, there
                else:
                    z, value = nearer, there
                if abs(there) * truncation < _EXACT:
                    break
            return nearer if np.isfinite(there) else 0.0
        before, before_z = value, z
        z += max(_CAUTION * value * truncation, 0.5) / length if value > 0 else 0.5 / length
    return 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _way_out(place, voxel, slope):
    """How much farther a ray leaves, along one axis, the block that a place (in voxels) is in.
    slope: depth a voxel."""
    first = (voxel >> 3) << 3
    return (first + SIDE - place) * slope if slope > 0 else (first - place) * slope
