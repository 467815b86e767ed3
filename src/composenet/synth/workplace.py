"""Offices as people work in them: desks that touch, in rows and islands, with all that stands on
them. Training alone holds such rooms (`furnish.TRAINING_KINDS`)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from composenet.synth.furniture.clutter_desk import keyboard, screen
from composenet.synth.placement import Layout
from composenet.synth.shape import Shape

_CROWDED = 0.6
_REACH_M = 0.36
"""How far in front of a screen its keyboard lies, if the desk is deep enough."""
_FROM_EDGE_M = 0.06


def fit_desks(layout: Layout, make: Callable[[str], Shape], most: int) -> list[int]:
    """At most `most` desks of one kind, flush beside each other along a wall or back to back in
    the room, most of them with a chair. Returns the desks."""
    if most < 1:
        return []
    rng, desk = layout.rng, make("desk")
    if rng.random() < 0.5:
        walls = [w for w in layout.room.walls if w.length_m > desk.extents_m[1] + 0.1]
        if not walls:
            return []
        wall = walls[int(rng.integers(len(walls)))]
        start = float(rng.uniform(0.02, wall.length_m - desk.extents_m[1] - 0.05))
        placed = [i for i in layout.row(wall, start, [desk] * most) if i is not None]
    else:
        placed = island(layout, desk, most)
    chair = make("chair")
    for index in placed:
        if rng.random() < 0.85:
            layout.tuck(index, chair, 0.0, float(rng.normal(0, 0.15)))
    return placed


def island(layout: Layout, desk: Shape, most: int) -> list[int]:
    """Up to four desks in the middle of a room: the first where there is space, others at its back
    and side. Returns them."""
    if not layout.free(desk, 0.3):
        return []
    first = len(layout.items) - 1
    back, side = (np.pi, 0.0), (np.pi / 2, -np.pi / 2)
    placed = [first]
    for way, (angle, turn) in enumerate((back, side) if layout.rng.random() < 0.6 else (side,)):
        for index in tuple(placed):
            # A desk at the other's back looks the other way, so its neighbour is at its right.
            sign = -1 if way and index != first else 1
            if len(placed) < most and layout.flush(index, desk, sign * angle, sign * turn):
                placed.append(len(layout.items) - 1)
    return placed


def dress(layout: Layout, make: Callable[[str], Shape], index: int) -> None:
    """What stands on a desk: screens at its back that look at the sitter, a keyboard before
    them, then more or less of everything."""
    rng, (deep, wide, _) = layout.rng, layout.items[index].extents_m
    screens = int(rng.choice([0, 1, 1, 2, 2, 3]))
    middle = float(rng.normal(0, 0.1 * wide))
    stood = []
    for k in range(screens):
        aside = middle + (k - (screens - 1) / 2) * float(rng.uniform(0.5, 0.62))
        back = _stand_at_the_back(layout, index, screen(rng), aside, float(rng.normal(0, 0.2)))
        if back is not None:
            stood.append((back, aside))
    if stood:
        (back, aside), board = stood[len(stood) // 2], keyboard(rng)
        forth = back + _REACH_M + float(rng.uniform(0.0, 0.1))
        edge = float(deep) / 2 - float(board.extents_m[0]) / 2 - _FROM_EDGE_M
        layout.on_top_at(index, board, min(forth, edge), aside, float(rng.normal(0, 0.1)))
    many = rng.random() < _CROWDED
    for _ in range(int(rng.integers(5, 14) if many else rng.integers(0, 5))):
        layout.on_top(index, make("small clutter"))


def _stand_at_the_back(
    layout: Layout, index: int, shape: Shape, aside: float, yaw: float
) -> float | None:
    """Stand it on a desk, so far aside, as far back as there is a flat and free place. Returns how
    far forth that is from the desk's middle, or None."""
    deep, half = float(layout.items[index].extents_m[0]), float(shape.extents_m[0]) / 2
    first = -deep / 2 + half + float(layout.rng.uniform(0.04, 0.14))
    for back in np.arange(first, deep / 2 - half, 0.06):
        if layout.on_top_at(index, shape, float(back), aside, yaw):
            return float(back)
    return None
