"""Things in a room and whether they are in each other's way.

Footprints are (x, y, yaw, half x, half y) in the room frame: oriented rectangles on the floor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numba
import numpy as np
from numpy.typing import NDArray

from composenet.synth.columns import Place, as_place, columns_of, meet
from composenet.synth.room import Room
from composenet.synth.shape import Shape

Footprint = tuple[float, float, float, float, float]

_HANGS_HIGH_M = 1.1
# Low things may stand in the free space below these.
_OPEN_BELOW = ("table", "desk")
_MAY_GO_BELOW = ("chair", "clutter")


@dataclass(frozen=True)
class Item:
    """One thing in the room. xyz: its box's centre, room frame. support: index of the item
    it stands on, or None for the floor and the walls."""

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

    @property
    def place(self) -> Place:
        return (self.xyz[0], self.xyz[1], self.yaw)

    @property
    def span_m(self) -> tuple[float, float]:
        """Its lowest and highest height above the floor."""
        half = float(self.extents_m[2]) / 2
        return self.xyz[2] - half, self.xyz[2] + half

    @property
    def on_floor(self) -> bool:
        return self.support is None and self.shape.mount_m == 0.0


def touches(
    item: Item,
    place: Place,
    others: Sequence[Item],
    places: NDArray[np.float64],
    gap_m: float,
) -> bool:
    """Whether the item, at a place, comes closer than gap_m to any other, those at places (N, 3).
    In plan, but for what stands below a table top: there the surfaces must keep apart."""
    if len(others) == 0:
        return False
    half = np.array([other.footprint[3:] for other in others])
    ex, ey, _ = item.extents_m
    near = _overlapping(np.array([*place, ex / 2, ey / 2]), np.hstack([places, half]), gap_m)
    return any(_meet(item, place, others[int(k)], places[k]) for k in np.flatnonzero(near))


def _taken_m(item: Item) -> tuple[float, float]:
    """The heights it takes up: what hangs low keeps the floor below it free."""
    low, high = item.span_m
    return (0.0 if item.support is None and low < _HANGS_HIGH_M else low), high


def _meet(item: Item, place: Place, other: Item, other_place: NDArray[np.float64]) -> bool:
    """Whether two things whose footprints overlap are in each other's way."""
    (low, high), (other_low, other_high) = _taken_m(item), _taken_m(other)
    if low > other_high or other_low > high:
        return False
    low_thing, high_thing = sorted((item, other), key=lambda i: i.shape.class_name in _OPEN_BELOW)
    if (
        high_thing.shape.class_name not in _OPEN_BELOW
        or low_thing.shape.class_name not in _MAY_GO_BELOW
        or not (item.on_floor and other.on_floor)
    ):
        return True
    return meet(columns_of(item.shape), place, columns_of(other.shape), as_place(other_place))


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
    footprint: Footprint, others: Sequence[Footprint] | NDArray[np.floating], gap_m: float
) -> bool:
    """Whether the footprint comes closer than gap_m to any of the others."""
    if len(others) == 0:
        return False
    rectangles = np.asarray(others, dtype=np.float64)
    return bool(_overlapping(np.array(footprint), rectangles, gap_m).any())


@numba.njit(cache=True, nogil=True)
def _overlapping(a, others, gap):  # type: ignore[no-untyped-def]
    """Separating axes of two rectangles: the four directions of their sides."""
    found = np.zeros(len(others), dtype=np.bool_)
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
            found[k] = True
    return found
