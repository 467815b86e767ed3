"""Where furniture stands: room programmes and placement without interpenetration.

Footprints are (x, y, yaw, half x, half y) in the room frame: oriented rectangles on the floor.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numba
import numpy as np
from numpy.typing import NDArray

from composenet.synth.room import Room
from composenet.synth.shape import Shape

Footprint = tuple[float, float, float, float, float]
GAP_M = 0.03


@dataclass(frozen=True)
class Item:
    """One thing in the room. xyz: its box's centre, room frame. support: index of the item
    it stands on, or None for the floor."""

    shape: Shape
    xyz: tuple[float, float, float]
    yaw: float
    support: int | None = None

    @cached_property
    def extents_m(self) -> NDArray[np.float64]:
        """(3,) of the shape."""
        return self.shape.extents_m

    @cached_property
    def footprint(self) -> Footprint:
        ex, ey, _ = self.extents_m
        return (self.xyz[0], self.xyz[1], self.yaw, ex / 2, ey / 2)


@dataclass
class Layout:
    """The furnishing of one room while it grows. items: in order of placement."""

    room: Room
    rng: np.random.Generator
    items: list[Item] = field(default_factory=list)

    def blocked(self, footprint: Footprint, gap_m: float = GAP_M) -> bool:
        """Whether the footprint leaves the room or comes closer than gap_m to a thing."""
        obstacles = [item.footprint for item in self.items if item.support is None]
        obstacles += self.room.keep_free
        return not inside(self.room, footprint) or overlaps(footprint, obstacles, gap_m)

    def place(self, shape: Shape, x: float, y: float, yaw: float, gap_m: float = GAP_M) -> bool:
        """Stand the shape on the floor there if that is free."""
        ex, ey, ez = shape.extents_m
        if self.blocked((x, y, yaw, ex / 2, ey / 2), gap_m):
            return False
        self.items.append(Item(shape, (x, y, ez / 2), yaw))
        return True

    def against_wall(self, shape: Shape) -> bool:
        """Back to a wall, looking into the room."""
        ex, ey, _ = shape.extents_m
        for _ in range(25):
            wall = self.room.walls[int(self.rng.integers(len(self.room.walls)))]
            if wall.length_m < ey + 0.05:
                continue
            along = self.rng.uniform(ey / 2 + 0.02, wall.length_m - ey / 2 - 0.02)
            x, y = wall.point(along, ex / 2 + self.rng.uniform(0.02, 0.08))
            if self.place(shape, x, y, wall.yaw + self.rng.normal(0, 0.015)):
                return True
        return False

    def free(self, shape: Shape) -> bool:
        """Anywhere, mostly along the walls' directions."""
        size = np.array(self.room.size_m)
        for _ in range(25):
            x, y = self.rng.uniform(0.1, 0.9, 2) * size
            yaw = self.rng.integers(4) * np.pi / 2 + self.rng.normal(0, 0.25)
            if self.place(shape, float(x), float(y), float(yaw), 0.08):
                return True
        return False

    def before(self, index: int, shape: Shape, gap_m: float, yaw_offset: float) -> bool:
        """In front of an item, turned by yaw_offset from it."""
        return self.beside(index, shape, 0.0, gap_m, yaw_offset)

    def beside(
        self, index: int, shape: Shape, angle: float, gap_m: float, yaw_offset: float
    ) -> bool:
        """At the item's side in the direction `angle` (a multiple of 90 degrees from its front)."""
        x, y, yaw, hx, hy = self.items[index].footprint
        ex, ey, _ = shape.extents_m
        along_x = abs(np.cos(angle)) > 0.5
        depth = ex if abs(np.cos(yaw_offset)) > 0.5 else ey
        reach = (hx if along_x else hy) + gap_m + depth / 2
        slack = max(0.0, (hy if along_x else hx) - 0.25)
        for _ in range(6):
            aside = self.rng.uniform(-slack, slack)
            dx = reach * np.cos(angle) - aside * np.sin(angle)
            dy = reach * np.sin(angle) + aside * np.cos(angle)
            wx = x + dx * np.cos(yaw) - dy * np.sin(yaw)
            wy = y + dx * np.sin(yaw) + dy * np.cos(yaw)
            turn = yaw + angle + yaw_offset + self.rng.normal(0, 0.12)
            if self.place(shape, float(wx), float(wy), float(turn), 0.01):
                return True
        return False

    def on_top(self, index: int, shape: Shape) -> bool:
        """Standing on a flat part of an item's upper side."""
        item = self.items[index]
        ex, ey, ez = shape.extents_m
        tops, cell = height_map(item.shape)
        nx, ny = (int(np.ceil(max(ex, ey) / c)) + 1 for c in cell)
        if nx >= tops.shape[0] or ny >= tops.shape[1]:
            return False
        others = [o.footprint for o in self.items if o.support == index]
        for _ in range(12):
            i = int(self.rng.integers(tops.shape[0] - nx))
            j = int(self.rng.integers(tops.shape[1] - ny))
            patch = tops[i : i + nx, j : j + ny]
            if not np.isfinite(patch).all() or np.ptp(patch) > 0.01:
                continue
            dx = (i + nx / 2) * cell[0] - item.extents_m[0] / 2
            dy = (j + ny / 2) * cell[1] - item.extents_m[1] / 2
            c, s = np.cos(item.yaw), np.sin(item.yaw)
            x, y = item.xyz[0] + c * dx - s * dy, item.xyz[1] + s * dx + c * dy
            yaw = float(self.rng.uniform(-np.pi, np.pi))
            if overlaps((x, y, yaw, ex / 2, ey / 2), others, 0.01):
                continue
            z = item.xyz[2] + float(patch.max()) + ez / 2
            if z + ez / 2 > self.room.height_m:
                return False
            self.items.append(Item(shape, (float(x), float(y), z), yaw, index))
            return True
        return False


def inside(room: Room, footprint: Footprint) -> bool:
    """Whether the footprint lies within the room's floor."""
    x, y, yaw, hx, hy = footprint
    reach_x = abs(hx * np.cos(yaw)) + abs(hy * np.sin(yaw))
    reach_y = abs(hx * np.sin(yaw)) + abs(hy * np.cos(yaw))
    width, depth = room.size_m
    if x < reach_x or y < reach_y or x > width - reach_x or y > depth - reach_y:
        return False
    return room.notch is None or not overlaps(footprint, [room.notch], 0.0)


def overlaps(
    footprint: Footprint, others: list[Footprint] | NDArray[np.floating], gap_m: float
) -> bool:
    """Whether the footprint comes closer than gap_m to any of the others."""
    if len(others) == 0:
        return False
    return bool(_overlaps(np.array(footprint), np.asarray(others, dtype=np.float64), gap_m))


@numba.njit(cache=True, nogil=True)
def _overlaps(a, others, gap):  # type: ignore[no-untyped-def]
    """Separating axes of two rectangles: the four directions of their sides."""
    ca, sa = np.cos(a[2]), np.sin(a[2])
    for k in range(len(others)):
        b = others[k]
        cb, sb = np.cos(b[2]), np.sin(b[2])
        dx, dy = b[0] - a[0], b[1] - a[1]
        along, across = abs(ca * cb + sa * sb), abs(sa * cb - ca * sb)
        if (
            abs(ca * dx + sa * dy) < a[3] + b[3] * along + b[4] * across + gap
            and abs(-sa * dx + ca * dy) < a[4] + b[3] * across + b[4] * along + gap
            and abs(cb * dx + sb * dy) < b[3] + a[3] * along + a[4] * across + gap
            and abs(-sb * dx + cb * dy) < b[4] + a[3] * across + a[4] * along + gap
        ):
            return True
    return False


def height_map(shape: Shape, cells: int = 24) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Height of the shape's upper side above its centre, (cells, cells) over its footprint
    [ix, iy], and the size of a cell (2,), metres."""
    cell = shape.extents_m[:2] / cells
    corners = shape.vertices[shape.faces].astype(np.float64)
    tops = np.full((cells, cells), -np.inf)
    _drop(corners, shape.extents_m[:2], tops)
    return tops, cell


@numba.njit(cache=True, nogil=True)
def _drop(corners, extents, tops):  # type: ignore[no-untyped-def]
    cells = len(tops)
    cx, cy = extents[0] / cells, extents[1] / cells
    for f in range(len(corners)):
        x = (corners[f, :, 0] + extents[0] / 2) / cx - 0.5
        y = (corners[f, :, 1] + extents[1] / 2) / cy - 0.5
        area = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0])
        if abs(area) < 1e-12:
            continue
        for i in range(max(0, int(np.ceil(x.min()))), min(cells - 1, int(x.max())) + 1):
            for j in range(max(0, int(np.ceil(y.min()))), min(cells - 1, int(y.max())) + 1):
                b = ((i - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (j - y[0])) / area
                c = ((x[1] - x[0]) * (j - y[0]) - (i - x[0]) * (y[1] - y[0])) / area
                if b >= 0 and c >= 0 and b + c <= 1:
                    p, q, r = corners[f, 0, 2], corners[f, 1, 2], corners[f, 2, 2]
                    z = p + b * (q - p) + c * (r - p)
                    tops[i, j] = max(tops[i, j], z)
