"""Average precision from similarities: one scorer for boxes and for volumes.

All-point interpolation, per class, over a whole data set. Within a frame, detections take
truths strongest first; each takes the most similar free one. A detection that reaches no
counted truth but a free ignored one is dropped (as in COCO), so it is no false positive.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from composenet.metrics.records import IntArray, ScoredFrame

UNMATCHED = -1


@dataclass(frozen=True)
class DetectionOutcomes:
    """Detections of one class at one threshold, dropped ones left out.

    scores: (D,). correct: (D,) bool. truths: counted object-frames.
    """

    scores: NDArray[np.float64]
    correct: NDArray[np.bool_]
    truths: int


def match_greedily(frame: ScoredFrame, threshold: float) -> IntArray:
    """(P,) the truth each detection takes, or UNMATCHED. One truth, one detection."""
    taken = np.full(len(frame.scores), UNMATCHED, dtype=np.int64)
    free = np.ones(len(frame.ignored), dtype=bool)
    for detection in np.argsort(-frame.scores, kind="stable"):
        similarity = frame.similarity[:, detection]
        near = free & (similarity >= threshold)
        candidates = near & ~frame.ignored if np.any(near & ~frame.ignored) else near
        if candidates.any():
            truth = int(np.argmax(np.where(candidates, similarity, -np.inf)))
            taken[detection] = truth
            free[truth] = False
    return taken


def outcomes(frames: Iterable[ScoredFrame], threshold: float) -> DetectionOutcomes:
    """What became of every detection of one class over the given frames."""
    parts = []
    for frame in frames:
        taken = match_greedily(frame, threshold)
        matched = taken != UNMATCHED
        dropped = np.zeros(len(taken), dtype=bool)
        dropped[matched] = frame.ignored[taken[matched]]
        parts.append(
            DetectionOutcomes(
                frame.scores[~dropped], matched[~dropped], int((~frame.ignored).sum())
            )
        )
    return concatenate(parts)


def concatenate(parts: Sequence[DetectionOutcomes]) -> DetectionOutcomes:
    """The detections of several frames or sequences together."""
    return DetectionOutcomes(
        scores=np.concatenate([np.zeros(0), *(part.scores for part in parts)]),
        correct=np.concatenate([np.zeros(0, dtype=bool), *(part.correct for part in parts)]),
        truths=sum(part.truths for part in parts),
    )


def average_precision(result: DetectionOutcomes) -> float:
    """Area under the precision-recall curve, 0..1; NaN where there is no truth.

    Precision is made monotone from the right (all-point). Detections of one score enter
    together, so the order of frames makes no difference.
    """
    if result.truths == 0:
        return float("nan")
    if len(result.scores) == 0:
        return 0.0
    order = np.argsort(-result.scores, kind="stable")
    scores, correct = result.scores[order], result.correct[order]
    last_of_score = np.append(scores[1:] != scores[:-1], True)
    tp = np.cumsum(correct)[last_of_score]
    precision = tp / (np.flatnonzero(last_of_score) + 1)
    recall = np.concatenate([[0.0], tp / result.truths])
    envelope = np.maximum.accumulate(precision[::-1])[::-1]
    return float(np.sum(np.diff(recall) * envelope))


def mean_over_classes(values: Sequence[float]) -> float:
    """Mean over the classes that have truth; NaN where none has."""
    present = [value for value in values if not np.isnan(value)]
    return float(np.mean(present)) if present else float("nan")
