"""A sequence's tracks and estimates against its truth; sequences together as a data set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from composenet.errors import DataError
from composenet.metrics.clear import ClearScores, clear_mot, drop_ignored
from composenet.metrics.detection import average_precision
from composenet.metrics.hota import HotaScores, hota_scores
from composenet.metrics.identity import IdentityScores, identity_scores
from composenet.metrics.objects import ObjectScores, PosedTruth, join_outcomes, score_objects
from composenet.metrics.pose import PoseScores, pose_scores
from composenet.metrics.records import FrameEvaluation, TrackingFrame, counted_pixels
from composenet.records import (
    CLASS_NAMES,
    Frame,
    ObjectEstimate,
    SequenceTruth,
    TrackedObject,
    TrackState,
)

SEEN_STATES = (TrackState.TRACKED, TrackState.RE_FOUND)
"""a track claims an object only in frames in which it says that it sees it"""


@dataclass(frozen=True)
class SequenceScores:
    """One sequence. clear: all classes; clear_per_class: by class_id. objects: None where only
    tracks were scored. seconds_per_frame: as given, one a frame, or empty."""

    clear: ClearScores
    clear_per_class: tuple[ClearScores, ...]
    identity: IdentityScores
    hota: HotaScores
    objects: ObjectScores | None = None
    seconds_per_frame: tuple[float, ...] = ()


@dataclass(frozen=True)
class AveragePrecisions:
    """By class_id, 0..1, NaN for classes without truth."""

    box25: tuple[float, ...]
    box50: tuple[float, ...]
    oriented25: tuple[float, ...]
    oriented50: tuple[float, ...]
    completion25: tuple[float, ...]
    completion50: tuple[float, ...]


@dataclass(frozen=True)
class CompletionScores:
    """Means over the matched objects, NaN where none is: volume IoU 0..1, surface distances
    in centimetres (see CompletionError)."""

    volume_iou: float
    chamfer_cm: float
    seen_cm: float
    unseen_cm: float


@dataclass(frozen=True)
class DatasetScores:
    """Several sequences. Shares are 0..1, NaN where undefined (IDF1 and HOTA 0, as in TrackEval).

    mota_by_sequence: by name, NaN for a sequence without counted objects; mota_mean: of the
    others, with its 95 % interval (bootstrap over sequences). clear, clear_per_class, identity,
    hota: pooled over all sequences. precisions, completion, pose: None where only tracks were
    scored. track_iou: mean of all TrackletCompletions, 0..1; NaN where no track has a
    reconstruction.
    """

    mota_by_sequence: Mapping[str, float]
    mota_mean: float
    mota_interval: tuple[float, float]
    clear: ClearScores
    clear_per_class: tuple[ClearScores, ...]
    identity: IdentityScores
    hota: HotaScores
    precisions: AveragePrecisions | None
    completion: CompletionScores | None
    pose: PoseScores | None
    seconds_median: float
    seconds_p95: float
    track_iou: float = float("nan")


def evaluate_sequence(
    truth: SequenceTruth,
    tracked: Sequence[Sequence[TrackedObject]],
    estimates: Sequence[Sequence[ObjectEstimate]] | None = None,
    *,
    frames: Sequence[Frame] | None = None,
    seconds_per_frame: Sequence[float] = (),
) -> SequenceScores:
    """Score one sequence; each list has one entry for every frame of the truth, in its order.

    Only tracked objects in state tracked or re-found count: an occluded, lost or ended track
    does not claim to see its object. Raises DataError where the lengths differ, an object has
    no truth record, or a track id stands twice in a frame.
    """
    for name, given in (("tracks", tracked), ("estimates", estimates), ("frames", frames)):
        if given is not None and len(given) != len(truth.frames):
            raise DataError(
                f"{name} for {len(given)} frames, but the ground truth has {len(truth.frames)}: "
                "give one list a frame, empty where nothing was found"
            )
    present = posed_truths(truth)
    evaluated = _evaluated(present, tracked)
    all_classes = drop_ignored(evaluated)
    return SequenceScores(
        clear=clear_mot(all_classes),
        clear_per_class=tuple(
            clear_mot(drop_ignored([frame.of_class(class_id) for frame in evaluated]))
            for class_id in range(len(CLASS_NAMES))
        ),
        identity=identity_scores(all_classes),
        hota=hota_scores(all_classes),
        objects=None if estimates is None else score_objects(present, estimates, frames),
        seconds_per_frame=tuple(seconds_per_frame),
    )


def tracking_frames(
    truth: SequenceTruth, tracked: Sequence[Sequence[TrackedObject]]
) -> list[TrackingFrame]:
    """What the tracking metrics see of a sequence: ids and distances, without what is ignored.
    tracked: one entry for every frame of the truth. Raises DataError."""
    return drop_ignored(_evaluated(posed_truths(truth), tracked))


def posed_truths(truth: SequenceTruth) -> list[list[PosedTruth]]:
    """Every frame's objects with their constant part, and whether they are ignored: with fewer
    than 150 visible pixels at 320x240, scaled by the image's area. Raises DataError."""
    objects = {item.gt_id: item for item in truth.objects}
    needed = counted_pixels(*truth.image_size)
    result = []
    for index, frame in enumerate(truth.frames):
        for placed in frame:
            if placed.gt_id not in objects:
                raise DataError(
                    f"ground truth, frame {index}: object {placed.gt_id} is not in the "
                    "sequence's list of objects"
                )
        result.append([PosedTruth(objects[p.gt_id], p, p.visible_pixels < needed) for p in frame])
    return result


def aggregate(by_name: Mapping[str, SequenceScores]) -> DatasetScores:
    """The scores of a data set from those of its sequences, by name. Raises DataError for no
    sequences."""
    if not by_name:
        raise DataError("no sequences to score: is the data folder empty?")
    scores = tuple(by_name.values())
    motas = np.array([score.clear.mota for score in scores])
    first, rest = scores[0], scores[1:]
    objects = [score.objects for score in scores if score.objects is not None]
    seconds = np.concatenate([score.seconds_per_frame for score in scores])
    return DatasetScores(
        mota_by_sequence=dict(zip(by_name, motas.tolist(), strict=True)),
        mota_mean=_mean(motas),
        mota_interval=bootstrap_interval(motas),
        clear=sum((score.clear for score in rest), first.clear),
        clear_per_class=tuple(
            sum(parts, ClearScores())
            for parts in zip(*(score.clear_per_class for score in scores), strict=True)
        ),
        identity=sum((score.identity for score in rest), first.identity),
        hota=sum((score.hota for score in rest), first.hota),
        precisions=_precisions(objects) if objects else None,
        completion=_completion(objects) if objects else None,
        pose=_pose(objects) if objects else None,
        seconds_median=float(np.median(seconds)) if len(seconds) else float("nan"),
        seconds_p95=float(np.percentile(seconds, 95)) if len(seconds) else float("nan"),
    )


def bootstrap_interval(values: np.ndarray, samples: int = 2000) -> tuple[float, float]:
    """95 % interval of the mean of (N,) values, NaN left out, by resampling (seeded)."""
    values = values[~np.isnan(values)]
    if len(values) == 0:
        return float("nan"), float("nan")
    picks = np.random.default_rng(0).integers(len(values), size=(samples, len(values)))
    low, high = np.percentile(values[picks].mean(axis=1), [2.5, 97.5])
    return float(low), float(high)


def _evaluated(
    present: Sequence[Sequence[PosedTruth]], tracked: Sequence[Sequence[TrackedObject]]
) -> list[FrameEvaluation]:
    pairs = enumerate(zip(present, tracked, strict=True))
    return [_frame_evaluation(index, *pair) for index, pair in pairs]


def _frame_evaluation(
    index: int, present: Sequence[PosedTruth], tracked: Sequence[TrackedObject]
) -> FrameEvaluation:
    seen = [entry for entry in tracked if entry.state in SEEN_STATES]
    track_ids = np.array([entry.track_id for entry in seen], dtype=np.int64)
    if len(np.unique(track_ids)) != len(track_ids):
        raise DataError(f"tracks, frame {index}: a track id stands there twice; ids must differ")
    return FrameEvaluation(
        gt_ids=np.array([p.truth.gt_id for p in present], dtype=np.int64),
        gt_class_ids=np.array([p.truth.class_id for p in present], dtype=np.int64),
        gt_centers_m=np.array([p.placed.box.center for p in present]).reshape(-1, 3),
        ignored=np.array([p.ignored for p in present], dtype=bool),
        track_ids=track_ids,
        track_class_ids=np.array([entry.class_id for entry in seen], dtype=np.int64),
        track_centers_m=np.array([entry.box.center for entry in seen]).reshape(-1, 3),
    )


def _mean(values: np.ndarray) -> float:
    values = values[~np.isnan(values)]
    return float(values.mean()) if len(values) else float("nan")


def _precisions(objects: Sequence[ObjectScores]) -> AveragePrecisions:
    classes = [join_outcomes(parts) for parts in zip(*(o.classes for o in objects), strict=True)]
    return AveragePrecisions(
        box25=tuple(average_precision(c.box25) for c in classes),
        box50=tuple(average_precision(c.box50) for c in classes),
        oriented25=tuple(average_precision(c.oriented25) for c in classes),
        oriented50=tuple(average_precision(c.oriented50) for c in classes),
        completion25=tuple(average_precision(c.completion25) for c in classes),
        completion50=tuple(average_precision(c.completion50) for c in classes),
    )


def _completion(objects: Sequence[ObjectScores]) -> CompletionScores:
    errors = [item.completion for score in objects for item in score.matched]
    return CompletionScores(
        volume_iou=_mean(np.array([error.volume_iou for error in errors])),
        chamfer_cm=_mean(np.array([error.chamfer_cm for error in errors])),
        seen_cm=_mean(np.array([error.seen_cm for error in errors])),
        unseen_cm=_mean(np.array([error.unseen_cm for error in errors])),
    )


def _pose(objects: Sequence[ObjectScores]) -> PoseScores:
    errors = [item.pose for score in objects for item in score.matched]
    return pose_scores(errors, sum(score.counted for score in objects))
