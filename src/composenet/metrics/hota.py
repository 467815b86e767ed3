"""HOTA: detection and association in one number (Luiten et al., IJCV 2021)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from composenet.metrics.records import MATCH_GATE_M, TrackingFrame

ALPHAS = np.arange(0.05, 0.99, 0.05)
"""similarity thresholds 0.05, 0.10, ... 0.95"""
_EPSILON = np.finfo(np.float64).eps


@dataclass(frozen=True)
class HotaScores:
    """Sums for each of the 19 alphas; those of several sequences add up.

    tp, fn, fp: (19,) object-frames. association_sum: (19,) over the TPs, of the IoU of the
    two trajectories each TP belongs to. similarity_sum: (19,) over the TPs.
    """

    tp: NDArray[np.float64]
    fn: NDArray[np.float64]
    fp: NDArray[np.float64]
    association_sum: NDArray[np.float64]
    similarity_sum: NDArray[np.float64]

    def __add__(self, other: HotaScores) -> HotaScores:
        return HotaScores(
            self.tp + other.tp,
            self.fn + other.fn,
            self.fp + other.fp,
            self.association_sum + other.association_sum,
            self.similarity_sum + other.similarity_sum,
        )

    @property
    def det_a(self) -> float:
        """Detection accuracy, mean over alphas."""
        return float(np.mean(self._det_a()))

    @property
    def ass_a(self) -> float:
        """Association accuracy, mean over alphas."""
        return float(np.mean(self._ass_a()))

    @property
    def loc_a(self) -> float:
        """Mean similarity of the TPs, mean over alphas; 1 where there is none."""
        return float(np.mean(np.maximum(1e-10, self.similarity_sum) / np.maximum(1e-10, self.tp)))

    @property
    def hota(self) -> float:
        """sqrt(DetA * AssA), mean over alphas."""
        return float(np.mean(np.sqrt(self._det_a() * self._ass_a())))

    def _det_a(self) -> NDArray[np.float64]:
        return self.tp / np.maximum(1, self.tp + self.fn + self.fp)

    def _ass_a(self) -> NDArray[np.float64]:
        return self.association_sum / np.maximum(1, self.tp)


def hota_scores(frames: Sequence[TrackingFrame], gate_m: float = MATCH_GATE_M) -> HotaScores:
    """HOTA sums of one sequence; similarity 0.5 is the gate (`TrackingFrame.similarity`).

    One assignment a frame serves all alphas: it maximises similarity weighted by how well the
    two identities agree over the whole sequence.
    """
    indexed = _Indexed(frames, gate_m)
    alignment = indexed.alignment()
    matched = np.zeros((len(ALPHAS), *alignment.shape))
    similarity_sum = np.zeros(len(ALPHAS))
    for rows, columns, similarity in indexed.frames:
        value = alignment[np.ix_(rows, columns)] * similarity
        r, c = linear_sum_assignment(value, maximize=True)
        good = similarity[r, c] >= ALPHAS[:, None] - _EPSILON
        for alpha in range(len(ALPHAS)):
            matched[alpha, rows[r[good[alpha]]], columns[c[good[alpha]]]] += 1
        similarity_sum += (good * similarity[r, c]).sum(axis=1)
    union = indexed.gt_counts[:, None] + indexed.track_counts - matched
    tp = matched.sum(axis=(1, 2))
    return HotaScores(
        tp=tp,
        fn=indexed.gt_counts.sum() - tp,
        fp=indexed.track_counts.sum() - tp,
        association_sum=(matched * matched / np.maximum(1, union)).sum(axis=(1, 2)),
        similarity_sum=similarity_sum,
    )


class _Indexed:
    """Frames with identities numbered from 0, and how often each identity appears."""

    def __init__(self, frames: Sequence[TrackingFrame], gate_m: float) -> None:
        gt_ids = np.unique(np.concatenate([[], *(frame.gt_ids for frame in frames)]))
        track_ids = np.unique(np.concatenate([[], *(frame.track_ids for frame in frames)]))
        self.gt_counts, self.track_counts = np.zeros(len(gt_ids)), np.zeros(len(track_ids))
        self.frames = []
        for frame in frames:
            rows = np.searchsorted(gt_ids, frame.gt_ids)
            columns = np.searchsorted(track_ids, frame.track_ids)
            self.gt_counts[rows] += 1
            self.track_counts[columns] += 1
            self.frames.append((rows, columns, frame.similarity(gate_m)))

    def alignment(self) -> NDArray[np.float64]:
        """(ids, ids) soft IoU of trajectories: each frame's similarity over what competes."""
        shared = np.zeros((len(self.gt_counts), len(self.track_counts)))
        for rows, columns, similarity in self.frames:
            rivals = similarity.sum(axis=0)[None] + similarity.sum(axis=1)[:, None] - similarity
            share = np.zeros_like(similarity)
            np.divide(similarity, rivals, out=share, where=rivals > _EPSILON)
            shared[np.ix_(rows, columns)] += share
        return shared / (self.gt_counts[:, None] + self.track_counts - shared)
