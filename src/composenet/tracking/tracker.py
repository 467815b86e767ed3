"""Online tracking: frame by frame, with nothing from the future."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeVar

from composenet.config import TrackingConfig, VolumeConfig
from composenet.errors import SequenceError
from composenet.records import Box, FloatArray, Frame, ObjectEstimate, Track, TrackedObject
from composenet.tracking.association import (
    NO_SURFACE,
    Pairs,
    match_boxes,
    match_first_pass,
    match_shapes,
    order_and_deduplicate,
)
from composenet.tracking.offline import in_order_of_time, link_offline
from composenet.tracking.tracklet import Tracklet
from composenet.tracking.visibility import Visibility, surface_in_world, visibility

T = TypeVar("T")


@dataclass
class _Matching:
    """Tracks and proposals of one frame: those that have found each other, and the others."""

    unseen: list[Tracklet]
    unclaimed: list[ObjectEstimate]
    seen: list[tuple[Tracklet, ObjectEstimate]] = field(default_factory=list)

    def take(self, tracklets: Sequence[Tracklet], pairs: Pairs) -> None:
        """pairs: positions in `tracklets`, which are some of the unseen, and in the unclaimed."""
        rows, columns = [row for row, _ in pairs], [column for _, column in pairs]
        self.seen += [(tracklets[row], self.unclaimed[column]) for row, column in pairs]
        self.unseen = [t for t in self.unseen if not any(t is tracklets[row] for row in rows)]
        self.unclaimed = _others(self.unclaimed, columns)


class Tracker:
    """Gives objects seen frame by frame their identities (paper, Object Tracking).

    max_depth_m: beyond this nothing is detected, so nothing is expected to be seen.
    """

    def __init__(
        self,
        config: TrackingConfig | None = None,
        max_depth_m: float = VolumeConfig.max_depth_m,
    ) -> None:
        self._config = config or TrackingConfig()
        self._max_depth_m = max_depth_m
        self._tracklets: list[Tracklet] = []  # but for those that ended and were never told of
        self._born = 0
        self._last_index: int | None = None
        self._frames: set[int] = set()
        self._turned = False

    def update(
        self,
        frame: Frame,
        estimates: Sequence[ObjectEstimate],
        surface: FloatArray = NO_SURFACE,
    ) -> tuple[TrackedObject, ...]:
        """Every track that is told of in this frame (see `Tracklet`), by id: seen ones, unseen ones
        at their last pose, and, once, those that ended in it. Ids are given at birth, so some never
        appear.

        surface: (M, 3) points in the world, what this frame and those before it saw and it does
        not contradict. The order of the estimates does not matter. Raises SequenceError for a frame
        whose index is not larger than the one before, after `turn_back` for one that is not
        smaller.
        """
        self.expect(frame.index)
        self._last_index = frame.index
        self._frames.add(frame.index)
        alive = [t for t in self._tracklets if t.alive]
        strong = [e for e in estimates if e.score >= self._config.min_score]
        proposals = order_and_deduplicate(strong, alive, self._config.duplicate_iou)

        found = _Matching(alive, list(proposals))
        followed = [t for t in alive if t.seen_this_way]
        found.take(followed, match_boxes(followed, found.unclaimed, self._config, surface))
        if self._turned:
            pairs = match_first_pass(found.unseen, found.unclaimed, frame.index, self._config)
            found.take(found.unseen, pairs)
            waiting = [t for t in found.unseen if not t.seen_this_way]
            found.take(waiting, match_boxes(waiting, found.unclaimed, self._config, surface))

        views = [self._view(t, frame) for t in found.unseen]
        if self._config.use_correspondences:
            pairs = match_shapes(found.unseen, views, found.unclaimed, frame.index, self._config)
            found.take(found.unseen, pairs)
            views = _others(views, [row for row, _ in pairs])

        for tracklet, proposal in found.seen:
            tracklet.observe(frame.index, proposal)
        for tracklet, view in zip(found.unseen, views, strict=True):
            tracklet.miss(frame.index, view)
        self._tracklets = [t for t in self._tracklets if t.alive or t.ever_told]
        born = [self._birth(frame.index, p) for p in found.unclaimed if self._may_start(p)]
        return tuple(t.latest for t in alive + born if t.told)

    @property
    def boxes(self) -> tuple[Box, ...]:
        """The last boxes of all living tracks, told of or not, world frame."""
        return tuple(t.box for t in self._tracklets if t.alive)

    def turn_back(self) -> None:
        """The frames come once more, from the last one back to the first: the tracks are those
        that are alive, and tell of these frames alone. Raises SequenceError the second time."""
        if self._turned:
            raise SequenceError("turn_back: frames are looked at twice at most; this tracker has")
        self._turned = True
        if self._last_index is not None:
            self._last_index += 1
        for tracklet in self._tracklets:
            tracklet.turn_back()

    def tracks(self) -> tuple[Track, ...]:
        """All tracks so far, as they were told of, ended ones included, by id; with config.offline
        without gaps and linked over the whole recording."""
        config = self._config
        tracks = [t.track(whole=config.offline) for t in self._tracklets]
        if self._turned:
            tracks = [in_order_of_time(track, config) for track in tracks]
        told = tuple(track for track in tracks if track.history)
        return link_offline(told, sorted(self._frames), config) if config.offline else told

    def expect(self, index: int) -> None:
        """Raises SequenceError for the index of a frame whose turn it is not (see `update`)."""
        last, order = self._last_index, "backwards, once" if self._turned else "in order, once"
        if last is not None and (index >= last if self._turned else index <= last):
            raise SequenceError(
                f"frame {index} came after frame {last}: give frames {order}, "
                "and another recording to another tracker (`tracker.restart()`)"
            )

    def _view(self, tracklet: Tracklet, frame: Frame) -> Visibility:
        points, spacing_m = surface_in_world(
            tracklet.model.surface, tracklet.S_world_canonical, tracklet.box
        )
        return visibility(points, spacing_m, frame, self._max_depth_m)

    def _may_start(self, proposal: ObjectEstimate) -> bool:
        return proposal.score >= self._config.min_birth_score

    def _birth(self, index: int, proposal: ObjectEstimate) -> Tracklet:
        self._born += 1
        tracklet = Tracklet(self._born, index, proposal, self._config)
        self._tracklets.append(tracklet)
        return tracklet


def _others(items: Sequence[T], taken: Sequence[int]) -> list[T]:
    """The items at positions that are not taken."""
    return [item for position, item in enumerate(items) if position not in taken]
