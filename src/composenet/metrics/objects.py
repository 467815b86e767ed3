"""Scores of each frame's posed detections: detection, completion and pose."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from composenet.geometry.box import OrientedBox, pairwise_iou, pairwise_oriented_iou
from composenet.metrics.completion import (
    CompletionError,
    VoxelVolume,
    completion_error,
    volume_iou,
    voxelize_estimate,
    voxelize_truth,
)
from composenet.metrics.detection import (
    UNMATCHED,
    DetectionOutcomes,
    concatenate,
    match_greedily,
    outcomes,
)
from composenet.metrics.pose import PoseError, pose_error
from composenet.metrics.records import ScoredFrame
from composenet.records import (
    CLASS_NAMES,
    Frame,
    ObjectEstimate,
    ObjectFrameTruth,
    ObjectTruth,
)

MATCH_IOU = 0.25
"""box IoU at which a detection is compared with a truth for pose and completion"""


@dataclass(frozen=True)
class ClassOutcomes:
    """Outcomes of one class by kind of IoU (axis-aligned boxes, oriented boxes, volumes) and
    threshold (0.25, 0.5)."""

    box25: DetectionOutcomes
    box50: DetectionOutcomes
    oriented25: DetectionOutcomes
    oriented50: DetectionOutcomes
    completion25: DetectionOutcomes
    completion50: DetectionOutcomes


@dataclass(frozen=True)
class MatchedObject:
    """A detection matched to a counted object at box IoU 0.25 and equal class."""

    class_id: int
    pose: PoseError
    completion: CompletionError


@dataclass(frozen=True)
class ObjectScores:
    """Detections of a sequence. classes: by class_id. counted: object-frames to be found."""

    classes: tuple[ClassOutcomes, ...]
    matched: tuple[MatchedObject, ...]
    counted: int


@dataclass(frozen=True)
class PosedTruth:
    """An object in a frame. ignored: too few visible pixels to count."""

    truth: ObjectTruth
    placed: ObjectFrameTruth
    ignored: bool


def score_objects(
    truths: Sequence[Sequence[PosedTruth]],
    estimates: Sequence[Sequence[ObjectEstimate]],
    frames: Sequence[Frame] | None = None,
) -> ObjectScores:
    """Scores of every frame's posed detections. All arguments have one entry a frame; with
    `frames`, surface errors are split into seen and unseen."""
    volumes = TruthVolumes()
    parts: list[list[ClassOutcomes]] = [[] for _ in CLASS_NAMES]
    matched: list[MatchedObject] = []
    for index, (present, found) in enumerate(zip(truths, estimates, strict=True)):
        frame = frames[index] if frames is not None else None
        for class_id in range(len(CLASS_NAMES)):
            gts = [truth for truth in present if truth.truth.class_id == class_id]
            predictions = [estimate for estimate in found if estimate.class_id == class_id]
            if gts or predictions:
                pairs = _Pairs(gts, predictions, volumes)
                parts[class_id].append(pairs.outcomes())
                matched += pairs.matched(frame)
    return ObjectScores(
        classes=tuple(join_outcomes(part) for part in parts),
        matched=tuple(matched),
        counted=sum(not truth.ignored for present in truths for truth in present),
    )


def join_outcomes(parts: Sequence[ClassOutcomes]) -> ClassOutcomes:
    """The outcomes of one class over several frames or sequences."""
    names = [field.name for field in fields(ClassOutcomes)]
    return ClassOutcomes(**{n: concatenate([getattr(part, n) for part in parts]) for n in names})


class TruthVolumes:
    """Volumes of true objects, made when first needed and kept while an object rests."""

    def __init__(self) -> None:
        self._last: dict[int, tuple[bytes, VoxelVolume]] = {}

    def __call__(self, truth: PosedTruth) -> VoxelVolume:
        pose = np.asarray(truth.placed.T_world_object, dtype=np.float64)
        gt_id = truth.truth.gt_id
        if gt_id not in self._last or self._last[gt_id][0] != pose.tobytes():
            self._last[gt_id] = (pose.tobytes(), voxelize_truth(truth.truth, pose))
        return self._last[gt_id][1]


class _Pairs:
    """Truths and detections of one class in one frame."""

    def __init__(
        self,
        truths: Sequence[PosedTruth],
        estimates: Sequence[ObjectEstimate],
        truth_volume: Callable[[PosedTruth], VoxelVolume],
    ) -> None:
        self._truths, self._estimates, self._truth_volume = truths, estimates, truth_volume
        self._volumes = [voxelize_estimate(estimate) for estimate in estimates] if truths else []
        self._ignored = np.array([truth.ignored for truth in truths], dtype=bool)
        self._scores = np.array([estimate.score for estimate in estimates], dtype=np.float64)
        self._boxes = self._frame(
            pairwise_iou([t.placed.box for t in truths], [e.box for e in estimates])
        )

    def outcomes(self) -> ClassOutcomes:
        boxes, oriented = self._boxes, self._frame(self._oriented_iou())
        volumes = self._frame(self._volume_iou())
        return ClassOutcomes(
            outcomes([boxes], 0.25),
            outcomes([boxes], 0.5),
            outcomes([oriented], 0.25),
            outcomes([oriented], 0.5),
            outcomes([volumes], 0.25),
            outcomes([volumes], 0.5),
        )

    def matched(self, frame: Frame | None) -> list[MatchedObject]:
        result = []
        for column, row in enumerate(match_greedily(self._boxes, MATCH_IOU)):
            if row == UNMATCHED or self._ignored[row]:
                continue
            gt, estimate = self._truths[row], self._estimates[column]
            result.append(
                MatchedObject(
                    class_id=estimate.class_id,
                    pose=pose_error(
                        estimate.S_world_canonical, gt.placed.T_world_object, gt.truth.symmetry
                    ),
                    completion=completion_error(
                        self._truth_volume(gt), self._volumes[column], frame
                    ),
                )
            )
        return result

    def _frame(self, similarity: NDArray[np.float64]) -> ScoredFrame:
        return ScoredFrame(similarity, self._scores, self._ignored)

    def _oriented_iou(self) -> NDArray[np.float64]:
        true_boxes = []
        for gt in self._truths:
            pose = gt.placed.T_world_object
            true_boxes.append(OrientedBox(pose[:3, 3], pose[:3, :3], gt.truth.extents_m))
        boxes = [
            OrientedBox(e.S_world_canonical.t, e.S_world_canonical.R, e.extents_m)
            for e in self._estimates
        ]
        return pairwise_oriented_iou(true_boxes, boxes)

    def _volume_iou(self) -> NDArray[np.float64]:
        values = np.zeros((len(self._truths), len(self._estimates)))
        for row, gt in enumerate(self._truths):
            for column, volume in enumerate(self._volumes):
                if volume.touches(gt.placed.box):
                    values[row, column] = volume_iou(self._truth_volume(gt), volume)
        return values
