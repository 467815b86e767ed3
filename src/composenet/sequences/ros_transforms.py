"""Where one frame of a robot is in another at some time, from its recorded transforms (tf)."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from composenet.geometry.transform import inverse_T, make_T

MAX_GAP_S = 1.0
"""Between two transforms that lie further apart in time nothing is told."""
MAX_BEYOND_S = 0.05
"""So long before the first and after the last that one holds."""
_WORLD = re.compile(r"map|odom|world|earth|origin|init|mocap|vicon|local|global")
_BODY = re.compile(r"(link|frame|footprint|body|base|imu|camera)$")


@dataclass(frozen=True)
class _Edge:
    """All that was told of a frame in its parent. times_s: (N,) rising; poses: (N, 7) x, y, z and
    a quaternion x, y, z, w. fixed: it holds at all times."""

    parent: str
    times_s: NDArray[np.float64]
    poses: NDArray[np.float64]
    fixed: bool

    def at(self, time_s: float) -> NDArray[np.float64] | None:
        """(4, 4) T_parent_child, None where none is near enough in time."""
        if self.fixed:
            return _matrix(self.poses[-1])
        times = self.times_s
        after = int(np.searchsorted(times, time_s))
        if after < len(times) and times[after] == time_s:
            return _matrix(self.poses[after])
        if after in (0, len(times)):
            end = min(after, len(times) - 1)
            return _matrix(self.poses[end]) if abs(times[end] - time_s) <= MAX_BEYOND_S else None
        if times[after] - times[after - 1] > MAX_GAP_S:
            return None
        pair = self.poses[after - 1 : after + 1]
        share = (time_s - times[after - 1]) / (times[after] - times[after - 1])
        turn = Slerp([0, 1], Rotation.from_quat(pair[:, 3:]))(share)
        return make_T(turn.as_matrix(), (1 - share) * pair[0, :3] + share * pair[1, :3])


class Transforms:
    """The tree of frames. A frame that had several parents is in that which was told of last."""

    def __init__(self, told: Iterable[tuple[Any, bool]]) -> None:
        """told: stamped transforms, and whether each holds at all times."""
        parents: dict[str, str] = {}
        rows: dict[tuple[str, str], list[tuple[float, ...]]] = defaultdict(list)
        fixed: dict[tuple[str, str], bool] = {}
        for stamped, always in told:
            child, parent = name(stamped.child_frame_id), name(stamped.header.frame_id)
            t, q = stamped.transform.translation, stamped.transform.rotation
            row = (seconds(stamped.header.stamp), t.x, t.y, t.z, q.x, q.y, q.z, q.w)
            if not np.isfinite(row).all() or not 0.9 < np.linalg.norm(row[4:]) < 1.1:
                continue
            parents[child] = parent
            rows[child, parent].append(row)
            fixed[child, parent] = always
        self._edges: dict[str, _Edge] = {}
        for child, parent in parents.items():
            table = np.array(rows[child, parent])
            _, order = np.unique(table[:, 0], return_index=True)
            table = table[-1:] if fixed[child, parent] else table[order]
            self._edges[child] = _Edge(parent, table[:, 0], table[:, 1:], fixed[child, parent])

    def root(self, frame: str) -> str:
        """The frame at the end of the way through all parents."""
        return self._way(frame)[-1]

    def moves(self, frame: str) -> bool:
        """Whether anything between a frame and its root is told of more than once."""
        return any(not self._edges[f].fixed for f in self._way(frame)[:-1])

    def T_root_frame(self, frame: str, time_s: float) -> NDArray[np.float64] | None:
        """(4, 4), None where a transform on the way is lacking at that time."""
        T = np.eye(4)
        for child in self._way(frame)[:-1]:
            step = self._edges[child].at(time_s)
            if step is None:
                return None
            T = step @ T
        return T

    def T_between(self, a: str, b: str, time_s: float) -> NDArray[np.float64] | None:
        """(4, 4) T_a_b, None where both have no common root or a transform is lacking."""
        if self.root(a) != self.root(b):
            return None
        T_root_a, T_root_b = self.T_root_frame(a, time_s), self.T_root_frame(b, time_s)
        if T_root_a is None or T_root_b is None:
            return None
        return inverse_T(T_root_a) @ T_root_b

    def is_world(self, frame: str) -> bool:
        """Whether a frame's root stands still in the room: it is called so, or something moves in
        it and it is not called as a part of a robot is."""
        root = self.root(frame)
        last = root.rpartition("/")[2].lower()
        if root == frame or _WORLD.search(last):
            return root != frame
        return self.moves(frame) and not _BODY.search(last)

    def _way(self, frame: str) -> list[str]:
        """The frame, its parent and so on; a circle ends where it closes."""
        way = [name(frame)]
        while (edge := self._edges.get(way[-1])) and edge.parent not in way:
            way.append(edge.parent)
        return way


def name(frame: str) -> str:
    """As all of ROS 2 writes it; some of ROS 1 begins with a slash."""
    return str(frame).lstrip("/")


def seconds(stamp: Any) -> float:
    """Of a time stamp."""
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)


def _matrix(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    return make_T(Rotation.from_quat(pose[3:]).as_matrix(), pose[:3])
