"""Masks with sharp rims: an image cut along depth steps and concave edges, its pieces given to
the instance masks that cover them.

MaskFusion, section "Segmentation": a pixel is an edge where a neighbour lies off its tangent plane
or where the surface folds inwards; what connects without crossing an edge is one convex-ish piece.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_closing, find_objects, label

from composenet.baselines.frame_maps import Maps
from composenet.records import FloatArray

CONCAVITY = 0.107
"""1 - cosine between two normals that fold inwards (27 degrees)"""
STEP_M, STEP_PER_M2 = 0.01, 0.006
"""a neighbour farther off the tangent plane than the first plus the second times depth squared"""
MIN_PIECE_PIXELS = 40
"""smaller pieces belong to no mask"""
MASK_SHARE = 0.65
"""of a piece's pixels, that a mask must cover to own it"""
_GROWTH, _GROWN_STEP_M, _GROWING_PIXELS = 3, 0.016, 12
_CROSS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], bool)


def pieces(maps: Maps) -> NDArray[np.int32]:
    """(H, W) number from 1 of the connected piece a pixel belongs to, 0 on edges and where
    nothing was measured. Pieces grow over edges onto pixels of nearly their depth."""
    edges = edge_map(maps.points, maps.normals)
    numbers, _ = label(~edges, _CROSS)
    return np.asarray(_grown(numbers.astype(np.int32), maps.points[..., 2]))


def masks_of_pieces(
    numbers: NDArray[np.int32], masks: NDArray[np.bool_]
) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """The refined masks: the union of the pieces that each covers. numbers: (H, W) as from
    `pieces`. masks: (M, H, W) bool, the surest last: it wins where they overlap.

    Returns (H, W) number from 1 of the mask a pixel belongs to, 0 for none, and (P + 1,) whether
    a piece is in a mask.
    """
    given = np.zeros(numbers.shape, np.int32)
    for number, mask in enumerate(masks, start=1):
        given[mask] = number
    counts = overlap_counts(numbers, given, len(masks) + 1)
    sizes = counts.sum(axis=1)
    counts[:, 0] = 0
    best = counts.argmax(axis=1)
    owned = (counts.max(axis=1) > MASK_SHARE * sizes) & (sizes >= MIN_PIECE_PIXELS)
    owned[0] = False
    refined = np.where(owned, best, 0)[numbers].astype(np.int32)
    closed = refined.copy()
    for number, place in enumerate(find_objects(refined), start=1):
        if place is not None:  # closing fills nothing outside a mask's box
            whole = binary_closing(np.pad(refined[place] == number, 2), _CROSS, iterations=2)
            closed[place][whole[2:-2, 2:-2] & (refined[place] == 0)] = number
    return closed, owned


def overlap_counts(
    rows: NDArray[np.int32], columns: NDArray[np.int32], n_columns: int
) -> NDArray[np.int64]:
    """(R, n_columns) pixels that have one number in the first image and one in the second."""
    n_rows = int(rows.max()) + 1
    flat = rows.ravel().astype(np.int64) * n_columns + columns.ravel()
    return np.bincount(flat, minlength=n_rows * n_columns).reshape(n_rows, n_columns)


@numba.njit(cache=True, nogil=True)
def edge_map(points: FloatArray, normals: FloatArray) -> NDArray[np.bool_]:
    """(H, W) bool: steps, inward folds, and pixels without a normal. points, normals: (H, W, 3)
    in camera axes."""
    height, width = points.shape[:2]
    edges = np.ones((height, width), np.bool_)
    for v in range(height):
        for u in range(width):
            px, py, pz = points[v, u]
            nx, ny, nz = normals[v, u]
            if pz <= 0 or nx * nx + ny * ny + nz * nz < 0.5:
                continue
            step_m = STEP_M + STEP_PER_M2 * pz * pz
            edge = False
            for y in range(max(0, v - 1), min(height, v + 2)):
                for x in range(max(0, u - 1), min(width, u + 2)):
                    qx, qy, qz = points[y, x]
                    if edge or qz <= 0:
                        continue
                    off = 0.0 + (qx - px) * nx + (qy - py) * ny + (qz - pz) * nz
                    edge = abs(off) > step_m
                    if off > 0 and not edge:
                        mx, my, mz = normals[y, x]
                        known = mx != 0 or my != 0 or mz != 0
                        edge = known and 1 - (0.0 + nx * mx + ny * my + nz * mz) > CONCAVITY
            edges[v, u] = edge
    return edges


@numba.njit(cache=True, nogil=True)
def _grown(numbers, depth):
    """Pieces of some size take pixels on edges, and of tiny pieces, beside them."""
    height, width = numbers.shape
    sizes = np.zeros(numbers.max() + 1, np.int64)
    for v in range(height):
        for u in range(width):
            sizes[numbers[v, u]] += 1
    for _ in range(_GROWTH):
        before = numbers.copy()
        for v in range(1, height - 1):
            for u in range(1, width - 1):
                own = before[v, u]
                if depth[v, u] <= 0 or (own != 0 and sizes[own] >= _GROWING_PIXELS):
                    continue
                for k in range(9):
                    y, x = v + k // 3 - 1, u + k % 3 - 1
                    other = before[y, x]
                    near = abs(depth[y, x] - depth[v, u]) < _GROWN_STEP_M
                    if other != 0 and near and sizes[other] >= _GROWING_PIXELS:
                        numbers[v, u] = other
                        break
    return numbers
