"""Where one frame of a robot is in another at some time, from its recorded transforms (tf)."""

from __future__ import annotations

import re
from array import array
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from composenet.geometry.transform import inverse_T
from composenet.sequences.stamps import Trajectory

MAX_GAP_S = 1.0
MAX_STEP = 0.1, 5.0
"""Between two transforms that differ and lie further apart in time (ten times as far, if they
differ by no more than this, metres and degrees) nothing is told, but ..."""
MAX_BEYOND_S = 0.05
"""... so long before and after each, that one holds."""
_WORLD = re.compile(r"map|odom|world|earth|origin|init|mocap|vicon|local|global")
_BODY = re.compile(
    r"(link|frame|footprint|body|base|imu|camera|trunk|torso|chassis|robot|stabilized|optical)$"
)


@dataclass(frozen=True)
class _Edge:
    """All that was told of a frame in its parent. fixed: it holds at all times."""

    parent: str
    told: Trajectory
    fixed: bool

    def at(self, time_s: float) -> NDArray[np.float64] | None:
        """(4, 4) T_parent_child, None where none is near enough in time."""
        return self.told.at(self.told.times_s[-1] if self.fixed else time_s)

    @property
    def moves(self) -> bool:
        return bool((self.told.poses != self.told.poses[0]).any())


class Transforms:
    """The tree of frames. A frame that had several parents is in that which was told of last, and
    what was told of it from time to time counts before what holds always."""

    def __init__(self, told: Iterable[tuple[Any, bool]]) -> None:
        """told: stamped transforms, and whether each holds at all times."""
        parents: dict[tuple[str, bool], str] = {}
        rows: dict[tuple[str, str, bool], array[float]] = defaultdict(lambda: array("d"))
        for stamped, fixed in told:
            child, parent = name(stamped.child_frame_id), name(stamped.header.frame_id)
            t, q = stamped.transform.translation, stamped.transform.rotation
            row = (seconds(stamped.header.stamp), t.x, t.y, t.z, q.x, q.y, q.z, q.w)
            length = q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w
            if 0.8 < length < 1.2 and all(map(isfinite, row)):
                parents[child, fixed] = parent
                rows[child, parent, fixed].extend(row)
        self._edges: dict[str, _Edge] = {}
        for (child, fixed), parent in sorted(parents.items(), key=lambda p: not p[0][1]):
            table = np.array(rows[child, parent, fixed]).reshape(-1, 8)
            _, order = np.unique(table[:, 0], return_index=True)
            table = table[-1:] if fixed else table[order]
            way = Trajectory(table[:, 0], table[:, 1:], MAX_GAP_S, MAX_BEYOND_S, MAX_STEP)
            self._edges[child] = _Edge(parent, way, fixed)

    def root(self, frame: str) -> str:
        """The frame at the end of the way through all parents."""
        return self._way(frame)[-1]

    def moves(self, frame: str) -> bool:
        """Whether anything between a frame and its root does."""
        return any(self._edges[frame].moves for frame in self._way(frame)[:-1])

    def T_root_frame(self, frame: str, time_s: float) -> NDArray[np.float64] | None:
        """(4, 4), None where a transform on the way is lacking at that time."""
        return self._along(self._way(frame)[:-1], time_s)

    def lacking(self, frame: str, time_s: float) -> str:
        """Which transforms on the way to the root are not known at that time."""
        edges = [(child, self._edges[child]) for child in self._way(frame)[:-1]]
        unknown = [(e.parent, child) for child, e in edges if e.at(time_s) is None]
        return ", ".join(f"from {parent!r} to {child!r}" for parent, child in unknown)

    def T_between(self, a: str, b: str, time_s: float) -> NDArray[np.float64] | None:
        """(4, 4) T_a_b, None where both are in no common frame or a transform is lacking."""
        way_a, way_b = self._way(a), self._way(b)
        common = next((frame for frame in way_a if frame in way_b), None)
        if common is None:
            return None
        T_common_a = self._along(way_a[: way_a.index(common)], time_s)
        T_common_b = self._along(way_b[: way_b.index(common)], time_s)
        if T_common_a is None or T_common_b is None:
            return None
        return inverse_T(T_common_a) @ T_common_b

    def _along(self, way: list[str], time_s: float) -> NDArray[np.float64] | None:
        """(4, 4): the first of these frames in the parent of the last."""
        T = np.eye(4)
        for child in way:
            step = self._edges[child].at(time_s)
            if step is None:
                return None
            T = step @ T
        return T

    def is_world(self, frame: str) -> bool:
        """Whether a frame's root stands still in the room: it is called so, or something moves in
        it and it is not called as a part of a robot is."""
        root = self.root(frame)
        if root == name(frame) or is_world_name(root):
            return root != name(frame)
        return self.moves(frame) and not _BODY.search(root.lower())

    def _way(self, frame: str) -> list[str]:
        """The frame, its parent and so on; a circle ends where it closes."""
        way = [name(frame)]
        while (edge := self._edges.get(way[-1])) and edge.parent not in way:
            way.append(edge.parent)
        return way


def is_world_name(frame: str) -> bool:
    """Whether a frame is called as worlds are."""
    return bool(_WORLD.search(frame.rpartition("/")[2].lower()))


def name(frame: str) -> str:
    """As all of ROS 2 writes it; some of ROS 1 begins with a slash."""
    return str(frame).lstrip("/")


def seconds(stamp: Any) -> float:
    """Of a time stamp."""
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)
