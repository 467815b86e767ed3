"""Beds of thick boards with flat bedding, and bunks of two or three low tiers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from composenet.records import Symmetry
from composenet.synth.furniture.bed_parts import Plan, add_board
from composenet.synth.furniture.parts import Rng, box, carcass, chance, fabric, rounded_box
from composenet.synth.shape import Shape, ShapeBuilder


def _flat_bedding(builder: ShapeBuilder, rng: Rng, plan: Plan, lift: float = 0.0) -> None:
    """A mattress, pillows like slabs, and a cover that hangs a little over the edges."""
    white, cloth = fabric(rng), fabric(rng)
    size = (plan.length, plan.width, plan.thick)
    builder.add(rounded_box(size, (0, 0, lift + plan.slats + plan.thick / 2), 0.03), white)
    top, count = lift + plan.top, 1 if plan.width < 1.3 else int(rng.integers(1, 3))
    deep, thick = float(rng.uniform(0.3, 0.5)), float(rng.uniform(0.05, 0.14))
    wide = plan.width / count * float(rng.uniform(0.7, 0.95))
    for index in range(count):
        y = (index - (count - 1) / 2) * plan.width / count
        x = -plan.length / 2 + deep / 2 + 0.03
        builder.add(rounded_box((deep, wide, thick), (x, y, top + thick / 2 - 0.01), 0.03), white)
    if chance(rng, 0.85):
        start = -plan.length / 2 + deep + float(rng.uniform(0.0, 0.35))
        over, hang = float(rng.uniform(0.0, 0.05)), float(rng.uniform(0.03, 0.9)) * plan.thick
        tall = float(rng.uniform(0.02, 0.08)) + hang
        long = plan.length / 2 - start + over
        middle = (start + plan.length / 2 + over) / 2
        center = (middle, 0, top - hang + tall / 2)
        builder.add(rounded_box((long, plan.width + 2 * over, tall), center, 0.02), cloth)
        if chance(rng, 0.5):  # turned back
            fold = (float(rng.uniform(0.12, 0.35)), plan.width + 2 * over, tall + 0.03)
            builder.add(rounded_box(fold, (start + fold[0] / 2, 0, center[2] + 0.015), 0.02), white)


def _plan(rng: Rng, narrow: bool) -> Plan:
    u = rng.uniform
    width = u(0.8, 1.15) if narrow or chance(rng, 0.4) else u(1.3, 2.0)
    return Plan(u(1.9, 2.2), width, u(0.14, 0.36), u(0.1, 0.3))


def boarded(rng: Rng) -> Shape:
    """A frame of thick boards on broad feet; the head board low and thick, the foot board none,
    low, or with posts that carry knobs."""
    builder, plan, body = ShapeBuilder(), _plan(rng, False), carcass(rng)
    thick, rim = float(rng.uniform(0.03, 0.1)), float(rng.uniform(0.0, 0.06))
    x, y = plan.length / 2 + rim, plan.width / 2 + rim
    gap = float(rng.uniform(0.0, 0.14))
    rail = (gap, plan.slats + float(rng.uniform(-0.02, 0.08)))
    middle, tall = sum(rail) / 2, rail[1] - rail[0]
    builder.add(box((2 * x, 2 * y, tall), (0, 0, middle)), body)
    if gap > 0.02:
        foot = float(rng.uniform(0.06, 0.2))
        for side_x in (-1, 1):
            for side_y in (-1, 1):
                at = (side_x * (x - foot / 2), side_y * (y - foot / 2), gap / 2)
                builder.add(box((foot, foot, gap + 0.01), at), body)
    _flat_bedding(builder, rng, plan)
    head = plan.top + float(rng.uniform(0.05, 0.7))
    kind = str(rng.choice(["plain", "plain", "posts", "arch"]))
    if kind == "plain":
        deep = 2 * thick
        size = (deep, 2 * y + float(rng.choice([0.0, rng.uniform(0.0, 0.15)])), head)
        builder.add(box(size, (-x - deep / 2, 0, head / 2)), body)
    else:
        add_board(builder, rng, -x - 0.02, 2 * y, 0.1, head, body, kind)
    if chance(rng, 0.4):
        low = plan.slats + float(rng.uniform(0.05, 0.6)) * (head - plan.slats)
        add_board(builder, rng, x + 0.02, 2 * y, 0.1, low, body, kind)
    return builder.build("bed", "boarded", Symmetry.NONE)


def tiers(rng: Rng) -> Shape:
    """Two or three bunks close over each other between thick posts, with rails or without."""
    builder, drawn, body = ShapeBuilder(), _plan(rng, True), carcass(rng)
    count = int(rng.integers(2, 4))
    step = float(rng.uniform(0.55, 0.75)) if count == 3 else float(rng.uniform(0.75, 1.1))
    slats, thick = float(rng.uniform(0.1, 0.3)), float(rng.uniform(0.08, 0.16))
    plan = Plan(drawn.length, drawn.width, slats, thick)
    post = float(rng.uniform(0.06, 0.13))
    x, y = plan.length / 2 + post / 2, plan.width / 2 + post / 2
    high = (count - 1) * step + plan.top + float(rng.uniform(0.1, 0.3))
    for side_x in (-x, x):
        for side_y in (-y, y):
            builder.add(box((post, post, high), (side_x, side_y, high / 2)), body)
    guard = chance(rng, 0.6)
    for level in range(count):
        lift = level * step
        z = lift + plan.slats
        builder.add(box((2 * x, 2 * y, 0.08), (0, 0, z - 0.04)), body)
        _flat_bedding(builder, rng, plan, lift)
        if guard and level:
            for side in (-1, 1):
                rail = (2 * x, 0.03, float(rng.uniform(0.06, 0.14)))
                builder.add(box(rail, (0, side * y, z + plan.thick + 0.1)), body)
        for end in (-x, x):
            size = (0.03, 2 * y, float(rng.uniform(0.1, 0.25)))
            builder.add(box(size, (end, 0, z + plan.thick + 0.08)), body)
    if chance(rng, 0.7):
        wall, left = float(rng.choice([-1, 1])), float(rng.uniform(0.2, 0.5)) * x
        for at in (left, left + 0.4):
            builder.add(box((0.04, 0.04, high - 0.1), (at, wall * (y + 0.03), high / 2)), body)
        for rung in np.linspace(0.2, high - 0.25, int(rng.integers(3, 7))):
            builder.add(box((0.4, 0.04, 0.04), (left + 0.2, wall * (y + 0.03), rung)), body)
    return builder.build("bed", "tiers", Symmetry.NONE)


STYLES: dict[str, dict[str, Callable[[Rng], Shape]]] = {"bed": {"boarded": boarded, "tiers": tiers}}
