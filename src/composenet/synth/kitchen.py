"""Fitted kitchens along one or two walls of a room."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from composenet.synth.collision import Item
from composenet.synth.furniture import make_furniture
from composenet.synth.furniture.kitchen_units import (
    KitchenStyle,
    base_unit,
    inset_sink,
    random_style,
    sink_unit,
    wall_cupboard,
)
from composenet.synth.placement import Layout
from composenet.synth.room import Wall
from composenet.synth.shape import Shape

_WIDEST_M = 1.5


def fit_kitchen(layout: Layout, make: Callable[[str], Shape], most: int) -> None:
    """Rows of base cabinets with a sink and appliances among them, flush along a wall and often
    round its corner, wall cupboards above. At most `most` pieces of furniture. Where meshes
    replace furniture, low ones of them stand in the row."""
    rng, walls, style = layout.rng, layout.room.walls, random_style(layout.rng)
    fitted = bool(rng.random() >= layout.cad_share)
    wall, start, end = _stretch(layout)
    corner = end > wall.length_m - 0.1 and rng.random() < 0.75
    hung = int(rng.integers(0, min(3, most))) if fitted else 0
    length = min(end - start, float(rng.uniform(1.8, 4.5)))
    start = end - length if corner else start + float(rng.uniform(0, 1)) * (end - start - length)
    before = len(layout.furniture)
    most_here = most - hung if not corner else -(-(most - hung) * 3 // 5)
    shapes, inset = _run(layout, make, style, length, most_here, True, fitted)
    _let_in(layout, layout.row(wall, start, shapes), shapes, inset)
    if corner and most_here < most - hung:
        other = walls[(walls.index(wall) + 1) % len(walls)]
        inwards = style.depth + 0.08
        length = min(other.length_m - inwards, float(rng.uniform(0.8, 3.0)))
        left = most - hung - (len(layout.furniture) - before)
        layout.row(other, inwards, _run(layout, make, style, length, left, False, fitted)[0])
    if hung:
        _hang(layout, style, wall, start, length, hung)


def _stretch(layout: Layout) -> tuple[Wall, float, float]:
    """A wall and where on it no door is, from and to; the longer the likelier."""
    stretches = []
    for wall in layout.room.walls:
        doors = sorted((o.start_m, o.end_m) for o in wall.openings if o.bottom_m == 0.0)
        edges = [0.01, *(e for low, high in doors for e in (low - 0.05, high + 0.05))]
        edges.append(wall.length_m - 0.01)
        stretches += [(wall, a, b) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    length = np.array([b - a for _, a, b in stretches]).clip(min=0.0) ** 3
    return stretches[int(layout.rng.choice(len(stretches), p=length / length.sum()))]


_Inset = tuple[Shape, Shape, tuple[float, float, float]]


def _run(
    layout: Layout,
    make: Callable[[str], Shape],
    style: KitchenStyle,
    length_m: float,
    most: int,
    with_sink: bool,
    fitted: bool,
) -> tuple[list[Shape], _Inset | None]:
    """What stands side by side on length_m: at most `most` pieces of furniture (a sink let into
    a cabinet is another one), appliances between."""
    rng = layout.rng
    inset: _Inset | None = None
    names = ("oven", "washing_machine", "refrigerator")
    kinds = [str(rng.choice(names)) for _ in range(int(rng.integers(0, 1 + (length_m > 2) * 2)))]
    pieces = [make_furniture("clutter", rng, kind) for kind in kinds]
    length_m -= sum(float(shape.extents_m[1]) for shape in pieces)
    if with_sink and most > 0 and length_m > 0.6:
        width = float(rng.uniform(0.6, min(1.4, length_m)))
        if not fitted:
            pieces.append(make("sink"))
        elif most > 1 and rng.random() < 0.65:
            inset = inset_sink(rng, style, width)
            pieces.append(inset[0])
            most -= 1
        else:
            pieces.append(sink_unit(rng, style, width))
        length_m -= float(pieces[-1].extents_m[1])
        most -= 1
    while most > 0 and length_m > 0.42:
        width = float(np.clip(length_m / most * rng.uniform(0.6, 1.1), 0.42, _WIDEST_M))
        width = min(width, length_m - 0.01)
        pieces.append(base_unit(rng, style, width) if fitted else _low(make))
        length_m -= float(pieces[-1].extents_m[1]) + 0.002
        most -= 1
    return [pieces[k] for k in rng.permutation(len(pieces))], inset


def _low(make: Callable[[str], Shape]) -> Shape:
    for _ in range(4):
        shape = make("cabinet")
        if shape.extents_m[2] < 1.05 and not shape.mount_m:
            break
    return shape


def _let_in(
    layout: Layout, placed: list[int | None], shapes: list[Shape], inset: _Inset | None
) -> None:
    """Put the sink into the hole of its cabinet, where that found its place."""
    for index, shape in zip(placed, shapes, strict=True):
        if inset is None or index is None or shape is not inset[0]:
            continue
        item, (dx, dy, dz) = layout.items[index], inset[2]
        c, s = np.cos(item.yaw), np.sin(item.yaw)
        at = (item.xyz[0] + c * dx - s * dy, item.xyz[1] + s * dx + c * dy, item.xyz[2] + dz)
        layout.items.append(Item(inset[1], (float(at[0]), float(at[1]), at[2]), item.yaw, index))


def _hang(
    layout: Layout, style: KitchenStyle, wall: Wall, start_m: float, length_m: float, count: int
) -> None:
    """Wall cupboards side by side somewhere above the row."""
    widths = [float(width) for width in layout.rng.uniform(0.4, 1.2, count)]
    start = start_m + float(layout.rng.uniform(0, max(0.0, length_m - sum(widths))))
    layout.row(wall, start, [wall_cupboard(layout.rng, style, width) for width in widths])
