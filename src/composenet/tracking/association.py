"""Which proposal continues which tracklet: the paper's two passes (Object Tracking)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from composenet.config import TrackingConfig
from composenet.geometry.box import inside, pairwise_iou
from composenet.records import Box, FloatArray, ObjectEstimate
from composenet.tracking.affinity import (
    canonical_iou,
    center_distance_m,
    coarse,
    same_class,
)
from composenet.tracking.assignment import assign
from composenet.tracking.tracklet import Tracklet
from composenet.tracking.visibility import Visibility

Pairs = tuple[tuple[int, int], ...]
"""(tracklet, proposal) positions in the sequences given."""

NO_SURFACE: FloatArray = np.zeros((0, 3))
"""Nothing is remembered."""
LEAST_SURFACE = 50
"""Fewer voxels of surface say nothing of what stands in a place."""
PLACE_SLACK_M = 0.05
"""As wide as a voxel is by default."""
HELD_PLACE = 0.5
"""Of two proposals that are one object, one in the very place of a track counts this much more."""
OTHER_CLASS = 0.5
"""Boxes of unequal class attract each other this much less."""


def order_and_deduplicate(
    estimates: Sequence[ObjectEstimate],
    tracklets: Sequence[Tracklet],
    duplicate_iou: float,
) -> tuple[ObjectEstimate, ...]:
    """Proposals strongest first (ties by place), whatever order they came in.

    Of two of one class whose boxes overlap by more than duplicate_iou the weaker is dropped:
    solid furniture cannot share that much space, so both are the same object. One that overlaps
    the box of a tracklet of its class counts as stronger for that, so that a box between a tracked
    object and a new neighbour does not put away the tracked one.
    """
    ordered = sorted(estimates, key=lambda e: (-e.score, *np.asarray(e.box.center), e.class_id))
    boxes, classes = [e.box for e in ordered], [e.class_id for e in ordered]
    clash = (pairwise_iou(boxes, boxes) > duplicate_iou) & same_class(classes, classes)
    alike = same_class(classes, [t.class_id for t in tracklets])
    held = (pairwise_iou(boxes, [t.box for t in tracklets]) * alike).max(axis=1, initial=0)
    strength = np.array([e.score for e in ordered]) * (1 + HELD_PLACE * held)
    kept: list[int] = []
    for index in np.argsort(-strength, kind="stable"):
        if not clash[index, kept].any():
            kept.append(int(index))
    return tuple(ordered[index] for index in sorted(kept))


def match_boxes(
    tracklets: Sequence[Tracklet],
    proposals: Sequence[ObjectEstimate],
    config: TrackingConfig,
    surface: FloatArray = NO_SURFACE,
) -> Pairs:
    """First pass: overlap with the last box, gated by its IoU [paper].

    Classes need not be equal, as a class read from one view errs more often than a place
    does; between admissible pairs the equal class is preferred. Where they are equal less
    overlap will do: the box of an object seen in part is often half a box off. But not where
    most of the surface (M, 3) known in the track's box lies outside the proposal: then the track's
    object still stands there, out of view perhaps, and the proposal is its neighbour.
    """
    iou = pairwise_iou([t.box for t in tracklets], [p.box for p in proposals])
    alike = same_class([t.class_id for t in tracklets], [p.class_id for p in proposals])
    close = iou >= config.box_iou_gate
    near = alike & ~close & (iou >= config.same_class_iou_gate)
    for row, column in np.argwhere(near):
        share = kept_share(tracklets[row].box, proposals[column].box, surface)
        near[row, column] = share >= config.kept_place_share
    return assign(iou * np.where(alike, 1.0, OTHER_CLASS), close | near)


def match_first_pass(
    tracklets: Sequence[Tracklet],
    proposals: Sequence[ObjectEstimate],
    frame_index: int,
    config: TrackingConfig,
) -> Pairs:
    """Looking back: overlap with where this very frame showed the track the first time, for equal
    classes, gated by its IoU.

    It comes after the last boxes of tracks that were seen on the way back, which may know better,
    and before those of the others: where these ended up, somebody else may have been before.
    """
    known = {row: box for row, t in enumerate(tracklets) if (box := t.first_pass_box(frame_index))}
    classes = [tracklets[row].class_id for row in known]
    iou = pairwise_iou([*known.values()], [p.box for p in proposals])
    alike = same_class(classes, [p.class_id for p in proposals])
    pairs, rows = assign(iou, alike & (iou >= config.box_iou_gate)), [*known]
    return tuple((rows[place], column) for place, column in pairs)


def kept_share(old: Box, new: Box, surface: FloatArray) -> float:
    """Share of the surface (M, 3) known in the old box that the new one, which may be off by
    PLACE_SLACK_M, holds; 1 where too little is known."""
    there = surface[inside(surface, old)]
    if len(there) < LEAST_SURFACE:
        return 1.0
    return float(inside(there, Box(new.center, new.extents + 2 * PLACE_SLACK_M)).mean())


def match_shapes(
    tracklets: Sequence[Tracklet],
    views: Sequence[Visibility],
    proposals: Sequence[ObjectEstimate],
    frame_index: int,
    config: TrackingConfig,
) -> Pairs:
    """Second pass, over what the first left: canonical IoU, gated [paper].

    Two chairs look alike, so a pair must also be of one class, within `reach_m`, and not
    a jump away from a place that still shows the object (`views`, one per tracklet). Of
    several admissible partners a nearer one is preferred.
    """
    boxes, other_boxes = [t.box for t in tracklets], [p.box for p in proposals]
    likeness = canonical_iou(
        [t.model.coarse for t in tracklets], [coarse(p.canonical) for p in proposals]
    )
    alike = same_class([t.class_id for t in tracklets], [p.class_id for p in proposals])
    nearness = _nearness(
        center_distance_m(boxes, other_boxes),
        np.array([abs(frame_index - t.last_seen) for t in tracklets]),
        config,
    )
    still_there = np.array([view.still_there for view in views], dtype=bool)
    stays = still_there[:, None] & elsewhere(boxes, other_boxes)
    admissible = (likeness >= config.canonical_iou_gate) & alike & (nearness > 0) & ~stays
    return assign(likeness * nearness, admissible)


def elsewhere(a: Sequence[Box], b: Sequence[Box]) -> NDArray[np.bool_]:
    """(A, B) bool: whether neither box holds the centre of the other. Boxes of neighbours may
    touch, and that of an object grows as more of it comes into view, but around its own centre."""
    if not a or not b:
        return np.zeros((len(a), len(b)), dtype=bool)
    centers, other_centers = (np.array([box.center for box in boxes]) for boxes in (a, b))
    holds = np.array([inside(other_centers, box) for box in a])
    held = np.array([inside(centers, box) for box in b]).T
    return np.asarray(~holds & ~held)


def reach_m(frames_unseen: NDArray[np.int_], config: TrackingConfig) -> NDArray[np.float64]:
    """How far the centre may have moved since it was seen, metres: the slack plus the
    largest speed times the frames passed, up to a limit beyond which likeness is no proof."""
    way = config.reach_slack_m + config.max_speed_m_per_frame * frames_unseen
    return np.minimum(way, config.max_reach_m)


def _nearness(
    distance_m: NDArray[np.float64], frames_unseen: NDArray[np.int_], config: TrackingConfig
) -> NDArray[np.float64]:
    """1 at the last place, falling to 1/2 at the reach, 0 beyond."""
    reach = reach_m(frames_unseen, config)[:, None]
    return np.where(distance_m <= reach, 1 - 0.5 * distance_m / reach, 0.0)
