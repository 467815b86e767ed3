"""Sinks: pedestal, wall-hung, vanity, kitchen, vessel bowl, corner, utility. The wall is at -X."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np

from composenet.records import Symmetry
from composenet.synth.furniture.cases import Cell, add_base, add_case, opened, random_look, splits
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
from composenet.synth.furniture.sanitary import add_tap, basin
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


def _top_with_bowl(
    rng: Rng,
    size: tuple[float, float, float],
    z: float,
    bowls: list[tuple[float, float]],
    deep: float,
    power: float,
) -> tuple[Solid, list[Solid], list[Solid]]:
    """A counter slab of `size` whose top is at z with bowls (centre y, width) sunk into it.
    Returns the slab with its holes, the bowls, and what they displace in a case below."""
    depth, width, thick = size
    front, back = float(rng.uniform(0.04, 0.08)), float(rng.uniform(0.1, 0.16))
    x0, x1 = back - depth / 2, depth / 2 - front
    slab = box((depth, width, thick), (0, 0, z - thick / 2))
    vessels, cuts = [], []
    for y, bowl_width in bowls:
        hole = oval(x1 - x0, bowl_width, power, 24, ((x0 + x1) / 2, y))
        centre = np.array([(x0 + x1) / 2, y])
        slab = slab - loft_z([hole, hole], [z - thick - 1, z + 1])
        outer = (hole - centre) * 1.05 + centre
        shrunk = (hole - centre) * 0.8 + centre
        wall = (hole - centre) * 0.76 + centre
        cuts.append(loft_z([wall, hole, hole], [z - deep + 0.008, z - 0.5 * deep, z + 0.1]))
        vessels.append(
            basin(
                [
                    (shrunk, z - deep),
                    (outer, z - 0.5 * deep),
                    (outer, z + 0.004),
                    ((hole - centre) * 0.97 + centre, z + 0.004),
                    ((hole - centre) * 0.95 + centre, z - 0.5 * deep),
                    ((hole - centre) * 0.72 + centre, z - deep + 0.015),
                ]
            )
        )
    return slab, vessels, cuts


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
    roll, fittings, low = rng.random(), metal(rng), rim - thick
    if roll < 0.35:  # waste pipe into the floor
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
    return _finish(builder, "wall_hung")


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
    slab, vessels, cuts = _top_with_bowl(rng, size, height, places, 0.15, power)
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
    builder, look = ShapeBuilder(), random_look(rng)
    width, depth = float(rng.uniform(0.6, 1.6)), float(rng.uniform(0.52, 0.65))
    height, thick = float(rng.uniform(0.84, 0.94)), float(rng.uniform(0.025, 0.045))
    kick = float(rng.uniform(0.08, 0.14))
    edges = splits(rng, -width / 2, width / 2, max(1, round(width / 0.5)))
    cells = [
        Cell(y0, y1, kick, height - thick, "left" if index % 2 else "right", opened(rng, 0.1), 1)
        for index, (y0, y1) in enumerate(pairwise(edges))
    ]
    add_base(builder, rng, "plinth", depth - 0.02, width, kick, look.body)
    double = width > 0.95 and chance(rng, 0.45)
    bowl = (
        float(rng.uniform(0.34, 0.42))
        if double
        else min(0.75 * width, float(rng.uniform(0.4, 0.7)))
    )
    offset = 0.0 if double else float(rng.uniform(-0.5, 0.5)) * (0.9 * width - bowl)
    ys = (-0.55 * bowl, 0.55 * bowl) if double else (offset,)
    places = [(y, bowl) for y in ys]
    size = (depth, width, thick)
    power = float(rng.uniform(5, 14))
    slab, vessels, cuts = _top_with_bowl(rng, size, height, places, 0.19, power)
    top = stone(rng) if chance(rng, 0.5) else wood(rng)
    builder.add(slab, top)
    low, high = (-depth / 2, -width / 2, kick), (depth / 2 - 0.03, width / 2, height - thick)
    add_case(builder, look, low, high, cells, cuts)
    steel = metal(rng) if chance(rng, 0.75) else ceramic(rng)
    for part in vessels:
        builder.add(part, steel)
    side = 1.0 if offset <= 0 else -1.0
    room = width / 2 - abs(offset) - bowl / 2 if not double else 0.0
    if width / 2 - side * offset - bowl / 2 > 0.3 and room > 0.0 and chance(rng, 0.6):
        for x in np.linspace(-0.3, 0.3, 6) * depth:
            start = offset + side * (bowl / 2 + 0.05)
            rib = box((0.012, 0.22, 0.008), (x, start + side * 0.11, height + 0.002))
            builder.add(rib, steel)
    foot = (0.06 - depth / 2, float(np.mean(ys)), height)
    add_tap(builder, rng, foot, (1, 0), float(rng.uniform(0.18, 0.38)), 0.2, metal(rng))
    if chance(rng, 0.3):
        builder.add(box((0.02, width, 0.12), (0.01 - depth / 2, 0, height + 0.06)), top)
    return _finish(builder, "kitchen")


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
