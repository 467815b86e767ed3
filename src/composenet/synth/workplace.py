"""Offices as people work in them: desks that touch, in rows and islands, with all that stands on
them. Training alone holds such rooms (`furnish.TRAINING_KINDS`)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from composenet.synth.furniture.clutter_people import sitting
from composenet.synth.furniture.clutter_small import keyboard, monitor, picture_tube
from composenet.synth.placement import Layout
from composenet.synth.shape import Shape

_CROWDED, _PEOPLED = 0.6, 0.15


def fit_desks(layout: Layout, make: Callable[[str], Shape], most: int) -> None:
    """At most `most` desks of one kind, flush beside each other along a wall or back to back in
    the room; most of them have screens and a chair, all are furnished with what is used there."""
    rng, desk = layout.rng, make("desk")
    if rng.random() < 0.5:
        walls = [w for w in layout.room.walls if w.length_m > desk.extents_m[1] + 0.1]
        if not walls:
            return
        wall = walls[int(rng.integers(len(walls)))]
        start = float(rng.uniform(0.02, wall.length_m - desk.extents_m[1] - 0.05))
        placed = [i for i in layout.row(wall, start, [desk] * most) if i is not None]
    else:
        placed = _island(layout, desk, most)
    chair = make("chair")
    for index in placed:
        dress(layout, make, index)
        if rng.random() < _PEOPLED:
            layout.tuck(index, sitting(rng), 0.0, 0.0)
        elif rng.random() < 0.85:
            layout.tuck(index, chair, 0.0, float(rng.normal(0, 0.15)))


def _island(layout: Layout, desk: Shape, most: int) -> list[int]:
    """Desks in the middle of a room: the first where there is space, others at its back and
    side."""
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
    for k in range(screens):
        aside = middle + (k - (screens - 1) / 2) * float(rng.uniform(0.5, 0.62))
        back = -deep / 2 + float(rng.uniform(0.2, 0.32))
        screen = picture_tube(rng) if rng.random() < 0.2 else monitor(rng)
        layout.on_top_at(index, screen, back, aside, float(rng.normal(0, 0.2)))
    if screens:
        front = deep / 2 - float(rng.uniform(0.15, 0.28))
        layout.on_top_at(index, keyboard(rng), front, middle, float(rng.normal(0, 0.1)))
    many = rng.random() < _CROWDED
    for _ in range(int(rng.integers(5, 14) if many else rng.integers(0, 5))):
        layout.on_top(index, make("small clutter"))
