"""Pair scores between tracklets (rows) and proposals (columns)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from composenet.records import Box, FloatArray

OCCUPIED = 0.5
"""Canonical reconstructions are binarised here (paper, Object Tracking)."""


def center_distance_m(a: Sequence[Box], b: Sequence[Box]) -> NDArray[np.float64]:
    """(A, B) distances between the centres of boxes, metres."""
    if not a or not b:
        return np.zeros((len(a), len(b)))
    return np.linalg.norm(_centers(a)[:, None] - _centers(b)[None], axis=-1)


def same_class(a: Sequence[int], b: Sequence[int]) -> NDArray[np.bool_]:
    """(A, B) whether the classes are equal."""
    return np.asarray(a, dtype=int)[:, None] == np.asarray(b, dtype=int)[None]


def occupancy_bits(canonical: FloatArray) -> NDArray[np.uint64]:
    """(4096,) words holding the 64^3 cells of a canonical reconstruction, binarised at 0.5."""
    return np.packbits(canonical.reshape(-1) >= OCCUPIED).view(np.uint64)


def canonical_iou(
    a: Sequence[NDArray[np.uint64]], b: Sequence[NDArray[np.uint64]]
) -> NDArray[np.float64]:
    """(A, B) volumetric IoU of binarised reconstructions (`occupancy_bits`).

    Two empty ones have an IoU of 0: nothing was recognised. Paper, Object Tracking.
    """
    iou = np.zeros((len(a), len(b)))
    if not a or not b:
        return iou
    columns = np.stack(b)
    for row, bits in enumerate(a):
        shared = np.bitwise_count(columns & bits).sum(axis=1, dtype=np.int64)
        either = np.bitwise_count(columns | bits).sum(axis=1, dtype=np.int64)
        iou[row] = shared / np.maximum(either, 1)
    return iou


def _centers(boxes: Sequence[Box]) -> NDArray[np.float64]:
    return np.array([box.center for box in boxes], dtype=np.float64)
