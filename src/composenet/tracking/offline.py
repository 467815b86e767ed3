"""The paper's second pass over a whole sequence, and what is needed to look at one backwards. It
looks into the future: what it returns for a frame depends on later frames. Online tracking does not
use it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from composenet.config import TrackingConfig
from composenet.records import FloatArray, Track, TrackedObject, TrackState
from composenet.tracking.affinity import canonical_iou, coarse
from composenet.tracking.assignment import assign
from composenet.tracking.association import reach_m
from composenet.tracking.tracklet import decay


def in_order_of_time(track: Track, config: TrackingConfig) -> Track:
    """A track whose frames were looked at backwards, earliest first, from the first frame on that
    shows it; after the last that does, it is where that one shows it. Re-found: seen after a frame
    in which it was not. While it is unseen its confidence decays from that of the last frame that
    showed it, in time."""
    entries = _by_frame(track.history)
    shown = [i for i, entry in enumerate(entries) if entry.observed]
    if not shown:
        return replace(track, history=())
    last, history = entries[shown[-1]], list[TrackedObject]()
    for entry in entries[shown[0] :]:
        if entry.observed:
            absent = bool(history) and not history[-1].observed
            entry = replace(entry, state=TrackState.RE_FOUND if absent else TrackState.TRACKED)
        else:
            confidence = decay(entry.state, config) * history[-1].confidence
            entry = replace(entry, confidence=confidence)
        history.append(entry if entry.frame_index <= last.frame_index else _placed(entry, last))
    return replace(track, history=tuple(history))


def _placed(entry: TrackedObject, there: TrackedObject) -> TrackedObject:
    """The entry with the place and shape of another."""
    S, extents_m = there.S_world_canonical, there.extents_m
    return replace(entry, box=there.box, S_world_canonical=S, extents_m=extents_m)


def link_offline(
    tracks: Sequence[Track], frames: Sequence[int], config: TrackingConfig
) -> tuple[Track, ...]:
    """Merge tracks that are one object, under the id of the earliest; by id.

    Tracks that are never seen in the same frame, of one class, are matched by canonical IoU
    (gated, optimal assignment; paper, Object Tracking); single unmatched
    proposals are tracks of one frame here, so they join too. Unless it moves faster than
    furniture can (`association.reach_m`). Repeated until nothing matches. A merged track has
    an entry for every one of the recording's frames (indices, in order) from its birth to its end,
    and every track the class of all of it in each of its entries. With use_correspondences off
    nothing is merged.
    """
    groups = [_Group.of(track) for track in sorted(tracks, key=_birth)]
    while config.use_correspondences and (merged := _merge_once(groups, config)):
        groups = merged
    joined = [_joined(group, frames, config) for group in groups]
    return tuple(sorted(joined, key=lambda track: track.track_id))


@dataclass(frozen=True)
class _Group:
    """Tracks taken to be one object, earliest first. seen: its observed entries by frame.
    canonical: mean of the tracks' models, weighted by how often each was seen."""

    tracks: tuple[Track, ...]
    seen: tuple[TrackedObject, ...]
    canonical: FloatArray

    @staticmethod
    def of(track: Track) -> _Group:
        seen = tuple(entry for entry in track.history if entry.observed)
        return _Group((track,), seen, track.canonical)

    def joined_by(self, other: _Group) -> _Group:
        own, others = len(self.seen), len(other.seen)
        canonical = (own * self.canonical + others * other.canonical) / (own + others)
        return _Group(
            tuple(sorted(self.tracks + other.tracks, key=_birth)),
            _by_frame(self.seen + other.seen),
            canonical.astype(np.float32),
        )

    def may_join(self, other: _Group, config: TrackingConfig) -> bool:
        """One class, never seen together, and no step between the two beyond reach."""
        if self.tracks[0].class_id != other.tracks[0].class_id:
            return False
        steps = list(pairwise(_by_frame(self.seen + other.seen)))
        gaps = np.array([after.frame_index - before.frame_index for before, after in steps])
        if (gaps == 0).any():
            return False
        crosses = np.array([before.track_id != after.track_id for before, after in steps])
        way_m = np.linalg.norm(
            [after.box.center - before.box.center for before, after in steps], axis=1
        )
        return bool((way_m <= reach_m(gaps, config))[crosses].all())


def _merge_once(groups: list[_Group], config: TrackingConfig) -> list[_Group]:
    """The groups after one optimal assignment of earlier to later ones; empty if none fit.

    The assignment may chain groups; a link that no longer fits after stronger ones were
    made is left to the next round.
    """
    shapes = [coarse(group.canonical) for group in groups]
    likeness = canonical_iou(shapes, shapes)
    fits = likeness >= config.canonical_iou_gate
    fits &= np.triu(np.ones_like(fits), k=1)
    for row, column in np.argwhere(fits):
        fits[row, column] = groups[row].may_join(groups[column], config)
    pairs = sorted(assign(likeness, fits), key=lambda pair: -likeness[pair])
    holder, merged = list(range(len(groups))), dict(enumerate(groups))
    for row, column in pairs:
        first, second = sorted((holder[row], holder[column]))
        if merged[first].may_join(merged[second], config):
            merged[first] = merged[first].joined_by(merged.pop(second))
            holder = [first if index == second else index for index in holder]
    return list(merged.values()) if len(merged) < len(groups) else []


def _joined(group: _Group, frames: Sequence[int], config: TrackingConfig) -> Track:
    """The group as one track: seen entries, and between them those of whichever member was
    seen last, or a repetition of the entry before where that one had ended."""
    head = group.tracks[0]
    recorded = {(e.frame_index, t.track_id): e for t in group.tracks for e in t.history}
    seen = {entry.frame_index: entry for entry in group.seen}
    holder, last_seen = group.seen[0], group.seen[-1].frame_index
    history: list[TrackedObject] = []
    for frame in frames:
        if frame < holder.frame_index:
            continue
        if frame in seen:
            holder = entry = seen[frame]
            absent = bool(history) and not history[-1].observed
            entry = replace(entry, state=TrackState.RE_FOUND if absent else TrackState.TRACKED)
        elif (recorded_entry := recorded.get((frame, holder.track_id))) is not None and (
            frame > last_seen or recorded_entry.state is not TrackState.ENDED
        ):
            entry = recorded_entry
        elif frame < last_seen:
            entry = _repeated(history[-1], frame, config)
        else:
            break
        history.append(replace(entry, track_id=head.track_id, class_id=head.class_id))
    return Track(head.track_id, head.class_id, tuple(history), group.canonical)


def _repeated(entry: TrackedObject, frame_index: int, config: TrackingConfig) -> TrackedObject:
    """The entry once more, unseen; where nobody looked whether its place was in view, occluded."""
    state = TrackState.OCCLUDED if entry.observed else entry.state
    confidence = decay(state, config) * entry.confidence
    return replace(
        entry, frame_index=frame_index, observed=False, state=state, confidence=confidence
    )


def _by_frame(entries: Sequence[TrackedObject]) -> tuple[TrackedObject, ...]:
    return tuple(sorted(entries, key=lambda entry: entry.frame_index))


def _birth(track: Track) -> tuple[int, int]:
    return track.history[0].frame_index, track.track_id
