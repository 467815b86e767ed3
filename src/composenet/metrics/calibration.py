"""Is a confidence of 0.8 right eight times in ten?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from composenet.errors import DataError
from composenet.metrics.clear import correspondences
from composenet.metrics.evaluate import tracking_frames
from composenet.metrics.records import MATCH_GATE_M
from composenet.records import SequenceTruth, TrackedObject

BINS = 10


@dataclass(frozen=True)
class Judged:
    """Claims and what became of them. confidence: (N,) in 0..1. right: (N,) bool."""

    confidence: NDArray[np.float64]
    right: NDArray[np.bool_]

    @staticmethod
    def joined(parts: Sequence[Judged]) -> Judged:
        """The claims of several frames or sequences together."""
        return Judged(
            np.concatenate([np.zeros(0), *(part.confidence for part in parts)]),
            np.concatenate([np.zeros(0, dtype=bool), *(part.right for part in parts)]),
        )


@dataclass(frozen=True)
class Calibration:
    """Claims by confidence, in bins of equal width. edges: (B + 1,). counts: (B,).
    confidence: (B,) mean of the bin, share_right: (B,), both NaN in empty bins. error: expected
    calibration error, the mean over all claims of their bin's gap between the two; NaN where
    nothing was claimed."""

    edges: NDArray[np.float64]
    counts: NDArray[np.int64]
    confidence: NDArray[np.float64]
    share_right: NDArray[np.float64]
    error: float


def calibration(claims: Judged, bins: int = BINS) -> Calibration:
    """Bins are closed below; the last one also holds 1. Raises DataError for confidences outside
    0..1."""
    values = np.asarray(claims.confidence, dtype=np.float64)
    if not ((values >= 0) & (values <= 1)).all():
        raise DataError("a confidence lies outside 0..1, so it cannot be a share")
    member = np.minimum((values * bins).astype(np.int64), bins - 1)
    counts = np.bincount(member, minlength=bins)
    with np.errstate(invalid="ignore"):
        confidence = np.bincount(member, weights=values, minlength=bins) / counts
        share_right = np.bincount(member, weights=claims.right, minlength=bins) / counts
    gaps = np.nan_to_num(np.abs(share_right - confidence))
    error = float((counts * gaps).sum() / counts.sum()) if len(values) else float("nan")
    return Calibration(np.linspace(0, 1, bins + 1), counts, confidence, share_right, error)


def judged_tracks(truth: SequenceTruth, tracked: Sequence[Sequence[TrackedObject]]) -> Judged:
    """Every track in every frame in which it says that it sees its object. Right where CLEAR MOT
    matches it (class equal, centres under 25 cm apart, one to one); a track that matches an
    ignored object is neither right nor wrong. tracked: one entry for every frame of the truth.
    """
    frames = tracking_frames(truth, tracked)
    parts = []
    for frame, matches, entries in zip(
        frames, correspondences(frames, MATCH_GATE_M), tracked, strict=True
    ):
        confidence = {entry.track_id: entry.confidence for entry in entries}
        right = np.zeros(len(frame.track_ids), dtype=bool)
        right[matches.columns] = True
        values = [confidence[track_id] for track_id in frame.track_ids.tolist()]
        parts.append(Judged(np.array(values, dtype=np.float64), right))
    return Judged.joined(parts)
