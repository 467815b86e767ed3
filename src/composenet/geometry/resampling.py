"""Cubes of values read through affine maps."""

from __future__ import annotations

import numba
import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from composenet.geometry.affine import apply_affine


def resampled(values: Tensor, A: Tensor, b: Tensor, cells: int, nearest: bool = False) -> Tensor:
    """Values of cubes at the cell centres of other cubes.

    values: (M, C, C, C), zero beyond. A: (M, 3, 3), b: (M, 3): from places in the other cubes,
    -0.5..0.5 along their sides, to places in these, 0..1. Returns (M, cells, cells, cells),
    interpolated linearly between cell centres, or those of the nearest cell.
    """
    if values.device.type == "cpu":
        found = np.zeros((len(values), cells, cells, cells), np.float32)
        _read(values.numpy(), A.numpy(), b.numpy(), nearest, found)
        return torch.from_numpy(found)
    return sampled(values, A, b, cells, nearest)


def sampled(values: Tensor, A: Tensor, b: Tensor, cells: int, nearest: bool) -> Tensor:
    """`resampled` on any device, by the sampler that torch has."""
    steps = (torch.arange(cells, device=values.device) + 0.5) / cells - 0.5
    centers = torch.stack(torch.meshgrid(steps, steps, steps, indexing="ij"), -1).view(-1, 3)
    places = apply_affine(A, b, centers)
    grid = (2 * places - 1).flip(-1).view(-1, cells, cells, cells, 3)
    mode = "nearest" if nearest else "bilinear"
    return F.grid_sample(values[:, None], grid, mode, "zeros", align_corners=False)[:, 0]


@numba.njit(cache=True, nogil=True)
def _read(values, A, b, nearest, found):
    """Fill found, which is zero where nothing is read."""
    size, n = values.shape[1], found.shape[1]
    end = size + 1
    steps = (np.arange(n) + 0.5) / n - 0.5
    padded = np.zeros((size + 2, size + 2, size + 2), values.dtype)
    for m in range(len(values)):
        padded[1:-1, 1:-1, 1:-1] = values[m]
        S = size * A[m]
        low = size * b[m] + 0.5
        for i in range(n):
            for j in range(n):
                x0 = S[0, 0] * steps[i] + S[0, 1] * steps[j] + low[0]
                y0 = S[1, 0] * steps[i] + S[1, 1] * steps[j] + low[1]
                z0 = S[2, 0] * steps[i] + S[2, 1] * steps[j] + low[2]
                for k in range(n):
                    x = x0 + S[0, 2] * steps[k]
                    y = y0 + S[1, 2] * steps[k]
                    z = z0 + S[2, 2] * steps[k]
                    if not (0 <= x < end and 0 <= y < end and 0 <= z < end):  # so nan is none
                        continue
                    if nearest:
                        cell = int(np.rint(x)), int(np.rint(y)), int(np.rint(z))
                        found[m, i, j, k] = padded[cell]
                    else:
                        found[m, i, j, k] = _between(padded, x, y, z)


@numba.njit(cache=True, nogil=True)
def _between(cube, x, y, z):
    """Linear between the eight cells around a place >= 0."""
    i, j, k = int(x), int(y), int(z)
    a, b, c = x - i, y - j, z - k
    near = (1 - c) * cube[i, j, k] + c * cube[i, j, k + 1]
    left = (1 - c) * cube[i, j + 1, k] + c * cube[i, j + 1, k + 1]
    far = (1 - c) * cube[i + 1, j, k] + c * cube[i + 1, j, k + 1]
    across = (1 - c) * cube[i + 1, j + 1, k] + c * cube[i + 1, j + 1, k + 1]
    return (1 - a) * ((1 - b) * near + b * left) + a * ((1 - b) * far + b * across)
