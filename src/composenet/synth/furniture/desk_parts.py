"""Tops, drawers and legs that desks are put together from."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from composenet.synth.furniture.chair_parts import legs_between
from composenet.synth.furniture.curves import soft_slab
from composenet.synth.furniture.parts import (
    Rng,
    Solid,
    bar,
    box,
    box_between,
    carcass,
    chance,
    extrude,
    metal,
    rod,
    rounded_rectangle,
)
from composenet.synth.shape import Material, ShapeBuilder


@dataclass(frozen=True)
class Desk:
    """Measures, metres: depth (X), width (Y), height of the working surface, its thickness."""

    deep: float
    wide: float
    height: float
    thick: float

    @property
    def under(self) -> float:
        """Height of the lower side of the top."""
        return self.height - self.thick


def draw_desk(rng: Rng) -> Desk:
    """Random measures."""
    u = rng.uniform
    return Desk(u(0.5, 0.85), u(1.0, 1.8), u(0.71, 0.78), u(0.018, 0.05))


def desk_top(d: Desk, rng: Rng) -> Solid:
    """The working surface."""
    outline = rounded_rectangle(d.deep, d.wide, rng.choice([0.004, 0.05, 0.12]), 3)
    if chance(rng, 0.4):
        return soft_slab(outline, d.under, d.thick, d.thick)
    return extrude(outline, d.thick, d.under)


def _handle(rng: Rng, kind: int, x: float, y: float, z: float, room: float) -> Solid:
    """A knob, bar or recessed-looking grip on a front at x."""
    if kind == 0:
        return rod((x - 0.005, y, z), (x + 0.025, y, z), 0.014, segments=8)
    if kind == 1:
        return box((0.03, room * 0.45, 0.012), (x + 0.012, y, z))
    return box((0.02, room * 0.25, 0.03), (x + 0.006, y, z))


def drawers(
    rng: Rng, builder: ShapeBuilder, low: tuple[float, float, float],
    high: tuple[float, float, float], body: Material, rows: int,
) -> None:  # fmt: skip
    """A box whose +X side has so many drawer fronts."""
    builder.add(box_between(low, high), body)
    front = body if chance(rng, 0.6) else carcass(rng)
    grips, kind = metal(rng), int(rng.integers(3))
    edges = np.linspace(low[2], high[2], rows + 1)
    y, room = (low[1] + high[1]) / 2, high[1] - low[1]
    for a, b in pairwise(edges):
        panel = (0.018, room - 0.012, b - a - 0.012)
        builder.add(box(panel, (high[0] + 0.008, y, (a + b) / 2)), front)
        z = (a + b) / 2 if b - a < 0.2 else b - 0.06
        builder.add(_handle(rng, kind, high[0] + 0.017, y, z, room), grips)


def drawer_pedestal(
    rng: Rng, builder: ShapeBuilder, d: Desk, side: int, body: Material, raised: float
) -> None:
    """Drawers under one end, from the floor or raised."""
    width, inset = rng.uniform(0.32, 0.46), rng.uniform(0.0, 0.05)
    y = np.sort([side * (d.wide / 2 - inset), side * (d.wide / 2 - inset - width)])
    x = d.deep / 2 - rng.uniform(0.02, 0.06)
    low = (-d.deep / 2 + rng.uniform(0.01, 0.06), float(y[0]), raised)
    rows = int(rng.integers(1, 3)) if raised > 0.3 else int(rng.integers(2, 5))
    drawers(rng, builder, low, (x, float(y[1]), d.under + 0.002), body, rows)


def leg_frame(rng: Rng, d: Desk, sides: tuple[int, ...] = (-1, 1)) -> list[Solid]:
    """Legs, a panel or a frame under the given ends."""
    x, y = d.deep / 2, d.wide / 2
    size, kind = rng.uniform(0.025, 0.07), rng.integers(4)
    inset = rng.uniform(0, 0.06)
    solids: list[Solid] = []
    for side in sides:
        at = side * (y - size / 2 - inset)
        if kind == 0:
            solids.append(box((d.deep - 0.04, 0.025, d.under), (0, at, d.under / 2)))
            continue
        spots = np.array([(x - size / 2 - inset, at, 0), (-x + size / 2 + inset, at, 0)])
        high = spots + np.array([0, 0, d.under + 0.003])
        if kind == 1:
            high[:, 0] *= rng.uniform(0.6, 0.9)
            high[:, 1] -= side * rng.uniform(0, 0.08)
        round_legs = 10 if chance(rng, 0.4) else 4
        solids += legs_between(spots, high, size, rng.uniform(0.6, 1.0), round_legs)
        if kind == 2:
            solids.append(bar(spots[0] + (0, 0, size / 2), spots[1] + (0, 0, size / 2), size, size))
    return solids


def modesty(rng: Rng, d: Desk) -> Solid:
    """A panel across the back, more or less far down."""
    tall = rng.uniform(0.2, 0.95) * d.under
    x = -d.deep / 2 + rng.uniform(0.02, 0.12)
    return box((0.02, d.wide - 0.06, tall), (x, 0, d.under - tall / 2 + 0.002))


def pencil_drawers(rng: Rng, builder: ShapeBuilder, d: Desk, body: Material) -> None:
    """Flat drawers right under the top, between the ends."""
    count, tall = int(rng.integers(1, 4)), rng.uniform(0.07, 0.13)
    width = (d.wide - rng.uniform(0.1, 0.3)) / count
    for i in range(count):
        y = (i - (count - 1) / 2) * width
        low = (-d.deep / 2 + 0.05, y - width / 2, d.under - tall)
        high = (d.deep / 2 - 0.03, y + width / 2, d.under + 0.002)
        drawers(rng, builder, low, high, body, 1)
