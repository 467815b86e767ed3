"""One identity while it is being tracked: its last pose, its canonical model, its state.

States, each frame:
  seen                                        -> TRACKED, or RE_FOUND after an absence
  unseen, its place hidden or out of view     -> OCCLUDED
  unseen, its place in open view              -> LOST
  unseen for too long, or LOST too many times -> ENDED, for good; looking back not before the
                                                 first frame that showed it the first time
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from composenet.records import (
    CLASS_NAMES,
    Box,
    ObjectEstimate,
    Similarity,
    Track,
    TrackedObject,
    TrackState,
)
from composenet.tracking.canonical import CanonicalModel
from composenet.tracking.visibility import Visibility

if TYPE_CHECKING:
    from composenet.config import TrackingConfig


SMALLEST_DIAGONAL_M = 0.3
"""Noise of the centres does not shrink with objects smaller than this."""

FIRST_LOOK = 0.9
"""What a track's first detection counts."""


def stands_still(old: Box, new: Box, still_share: float) -> bool:
    """Whether the centre moved, horizontally, by at most still_share of the new box's horizontal
    diagonal."""
    step = float(np.linalg.norm((new.center - old.center)[:2]))
    return step <= still_share * max(float(np.linalg.norm(new.extents[:2])), SMALLEST_DIAGONAL_M)


def mean_box(old: Box, new: Box, share: float) -> Box:
    """The box between two, of which the new one has the given share."""
    return Box(
        old.center + share * (new.center - old.center),
        old.extents + share * (new.extents - old.extents),
    )


def decay(unseen: TrackState, config: TrackingConfig) -> float:
    """The factor on the confidence for a frame in which a track is LOST, or else."""
    return config.lost_decay if unseen is TrackState.LOST else config.occluded_decay


class Tracklet:
    """Mutable; owned by one Tracker. Born from a proposal, then told of every frame either
    that it was seen (`observe`) or that it was not (`miss`).

    It is told of from the frame on in which its confidence reaches config.min_confidence, until
    it is seen with less than config.keep_confidence (or the former, if that is lower); then once
    more when it reaches the former.

    Confidence: at birth nine tenths of the score; when seen again, the mean of the last
    confidence and the score, after an absence no less than at a birth; while unseen, it decays by
    a factor a frame, faster when lost than when occluded; 0 at the end.

    latest: the entry of the newest frame. told, ever_told: of in that frame, of in any.
    seen_this_way: whether a frame has shown it since the recording was turned back, if it was.
    """

    def __init__(
        self, track_id: int, frame_index: int, estimate: ObjectEstimate, config: TrackingConfig
    ) -> None:
        self.track_id = track_id
        self._config = config
        self.model = CanonicalModel(estimate.canonical.astype(np.float32))
        self.state = TrackState.TRACKED
        self._votes = np.zeros(len(CLASS_NAMES))
        self._confidence = FIRST_LOOK * estimate.score
        self.told = self.ever_told = False
        self._misses = self._visible_misses = 0
        self.box, self._steadiness = estimate.box, 0.0
        self._history: list[tuple[TrackedObject, bool]] = []  # with whether it was told of
        self._first_pass: dict[int, Box] = {}  # by frame, in order of time
        self.S_world_canonical = estimate.S_world_canonical
        self.extents_m = estimate.extents_m
        self._pose_known = estimate.pose_observable
        self._see(frame_index, estimate)

    @property
    def alive(self) -> bool:
        """Whether it may still be matched."""
        return self.state is not TrackState.ENDED

    @property
    def class_id(self) -> int:
        """The class with the largest sum of probabilities so far, each weighted by its score."""
        return int(np.argmax(self._votes))

    def observe(self, frame_index: int, estimate: ObjectEstimate) -> None:
        """The frame shows it as `estimate`."""
        absent = self.state in (TrackState.OCCLUDED, TrackState.LOST)
        self.state = TrackState.RE_FOUND if absent else TrackState.TRACKED
        self._confidence = (self._confidence + estimate.score) / 2
        if absent:
            self._confidence = max(self._confidence, FIRST_LOOK * estimate.score)
        self._update_shape(estimate, self._config.running_mean_weight)
        self._see(frame_index, estimate)

    def miss(self, frame_index: int, view: Visibility) -> None:
        """The frame does not show it, though `view` of its last place could be had."""
        config = self._config
        lost = view.expected >= config.expected_visible_share
        self._misses += 1
        self._visible_misses += lost
        self.state = TrackState.LOST if lost else TrackState.OCCLUDED
        self._confidence *= decay(self.state, config)
        to_come = next(iter(self._first_pass), frame_index) < frame_index
        if not to_come and (
            self._misses >= config.end_after_frames
            or self._visible_misses >= config.end_after_visible_misses
        ):
            self.state = TrackState.ENDED
            self._confidence = 0.0
        self._record(frame_index, observed=False)

    def first_pass_box(self, frame_index: int) -> Box | None:
        """Looking back: where this frame showed it the first time; None where it did not."""
        return self._first_pass.get(frame_index)

    def track(self, whole: bool = False) -> Track:
        """Every frame in which it was told of, perhaps none, as a record. whole: in hindsight,
        those between the first and the last of them, too."""
        rows = [row for row, (_, told) in enumerate(self._history) if told]
        if whole and rows:
            rows = list(range(rows[0], rows[-1] + 1))
        history = tuple(self._history[row][0] for row in rows)
        self.model.mean.setflags(write=False)
        return Track(self.track_id, self.class_id, history, self.model.mean)

    def turn_back(self) -> None:
        """The recording is looked at again from its end: it stays what it was when last seen, its
        history begins anew. Frames that have not shown it since will be missed again."""
        seen = [entry for entry, _ in self._history if entry.observed]
        self._first_pass = {entry.frame_index: entry.box for entry in seen}
        self._history = []
        self.seen_this_way = False
        self._misses = self._visible_misses = 0
        self._confidence = self._confidence_seen

    def _update_shape(self, estimate: ObjectEstimate, weight: float) -> None:
        """Pose, extents and canonical model. An estimate whose pose is not observable says
        where the object is, not how it is turned or shaped."""
        if estimate.pose_observable:
            fresh = CanonicalModel(estimate.canonical.astype(np.float32))
            known = self._pose_known
            self.model = self.model.updated(estimate.canonical, weight) if known else fresh
        if estimate.pose_observable or not self._pose_known:
            self.S_world_canonical = estimate.S_world_canonical
            self.extents_m = estimate.extents_m
            self._pose_known = estimate.pose_observable
        else:
            last, shift = self.S_world_canonical, estimate.box.center - self.box.center
            self.S_world_canonical = Similarity(last.scale_m, last.R, last.t + shift)

    def _see(self, frame_index: int, estimate: ObjectEstimate) -> None:
        self.box = self._steadied(estimate)
        S, shift = self.S_world_canonical, self.box.center - estimate.box.center
        self.S_world_canonical = Similarity(S.scale_m, S.R, S.t + shift)
        self.last_seen, self.seen_this_way = frame_index, True
        self._votes += max(estimate.score, 1e-3) * estimate.class_probabilities
        self._misses = self._visible_misses = 0
        self._confidence_seen = self._confidence
        config = self._config
        kept_from = min(config.keep_confidence, config.min_confidence)
        self.told = self._confidence >= (kept_from if self.told else config.min_confidence)
        self.ever_told |= self.told
        self._record(frame_index, observed=True)

    def _steadied(self, estimate: ObjectEstimate) -> Box:
        """Mean of the last boxes, weighted by their scores, while the object stands still; with
        a longer step the mean begins anew."""
        weight = max(estimate.score, 1e-3)
        if not stands_still(self.box, estimate.box, self._config.still_share):
            self._steadiness = 0.0
        share = weight / (self._steadiness + weight)
        self._steadiness = min(self._steadiness + weight, self._config.steady_weight)
        return mean_box(self.box, estimate.box, share)

    def _record(self, frame_index: int, observed: bool) -> None:
        """The entry of a frame. Its arrays are shared, and cannot be written to any more."""
        S = self.S_world_canonical
        for array in (self.box.center, self.box.extents, S.R, S.t, self.extents_m):
            array.setflags(write=False)
        self.latest = TrackedObject(
            track_id=self.track_id,
            frame_index=frame_index,
            class_id=self.class_id,
            state=self.state,
            confidence=float(self._confidence),
            box=self.box,
            S_world_canonical=self.S_world_canonical,
            extents_m=self.extents_m,
            observed=observed,
        )
        self._history.append((self.latest, self.told))
