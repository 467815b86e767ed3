"""Heavy, plain joinery: desks, bookshelves and cabinets of thick posts, boards and panels."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from composenet.records import Symmetry
from composenet.synth.furniture.cases import Cell, Look, add_case, random_look
from composenet.synth.furniture.chair_parts import add_all, legs_between
from composenet.synth.furniture.desk_parts import Desk, desk_top, drawers, modesty, pencil_drawers
from composenet.synth.furniture.parts import (
    Rng,
    Solid,
    box,
    box_between,
    carcass,
    chance,
    extrude,
    wood,
)
from composenet.synth.shape import Material, Shape, ShapeBuilder


def _posts(builder: ShapeBuilder, spots: list[tuple[float, float]], size: float, height: float,
           material: Material) -> None:  # fmt: skip
    for x, y in spots:
        builder.add(box((size, size, height), (x, y, height / 2)), material)


def _slab(d: Desk) -> Solid:
    return box((d.deep, d.wide, d.thick), (0, 0, d.height - d.thick / 2))


def _heavy_desk(rng: Rng) -> Desk:
    u = rng.uniform
    return Desk(u(0.5, 0.95), u(1.0, 1.9), u(0.71, 0.9), u(0.035, 0.09))


def panelled_desk(rng: Rng) -> Shape:
    """Thick corner posts, panels between them at the ends and behind, drawers under the top."""
    builder, d, body = ShapeBuilder(), _heavy_desk(rng), carcass(rng)
    over = float(rng.uniform(0.0, 0.04))
    builder.add(_slab(d), body if chance(rng, 0.5) else carcass(rng))
    size = float(rng.uniform(0.05, 0.14))
    x, y = d.deep / 2 - over - size / 2, d.wide / 2 - over - size / 2
    _posts(builder, [(sx * x, sy * y) for sx in (-1, 1) for sy in (-1, 1)], size, d.under + 0.002,
           body)  # fmt: skip
    low = float(rng.uniform(0.03, 0.35))
    for side in (-1, 1):
        builder.add(box_between((-x, side * y - 0.012, low), (x, side * y + 0.012, d.under)), body)
    if chance(rng, 0.8):
        builder.add(box_between((-x - 0.012, -y, low), (-x + 0.012, y, d.under)), body)
    if chance(rng, 0.75):
        inner = Desk(d.deep - 2 * over, 2 * y, d.height, d.thick)
        pencil_drawers(rng, builder, inner, body)
    return builder.build("desk", "panelled", Symmetry.NONE)


def hung_drawers_desk(rng: Rng) -> Shape:
    """Boxes of drawers hung under one or both ends, on thin legs."""
    builder, body = ShapeBuilder(), carcass(rng)
    u = rng.uniform
    d = Desk(u(0.42, 0.9), u(0.9, 1.9), u(0.71, 0.92), u(0.02, 0.08))
    builder.add(desk_top(d, rng), body if chance(rng, 0.6) else carcass(rng))
    inset, size = float(rng.uniform(0.01, 0.06)), float(rng.uniform(0.03, 0.07))
    wide, tall = float(rng.uniform(0.22, 0.36)) * d.wide, float(rng.uniform(0.16, 0.45)) * d.under
    back, front = -d.deep / 2 + inset, d.deep / 2 - inset - 0.01
    for side in (-1, 1) if chance(rng, 0.7) else (int(rng.choice([-1, 1])),):
        ends = np.sort([side * (d.wide / 2 - inset), side * (d.wide / 2 - inset - wide)])
        low = (back, float(ends[0]), d.under - tall)
        drawers(rng, builder, low, (front, float(ends[1]), d.under + 0.002), body,
                int(rng.integers(1, 3)))  # fmt: skip
    if chance(rng, 0.5):
        drawers(rng, builder, (back, -d.wide / 2 + inset + wide, d.under - 0.1),
                (front, d.wide / 2 - inset - wide, d.under + 0.002), body, 1)  # fmt: skip
    x, y = d.deep / 2 - inset - size / 2, d.wide / 2 - inset - size / 2
    tops = np.array([(sx * x, sy * y, d.under + 0.002) for sx in (-1, 1) for sy in (-1, 1)])
    spread = float(rng.choice([1.0, rng.uniform(1.0, 1.04)]))
    feet = tops * (spread, spread, 0.0)
    legs = legs_between(feet, tops, size, rng.uniform(0.4, 1.0), 10 if chance(rng, 0.4) else 4)
    add_all(builder, legs, body if chance(rng, 0.7) else wood(rng))
    return builder.build("desk", "hung_drawers", Symmetry.NONE)


def panelled_corner_desk(rng: Rng) -> Shape:
    """L-shaped, with thick posts and panels along its two outer sides."""
    builder, body = ShapeBuilder(), carcass(rng)
    d = _heavy_desk(rng)
    deep, broad = float(rng.uniform(0.5, 0.85)), float(rng.uniform(0.5, 0.85))
    long, wide, side = float(rng.uniform(1.3, 1.9)), float(rng.uniform(1.3, 1.9)), 1
    x, y = long / 2, wide / 2
    outline = np.array([(-x, -y), (-x + deep, -y), (-x + deep, y - broad), (x, y - broad),
                        (x, y), (-x, y)])  # fmt: skip
    if chance(rng, 0.5):
        outline, side = outline[::-1] * (1, -1), -1
    builder.add(extrude(outline, d.thick, d.under), body)
    size, low = float(rng.uniform(0.05, 0.12)), float(rng.uniform(0.0, 0.3))
    half = size / 2
    spots = [
        (-x + half, -side * (y - half)),
        (-x + deep - half, -side * (y - half)),
        (x - half, side * (y - broad + half)),
        (x - half, side * (y - half)),
        (-x + half, side * (y - half)),
    ]
    _posts(builder, spots, size, d.under + 0.002, body)
    builder.add(box_between((-x + half, -y + half, low), (-x + half + 0.02, y - half, d.under)),
                body)  # fmt: skip
    far = side * (y - half)
    builder.add(box_between((-x + half, far - 0.01, low), (x - half, far + 0.01, d.under)), body)
    near = -side * (y - half)
    builder.add(
        box_between((-x + half, near - 0.01, low), (-x + deep - half, near + 0.01, d.under)), body
    )
    if chance(rng, 0.6):
        at = np.sort([-side * (y - size), -side * (y - size - 0.4)])
        drawers(rng, builder, (-x + 0.05, float(at[0]), float(rng.choice([low, d.under - 0.25]))),
                (-x + deep - 0.03, float(at[1]), d.under + 0.002), body, 2)  # fmt: skip
    return builder.build("desk", "panelled_corner", Symmetry.NONE)


def parsons_desk(rng: Rng) -> Shape:
    """A slab on legs as thick as itself, a panel behind: between a table and a desk, with the
    drawers that make it a desk."""
    builder, d, body = ShapeBuilder(), _heavy_desk(rng), carcass(rng)
    builder.add(_slab(d), body)
    size = max(d.thick, float(rng.uniform(0.04, 0.1)))
    x, y = d.deep / 2 - size / 2, d.wide / 2 - size / 2
    _posts(builder, [(sx * x, sy * y) for sx in (-1, 1) for sy in (-1, 1)], size, d.under + 0.002,
           body)  # fmt: skip
    pencil_drawers(rng, builder, d, body)
    if chance(rng, 0.6):
        builder.add(modesty(rng, d), body)
    return builder.build("desk", "parsons", Symmetry.NONE)


def post_bookshelf(rng: Rng) -> Shape:
    """Thick shelves between four thick posts; closed by panels behind or at the ends, or open."""
    builder, body = ShapeBuilder(), carcass(rng)
    deep, wide = float(rng.uniform(0.28, 0.5)), float(rng.uniform(0.5, 1.6))
    high = float(rng.uniform(0.7, 2.0))
    size, thick = float(rng.uniform(0.04, 0.12)), float(rng.uniform(0.02, 0.07))
    x, y = deep / 2 - size / 2, wide / 2 - size / 2
    _posts(builder, [(sx * x, sy * y) for sx in (-1, 1) for sy in (-1, 1)], size, high, body)
    above = float(rng.choice([0.0, rng.uniform(0.0, 0.1)]))
    levels = np.linspace(rng.uniform(0.05, 0.25), high - above - thick,
                         max(2, round((high - above) / rng.uniform(0.32, 0.5))))  # fmt: skip
    for z in levels:
        board = (deep - 0.3 * size, wide - 0.3 * size, thick)
        builder.add(box(board, (0, 0, z + thick / 2)), body)
    low, top = float(levels[0]), high - above
    if chance(rng, 0.4):
        builder.add(box_between((-x - 0.01, -y, low), (-x + 0.01, y, top)), body)
    if chance(rng, 0.5):
        for side in (-1, 1):
            builder.add(box_between((-x, side * y - 0.01, low), (x, side * y + 0.01, top)), body)
    return builder.build("bookshelf", "posts", Symmetry.NONE)


def cornice_bookcase(rng: Rng) -> Shape:
    """Open shelves over a wider cupboard, with a plinth and a cornice that stand out."""
    builder, look = ShapeBuilder(), random_look(rng)
    deep, wide = float(rng.uniform(0.25, 0.4)), float(rng.uniform(0.7, 1.4))
    high = float(rng.uniform(1.4, 2.15))
    middle = float(rng.uniform(0.25, 0.42)) * high
    ledge, x, y = float(rng.uniform(0.02, 0.06)), deep / 2, wide / 2
    doors = [Cell(-y, y, 0.08, middle, "double")]
    add_case(builder, look, (-x, -y, 0.08), (x, y, middle), doors)
    shelves = [Cell(-y + ledge, y - ledge, middle, high - 0.06, "open",
                    shelves=int(rng.integers(2, 5)))]  # fmt: skip
    add_case(builder, look, (-x, -y + ledge, middle), (x - ledge, y - ledge, high - 0.06), shelves)
    for z, tall in ((0.0, 0.09), (middle - 0.015, 0.03), (high - 0.07, 0.07)):
        size = (deep + ledge, wide + 2 * ledge, tall)
        builder.add(box(size, (ledge / 2, 0, z + tall / 2)), look.body)
    return builder.build("bookshelf", "cornice", Symmetry.NONE)


def framed_cabinet(rng: Rng) -> Shape:
    """A thick frame with fronts set back in it, a heavy top that stands out, short thick legs."""
    builder, body = ShapeBuilder(), carcass(rng)
    drawn = random_look(rng, body)
    look = Look(**{**vars(drawn), "proud": 0.004, "front": "flat"})
    deep, wide = float(rng.uniform(0.35, 0.65)), float(rng.uniform(0.4, 1.7))
    high = float(rng.uniform(0.42, 0.95))
    top, over = float(rng.uniform(0.03, 0.09)), float(rng.uniform(0.0, 0.05))
    stile, back = float(rng.uniform(0.04, 0.09)), float(rng.uniform(0.015, 0.05))
    low, x, y = float(rng.uniform(0.0, 0.16)), deep / 2, wide / 2
    builder.add(box((deep + 2 * over, wide + 2 * over, top), (0, 0, high - top / 2)), body)
    spots = [(sx * (x - stile / 2), sy * (y - stile / 2)) for sx in (-1, 1) for sy in (-1, 1)]
    _posts(builder, spots, stile, high - top + 0.002, body)
    for z in (low, high - top - stile):
        builder.add(box_between((x - stile, -y, z), (x, y, z + stile)), body)
    inner, a, b = y - stile, low + stile, high - top - stile
    rows = int(rng.integers(1, 4))
    if chance(rng, 0.5):
        edges = np.linspace(a, b, rows + 1)
        cells = [Cell(-inner, inner, float(edges[i]), float(edges[i + 1]), "drawer")
                 for i in range(rows)]  # fmt: skip
    elif chance(rng, 0.4):
        cells = [Cell(-inner, inner, a, b, "open", shelves=int(rng.integers(0, 3)))]
    else:
        cells = [Cell(-inner, inner, a, b, "double" if wide > 0.6 else "left")]
    add_case(builder, look, (-x + 0.004, -inner, a - 0.004), (x - back, inner, b + 0.004), cells)
    if chance(rng, 0.8):
        for side in (-1, 1):
            at = side * (y - 0.02)
            low_corner, high_corner = (-x + 0.01, at - 0.01, low), (x - 0.01, at + 0.01, high - top)
            builder.add(box_between(low_corner, high_corner), body)
    return builder.build("cabinet", "framed", Symmetry.NONE)


STYLES: dict[str, dict[str, Callable[[Rng], Shape]]] = {
    "desk": {
        "panelled": panelled_desk,
        "hung_drawers": hung_drawers_desk,
        "panelled_corner": panelled_corner_desk,
        "parsons": parsons_desk,
    },
    "bookshelf": {"posts": post_bookshelf, "cornice": cornice_bookcase},
    "cabinet": {"framed": framed_cabinet},
}
