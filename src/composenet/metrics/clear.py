"""CLEAR MOT: misses, false positives, identity switches (Bernardin and Stiefelhagen, 2008).

The two reference implementations disagree in places; `Convention` names whose rules hold:

| | TRACKEVAL (the benchmark's) | MOTMETRICS |
| --- | --- | --- |
| correspondence kept | that of the previous frame | the last one, however old (*) |
| the rest is assigned by | largest total similarity | most matches, then least distance |
| fragmentation | tracked again after a frame untracked or absent | ... after a miss |
| mostly tracked | over 80 % of its frames | at least 80 % |

(*) Where several objects last had one track, the first in the frame's order keeps it.
As in TrackEval, "the previous frame" is the last one that had both truth and tracks.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from composenet.metrics.records import (
    MATCH_GATE_M,
    FrameEvaluation,
    IntArray,
    TrackingFrame,
    centre_distances,
)

_KEEP_BONUS = 1000.0  # outweighs any sum of similarities, which are at most 1 each


class Convention(StrEnum):
    """Whose rules hold where reference implementations disagree."""

    TRACKEVAL = "trackeval"
    MOTMETRICS = "motmetrics"


@dataclass(frozen=True)
class ClearScores:
    """Counts over object-frames (tp, fn, fp, id_switches), objects (the tracked and lost) and
    the summed centre distance of the matches, metres. Scores of sequences add up."""

    tp: int = 0
    fn: int = 0
    fp: int = 0
    id_switches: int = 0
    fragmentations: int = 0
    mostly_tracked: int = 0
    partly_tracked: int = 0
    mostly_lost: int = 0
    distance_sum_m: float = 0.0

    def __add__(self, other: ClearScores) -> ClearScores:
        return ClearScores(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))

    @property
    def truths(self) -> int:
        """Object-frames to be found."""
        return self.tp + self.fn

    @property
    def mota(self) -> float:
        """1 - (FN + FP + IDSW) / truths, at most 1; NaN where there is no truth."""
        errors = self.fn + self.fp + self.id_switches
        return 1 - errors / self.truths if self.truths else float("nan")

    @property
    def motp_cm(self) -> float:
        """Mean centre distance of the matches, centimetres; NaN where there are none."""
        return 100 * self.distance_sum_m / self.tp if self.tp else float("nan")


@dataclass(frozen=True)
class FrameErrors:
    """The errors of one frame. missed, switched: gt_ids; false: track_ids."""

    missed: tuple[int, ...]
    false: tuple[int, ...]
    switched: tuple[int, ...]

    @property
    def count(self) -> int:
        """Of all three kinds."""
        return len(self.missed) + len(self.false) + len(self.switched)


@dataclass(frozen=True)
class Matches:
    """One-to-one matches of a frame: rows (M,) into gt_ids, columns (M,) into track_ids."""

    rows: IntArray
    columns: IntArray


def clear_mot(
    frames: Sequence[TrackingFrame],
    gate_m: float = MATCH_GATE_M,
    convention: Convention = Convention.TRACKEVAL,
) -> ClearScores:
    """CLEAR MOT counts of one sequence; a match needs a distance under `gate_m`."""
    matches = correspondences(frames, gate_m, convention)
    tp = sum(len(match.rows) for match in matches)
    distance = sum(
        float(frame.distance_m[match.rows, match.columns].sum())
        for frame, match in zip(frames, matches, strict=True)
    )
    mostly, partly, lost = _coverage(frames, matches, convention)
    return ClearScores(
        tp=tp,
        fn=sum(len(frame.gt_ids) for frame in frames) - tp,
        fp=sum(len(frame.track_ids) for frame in frames) - tp,
        id_switches=sum(map(len, _switches(frames, matches))),
        fragmentations=_count_fragments(frames, matches, convention),
        mostly_tracked=mostly,
        partly_tracked=partly,
        mostly_lost=lost,
        distance_sum_m=distance,
    )


def frame_errors(
    frames: Sequence[TrackingFrame], gate_m: float = MATCH_GATE_M
) -> list[FrameErrors]:
    """Which objects and tracks of each frame MOTA counts against a system."""
    matches = correspondences(frames, gate_m)
    switched = _switches(frames, matches)
    return [
        FrameErrors(
            tuple(np.delete(frame.gt_ids, match.rows).tolist()),
            tuple(np.delete(frame.track_ids, match.columns).tolist()),
            tuple(now),
        )
        for frame, match, now in zip(frames, matches, switched, strict=True)
    ]


def correspondences(
    frames: Sequence[TrackingFrame], gate_m: float, convention: Convention = Convention.TRACKEVAL
) -> list[Matches]:
    """Who is whom in every frame: known correspondences first, the rest by assignment."""
    known: dict[int, int] = {}
    result = []
    for frame in frames:
        if convention is Convention.TRACKEVAL:
            matches = _match_by_similarity(frame, known, gate_m)
            if len(frame.gt_ids) and len(frame.track_ids):
                known = {}
        else:
            matches = _match_carrying_forward(frame, known, gate_m)
        known.update(_pairs(frame, matches))
        result.append(matches)
    return result


def drop_ignored(
    frames: Sequence[FrameEvaluation], gate_m: float = MATCH_GATE_M
) -> list[TrackingFrame]:
    """Distances without ignored objects and without the tracks that match one.

    Matches are the correspondences of CLEAR MOT over all objects, counted or not, so that a
    track which follows an object in and out of sight costs nothing while it cannot be judged.
    """
    complete = [centre_distances(frame) for frame in frames]
    result = []
    for frame, distances, matches in zip(
        frames, complete, correspondences(complete, gate_m), strict=True
    ):
        counted = ~frame.ignored
        kept = np.ones(len(frame.track_ids), dtype=bool)
        kept[matches.columns[frame.ignored[matches.rows]]] = False
        result.append(
            TrackingFrame(
                frame.gt_ids[counted],
                frame.track_ids[kept],
                distances.distance_m[np.ix_(counted, kept)],
            )
        )
    return result


def _pairs(frame: TrackingFrame, matches: Matches) -> list[tuple[int, int]]:
    gt_ids, track_ids = frame.gt_ids[matches.rows], frame.track_ids[matches.columns]
    return list(zip(gt_ids.tolist(), track_ids.tolist(), strict=True))


def _is_known(frame: TrackingFrame, known: dict[int, int]) -> NDArray[np.bool_]:
    """(G, P) whether the pair is a known correspondence."""
    pairs = [[known.get(g) == p for p in frame.track_ids.tolist()] for g in frame.gt_ids.tolist()]
    return np.array(pairs, dtype=bool).reshape(frame.distance_m.shape)


def _match_by_similarity(frame: TrackingFrame, known: dict[int, int], gate_m: float) -> Matches:
    allowed = frame.distance_m < gate_m
    value = frame.similarity(gate_m) + _KEEP_BONUS * _is_known(frame, known)
    rows, columns = linear_sum_assignment(np.where(allowed, value, 0.0), maximize=True)
    valid = allowed[rows, columns]
    return Matches(rows[valid], columns[valid])


def _match_carrying_forward(frame: TrackingFrame, known: dict[int, int], gate_m: float) -> Matches:
    allowed = frame.distance_m < gate_m
    rows, columns = [], []
    for row, column in np.argwhere(allowed & _is_known(frame, known)).tolist():
        if column not in columns:  # several objects may have had one track, in turn
            rows.append(row)
            columns.append(column)
    allowed[rows, :] = allowed[:, columns] = False
    forbidden = 1.0 + frame.distance_m[allowed].sum()  # costs more than all matches together
    cost = np.where(allowed, frame.distance_m, forbidden)
    free_rows, free_columns = linear_sum_assignment(cost)
    valid = allowed[free_rows, free_columns]
    return Matches(
        np.concatenate([np.array(rows, dtype=np.int64), free_rows[valid]]),
        np.concatenate([np.array(columns, dtype=np.int64), free_columns[valid]]),
    )


def _switches(frames: Sequence[TrackingFrame], matches: Sequence[Matches]) -> list[list[int]]:
    """The gt_ids of each frame matched to another track than their last one, however long ago."""
    last: dict[int, int] = {}
    switched = []
    for frame, match in zip(frames, matches, strict=True):
        pairs = _pairs(frame, match)
        switched.append([gt_id for gt_id, track in pairs if last.get(gt_id, track) != track])
        last.update(pairs)
    return switched


def _count_fragments(
    frames: Sequence[TrackingFrame], matches: Sequence[Matches], convention: Convention
) -> int:
    """How often objects become tracked again after an interruption."""
    tracked: set[int] = set()
    ever: set[int] = set()
    fragments = 0
    for frame, match in zip(frames, matches, strict=True):
        now = set(frame.gt_ids[match.rows].tolist())
        fragments += len((now & ever) - tracked)
        ever |= now
        if convention is Convention.MOTMETRICS:
            tracked = (tracked - set(frame.gt_ids.tolist())) | now
        elif len(frame.gt_ids) and len(frame.track_ids):
            tracked = now
    return fragments


def _coverage(
    frames: Sequence[TrackingFrame], matches: Sequence[Matches], convention: Convention
) -> tuple[int, int, int]:
    """Objects tracked for most (80 %), some and few (under 20 %) of their frames."""
    present: Counter[int] = Counter()
    matched: Counter[int] = Counter()
    for frame, match in zip(frames, matches, strict=True):
        present.update(frame.gt_ids.tolist())
        matched.update(frame.gt_ids[match.rows].tolist())
    shares = np.array([matched[gt_id] / count for gt_id, count in present.items()])
    most = shares > 0.8 if convention is Convention.TRACKEVAL else shares >= 0.8
    few = shares < 0.2
    return int(most.sum()), int((~most & ~few).sum()), int(few.sum())
