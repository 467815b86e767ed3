"""Brightness of images, and rows of the normal equations that align them."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

LUMA = np.array([0.299, 0.587, 0.114], np.float32)


def brightness(color: NDArray[np.uint8]) -> NDArray[np.float32]:
    """(H, W) in 0..1 of an image (H, W, 3) uint8, RGB."""
    return np.asarray(color @ LUMA / 255, np.float32)


@numba.njit(cache=True, nogil=True)
def halved(image):
    """(ceil(H / 2), ceil(W / 2)) every other pixel of the image smoothed by 1-2-1 both ways."""
    height, width = image.shape
    out = np.empty(((height + 1) // 2, (width + 1) // 2), image.dtype)
    for v in range(out.shape[0]):
        above, below = max(2 * v - 1, 0), min(2 * v + 1, height - 1)
        for u in range(out.shape[1]):
            total = 0.0
            for k in range(3):
                x = min(max(2 * u + k - 1, 0), width - 1)
                column = 0.0 + image[above, x] + 2 * image[2 * v, x] + image[below, x]
                total += np.float32(column / 4) * (2 if k == 1 else 1)
            out[v, u] = total / 4
    return out


@numba.njit(cache=True, nogil=True)
def photometric_row(point, light, image, fx, fy, cx, cy, row):
    """Brightness of the image (H, W) where a point (3,) of the model projects, less the point's
    own; row (6,) becomes its derivative by `increment`. NaN outside the image."""
    height, width = image.shape
    u, v = fx * point[0] / point[2] + cx, fy * point[1] / point[2] + cy
    if not (0 <= u < width - 1 and 0 <= v < height - 1):
        return np.nan
    x, y = int(u), int(v)
    a, b = u - x, v - y
    p, q, r, s = image[y, x], image[y, x + 1], image[y + 1, x], image[y + 1, x + 1]
    gu = ((q - p) * (1 - b) + (s - r) * b) * fx / point[2]
    gv = ((r - p) * (1 - a) + (s - q) * a) * fy / point[2]
    row[0] = gu
    row[1] = gv
    row[2] = -(gu * point[0] + gv * point[1]) / point[2]
    row[3] = point[1] * row[2] - point[2] * row[1]
    row[4] = point[2] * row[0] - point[0] * row[2]
    row[5] = point[0] * row[1] - point[1] * row[0]
    return (p * (1 - a) + q * a) * (1 - b) + (r * (1 - a) + s * a) * b - light


@numba.njit(cache=True, nogil=True)
def add_row(A, b, row, residual, weight):
    """One residual into J^T W J (6, 6), of which only the upper half, and J^T W r (6,), in place:
    `mirrored` when all are in."""
    for i in range(6):
        weighted = weight * row[i]
        for j in range(i, 6):
            A[i, j] += weighted * row[j]
        b[i] += weighted * residual


@numba.njit(cache=True, nogil=True)
def mirrored(A):
    """The whole of a symmetric matrix whose upper half is given."""
    return A + A.T - np.diag(np.diag(A))


@numba.njit(cache=True, nogil=True)
def move_into(T, vector, shift, out):
    """out (3,) becomes the vector (3,) turned by T (4, 4) and, as far as shift says, moved."""
    for k in range(3):
        out[k] = shift * T[k, 3]
        for j in range(3):
            out[k] += T[k, j] * vector[j]
