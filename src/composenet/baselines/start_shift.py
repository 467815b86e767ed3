"""The advantage that the paper grants systems which see surfaces only: where objects start.

A track's reference point is moved to the true centre of its object once, at the track's first
frame; from there the estimated motion carries it on. The object is the one of the track's class
whose true box, grown by the matching gate, holds the point; with several, nearest centres are
assigned. A track that begins on nothing of its class is left as it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from composenet.metrics.evaluate import SEEN_STATES
from composenet.metrics.records import MATCH_GATE_M
from composenet.records import Box, ObjectFrameTruth, SequenceTruth, Similarity, TrackedObject
from composenet.tracking.assignment import assign


def start_at_true_centres(
    truth: SequenceTruth, tracked: Sequence[Sequence[TrackedObject]]
) -> list[tuple[TrackedObject, ...]]:
    """The tracks with their reference points moved. tracked: one entry for every frame of the
    truth; both in one world."""
    class_ids = {item.gt_id: item.class_id for item in truth.objects}
    offsets: dict[int, NDArray[np.float64]] = {}  # by track id, in the object's own axes
    result = []
    for present, entries in zip(truth.frames, tracked, strict=True):
        new = [e for e in entries if e.track_id not in offsets and e.state in SEEN_STATES]
        starts = _true_starts(present, class_ids, new)
        for entry in new:
            S = entry.S_world_canonical
            offsets[entry.track_id] = S.R.T @ (starts.get(entry.track_id, S.t) - S.t)
        result.append(tuple(_moved(e, offsets.get(e.track_id, np.zeros(3))) for e in entries))
    return result


def _true_starts(
    present: Sequence[ObjectFrameTruth], class_ids: dict[int, int], new: Sequence[TrackedObject]
) -> dict[int, NDArray[np.float64]]:
    """True centres by track id, for the tracks that begin on an object."""
    shape = (len(present), len(new))
    points = np.array([e.S_world_canonical.t for e in new]).reshape(-1, 3)
    centers = np.array([p.box.center for p in present]).reshape(-1, 3)
    halves = np.array([p.box.extents for p in present]).reshape(-1, 3) / 2
    offset = points[None] - centers[:, None]
    same = np.array([[class_ids[p.gt_id] == e.class_id for e in new] for p in present], dtype=bool)
    inside = (np.abs(offset) <= halves[:, None] + MATCH_GATE_M).all(axis=2)
    nearness = 1 / (1e-3 + np.linalg.norm(offset, axis=2))
    pairs = assign(nearness, same.reshape(shape) & inside)
    return {new[column].track_id: centers[row] for row, column in pairs}


def _moved(entry: TrackedObject, offset: NDArray[np.float64]) -> TrackedObject:
    S = entry.S_world_canonical
    t = S.t + S.R @ offset
    return replace(
        entry,
        box=Box(t, entry.box.extents),
        S_world_canonical=Similarity(S.scale_m, S.R, t),
    )
