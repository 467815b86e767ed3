"""Does an object that leaves the view and comes back keep its identity?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise

import numpy as np

from composenet.metrics.clear import correspondences
from composenet.metrics.evaluate import tracking_frames
from composenet.metrics.records import MATCH_GATE_M
from composenet.records import SequenceTruth, TrackedObject

ABSENT_FRAMES = 3
"""An object that does not count for so many frames in a row has left."""


class Outcome(StrEnum):
    """What became of an identity. KEPT: the same track before and after. CHANGED: another one.
    UNKNOWN: no track had it when it left. MISSED: one had, but none has it after."""

    KEPT = "kept"
    CHANGED = "changed"
    UNKNOWN = "unknown"
    MISSED = "missed"


@dataclass(frozen=True)
class Return:
    """One object that leaves and comes back. left, back: the last frame that it counts in before
    and the first after, positions in the sequence. moved_m: how far its centre moved meanwhile.
    before, after: the track that had it last before it left and first until it leaves again."""

    gt_id: int
    left: int
    back: int
    moved_m: float
    before: int | None
    after: int | None

    @property
    def outcome(self) -> Outcome:
        """What became of its identity."""
        if self.before is None:
            return Outcome.UNKNOWN
        if self.after is None:
            return Outcome.MISSED
        return Outcome.KEPT if self.before == self.after else Outcome.CHANGED


def returns(truth: SequenceTruth, tracked: Sequence[Sequence[TrackedObject]]) -> tuple[Return, ...]:
    """Every return of a sequence, object by object. A track has an object where CLEAR MOT matches
    the two (class equal, centres under 25 cm apart, one to one); an object is away while it does
    not count, for too few of its pixels are seen. tracked: one entry for every frame of the truth.
    Raises DataError.
    """
    frames = tracking_frames(truth, tracked)
    held: dict[int, dict[int, int | None]] = {}  # by object and frame, where it counts
    for index, (frame, matches) in enumerate(
        zip(frames, correspondences(frames, MATCH_GATE_M), strict=True)
    ):
        tracks = dict(zip(matches.rows.tolist(), matches.columns.tolist(), strict=True))
        for row, gt_id in enumerate(frame.gt_ids.tolist()):
            track = int(frame.track_ids[tracks[row]]) if row in tracks else None
            held.setdefault(gt_id, {})[index] = track
    centers = [{o.gt_id: np.asarray(o.box.center) for o in frame} for frame in truth.frames]
    found = []
    for gt_id, own in sorted(held.items()):
        for before, after in pairwise(_visits(sorted(own))):
            left, back = before[-1], after[0]
            moved_m = float(np.linalg.norm(centers[back][gt_id] - centers[left][gt_id]))
            last = next((own[i] for i in reversed(before) if own[i] is not None), None)
            first = next((own[i] for i in after if own[i] is not None), None)
            found.append(Return(gt_id, left, back, moved_m, last, first))
    return tuple(found)


def _visits(frames: Sequence[int]) -> list[list[int]]:
    """Frames in order, parted where ABSENT_FRAMES or more are between two."""
    visits: list[list[int]] = []
    for frame in frames:
        if not visits or frame - visits[-1][-1] > ABSENT_FRAMES:
            visits.append([])
        visits[-1].append(frame)
    return visits
