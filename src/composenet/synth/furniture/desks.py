"""Desks: wide along Y; the sitter's side, where drawers open, is +X."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from composenet.records import Symmetry
from composenet.synth.furniture.chair_parts import add_all, legs_between
from composenet.synth.furniture.desk_parts import (
    Desk,
    desk_top,
    draw_desk,
    drawer_pedestal,
    drawers,
    leg_frame,
    modesty,
    pencil_drawers,
)
from composenet.synth.furniture.parts import (
    Rng,
    box,
    box_between,
    carcass,
    chance,
    cylinder,
    extrude,
    extrude_y,
    metal,
    paint,
    wood,
)
from composenet.synth.shape import Shape, ShapeBuilder


def _single(rng: Rng) -> Shape:
    """Drawers under one end, legs or a panel under the other."""
    builder, d, body = ShapeBuilder(), draw_desk(rng), carcass(rng)
    side = int(rng.choice([-1, 1]))
    builder.add(desk_top(d, rng), body if chance(rng, 0.5) else carcass(rng))
    raised = rng.choice([0.0, rng.uniform(0.03, 0.12), rng.uniform(0.35, 0.5)])
    drawer_pedestal(rng, builder, d, side, body, raised)
    legs = wood(rng) if chance(rng, 0.3) else body
    add_all(builder, leg_frame(rng, d, (-side,) if raised == 0.0 else (-1, 1)), legs)
    if chance(rng, 0.5):
        builder.add(modesty(rng, d), body)
    return builder.build("desk", "single_pedestal", Symmetry.NONE)


def _double(rng: Rng) -> Shape:
    """Drawers under both ends."""
    builder, d, body = ShapeBuilder(), draw_desk(rng), carcass(rng)
    d = Desk(d.deep, max(d.wide, rng.uniform(1.3, 1.9)), d.height, d.thick)
    builder.add(desk_top(d, rng), body if chance(rng, 0.6) else carcass(rng))
    raised = rng.choice([0.0, rng.uniform(0.03, 0.15)])
    for side in (-1, 1):
        drawer_pedestal(rng, builder, d, side, body, raised)
    if raised > 0:
        add_all(builder, leg_frame(rng, d), body)
    if chance(rng, 0.7):
        builder.add(modesty(rng, d), body)
    if chance(rng, 0.4):
        inner = Desk(d.deep, d.wide * 0.55, d.height, d.thick)
        pencil_drawers(rng, builder, inner, body)
    return builder.build("desk", "double_pedestal", Symmetry.NONE)


def _writing(rng: Rng) -> Shape:
    """A writing table with flat drawers and free legs, often a gallery behind."""
    builder, d, body = ShapeBuilder(), draw_desk(rng), carcass(rng)
    builder.add(desk_top(d, rng), body)
    pencil_drawers(rng, builder, d, body)
    add_all(builder, leg_frame(rng, d), body if chance(rng, 0.6) else metal(rng))
    if chance(rng, 0.5):
        tall = rng.uniform(0.06, 0.16)
        builder.add(box((0.02, d.wide, tall), (-d.deep / 2 + 0.01, 0, d.height + tall / 2)), body)
    return builder.build("desk", "writing", Symmetry.NONE)


def _modesty_panel(rng: Rng) -> Shape:
    """An office desk: top, end frames, panel."""
    builder, d, body = ShapeBuilder(), draw_desk(rng), carcass(rng)
    builder.add(desk_top(d, rng), carcass(rng))
    add_all(builder, leg_frame(rng, d), body if chance(rng, 0.5) else metal(rng))
    builder.add(modesty(rng, d), body)
    if chance(rng, 0.4):  # a screen above the back edge
        tall = rng.uniform(0.3, 0.45)
        builder.add(
            box((0.03, d.wide * 0.97, tall), (-d.deep / 2, 0, d.height + tall / 2)), paint(rng)
        )
    if chance(rng, 0.4):
        drawer_pedestal(rng, builder, d, int(rng.choice([-1, 1])), body, 0.04)
    return builder.build("desk", "modesty_panel", Symmetry.NONE)


def _hutch(rng: Rng) -> Shape:
    """Shelves and pigeon holes above the back of the top."""
    builder, d, body = ShapeBuilder(), draw_desk(rng), carcass(rng)
    builder.add(desk_top(d, rng), body)
    side = int(rng.choice([-1, 1]))
    if chance(rng, 0.6):
        drawer_pedestal(rng, builder, d, side, body, 0.0)
        add_all(builder, leg_frame(rng, d, (-side,)), body)
    else:
        add_all(builder, leg_frame(rng, d), body)
    tall, deep, board = rng.uniform(0.25, 0.75), rng.uniform(0.18, 0.3), rng.uniform(0.015, 0.025)
    rear, wide = -d.deep / 2, d.wide * rng.choice([1.0, 1.0, rng.uniform(0.5, 0.9)])
    x, top = rear + deep / 2, d.height + tall
    cells = int(rng.integers(1, 5))
    for y in np.linspace(-wide / 2 + board / 2, wide / 2 - board / 2, cells + 1):
        builder.add(box_between((rear, y - board / 2, d.height - 0.002),
                                (rear + deep, y + board / 2, top)), body)  # fmt: skip
    for z in np.linspace(d.height, top, int(rng.integers(2, 4)))[1:]:
        builder.add(box((deep, wide, board), (x, 0, z - board / 2)), body)
    if chance(rng, 0.6):
        builder.add(box((0.012, wide, tall), (rear + 0.006, 0, d.height + tall / 2)), body)
    if chance(rng, 0.5):
        builder.add(modesty(rng, d), body)
    return builder.build("desk", "hutch", Symmetry.NONE)


def _monitor_shelf(rng: Rng) -> Shape:
    """A computer desk: a raised shelf for the screen, often a keyboard tray."""
    builder, d, body = ShapeBuilder(), draw_desk(rng), carcass(rng)
    builder.add(desk_top(d, rng), body)
    frame = metal(rng) if chance(rng, 0.5) else body
    add_all(builder, leg_frame(rng, d), frame)
    wide, deep, lift = d.wide * rng.uniform(0.45, 1.0), rng.uniform(0.2, 0.3), rng.uniform(0.1, 0.2)
    x = -d.deep / 2 + deep / 2
    builder.add(box((deep, wide, 0.02), (x, 0, d.height + lift)), body)
    for y in (-0.46 * wide, 0.46 * wide):
        builder.add(box((deep * 0.9, 0.02, lift), (x, y, d.height + lift / 2)), frame)
    if chance(rng, 0.6):
        size = (d.deep * 0.5, d.wide * rng.uniform(0.45, 0.8), 0.018)
        z = d.under - 0.09
        builder.add(box(size, (d.deep * 0.2 + rng.uniform(0, 0.12), 0, z)), body)
        for y in (-size[1] / 2, size[1] / 2):
            builder.add(
                box((size[0] * 0.8, 0.016, 0.1), (d.deep * 0.18, y, d.under - 0.045)), frame
            )
    if chance(rng, 0.5):
        builder.add(modesty(rng, d), body)
    if chance(rng, 0.4):
        z = rng.uniform(0.08, 0.2)
        builder.add(box((d.deep * 0.6, d.wide * 0.94, 0.02), (-d.deep * 0.15, 0, z)), body)
    return builder.build("desk", "monitor_shelf", Symmetry.NONE)


def _corner(rng: Rng) -> Shape:
    """L-shaped; the wing runs towards the sitter at one end, its inner corner often cut."""
    builder, d, body = ShapeBuilder(), draw_desk(rng), carcass(rng)
    d = Desk(rng.uniform(0.5, 0.75), rng.uniform(1.3, 1.9), d.height, d.thick)
    side, wing, broad = int(rng.choice([-1, 1])), rng.uniform(0.5, 1.1), rng.uniform(0.45, 0.65)
    x, y = d.deep / 2, d.wide / 2
    inner = y - broad
    cut = rng.choice([0.0, rng.uniform(0.1, 0.35)])
    outline = np.array([(-x, -y), (x, -y), (x, inner - cut), (x + cut, inner), (x + wing, inner),
                        (x + wing, y), (-x, y)])  # fmt: skip
    if side < 0:
        outline = outline[::-1] * (1, -1)
    builder.add(extrude(outline, d.thick, d.under), body)
    frame = metal(rng) if chance(rng, 0.4) else body
    far = (x + wing - 0.06, side * (inner + 0.04)), (x + wing - 0.06, side * (y - 0.04))
    near = (-x + 0.05, -side * (y - 0.04)), (x - 0.05, -side * (y - 0.04))
    if chance(rng, 0.5):
        for spot in (*far, *near, (-x + 0.05, side * (y - 0.05))):
            builder.add(cylinder(rng.uniform(0.024, 0.028), d.under, (*spot, 0), 10), frame)
    else:
        thick = rng.uniform(0.018, 0.03)
        builder.add(box((thick, broad - 0.04, d.under),
                        (x + wing - 0.04, side * (inner + y) / 2, d.under / 2)), body)  # fmt: skip
        builder.add(
            box((d.deep - 0.04, thick, d.under), (0, -side * (y - 0.03), d.under / 2)), body
        )
        builder.add(box((thick, broad * 0.6, d.under),
                        (-x + 0.03, side * (y - broad * 0.3), d.under / 2)), body)  # fmt: skip
    if chance(rng, 0.5):
        drawer_pedestal(rng, builder, d, -side, body, 0.0)
    if chance(rng, 0.6):
        builder.add(modesty(rng, d), body)
    if chance(rng, 0.35):
        deep, tall = 0.24, rng.uniform(0.25, 0.5)
        for at in (-y + 0.02, 0.0, y - 0.02):
            builder.add(box((deep, 0.02, tall), (-x + deep / 2, at, d.height + tall / 2)), body)
        builder.add(box((deep, d.wide, 0.02), (-x + deep / 2, 0, d.height + tall)), body)
    return builder.build("desk", "corner", Symmetry.NONE)


def _standing(rng: Rng) -> Shape:
    """Height-adjustable: two T-shaped legs, a cross beam, a control under the front edge."""
    builder, d = ShapeBuilder(), draw_desk(rng)
    height = rng.uniform(0.68, 1.2)
    d = Desk(rng.uniform(0.6, 0.85), rng.uniform(1.1, 1.8), height, rng.uniform(0.02, 0.035))
    steel = metal(rng) if chance(rng, 0.6) else paint(rng)
    builder.add(desk_top(d, rng), carcass(rng))
    y, size, back = d.wide * rng.uniform(0.32, 0.42), rng.uniform(0.05, 0.08), rng.uniform(0, 0.1)
    for side in (y, -y):
        builder.add(box((d.deep * rng.uniform(0.8, 0.95), size, 0.03), (0, side, 0.015)), steel)
        builder.add(box((size, size * 0.7, d.under * 0.6), (-back, side, d.under * 0.3)), steel)
        builder.add(box((size * 0.75, size * 0.5, d.under), (-back, side, d.under / 2)), steel)
        builder.add(box((d.deep * 0.8, size * 0.7, 0.03), (0, side, d.under - 0.013)), steel)
    z = d.under - 0.04 if chance(rng, 0.6) else d.under * 0.45
    builder.add(box((0.04, 2 * y, 0.06), (-back, 0, z)), steel)
    spot = (d.deep / 2 - 0.03, rng.choice([-1, 1]) * d.wide * 0.35, d.under - 0.01)
    builder.add(box((0.05, 0.12, 0.022), spot), paint(rng))
    builder.add(box((0.12, d.wide * 0.5, 0.06), (-d.deep / 2 + 0.08, 0, d.under - 0.03)), steel)
    return builder.build("desk", "standing", Symmetry.NONE)


def _secretary(rng: Rng) -> Shape:
    """Drawers below, a fall front in the middle, a case with compartments above."""
    builder, body = ShapeBuilder(), wood(rng) if chance(rng, 0.75) else carcass(rng)
    deep, wide = rng.uniform(0.38, 0.55), rng.uniform(0.7, 1.1)
    height, top = rng.uniform(0.7, 0.78), rng.uniform(1.0, 1.4)
    x, y, board = deep / 2, wide / 2, 0.022
    slope = rng.uniform(0.1, 0.6) * deep
    for side in (-1, 1):
        profile = [
            (-x, height - 0.1),
            (x, height - 0.1),
            (x, height + 0.02),
            (x - slope, top),
            (-x, top),
        ]
        builder.add(extrude_y(profile, board, side * (y - board / 2)), body)
    builder.add(box((deep - slope, wide, board), (-slope / 2, 0, top)), body)
    builder.add(
        box((0.015, wide, top - height + 0.1), (-x + 0.008, 0, (top + height) / 2 - 0.05)), body
    )
    builder.add(box((deep, wide, board), (0, 0, height - board / 2)), body)
    for at in np.linspace(-y, y, int(rng.integers(3, 7)))[1:-1]:
        builder.add(box((deep * 0.35, 0.012, (top - height) * 0.9),
                        (-x + deep * 0.18, at, (top + height) / 2)), body)  # fmt: skip
    z = rng.uniform(0.35, 0.65) * (top - height) + height
    builder.add(box((deep * 0.35, wide, 0.014), (-x + deep * 0.18, 0, z)), body)
    reach = rng.uniform(0.25, 0.4)  # the open flap
    builder.add(box((reach, wide - 0.05, 0.02), (x + reach / 2, 0, height - 0.012)), body)
    if chance(rng, 0.55):
        low = 0.0 if chance(rng, 0.5) else rng.uniform(0.08, 0.15)
        drawers(
            rng, builder, (-x, -y, low), (x - 0.02, y, height - 0.02), body, int(rng.integers(2, 5))
        )
    else:
        drawers(rng, builder, (-x, -y, height - 0.13), (x - 0.02, y, height - 0.02), body, 1)
        low = rng.uniform(0.0, 0.1)
    feet = np.array([(a, b, 0) for a in (x - 0.05, -x + 0.04) for b in (y - 0.03, -y + 0.03)])
    high = feet + np.array([0, 0, height - 0.1])
    add_all(builder, legs_between(feet, high, 0.045, rng.uniform(0.5, 1), 4), body)
    return builder.build("desk", "secretary", Symmetry.NONE)


STYLES: dict[str, dict[str, Callable[[Rng], Shape]]] = {
    "desk": {
        "single_pedestal": _single,
        "double_pedestal": _double,
        "writing": _writing,
        "modesty_panel": _modesty_panel,
        "hutch": _hutch,
        "monitor_shelf": _monitor_shelf,
        "corner": _corner,
        "standing": _standing,
        "secretary": _secretary,
    }
}
