"""What beds share: frames, boards at the ends, mattresses, pillows and covers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from composenet.synth.furniture.parts import (
    Rng,
    arc,
    bar,
    box,
    chance,
    cone,
    cushion,
    extrude_x,
    fabric,
    paint,
    rounded_box,
)
from composenet.synth.shape import Material, ShapeBuilder

_WIDTHS = (0.8, 0.9, 0.9, 1.0, 1.2, 1.4, 1.4, 1.6, 1.6, 1.8, 1.8, 2.0)


@dataclass(frozen=True)
class Plan:
    """Sleeping surface: length (x) and width (y) of the mattress, the height of the slats that
    carry it, the mattress's thickness. Metres; the mattress is centred on x = y = 0."""

    length: float
    width: float
    slats: float
    thick: float

    @property
    def top(self) -> float:
        """Height of the mattress's top."""
        return self.slats + self.thick


def random_plan(rng: Rng, slats: tuple[float, float] = (0.2, 0.38), narrow: bool = False) -> Plan:
    width = float(rng.choice(_WIDTHS[:4] if narrow else _WIDTHS)) + float(rng.uniform(-0.03, 0.03))
    thick = float(rng.uniform(0.14, 0.3)) if not narrow else float(rng.uniform(0.1, 0.2))
    return Plan(float(rng.uniform(1.88, 2.12)), width, float(rng.uniform(*slats)), thick)


def add_bedding(builder: ShapeBuilder, rng: Rng, plan: Plan, lift: float = 0.0) -> None:
    """Mattress, pillows and a cover, raised by lift."""
    size = (plan.length, plan.width, plan.thick)
    white = fabric(rng) if chance(rng, 0.3) else paint(rng)
    middle = lift + plan.slats + plan.thick / 2
    builder.add(rounded_box(size, (0, 0, middle), float(rng.uniform(0.02, 0.07))), white)
    top = lift + plan.top
    _pillows(builder, rng, plan, top)
    if chance(rng, 0.75):
        _cover(builder, rng, plan, top)


def _pillows(builder: ShapeBuilder, rng: Rng, plan: Plan, top: float) -> None:
    count = 1 if plan.width < 1.15 else 2
    material = fabric(rng)
    for row in range(2 if chance(rng, 0.25) else 1):
        wide = min(plan.width / count * float(rng.uniform(0.7, 0.92)), 0.85)
        deep, thick = float(rng.uniform(0.35, 0.5)), float(rng.uniform(0.1, 0.18))
        tilt = float(rng.choice([0.0, rng.uniform(15, 60)]))
        for index in range(count):
            y = (index - (count - 1) / 2) * plan.width / count
            pillow = cushion((deep, wide, thick), power=3.0, segments=12)
            pillow = pillow.rotate((0, tilt, float(rng.normal(0, 3))))
            low = -float(pillow.bounding_box()[2])
            x = -plan.length / 2 + deep / 2 + 0.03 + 0.16 * row
            builder.add(pillow.translate((x, y, top + low - 0.015)), material)


def _cover(builder: ShapeBuilder, rng: Rng, plan: Plan, top: float) -> None:
    """Duvet or blanket: over most of the bed, hanging down at the sides or folded on the end."""
    material = fabric(rng)
    share = float(rng.choice([rng.uniform(0.55, 0.8), rng.uniform(0.2, 0.35)]))
    start = plan.length / 2 - share * plan.length
    thick = float(rng.uniform(0.02, 0.08))
    over = float(rng.uniform(0.0, 0.035))
    size = (plan.length / 2 - start + over, plan.width + 2 * over, thick)
    center = ((start + plan.length / 2 + over) / 2, 0, top + thick / 2 - 0.01)
    builder.add(rounded_box(size, center, 0.02), material)
    if over > 0.01:
        drop = float(rng.uniform(0.06, 0.9)) * min(plan.thick, 0.25)
        for side in (-1, 1):
            wall = box((size[0] - 0.04, over + 0.006, drop), (center[0], 0, top - drop / 2))
            builder.add(wall.translate((0, side * (plan.width + over) / 2, 0)), material)
    if share > 0.5 and chance(rng, 0.5):  # turned back at its upper edge
        fold = rounded_box(
            (0.25, size[1] * 0.99, thick + 0.03), (start + 0.1, 0, top + thick), 0.02
        )
        builder.add(fold, fabric(rng) if chance(rng, 0.5) else material)


def add_frame(
    builder: ShapeBuilder, rng: Rng, plan: Plan, material: Material, margin: float = 0.03
) -> None:
    """Side rails and slats' plane, on four (or six) legs."""
    rail = float(rng.uniform(0.1, 0.22))
    z, thick = plan.slats + 0.04 - rail / 2, float(rng.uniform(0.022, 0.04))
    for side in (-1, 1):
        y = side * (plan.width / 2 + margin - thick / 2)
        builder.add(box((plan.length, thick, rail), (0, y, z)), material)
    builder.add(box((plan.length, plan.width, 0.04), (0, 0, plan.slats - 0.02)), material)
    for x in (-plan.length / 2 + 0.1, plan.length / 2 - 0.1):
        for y in (-plan.width / 2 + 0.05, plan.width / 2 - 0.05):
            builder.add(cone(0.022, 0.032, plan.slats - 0.02, (x, y, 0), 8), material)


def add_board(
    builder: ShapeBuilder,
    rng: Rng,
    x: float,
    width: float,
    low: float,
    high: float,
    material: Material,
    kind: str,
) -> None:
    """A head or foot board in the plane x, from low to high. kind: plain, posts, slats, arch,
    rungs or padded."""
    thick = float(rng.uniform(0.025, 0.06))
    half = width / 2
    if kind == "plain":
        builder.add(
            rounded_box((thick, width, high - low), (x, 0, (low + high) / 2), 0.012), material
        )
    elif kind == "padded":
        deep, columns = float(rng.uniform(0.06, 0.14)), int(rng.integers(1, 6))
        builder.add(rounded_box((deep / 2, width, high), (x, 0, high / 2), 0.012), material)
        for y in (np.arange(columns) + 0.5) / columns * width - half:
            size = (deep / 2, width / columns, high - low)
            builder.add(rounded_box(size, (x + deep / 4, y, (low + high) / 2), 0.02), material)
    elif kind == "arch":
        rise = float(rng.uniform(0.12, 0.4)) * (high - low)
        radius = (half**2 + rise**2) / (2 * rise)
        reach = float(np.arcsin(min(half / radius, 1.0)))
        top = arc((0, high - radius), radius, np.pi / 2 - reach, np.pi / 2 + reach, 12)
        outline = np.concatenate([top, [(-half, low), (half, low)]])
        builder.add(extrude_x(outline, thick, x), material)
    else:
        post = float(rng.uniform(0.04, 0.08))
        for y in (-half + post / 2, half - post / 2):
            builder.add(box((post, post, high), (x, y, high / 2)), material)
            if kind == "posts" and chance(rng, 0.5):
                builder.add(cushion((post, post, post), (x, y, high + post / 2), 2, 8), material)
        rail = float(rng.uniform(0.05, 0.12))
        levels = (low + rail / 2, high - rail / 2 - 0.02)
        for z in levels:
            builder.add(box((0.6 * post, width - post, rail), (x, 0, z)), material)
        if kind == "posts":
            size = (0.3 * post, width - post, levels[1] - levels[0])
            builder.add(box(size, (x, 0, sum(levels) / 2)), material)
        elif kind == "slats":
            for y in np.linspace(-half + post, half - post, max(4, round(width / 0.14)))[1:-1]:
                builder.add(bar((x, y, levels[0]), (x, y, levels[1]), 0.05, 0.015), material)
        else:
            for z in np.linspace(*levels, int(rng.integers(3, 6)))[1:-1]:
                builder.add(box((0.02, width - post, 0.06), (x, 0, z)), material)
    if kind in ("plain", "arch") and low > 0.02:
        for y in (-0.8 * half, 0.8 * half):
            builder.add(box((0.8 * thick, 0.06, low + 0.02), (x, y, low / 2 + 0.01)), material)
