"""Sinks: pedestal, wall-hung, vanity, kitchen, vessel bowl, corner, utility. The wall is at -X."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np

from composenet.records import Symmetry
from composenet.synth.furniture.cases import Cell, add_base, add_case, opened, random_look, splits
from composenet.synth.furniture.kitchen_units import random_style, sink_unit
from composenet.synth.furniture.parts import (
    Rng,
    Solid,
    bar,
    box,
    box_between,
    ceramic,
    chance,
    cylinder,
    glass,
    loft_z,
    metal,
    oval,
    rod,
    rounded_box,
    stone,
    tube,
    wood,
)
from composenet.synth.furniture.sanitary import add_tap, basin, top_with_bowl
from composenet.synth.shape import Material, Shape, ShapeBuilder


def _finish(builder: ShapeBuilder, style: str) -> Shape:
    return builder.build("sink", style, Symmetry.NONE)


def _washbasin(
    rng: Rng, depth: float, width: float, rim: float, thick: float, power: float
) -> tuple[Solid, float]:
    """A hanging basin with a shelf at the back for the tap; returns it and that shelf's x."""
    outer = oval(depth, width, power, 28)
    outer[:, 0] = np.where(
        outer[:, 0] < 0, -depth / 2 * np.abs(outer[:, 0] * 2 / depth) ** 0.3, outer[:, 0]
    )
    ledge, wall = float(rng.uniform(0.08, 0.14)), float(rng.uniform(0.02, 0.045))
    inner = oval(depth - wall - ledge, width - 2 * wall, power, 28)
    inner = inner * (1.0, float(rng.uniform(0.85, 1.0))) + np.array([(ledge - wall) / 2, 0])
    middle = np.array([(ledge - wall) / 2, 0.0])
    under = float(rng.uniform(0.45, 0.75))
    bottom = outer * under - np.array([depth / 2 * (1 - under), 0])
    solid = basin(
        [
            (bottom, rim - thick),
            (outer, rim - 0.4 * thick),
            (outer, rim),
            (inner, rim),
            ((inner - middle) * 0.85 + middle, rim - 0.35 * thick),
            ((inner - middle) * 0.4 + middle, rim - 0.7 * thick),
        ]
    )
    return solid, ledge / 2 - depth / 2


def pedestal(rng: Rng) -> Shape:
    """A basin on a column of its own."""
    builder, body = ShapeBuilder(), ceramic(rng)
    depth, width = float(rng.uniform(0.38, 0.52)), float(rng.uniform(0.45, 0.72))
    rim, thick = float(rng.uniform(0.78, 0.9)), float(rng.uniform(0.16, 0.24))
    bowl, shelf = _washbasin(rng, depth, width, rim, thick, float(rng.choice([2.0, 2.4, 4.0, 8.0])))
    builder.add(bowl, body)
    across, power = float(rng.uniform(0.15, 0.24)), float(rng.uniform(2.0, 5.0))
    centre = (-0.12 * depth - 0.02, 0)
    sections = [
        oval(across * k, across * k, power, 20, centre) for k in (1.35, 1.25, 0.85, 0.95, 1.3)
    ]
    column = loft_z(sections, [0, 0.05, 0.16, 0.6 * rim, rim - 0.8 * thick])
    builder.add(column, body)
    add_tap(builder, rng, (shelf, 0, rim), (1, 0), float(rng.uniform(0.08, 0.2)), 0.12, metal(rng))
    return _finish(builder, "pedestal")


def wall_hung(rng: Rng) -> Shape:
    """A basin without a column: on a wall frame, on console legs, or with its pipe below."""
    builder, body = ShapeBuilder(), ceramic(rng)
    depth, width = float(rng.uniform(0.28, 0.52)), float(rng.uniform(0.38, 0.9))
    thick, rim = float(rng.uniform(0.12, 0.22)), float(rng.uniform(0.78, 0.9))
    power = float(rng.choice([rng.uniform(2.0, 2.6), rng.uniform(3.0, 12.0)]))
    bowl, shelf = _washbasin(rng, depth, width, rim, thick, power)
    builder.add(bowl, body)
    roll, fittings, low, mount_m = rng.random(), metal(rng), rim - thick, 0.0
    if roll < 0.2:
        mount_m = low
    elif roll < 0.4:  # waste pipe into the floor
        builder.add(cylinder(0.035, 0.14, (0, 0, low - 0.2), 12), fittings)
        x = float(rng.uniform(-0.4, -0.2)) * depth
        pipe = [(0, 0, low + 0.02), (0, 0, low - 0.12), (x, 0, low - 0.12), (x, 0, 0)]
        builder.add(tube(pipe, 0.018), fittings)
    elif roll < 0.7:  # boxed-in frame behind
        thick_wall, wide = float(rng.uniform(0.05, 0.14)), width * float(rng.uniform(0.9, 1.6))
        high = rim + float(rng.uniform(0.1, 0.4))
        wall = box((thick_wall, wide, high), (-(depth + thick_wall) / 2, 0, high / 2))
        builder.add(wall, stone(rng) if chance(rng, 0.5) else wood(rng))
        if chance(rng, 0.5):
            outlines = [oval(0.2, w, 3.0, 16, (0.1 - depth / 2, 0)) for w in (0.1, 0.16, 0.2)]
            levels = [low - 0.28, rim - 0.7 * thick - 0.1, rim - 0.6 * thick]
            builder.add(loft_z(outlines, levels), body)
    else:  # console legs
        leg = float(rng.uniform(0.01, 0.02))
        for x in (-0.4 * depth, 0.35 * depth):
            for y in (-0.4 * width, 0.4 * width):
                builder.add(rod((x, y, 0), (x, y, rim - 0.3 * thick), leg), fittings)
    add_tap(builder, rng, (shelf, 0, rim), (1, 0), float(rng.uniform(0.08, 0.18)), 0.12, fittings)
    return builder.build("sink", "wall_hung", Symmetry.NONE, mount_m)


def vanity(rng: Rng) -> Shape:
    """Bathroom cabinet with one or two basins sunk into its top."""
    builder, look = (
        ShapeBuilder(),
        replace(random_look(rng), front=str(rng.choice(["flat", "frame"]))),
    )
    double = chance(rng, 0.25)
    width = float(rng.uniform(1.15, 1.6) if double else rng.uniform(0.5, 1.1))
    depth, height = float(rng.uniform(0.42, 0.56)), float(rng.uniform(0.76, 0.9))
    kind = str(rng.choice(["plinth", "legs", "bracket", "none"]))
    base = {"plinth": 0.09, "none": 0.0}.get(kind, float(rng.uniform(0.1, 0.25)))
    thick = float(rng.uniform(0.02, 0.06))
    case_top = height - thick
    cells: list[Cell] = []
    count = max(1, round(width / 0.45))
    edges = splits(rng, -width / 2, width / 2, count)
    drawers = chance(rng, 0.4)
    for y0, y1 in pairwise(edges):
        if drawers:
            middle = (base + case_top) / 2
            cells += [
                Cell(y0, y1, base, middle, "drawer"),
                Cell(y0, y1, middle, case_top, "drawer"),
            ]
        else:
            hinge = str(rng.choice(["left", "right"]))
            cells.append(Cell(y0, y1, base, case_top, hinge, opened(rng, 0.08), 1))
    add_base(builder, rng, kind, depth - 0.02, width - 0.02, base, look.body)
    top = ceramic(rng) if chance(rng, 0.6) else stone(rng)
    ys = (-width / 4, width / 4) if double else (0.0,)
    bowl_width = min(float(rng.uniform(0.38, 0.55)), 0.8 * width / len(ys))
    size = (depth, width + 0.02, thick)
    power = float(rng.uniform(2.0, 7.0))
    places = [(y, bowl_width) for y in ys]
    slab, vessels, cuts = top_with_bowl(rng, size, height, places, 0.15, power)
    builder.add(slab, top)
    low, high = (-depth / 2, -width / 2, base), (depth / 2 - 0.02, width / 2, case_top)
    add_case(builder, look, low, high, cells, cuts)
    white, fittings = ceramic(rng), metal(rng)
    for y, vessel in zip(ys, vessels, strict=True):
        builder.add(vessel, white)
        add_tap(builder, rng, (0.06 - depth / 2, y, height), (1, 0), 0.14, 0.13, fittings)
    if chance(rng, 0.3):
        splash = box((0.02, width, 0.1), (0.01 - depth / 2, 0, height + 0.05))
        builder.add(splash, top)
    if chance(rng, 0.12):
        pane = box((0.02, 0.8 * width, 0.7), (0.01 - depth / 2, 0, height + 0.65))
        builder.add(pane, glass(rng))
        builder.add(box((0.015, 0.7 * width, 1.0), (0.008 - depth / 2, 0, height + 0.4)), look.body)
    return _finish(builder, "vanity")


def kitchen(rng: Rng) -> Shape:
    """Steel or ceramic bowls in a worktop on base units, with a drainer and a high tap."""
    return sink_unit(rng, random_style(rng), float(rng.uniform(0.6, 1.6)))


def _bowl(rng: Rng, depth: float, width: float, z: float, high: float) -> Solid:
    power, foot = float(rng.choice([2.0, 2.0, 4.0, 12.0])), float(rng.uniform(0.45, 0.9))
    outer = oval(depth, width, power, 24)
    inner = outer * (1 - 0.03 / min(depth, width) * 2)
    return basin(
        [
            (outer * foot, z),
            (outer * (0.4 + 0.6 * foot), z + 0.35 * high),
            (outer, z + high),
            (inner, z + high),
            (inner * (0.4 + 0.6 * foot) * 0.97, z + 0.4 * high),
            (inner * foot * 0.8, z + 0.12 * high),
        ]
    )


def vessel(rng: Rng) -> Shape:
    """A bowl standing on a counter: on a cabinet, a console table, or a slab alone."""
    builder, look = ShapeBuilder(), random_look(rng)
    width, depth = float(rng.uniform(0.55, 1.3)), float(rng.uniform(0.42, 0.55))
    counter, thick = float(rng.uniform(0.68, 0.8)), float(rng.uniform(0.03, 0.08))
    top = stone(rng) if chance(rng, 0.4) else wood(rng)
    builder.add(rounded_box((depth, width, thick), (0, 0, counter - thick / 2), 0.006), top)
    kind = rng.random()
    if kind < 0.45:
        base = float(rng.choice([0.08, 0.25]))
        edges = splits(rng, -width / 2, width / 2, max(1, round(width / 0.5)))
        front = str(rng.choice(["drawer", "left"]))
        cells = [Cell(a, b, base, counter - thick, front) for a, b in pairwise(edges)]
        add_base(builder, rng, "legs" if base > 0.1 else "plinth", depth, width, base, look.body)
        low, high = (-depth / 2, -width / 2, base), (depth / 2 - 0.02, width / 2, counter - thick)
        add_case(builder, look, low, high, cells)
    elif kind < 0.8:
        leg, frame = float(rng.uniform(0.025, 0.05)), metal(rng) if chance(rng, 0.5) else top
        x, y = depth / 2 - leg, width / 2 - leg
        for side_x in (-x, x):
            for side_y in (-y, y):
                builder.add(
                    bar((side_x, side_y, 0), (side_x, side_y, counter - thick), leg, leg), frame
                )
        if chance(rng, 0.6):
            builder.add(box((depth - leg, width - leg, 0.025), (0, 0, 0.2)), top)
    else:  # gables
        size = (0.9 * depth, 0.05, counter - thick)
        for y in (0.03 - width / 2, width / 2 - 0.03):
            builder.add(box(size, (0, y, size[2] / 2)), look.body)
    size_x = depth - float(rng.uniform(0.1, 0.16))
    size_y = min(size_x * float(rng.uniform(1.0, 1.6)), 0.8 * width)
    shift = depth / 2 - size_x / 2 - 0.02
    bowl = _bowl(rng, size_x, size_y, counter, float(rng.uniform(0.1, 0.17)))
    builder.add(bowl.translate((shift, 0, 0)), ceramic(rng) if chance(rng, 0.75) else stone(rng))
    foot = (0.045 - depth / 2, 0.0, counter)
    add_tap(builder, rng, foot, (1, 0), float(rng.uniform(0.22, 0.32)), 0.15, metal(rng))
    return _finish(builder, "vessel")


def corner(rng: Rng) -> Shape:
    """A small basin between two walls, on the wall, a column or a cabinet."""
    builder, body = ShapeBuilder(), ceramic(rng)
    side, rim = float(rng.uniform(0.32, 0.5)), float(rng.uniform(0.8, 0.88))
    deep = float(rng.uniform(0.12, 0.18))
    angle = (np.arange(28) + 0.5) * 2 * np.pi / 28
    turned = angle - np.pi / 4  # the plan's own axes along the two walls
    reach = np.minimum(0.5 / np.maximum(np.abs(np.cos(turned)), np.abs(np.sin(turned))), 0.62)
    bulge = float(rng.uniform(0.5, 0.56))
    reach = np.where(
        np.abs((angle + np.pi) % (2 * np.pi) - np.pi) < 2.2, np.minimum(reach, bulge), reach
    )
    reach = np.where(np.abs(angle - np.pi) < 0.9, np.minimum(0.70, reach * 1.12), reach)
    outer = side * reach[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    inner = oval(0.62 * side, 0.74 * side, 2.2, 28, (0.08 * side, 0))
    centre = np.array([0.08 * side, 0.0])
    sections = [
        (outer * 0.6 - np.array([0.1 * side, 0]), rim - deep),
        (outer, rim - 0.4 * deep),
        (outer, rim),
        (inner, rim),
        ((inner - centre) * 0.5 + centre, rim - 0.75 * deep),
    ]
    builder.add(basin(sections), body)
    roll = rng.random()
    if roll < 0.4:
        builder.add(cylinder(0.07, rim - 0.7 * deep, (-0.1 * side, 0, 0), 16), body)
    else:
        case = outer * 0.85 - np.array([0.08 * side, 0])
        builder.add(loft_z([case, case], [0, rim - 0.8 * deep]), wood(rng))
    foot = (-0.45 * side, 0.0, rim)
    add_tap(builder, rng, foot, (1, 0), 0.12, 0.12, metal(rng))
    return _finish(builder, "corner")


def utility(rng: Rng) -> Shape:
    """Laundry or workshop trough on legs; a steel table with a bowl."""
    builder, fittings = ShapeBuilder(), metal(rng)
    body: Material = ceramic(rng) if chance(rng, 0.5) else metal(rng)
    width, depth = float(rng.uniform(0.45, 1.2)), float(rng.uniform(0.42, 0.62))
    rim, deep = float(rng.uniform(0.8, 0.92)), float(rng.uniform(0.2, 0.36))
    outer = oval(depth, width, 14.0, 28)
    inner = outer * (1 - 0.06 / depth, 1 - 0.06 / width)
    taper = float(rng.uniform(0.8, 1.0))
    rings = [
        (outer * taper, rim - deep),
        (outer, rim),
        (inner, rim),
        (inner * taper, rim - deep + 0.03),
    ]
    builder.add(basin(rings), body)
    x, y = 0.42 * depth * taper, 0.45 * width * taper
    leg = float(rng.uniform(0.012, 0.022))
    for side_x in (-x, x):
        for side_y in (-y, y):
            builder.add(
                rod((side_x, side_y, 0), (side_x, side_y, rim - deep + 0.02), leg), fittings
            )
    if chance(rng, 0.4):
        shelf = (2 * x, 2 * y, 0.02)
        builder.add(box(shelf, (0, 0, 0.2)), fittings)
    if chance(rng, 0.5):
        low = (-depth / 2, -width / 2, rim - 0.02)
        builder.add(box_between(low, (0.02 - depth / 2, width / 2, rim + 0.15)), body)
    foot = (0.02 - depth / 2, 0.0, rim)
    add_tap(builder, rng, foot, (1, 0), float(rng.uniform(0.15, 0.3)), 0.2, fittings)
    return _finish(builder, "utility")


STYLES: dict[str, dict[str, Callable[[Rng], Shape]]] = {
    "sink": {
        builder.__name__: builder
        for builder in (pedestal, wall_hung, vanity, kitchen, vessel, corner, utility)
    }
}
