"""Fitted kitchens: base units, sink units, basins let into a worktop, wall cupboards.

All units of one kitchen share a KitchenStyle, so that they stand flush side by side.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from composenet.records import Symmetry
from composenet.synth.furniture.cabinet_parts import door, finish, pairs, stacked_drawers
from composenet.synth.furniture.cases import (
    Cell,
    Look,
    add_base,
    add_case,
    opened,
    random_look,
    splits,
)
from composenet.synth.furniture.parts import (
    Rng,
    box,
    ceramic,
    chance,
    loft_z,
    metal,
    oval,
    rounded_box,
    stone,
    wood,
)
from composenet.synth.furniture.sanitary import add_tap, basin, top_with_bowl
from composenet.synth.shape import Material, Shape, ShapeBuilder


@dataclass(frozen=True)
class KitchenStyle:
    """Metres. height: of the worktop's upper side, top_m thick; kick: of the plinth; overhang:
    of the worktop over the fronts. hang_m, tall_m, wall_depth_m: where and how large wall
    cupboards are."""

    look: Look
    top: Material
    depth: float
    height: float
    kick: float
    top_m: float
    overhang: float
    hang_m: float
    tall_m: float
    wall_depth_m: float


def random_style(rng: Rng) -> KitchenStyle:
    """What one kitchen's units have in common."""
    return KitchenStyle(
        look=random_look(rng),
        top=stone(rng) if chance(rng, 0.6) else wood(rng),
        depth=float(rng.uniform(0.52, 0.66)),
        height=float(rng.uniform(0.82, 0.96)),
        kick=float(rng.uniform(0.07, 0.17)),
        top_m=float(rng.uniform(0.018, 0.045)),
        overhang=float(rng.uniform(0.0, 0.04)),
        hang_m=float(rng.uniform(1.3, 1.5)),
        tall_m=float(rng.uniform(0.45, 0.9)),
        wall_depth_m=float(rng.uniform(0.28, 0.38)),
    )


def base_unit(rng: Rng, style: KitchenStyle, width: float) -> Shape:
    """A cabinet below a worktop: doors and drawers."""
    builder = ShapeBuilder()
    _add_case(builder, rng, style, width, _cells(rng, style, width))
    _add_worktop(builder, style, width)
    return finish(builder, "kitchen_base")


def sink_unit(rng: Rng, style: KitchenStyle, width: float) -> Shape:
    """A sink with all of its unit: one or two bowls, often a drainer, a high tap."""
    builder = ShapeBuilder()
    double = width > 0.95 and chance(rng, 0.45)
    bowl = float(
        rng.uniform(0.34, 0.42) if double else min(0.75 * width, float(rng.uniform(0.4, 0.7)))
    )
    offset = 0.0 if double else float(rng.uniform(-0.5, 0.5)) * (0.9 * width - bowl)
    ys = (-0.55 * bowl, 0.55 * bowl) if double else (offset,)
    size = (style.depth + style.overhang, width, style.top_m)
    slab, vessels, cuts = top_with_bowl(
        rng, size, style.height, [(y, bowl) for y in ys], 0.19, float(rng.uniform(5, 14))
    )
    shift = (style.overhang / 2, 0, 0)
    builder.add(slab.translate(shift), style.top)
    cells = _cells(rng, style, width, drawers=False)
    _add_case(builder, rng, style, width, cells, [cut.translate(shift) for cut in cuts])
    steel = metal(rng) if chance(rng, 0.75) else ceramic(rng)
    for part in vessels:
        builder.add(part.translate(shift), steel)
    side = 1.0 if offset <= 0 else -1.0
    start = offset + side * (bowl / 2 + 0.05)
    if not double and width / 2 - side * start > 0.26 and chance(rng, 0.6):
        for x in np.linspace(-0.3, 0.3, 6) * style.depth:
            at = (x, start + side * 0.11, style.height + 0.002)
            builder.add(box((0.012, 0.22, 0.008), at), steel)
    foot = (0.06 - style.depth / 2, float(np.mean(ys)), style.height)
    add_tap(builder, rng, foot, (1, 0), float(rng.uniform(0.18, 0.38)), 0.2, metal(rng))
    if chance(rng, 0.2):
        at = (0.01 - style.depth / 2, 0, style.height + 0.06)
        builder.add(box((0.02, width, 0.12), at), style.top)
    return builder.build("sink", "kitchen", Symmetry.NONE)


def inset_sink(
    rng: Rng, style: KitchenStyle, width: float
) -> tuple[Shape, Shape, tuple[float, float, float]]:
    """A cabinet with a hole in its worktop and the sink let into it, two objects that do not
    meet. Third: the sink's centre from the cabinet's, in object axes."""
    x0, x1 = 0.13 - style.depth / 2, style.depth / 2 - float(rng.uniform(0.05, 0.09))
    bowl = float(min(rng.uniform(0.36, 0.75), width - 0.14))
    y = float(rng.uniform(-0.5, 0.5)) * (width - bowl - 0.1)
    deep, power = float(rng.uniform(0.14, 0.22)), float(rng.choice([2.2, 6.0, 10.0, 16.0]))
    middle = np.array([(x0 + x1) / 2, y])
    hole = oval(x1 - x0, bowl, power, 24)
    top, low = style.height, style.height - deep

    unit = ShapeBuilder()
    gap = loft_z([hole * 1.01 + middle] * 2, [low - 0.01, top + 0.1])
    _add_case(unit, rng, style, width, _cells(rng, style, width, drawers=False), [gap])
    unit.add(_worktop(style, width) - gap, style.top)

    sink, steel = ShapeBuilder(), metal(rng) if chance(rng, 0.8) else ceramic(rng)
    skin = [(0.9, low), (0.995, low + 0.05), (0.995, top + 0.003), (0.96, top + 0.003),
            (0.96, low + 0.055), (0.86, low + 0.006)]  # fmt: skip
    sink.add(basin([(hole * k + middle, z) for k, z in skin]), steel)
    _add_rim(sink, rng, style, width, (x0, x1, y, bowl), gap, steel)
    foot = (0.07 - style.depth / 2, y, top + 0.003)
    add_tap(sink, rng, foot, (1, 0), float(rng.uniform(0.15, 0.36)), 0.18, metal(rng))
    between = sink.bounds.mean(axis=0) - unit.bounds.mean(axis=0)
    return (
        finish(unit, "sink_base"),
        sink.build("sink", "inset", Symmetry.NONE),
        (float(between[0]), float(between[1]), float(between[2])),
    )


def wall_cupboard(rng: Rng, style: KitchenStyle, width: float) -> Shape:
    """A cupboard that hangs above the worktop."""
    builder, look = ShapeBuilder(), style.look
    if chance(rng, 0.15):
        look = replace(look, front="glass")
    cells: list[Cell] = []
    for y0, y1 in pairs(splits(rng, -width / 2, width / 2, max(1, round(width / 0.6)))):
        if chance(rng, 0.12):
            cells.append(Cell(y0, y1, 0.0, style.tall_m, "open", shelves=int(rng.integers(1, 3))))
        else:
            cells.append(door(rng, y0, y1, 0.0, style.tall_m, 2))
    half = style.wall_depth_m / 2
    add_case(builder, look, (-half, -width / 2, 0), (half, width / 2, style.tall_m), cells)
    return builder.build("cabinet", "wall_cupboard", Symmetry.NONE, mount_m=style.hang_m)


def _cells(rng: Rng, style: KitchenStyle, width: float, drawers: bool = True) -> list[Cell]:
    cells: list[Cell] = []
    low, high = style.kick, style.height - style.top_m
    for y0, y1 in pairs(splits(rng, -width / 2, width / 2, max(1, round(width / 0.55)), 0.1)):
        kind = rng.random() if drawers else 1.0
        if kind < 0.3:
            cells += stacked_drawers(rng, y0, y1, low, high, int(rng.integers(3, 5)))
        elif kind < 0.6:
            split = high - float(rng.uniform(0.13, 0.2))
            cells += [
                door(rng, y0, y1, low, split),
                *stacked_drawers(rng, y0, y1, split, high, 1),
            ]
        elif drawers:
            cells.append(door(rng, y0, y1, low, high))
        else:  # the bowl takes the room that an open door would show
            hinge = str(rng.choice(["left", "right"]))
            cells.append(Cell(y0, y1, low, high, hinge, opened(rng, 0.04), 1))
    return cells


def _add_case(builder, rng, style, width, cells, cuts=()) -> None:  # type: ignore[no-untyped-def]
    """Plinth and carcass, without the worktop."""
    add_base(builder, rng, "plinth", style.depth, width, style.kick, style.look.body)
    low = (-style.depth / 2, -width / 2, style.kick)
    high = (style.depth / 2, width / 2, style.height - style.top_m)
    add_case(builder, style.look, low, high, cells, cuts)


def _worktop(style: KitchenStyle, width: float):  # type: ignore[no-untyped-def]
    size = (style.depth + style.overhang, width, style.top_m)
    return box(size, (style.overhang / 2, 0, style.height - style.top_m / 2))


def _add_worktop(builder: ShapeBuilder, style: KitchenStyle, width: float) -> None:
    builder.add(_worktop(style, width), style.top)


def _add_rim(builder, rng, style, width, bowl, gap, steel) -> None:  # type: ignore[no-untyped-def]
    """A thin plate round the bowl (x0, x1, y, width), lying on the worktop, often with a
    drainer to one side."""
    x0, x1, y, wide = bowl
    left, right = y - wide / 2 - 0.03, y + wide / 2 + 0.03
    room_left, room_right = left + width / 2, width / 2 - right
    if max(room_left, room_right) > 0.25 and chance(rng, 0.7):
        reach = min(0.5, max(room_left, room_right) - 0.02)
        left, right = (left - reach, right) if room_left > room_right else (left, right + reach)
        drainer = left + reach / 2 if room_left > room_right else right - reach / 2
        for x in np.linspace(x0 + 0.05, x1 - 0.05, 7):
            at = (x, drainer, style.height + 0.009)
            builder.add(box((0.012, 0.8 * reach, 0.008), at), steel)
    deep = x1 - x0 + 0.14
    centre = (x1 + 0.03 - deep / 2, (left + right) / 2, style.height + 0.003)
    plate = rounded_box((deep, right - left, 0.005), centre, 0.002)
    builder.add(plate - gap, steel)
