"""Surfels in an image: as opaque discs, and by the pixels that their centres fall on."""

from __future__ import annotations

import numba
import numpy as np

from composenet.geometry.photometric import LUMA

POINT, NORMAL, COLOR, RADIUS, CONFIDENCE, N_VALUES = 0, 3, 6, 9, 10, 11
"""First columns, and their number, of a table of surfels (N, 11) float32, in the body's axes."""
_FACING = 0.1  # cosine: discs seen flatter than this are not drawn


@numba.njit(cache=True, nogil=True)
def moved(T, values, i, first, shift):
    """The vector in three columns of a row, turned by T (4, 4) and, as far as shift says, moved."""
    x, y, z = values[i, first], values[i, first + 1], values[i, first + 2]
    return (
        shift * T[0, 3] + T[0, 0] * x + T[0, 1] * y + T[0, 2] * z,
        shift * T[1, 3] + T[1, 0] * x + T[1, 1] * y + T[1, 2] * z,
        shift * T[2, 3] + T[2, 0] * x + T[2, 1] * y + T[2, 2] * z,
    )


@numba.njit(cache=True, nogil=True)
def splatted(values, min_confidence, T, height, width, fx, fy, cx, cy):
    """(H, W) the nearest disc at every pixel, -1 for none, and its z-depth there. Of discs in one
    plane the one counts as nearest whose centre is."""
    index = np.full((height, width), -1, np.int32)
    depth = np.zeros((height, width), np.float32)
    nearest = np.full((height, width), np.inf)
    right, down = (np.arange(width) - cx) / fx, (np.arange(height) - cy) / fy
    for i in range(len(values)):
        if values[i, CONFIDENCE] < min_confidence:
            continue
        px, py, pz = moved(T, values, i, POINT, 1.0)
        if pz < 0.1:
            continue
        radius = values[i, RADIUS]
        u, v, reach = fx * px / pz + cx, fy * py / pz + cy, fx * radius / pz
        if not (-reach <= u < width + reach and -reach <= v < height + reach):
            continue
        nx, ny, nz = moved(T, values, i, NORMAL, 0.0)
        plane = nx * px + ny * py + nz * pz
        if plane > -_FACING * np.sqrt(px**2 + py**2 + pz**2):
            continue
        left, upper = max(0, int(np.ceil(u - reach))), max(0, int(np.ceil(v - reach)))
        for y in range(upper, min(height - 1, int(v + reach)) + 1):
            for x in range(left, min(width - 1, int(u + reach)) + 1):
                slope = nx * right[x] + ny * down[y] + nz
                if slope > -1e-3:
                    continue
                z = plane / slope
                away = (right[x] * z - px) ** 2 + (down[y] * z - py) ** 2 + (z - pz) ** 2
                if away <= radius**2 and z + np.sqrt(away) < nearest[y, x]:
                    nearest[y, x] = z + np.sqrt(away)
                    index[y, x] = i
                    depth[y, x] = z
    return index, depth


@numba.njit(cache=True, nogil=True)
def drawn(values, index, depth, T, fx, fy, cx, cy):
    """Points, normals and brightness, as in `Maps`, of the discs at every pixel."""
    height, width = index.shape
    points = np.zeros((height, width, 3), np.float32)
    normals = np.zeros((height, width, 3), np.float32)
    light = np.full((height, width), np.nan, np.float32)
    for y in range(height):
        for x in range(width):
            i = index[y, x]
            if i < 0:
                continue
            points[y, x, 0] = depth[y, x] * np.float32((x - cx) / fx)
            points[y, x, 1] = depth[y, x] * np.float32((y - cy) / fy)
            points[y, x, 2] = depth[y, x]
            normals[y, x, 0], normals[y, x, 1], normals[y, x, 2] = moved(T, values, i, NORMAL, 0)
            red, green, blue = values[i, COLOR], values[i, COLOR + 1], values[i, COLOR + 2]
            light[y, x] = red * LUMA[0] + green * LUMA[1] + blue * LUMA[2]
    return points, normals, light


@numba.njit(cache=True, nogil=True)
def pixel_of(T, values, i, fx, fy, cx, cy):
    """Pixel and depth of a surfel's centre; pixel (0, 0) if it is not well before the camera."""
    px, py, pz = moved(T, values, i, POINT, 1.0)
    if pz < 0.1:
        return 0, 0, pz
    return int(np.round(fx * px / pz + cx)), int(np.round(fy * py / pz + cy)), pz


@numba.njit(cache=True, nogil=True)
def centres(values, T, height, width, fx, fy, cx, cy):
    """(H, W) the nearest surfel whose centre falls on the pixel, -1 for none."""
    index = np.full((height, width), -1, np.int32)
    depth = np.zeros((height, width), np.float32)
    for i in range(len(values)):
        u, v, pz = pixel_of(T, values, i, fx, fy, cx, cy)
        if pz < 0.1:
            continue
        if 0 <= u < width and 0 <= v < height and (index[v, u] < 0 or pz < depth[v, u]):
            index[v, u] = i
            depth[v, u] = pz
    return index
