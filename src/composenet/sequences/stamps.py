"""Streams that were recorded each at times of its own: which image belongs to which, and where the
camera was between two poses."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from composenet.geometry.transform import make_T

MAX_GAP_S = 0.02
"""What is further apart in time does not belong together."""


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

    Nothing is partner of two, none is further away than `MAX_GAP_S`, earlier ones have earlier
    partners, and the sum of what lies between them is least, where a missing one counts as twice
    the gap. Where two cameras take turns, each image of one is half-way between two of the other:
    the nearest would be now the one before, now the one after, and some would come twice, as if
    nothing had moved.
    """
    order, rows = np.argsort(stream_s, kind="stable"), np.argsort(at_s, kind="stable")
    ordered, at = stream_s[order], at_s[rows]
    first = np.searchsorted(ordered, at - 1.01 * MAX_GAP_S)
    end = np.searchsorted(ordered, at + 1.01 * MAX_GAP_S)
    starts = np.concatenate([[0], np.cumsum(end - first)])
    places = _least_cost(at, ordered, first, end, starts, MAX_GAP_S)
    found = np.full(len(at_s), -1)
    found[rows] = np.append(order, -1)[places]  # -1 stays -1
    return found


def paired_or_nearest(
    at_s: NDArray[np.float64], stream_s: NDArray[np.float64]
) -> NDArray[np.int64]:
    """Likewise, but those that are left over share the nearest with others."""
    partners = paired(at_s, stream_s)
    return np.where(partners >= 0, partners, nearest(at_s, stream_s))


@numba.njit(cache=True, nogil=True)
def _least_cost(at, stream, first, end, starts, max_gap):  # type: ignore[no-untyped-def]
    """Partners of sorted times in a sorted stream, -1 without: dynamic programming over what is in
    reach, row by row. saved[j]: the most that the rows so far save, with partners below j."""
    alone, left, own = 0, 1, 2  # what is best for a row with partners below j
    choices = np.zeros(starts[-1], np.int8)
    saved = np.zeros(len(stream) + 1)
    reached = 0
    for i in range(len(at)):
        for j in range(reached + 1, end[i] + 1):
            saved[j] = saved[reached]
        reached = max(reached, end[i])
        before = saved[first[i]]  # as the row above left it
        for j in range(first[i] + 1, end[i] + 1):
            above, gap = saved[j], abs(at[i] - stream[j - 1])
            best, choice = above, alone
            if saved[j - 1] > best:
                best, choice = saved[j - 1], left
            if gap <= max_gap and before + 2 * max_gap - gap > best:
                best, choice = before + 2 * max_gap - gap, own
            saved[j], choices[starts[i] + j - 1 - first[i]] = best, choice
            before = above
    partners = np.full(len(at), -1)
    j = reached
    for i in range(len(at) - 1, -1, -1):
        j = min(j, end[i])
        while j > first[i] and choices[starts[i] + j - 1 - first[i]] == left:
            j -= 1
        if j > first[i] and choices[starts[i] + j - 1 - first[i]] == own:
            j -= 1
            partners[i] = j
    return partners


@dataclass(frozen=True)
class Trajectory:
    """Where something was from time to time. times_s: (N,) rising, N >= 1; poses: (N, 7) x, y, z
    and a quaternion x, y, z, w of any length but zero, NaN where it was lost. Between two that
    differ and lie over max_gap_s apart, or of which one was lost, and beyond both ends, each holds
    for max_beyond_s. Ten times that gap is none if they differ by at most max_step (metres,
    degrees)."""

    times_s: NDArray[np.float64]
    poses: NDArray[np.float64]
    max_gap_s: float
    max_beyond_s: float
    max_step: tuple[float, float] = (0.0, 0.0)

    def at(self, time_s: float) -> NDArray[np.float64] | None:
        """(4, 4), between two poses on an even way; None where none is near enough in time."""
        times = self.times_s
        after = min(int(np.searchsorted(times, time_s)), len(times) - 1)
        before = max(after - 1, 0)
        if times[before] < time_s < times[after]:
            gap_s, pair = times[after] - times[before], self.poses[[before, after]]
            known = bool(np.isfinite(pair).all())
            if known and (gap_s <= self.max_gap_s or self._stays(gap_s, *pair)):
                share = (time_s - times[before]) / gap_s
                turn = Slerp([0, 1], Rotation.from_quat(pair[:, 3:]))(share)
                return make_T(turn.as_matrix(), (1 - share) * pair[0, :3] + share * pair[1, :3])
        near = min(before, after, key=lambda place: abs(times[place] - time_s))
        if abs(times[near] - time_s) > self.max_beyond_s or not np.isfinite(self.poses[near]).all():
            return None
        return make_T(Rotation.from_quat(self.poses[near, 3:]).as_matrix(), self.poses[near, :3])

    def _stays(self, gap_s: float, pose: NDArray[np.float64], other: NDArray[np.float64]) -> bool:
        if np.array_equal(pose, other):
            return True
        if gap_s > 10 * self.max_gap_s:
            return False
        metres, degrees = self.max_step
        turn = Rotation.from_quat(pose[3:]).inv() * Rotation.from_quat(other[3:])
        moved_m = float(np.linalg.norm(other[:3] - pose[:3]))
        return moved_m <= metres and np.degrees(turn.magnitude()) <= degrees
