"""Pair scores between tracklets (rows) and proposals (columns)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from composenet.records import Box, FloatArray

COARSE_CELLS = 32
"""Cells a side of the grid on which reconstructions are compared."""


def center_distance_m(a: Sequence[Box], b: Sequence[Box]) -> NDArray[np.float64]:
    """(A, B) distances between the centres of boxes, metres."""
    if not a or not b:
        return np.zeros((len(a), len(b)))
    return np.linalg.norm(_centers(a)[:, None] - _centers(b)[None], axis=-1)


def same_class(a: Sequence[int], b: Sequence[int]) -> NDArray[np.bool_]:
    """(A, B) whether the classes are equal."""
    return np.asarray(a, dtype=int)[:, None] == np.asarray(b, dtype=int)[None]


def coarse(canonical: FloatArray) -> NDArray[np.float32]:
    """(32, 32, 32) largest values of the blocks of a canonical reconstruction (64, 64, 64)."""
    step = canonical.shape[0] // COARSE_CELLS
    values = np.asarray(canonical, np.float32)
    values = reduce(np.maximum, [values[i::step] for i in range(step)])
    values = reduce(np.maximum, [values[:, i::step] for i in range(step)])
    return reduce(np.maximum, [values[..., i::step] for i in range(step)])


def canonical_iou(a: Sequence[FloatArray], b: Sequence[FloatArray]) -> NDArray[np.float64]:
    """(A, B) volumetric IoU of reconstructions in 0..1 (`coarse`): the sum of the smaller of two
    values over that of the larger, cell by cell; of the paper's binarised ones it is their IoU
    (Object Tracking). Thin parts seen from two sides are seldom above 0.5 in the same cells.

    Two empty ones have an IoU of 0: nothing was recognised.
    """
    if not a or not b:
        return np.zeros((len(a), len(b)))
    rows, columns = (np.stack(side).reshape(len(side), -1) for side in (a, b))
    both = rows.sum(axis=1, dtype=np.float64)[:, None] + columns.sum(axis=1, dtype=np.float64)
    apart = cdist(rows, columns, "cityblock")
    return np.divide(both - apart, both + apart, out=np.zeros_like(both), where=both > 0)


def _centers(boxes: Sequence[Box]) -> NDArray[np.float64]:
    return np.array([box.center for box in boxes], dtype=np.float64)
