"""Where furniture stands: placement without interpenetration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from composenet.synth.collision import Item, inside, overlaps, touches
from composenet.synth.columns import height_map
from composenet.synth.room import Room, Wall
from composenet.synth.shape import Shape

GAP_M = 0.03


@dataclass
class Layout:
    """The furnishing of one room while it grows. items: in order of placement. cad_share:
    share of the furniture that is to be meshes from a folder."""

    room: Room
    rng: np.random.Generator
    cad_share: float = 0.0
    items: list[Item] = field(default_factory=list)

    @property
    def furniture(self) -> list[int]:
        """Indices of what belongs to the ten classes."""
        return [i for i, item in enumerate(self.items) if item.shape.class_name != "clutter"]

    def place(self, shape: Shape, x: float, y: float, yaw: float, gap_m: float = GAP_M) -> bool:
        """Stand the shape on the floor there, or hang it at its height, if that is free."""
        item = Item(shape, (x, y, shape.mount_m + float(shape.extents_m[2]) / 2), yaw)
        others = [o for o in self.items if o.support is None]
        if (
            not inside(self.room, item.footprint)
            or item.span_m[1] > self.room.height_m
            or overlaps(item.footprint, self.room.keep_free, 0.0)
            or touches(item, item.place, others, np.array([o.place for o in others]), gap_m)
        ):
            return False
        self.items.append(item)
        return True

    def against_wall(self, shape: Shape) -> bool:
        """Back to a wall, looking into the room."""
        ex, ey, _ = shape.extents_m
        for _ in range(25):
            wall = self.room.walls[int(self.rng.integers(len(self.room.walls)))]
            if wall.length_m < ey + 0.05:
                continue
            along = self.rng.uniform(ey / 2 + 0.02, wall.length_m - ey / 2 - 0.02)
            if shape.mount_m and not self.on_wall(shape, wall, along):
                continue
            off = 0.01 if shape.mount_m else self.rng.uniform(0.02, 0.08)
            x, y = wall.point(along, ex / 2 + off)
            turn = 0.0 if shape.mount_m else self.rng.normal(0, 0.015)
            if self.place(shape, x, y, wall.yaw + turn):
                return True
        return False

    def on_wall(self, shape: Shape, wall: Wall, along_m: float) -> bool:
        """Whether the wall is closed where the shape would hang."""
        low, high = along_m - shape.extents_m[1] / 2, along_m + shape.extents_m[1] / 2
        bottom, top = shape.mount_m, shape.mount_m + shape.extents_m[2]
        return not any(
            low < hole.end_m + 0.05
            and high > hole.start_m - 0.05
            and bottom < hole.top_m + 0.05
            and top > hole.bottom_m - 0.05
            for hole in wall.openings
        )

    def row(self, wall: Wall, start_m: float, shapes: Sequence[Shape]) -> list[int | None]:
        """Side by side along a wall, flush, from start_m on; a blocked place is left out. The
        index of each, or None where the wall ends before."""
        placed: list[int | None] = []
        for shape in shapes:
            ex, ey, _ = map(float, shape.extents_m)
            placed.append(None)
            while placed[-1] is None and start_m + ey <= wall.length_m:
                x, y = wall.point(start_m + ey / 2, ex / 2 + 0.01)
                free = not shape.mount_m or self.on_wall(shape, wall, start_m + ey / 2)
                if free and self.place(shape, x, y, wall.yaw, 0.0):
                    placed[-1] = len(self.items) - 1
                    start_m += ey + 0.002
                else:
                    start_m += 0.15
        return placed

    def free(self, shape: Shape, gap_m: float = 0.08) -> bool:
        """Anywhere, mostly along the walls' directions; what hangs, on a wall."""
        if shape.mount_m:
            return self.against_wall(shape)
        size = np.array(self.room.size_m)
        for _ in range(25):
            x, y = self.rng.uniform(0.1, 0.9, 2) * size
            yaw = self.rng.integers(4) * np.pi / 2 + self.rng.normal(0, 0.25)
            if self.place(shape, float(x), float(y), float(yaw), gap_m):
                return True
        return False

    def beside(
        self, index: int, shape: Shape, angle: float, gap_m: float, yaw_offset: float
    ) -> bool:
        """At the item's side in the direction `angle` (a multiple of 90 degrees from its front),
        turned by yaw_offset from that direction."""
        slack = max(0.0, self._sides(index, angle)[1] - 0.25)
        return any(
            self._at_side(index, shape, angle, self.rng.uniform(-slack, slack), gap_m, yaw_offset)
            for _ in range(6)
        )

    def tuck(self, index: int, shape: Shape, angle: float, aside_m: float) -> bool:
        """A seat at the item's side, facing it, mostly pushed below its top as far as there is
        room (up to 70 % of its depth), sometimes pulled out or turned away."""
        ex, roll, turn = float(shape.extents_m[0]), self.rng.random(), self.rng.normal(0, 0.09)
        wanted = -ex * self.rng.uniform(0.0, 0.7)
        if roll < 0.25:
            wanted = self.rng.uniform(0.03, 0.35)
        if roll < 0.12:
            turn = self.rng.uniform(-1.3, 1.3)
        turn = np.pi + (turn if roll < 0.12 else float(np.clip(turn, -0.26, 0.26)))
        tries = np.linspace(wanted, max(wanted, 0.0) + 0.1, 6)
        return any(self._at_side(index, shape, angle, aside_m, float(g), turn) for g in tries)

    def seats(self, index: int, shape: Shape) -> list[tuple[float, float]]:
        """(angle, aside) of the places at an item's four sides where the seat fits."""
        places = []
        for angle in np.arange(4) * np.pi / 2:
            length = 2 * self._sides(index, angle)[1]
            count = int(np.clip(length / (shape.extents_m[1] + 0.1), 1, 3))
            offsets = (np.arange(count) + 0.5) * length / count - length / 2
            places += [(float(angle), float(aside)) for aside in offsets]
        return places

    def _sides(self, index: int, angle: float) -> tuple[float, float]:
        """Half the item's extents in the direction `angle` from its front, and across."""
        _, _, _, hx, hy = self.items[index].footprint
        return (hx, hy) if abs(np.cos(angle)) > 0.5 else (hy, hx)

    def _at_side(
        self,
        index: int,
        shape: Shape,
        angle: float,
        aside_m: float,
        gap_m: float,
        yaw_offset: float,
    ) -> bool:
        x, y, yaw, _, _ = self.items[index].footprint
        ex, ey, _ = shape.extents_m
        depth = ex if abs(np.cos(yaw_offset)) > 0.5 else ey
        reach = self._sides(index, angle)[0] + gap_m + depth / 2
        c, s = np.cos(yaw + angle), np.sin(yaw + angle)
        at = (x + reach * c - aside_m * s, y + reach * s + aside_m * c)
        return self.place(shape, float(at[0]), float(at[1]), yaw + angle + yaw_offset, 0.01)

    def flush(self, index: int, shape: Shape, angle: float, yaw_offset: float) -> bool:
        """Right at the item's side in the direction `angle`, middle to middle."""
        return self._at_side(index, shape, angle, 0.0, 0.012, yaw_offset)

    def on_top(self, index: int, shape: Shape) -> bool:
        """Standing on a flat part of an item's upper side."""
        tops, cell = height_map(self.items[index].shape)
        nx, ny = _cells(np.full(2, shape.extents_m[:2].max()), cell)
        if nx >= tops.shape[0] or ny >= tops.shape[1]:
            return False
        for _ in range(12):
            i = int(self.rng.integers(tops.shape[0] - nx))
            j = int(self.rng.integers(tops.shape[1] - ny))
            height = _flat_m(tops[i : i + nx, j : j + ny])
            if height is None:
                continue
            yaw = float(self.rng.uniform(-np.pi, np.pi))
            if self._too_tall(index, shape, height):
                return False
            middle = (i + nx / 2) * cell[0], (j + ny / 2) * cell[1]
            if self._set_down(index, shape, middle, height, yaw):
                return True
        return False

    def on_top_at(self, index: int, shape: Shape, x: float, y: float, yaw: float) -> bool:
        """Standing on an item's upper side at x, y from its middle, turned by yaw from it, if
        that is flat and free."""
        item = self.items[index]
        tops, cell = height_map(item.shape)
        c, s = abs(np.cos(yaw)), abs(np.sin(yaw))
        nx, ny = _cells(np.array([[c, s], [s, c]]) @ shape.extents_m[:2], cell)
        middle = x + item.extents_m[0] / 2, y + item.extents_m[1] / 2
        i, j = round(middle[0] / cell[0] - nx / 2), round(middle[1] / cell[1] - ny / 2)
        if min(i, j) < 0 or i + nx > tops.shape[0] or j + ny > tops.shape[1]:
            return False
        height = _flat_m(tops[i : i + nx, j : j + ny])
        if height is None or self._too_tall(index, shape, height):
            return False
        return self._set_down(index, shape, middle, height, item.yaw + yaw)

    def _too_tall(self, index: int, shape: Shape, height_m: float) -> bool:
        """Whether the shape would reach through the ceiling."""
        top = self.items[index].xyz[2] + height_m + shape.extents_m[2]
        return bool(top > self.room.height_m)

    def _set_down(
        self, index: int, shape: Shape, middle: tuple[float, float], height_m: float, yaw: float
    ) -> bool:
        """Stand the shape on an item, middle from the corner of its footprint, if that is free."""
        item = self.items[index]
        others = [o for o in self.items if o.support == index or o.shape.mount_m]
        dx, dy = (m - e / 2 for m, e in zip(middle, item.extents_m[:2], strict=True))
        c, s = np.cos(item.yaw), np.sin(item.yaw)
        x, y = item.xyz[0] + c * dx - s * dy, item.xyz[1] + s * dx + c * dy
        z = item.xyz[2] + height_m + float(shape.extents_m[2]) / 2
        thing = Item(shape, (float(x), float(y), z), yaw, index)
        if touches(thing, thing.place, others, np.array([o.place for o in others]), 0.01):
            return False
        self.items.append(thing)
        return True


def _cells(size_m: NDArray[np.float64], cell: NDArray[np.float64]) -> tuple[int, int]:
    """Cells of a height map that something of a size (2,) covers."""
    nx, ny = (int(np.ceil(s / c)) + 1 for s, c in zip(size_m, cell, strict=True))
    return nx, ny


def _flat_m(patch: NDArray[np.float64]) -> float | None:
    """The height of a part of a height map, above the item's middle; None where it is not flat."""
    if not np.isfinite(patch).all() or np.ptp(patch) > 0.01:
        return None
    return float(patch.max())
