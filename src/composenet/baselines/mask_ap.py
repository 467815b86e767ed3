"""How good masks are: average precision by mask IoU, with the scorer of boxes and volumes.

As for the other metrics, truths of under 150 pixels (at 320x240) are ignored: neither missed nor,
if found, false.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from composenet.baselines.association import mask_iou
from composenet.baselines.records import InstanceMasks
from composenet.metrics.detection import average_precision, mean_over_classes, outcomes
from composenet.metrics.records import ScoredFrame, counted_pixels
from composenet.records import CLASS_NAMES

THRESHOLDS = (0.5, 0.55, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9, 0.95)


@dataclass(frozen=True)
class MaskScores:
    """In 0..1, NaN where undefined. ap50: mean over classes at IoU 0.5; class_ap50: of each, in
    their order; ap: mean over classes and IoU 0.5 to 0.95. precision50, recall50: of all classes'
    masks together at IoU 0.5, the class right. truths: masks that count."""

    ap50: float
    ap: float
    class_ap50: tuple[float, ...]
    precision50: float
    recall50: float
    truths: int


def scored_classes(truth: InstanceMasks, found: InstanceMasks) -> tuple[ScoredFrame, ...]:
    """One frame, class by class in their order."""
    height, width = truth.masks.shape[1:]
    ignored = truth.masks.sum(axis=(1, 2)) < counted_pixels(width, height)
    overlap = mask_iou(truth.masks, found.masks)
    result = []
    for class_id in range(len(CLASS_NAMES)):
        rows, columns = truth.class_ids == class_id, found.class_ids == class_id
        scores = found.scores[columns].astype(np.float64)
        result.append(ScoredFrame(overlap[rows][:, columns], scores, ignored[rows]))
    return tuple(result)


def mask_scores(frames: Sequence[tuple[ScoredFrame, ...]]) -> MaskScores:
    """Over all frames (see `scored_classes`)."""
    classes = list(zip(*frames, strict=True))
    at_50 = [outcomes(frames_of_class, THRESHOLDS[0]) for frames_of_class in classes]
    class_ap50 = tuple(average_precision(result) for result in at_50)
    means = [
        mean_over_classes([average_precision(outcomes(frames, t)) for frames in classes])
        for t in THRESHOLDS
    ]
    correct = sum(int(result.correct.sum()) for result in at_50)
    found = sum(len(result.scores) for result in at_50)
    truths = sum(result.truths for result in at_50)
    nan = float("nan")
    return MaskScores(
        ap50=means[0],
        ap=float(np.mean(means)),
        class_ap50=class_ap50,
        precision50=correct / found if found else nan,
        recall50=correct / truths if truths else nan,
        truths=truths,
    )
