"""Streams that were recorded each at times of its own: which image belongs to which, and where the
camera was between two poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import min_weight_full_bipartite_matching
from scipy.spatial.transform import Rotation, Slerp

from composenet.geometry.transform import make_T

MAX_GAP_S = 0.02
"""What is further apart in time does not belong together."""
_ALONE_S = 1.0


def nearest(at_s: NDArray[np.float64], stream_s: NDArray[np.float64]) -> NDArray[np.int64]:
    """For each of the times (N,), the index of the stream's nearest, -1 beyond `MAX_GAP_S`.

    The stream (M,) need not be sorted and may be empty.
    """
    if not len(stream_s):
        return np.full(len(at_s), -1)
    order = np.argsort(stream_s, kind="stable")
    ordered = stream_s[order]
    right = np.clip(np.searchsorted(ordered, at_s), 0, len(ordered) - 1)
    left = np.maximum(right - 1, 0)
    closer = np.where(np.abs(ordered[left] - at_s) <= np.abs(ordered[right] - at_s), left, right)
    return np.where(np.abs(ordered[closer] - at_s) <= MAX_GAP_S, order[closer], -1)


def paired(at_s: NDArray[np.float64], stream_s: NDArray[np.float64]) -> NDArray[np.int64]:
    """For each of the times (N,), the index of its partner in the stream (M,), -1 without one.

    Nothing is partner of two, none is further away than `MAX_GAP_S`, and the sum of what lies
    between them is least, where a missing one counts as a second. Where two cameras take turns,
    each image of one is half-way between two of the other: the nearest would be now the one before,
    now the one after, and some would come twice, as if nothing had moved.
    """
    order = np.argsort(stream_s, kind="stable")
    ordered = stream_s[order]
    first = np.searchsorted(ordered, at_s - MAX_GAP_S)
    counts = np.searchsorted(ordered, at_s + MAX_GAP_S, side="right") - first
    own = np.arange(len(at_s))
    rows = np.repeat(own, counts)
    columns = np.arange(counts.sum()) + np.repeat(first - (np.cumsum(counts) - counts), counts)
    apart_s = np.abs(ordered[columns] - at_s[rows])
    costs = np.concatenate([1 + apart_s, np.full(len(at_s), 1 + _ALONE_S)])  # 0 would be no edge
    edges = (np.concatenate([rows, own]), np.concatenate([columns, len(ordered) + own]))
    graph = coo_array((costs, edges), shape=(len(at_s), len(ordered) + len(at_s))).tocsr()
    rows, columns = min_weight_full_bipartite_matching(graph)
    found = np.full(len(at_s), -1)
    found[rows] = np.append(order, np.full(len(at_s), -1))[columns]
    return found


@dataclass(frozen=True)
class Trajectory:
    """Where something was from time to time. times_s: (N,) rising, N >= 1; poses: (N, 7) x, y, z
    and a quaternion x, y, z, w of any length but zero. Between two that differ and lie over
    max_gap_s apart, and beyond both ends, each holds for max_beyond_s."""

    times_s: NDArray[np.float64]
    poses: NDArray[np.float64]
    max_gap_s: float
    max_beyond_s: float

    def at(self, time_s: float) -> NDArray[np.float64] | None:
        """(4, 4), between two poses on an even way; None where none is near enough in time."""
        times = self.times_s
        after = min(int(np.searchsorted(times, time_s)), len(times) - 1)
        before = max(after - 1, 0)
        if times[before] < time_s < times[after]:
            gap_s, pair = times[after] - times[before], self.poses[[before, after]]
            if gap_s <= self.max_gap_s or np.array_equal(*pair):
                share = (time_s - times[before]) / gap_s
                turn = Slerp([0, 1], Rotation.from_quat(pair[:, 3:]))(share)
                return make_T(turn.as_matrix(), (1 - share) * pair[0, :3] + share * pair[1, :3])
        near = min(before, after, key=lambda place: abs(times[place] - time_s))
        if abs(times[near] - time_s) > self.max_beyond_s:
            return None
        return make_T(Rotation.from_quat(self.poses[near, 3:]).as_matrix(), self.poses[near, :3])
