"""IDF1: one track for one object over the whole sequence (Ristani et al., 2016)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from composenet.metrics.records import MATCH_GATE_M, TrackingFrame


@dataclass(frozen=True)
class IdentityScores:
    """Object-frames under the best one-to-one map of identities. Sequences add up."""

    idtp: int = 0
    idfn: int = 0
    idfp: int = 0

    def __add__(self, other: IdentityScores) -> IdentityScores:
        return IdentityScores(
            self.idtp + other.idtp, self.idfn + other.idfn, self.idfp + other.idfp
        )

    @property
    def idf1(self) -> float:
        """2 IDTP / (2 IDTP + IDFN + IDFP)."""
        return 2 * self.idtp / max(1, 2 * self.idtp + self.idfn + self.idfp)

    @property
    def idp(self) -> float:
        """Precision under the map."""
        return self.idtp / max(1, self.idtp + self.idfp)

    @property
    def idr(self) -> float:
        """Recall under the map."""
        return self.idtp / max(1, self.idtp + self.idfn)


def identity_scores(
    frames: Sequence[TrackingFrame], gate_m: float = MATCH_GATE_M
) -> IdentityScores:
    """IDTP, IDFN and IDFP of one sequence.

    FN + FP is least where the frames shared by mapped identities are most, so the map is the
    assignment that maximises those.
    """
    gt_ids = np.unique(np.concatenate([[], *(frame.gt_ids for frame in frames)]))
    track_ids = np.unique(np.concatenate([[], *(frame.track_ids for frame in frames)]))
    shared = np.zeros((len(gt_ids), len(track_ids)), dtype=np.int64)
    for frame in frames:
        rows = np.searchsorted(gt_ids, frame.gt_ids)
        columns = np.searchsorted(track_ids, frame.track_ids)
        shared[np.ix_(rows, columns)] += frame.distance_m < gate_m
    rows, columns = linear_sum_assignment(shared, maximize=True)
    idtp = int(shared[rows, columns].sum())
    truths = sum(len(frame.gt_ids) for frame in frames)
    predictions = sum(len(frame.track_ids) for frame in frames)
    return IdentityScores(idtp, truths - idtp, predictions - idtp)
