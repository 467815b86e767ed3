"""Cabinets: kitchen bases, wardrobes, sideboards, nightstands, dressers, filing cabinets, ..."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np

from composenet.records import Symmetry
from composenet.synth.furniture.cases import (
    BASES,
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
    arc,
    box,
    box_between,
    carcass,
    chance,
    extrude,
    paint,
    plastic,
    rounded_box,
    stone,
    tube,
    wood,
)
from composenet.synth.shape import Material, Shape, ShapeBuilder


def _finish(builder: ShapeBuilder, style: str) -> Shape:
    return builder.build("cabinet", style, Symmetry.NONE)


def _top(
    builder: ShapeBuilder, rng: Rng, depth: float, width: float, z: float, material: Material
) -> None:
    """A top board with some overhang at the front and the sides."""
    over, thick = float(rng.uniform(0.0, 0.03)), float(rng.uniform(0.015, 0.04))
    builder.add(
        rounded_box((depth + over, width + 2 * over, thick), (over / 2, 0, z + thick / 2), 0.006)
        if chance(rng, 0.5)
        else box((depth + over, width + 2 * over, thick), (over / 2, 0, z + thick / 2)),
        material,
    )


def _door(rng: Rng, y0: float, y1: float, z0: float, z1: float, shelves: int = 1) -> Cell:
    """A compartment behind one door, or two where it is wide."""
    kind = "double" if y1 - y0 > 0.62 else str(rng.choice(["left", "right"]))
    return Cell(y0, y1, z0, z1, kind, opened(rng), shelves)


def _drawers(rng: Rng, y0: float, y1: float, z0: float, z1: float, count: int) -> list[Cell]:
    """Drawers over one another, the lower ones often higher."""
    share = np.linspace(float(rng.uniform(1.0, 1.8)), 1.0, count)
    edges = z0 + (z1 - z0) * np.concatenate([[0.0], np.cumsum(share / share.sum())])
    return [
        Cell(y0, y1, float(low), float(high), "drawer", opened(rng, 0.08))
        for low, high in pairwise(edges)
    ]


def _pairs(edges: list[float]) -> list[tuple[float, float]]:
    return list(pairwise(edges))


def kitchen_base(rng: Rng) -> Shape:
    """Base units under a worktop."""
    builder, look = ShapeBuilder(), random_look(rng)
    width, depth, height = rng.uniform(0.4, 2.0), rng.uniform(0.52, 0.66), rng.uniform(0.8, 0.92)
    kick = float(rng.uniform(0.08, 0.15))
    cells: list[Cell] = []
    for y0, y1 in _pairs(splits(rng, -width / 2, width / 2, max(1, round(width / 0.55)), 0.1)):
        kind = rng.random()
        if kind < 0.3:
            cells += _drawers(rng, y0, y1, kick, height, int(rng.integers(3, 5)))
        elif kind < 0.7:
            split = height - float(rng.uniform(0.13, 0.2))
            cells += [_door(rng, y0, y1, kick, split), *_drawers(rng, y0, y1, split, height, 1)]
        else:
            cells.append(_door(rng, y0, y1, kick, height))
    add_base(builder, rng, "plinth", depth, width, kick, look.body)
    add_case(builder, look, (-depth / 2, -width / 2, kick), (depth / 2, width / 2, height), cells)
    _top(builder, rng, depth, width, height, stone(rng) if chance(rng, 0.6) else wood(rng))
    return _finish(builder, "kitchen_base")


def wall_unit(rng: Rng) -> Shape:
    """Cupboard that hangs on a wall."""
    builder, look = ShapeBuilder(), random_look(rng)
    width, depth, height = rng.uniform(0.35, 1.6), rng.uniform(0.18, 0.4), rng.uniform(0.4, 0.95)
    if chance(rng, 0.25):
        look = replace(look, front="glass")
    cells = []
    columns = max(1, round(width / 0.6))
    for y0, y1 in _pairs(splits(rng, -width / 2, width / 2, columns)):
        if columns > 1 and chance(rng, 0.15):
            cells.append(Cell(y0, y1, 0.0, height, "open", shelves=int(rng.integers(1, 3))))
        else:
            cells.append(_door(rng, y0, y1, 0.0, height, 2))
    add_case(builder, look, (-depth / 2, -width / 2, 0), (depth / 2, width / 2, height), cells)
    return _finish(builder, "wall_unit")


def wardrobe(rng: Rng) -> Shape:
    """Tall, with hinged doors, sometimes drawers below and a cornice."""
    builder, look = ShapeBuilder(), random_look(rng)
    if chance(rng, 0.15):
        look = replace(look, front="louvre")
    doors = int(rng.integers(1, 5))
    width = doors * float(rng.uniform(0.42, 0.6))
    depth, height = float(rng.uniform(0.5, 0.68)), float(rng.uniform(1.65, 2.35))
    base = float(rng.uniform(0.04, 0.15))
    kind = str(rng.choice(["plinth", "legs", "bracket", "bun"]))
    split = base + (float(rng.uniform(0.2, 0.55)) if chance(rng, 0.45) else 0.0)
    cells: list[Cell] = []
    for y0, y1 in _pairs(splits(rng, -width / 2, width / 2, max(1, round(doors / 2)))):
        if split > base:
            cells += _drawers(rng, y0, y1, base, split, int(rng.integers(1, 3)))
        cells.append(_door(rng, y0, y1, split, height, int(rng.integers(1, 4))))
    add_base(builder, rng, kind, depth, width, base, look.body)
    add_case(builder, look, (-depth / 2, -width / 2, base), (depth / 2, width / 2, height), cells)
    if chance(rng, 0.5):
        _top(builder, rng, depth + 0.03, width + 0.03, height, look.body)
    return _finish(builder, "wardrobe")


def sliding_wardrobe(rng: Rng) -> Shape:
    """Wide, with two or three panels that slide past each other."""
    builder, look = ShapeBuilder(), random_look(rng)
    width, depth, height = rng.uniform(1.2, 2.6), rng.uniform(0.55, 0.7), rng.uniform(1.9, 2.4)
    board = look.board
    low, high = (-depth / 2, -width / 2, 0.0), (depth / 2 - 0.06, width / 2, height)
    add_case(builder, look, low, high, [])
    for z0, z1 in ((0.0, 0.06), (height - 0.05, height)):
        builder.add(box_between((0, -width / 2, z0), (depth / 2, width / 2, z1)), look.body)
    for y in (-width / 2 + board / 2, width / 2 - board / 2):
        builder.add(box((depth, board, height), (0, y, height / 2)), look.body)
    edges = splits(rng, -width / 2 + board, width / 2 - board, int(rng.integers(2, 4)))
    panels = [look.panel, look.pane if chance(rng, 0.4) else look.panel]
    for index, (y0, y1) in enumerate(_pairs(edges)):
        x = depth / 2 - 0.055 + 0.027 * (index % 2)
        low, high = (x, y0 - 0.015, 0.05), (x + 0.022, y1 + 0.015, height - 0.045)
        builder.add(box_between(low, high), panels[index % 2])
        for z in (height / 3, 2 * height / 3) if look.front == "frame" else ():
            rail = ((x, y0 - 0.015, z - 0.015), (x + 0.028, y1 + 0.015, z + 0.015))
            builder.add(box_between(*rail), look.metal)
    return _finish(builder, "sliding_wardrobe")


def sideboard(rng: Rng) -> Shape:
    """Low and wide on legs: doors, drawers and open bays."""
    builder, look = ShapeBuilder(), random_look(rng)
    width, depth, height = rng.uniform(0.9, 2.1), rng.uniform(0.35, 0.52), rng.uniform(0.62, 0.98)
    kind = str(rng.choice(["legs", "splayed", "sled", "plinth", "bracket"]))
    base = float(rng.uniform(0.06, 0.1) if kind in ("plinth", "bracket") else rng.uniform(0.1, 0.3))
    cells: list[Cell] = []
    count = int(np.clip(round(width / rng.uniform(0.4, 0.7)), 2, 4))
    for y0, y1 in _pairs(splits(rng, -width / 2, width / 2, count, 0.15)):
        roll = rng.random()
        if roll < 0.3:
            cells += _drawers(rng, y0, y1, base, height, int(rng.integers(2, 5)))
        elif roll < 0.42:
            cells.append(Cell(y0, y1, base, height, "open", shelves=int(rng.integers(0, 3))))
        else:
            cells.append(_door(rng, y0, y1, base, height))
    add_base(builder, rng, kind, depth, width, base, look.metal if kind == "sled" else look.body)
    add_case(builder, look, (-depth / 2, -width / 2, base), (depth / 2, width / 2, height), cells)
    if chance(rng, 0.6):
        _top(builder, rng, depth, width, height, look.body)
    return _finish(builder, "sideboard")


def nightstand(rng: Rng) -> Shape:
    """Beside a bed: one or two drawers, often an open bay."""
    builder, look = ShapeBuilder(), random_look(rng)
    width, depth, height = rng.uniform(0.33, 0.62), rng.uniform(0.3, 0.5), rng.uniform(0.38, 0.7)
    kind = str(rng.choice(BASES))
    base = 0.0 if kind == "none" else float(rng.uniform(0.04, 0.25 if kind != "plinth" else 0.08))
    split = base + float(rng.uniform(0.3, 0.65)) * (height - base)
    layout = rng.random()
    half = width / 2
    if layout < 0.4:
        cells = _drawers(rng, -half, half, base, height, int(rng.integers(1, 4)))
    elif layout < 0.75:
        cells = [Cell(-half, half, base, split, "open")]
        cells += _drawers(rng, -half, half, split, height, 1)
    else:
        cells = [_door(rng, -half, half, base, split), Cell(-half, half, split, height, "open")]
    add_base(builder, rng, kind, depth, width, base, look.body)
    add_case(builder, look, (-depth / 2, -half, base), (depth / 2, half, height), cells)
    if chance(rng, 0.6):
        _top(builder, rng, depth, width, height, look.body)
    return _finish(builder, "nightstand")


def dresser(rng: Rng) -> Shape:
    """Chest of drawers, one to three columns; sometimes with a bowed front."""
    builder, look = ShapeBuilder(), random_look(rng)
    columns = int(rng.integers(1, 4))
    width = float(rng.uniform(0.5, 0.8) if columns == 1 else rng.uniform(0.85, 1.7))
    depth, height = float(rng.uniform(0.38, 0.56)), float(rng.uniform(0.7, 1.35))
    kind = str(rng.choice(["plinth", "legs", "bun", "bracket", "splayed"]))
    base = float(rng.uniform(0.05, 0.18))
    rows = int(np.clip(round((height - base) / rng.uniform(0.16, 0.28)), 3, 5))
    cells: list[Cell] = []
    for y0, y1 in _pairs(splits(rng, -width / 2, width / 2, columns)):
        cells += _drawers(rng, y0, y1, base, height, rows)
    if len(cells) > 8 and look.front in ("frame", "raised"):
        look = replace(look, front="flat")
    add_base(builder, rng, kind, depth, width, base, look.body)
    add_case(builder, look, (-depth / 2, -width / 2, base), (depth / 2, width / 2, height), cells)
    _top(builder, rng, depth, width, height, look.body)
    if chance(rng, 0.15):  # a mirror or gallery at the back
        tall = float(rng.uniform(0.1, 0.7))
        board = box((0.03, 0.8 * width, tall + 0.05), (0.03 - depth / 2, 0, height + tall / 2))
        builder.add(board, look.pane if tall > 0.3 else look.body)
    return _finish(builder, "dresser")


def tv_stand(rng: Rng) -> Shape:
    """Low media bench: open bays between closed ones."""
    builder, look = ShapeBuilder(), random_look(rng)
    width, depth, height = rng.uniform(0.9, 2.4), rng.uniform(0.32, 0.52), rng.uniform(0.32, 0.62)
    kind = str(rng.choice(["legs", "splayed", "sled", "plinth", "blocks", "none"]))
    base = 0.0 if kind == "none" else float(rng.uniform(0.04, 0.17))
    ends = str(rng.choice(["drawer", "left", "open"]))
    edges = splits(rng, -width / 2, width / 2, int(rng.integers(2, 5)), 0.1)
    cells: list[Cell] = []
    for index, (y0, y1) in enumerate(_pairs(edges)):
        outer = index in (0, len(edges) - 2)
        if outer and ends == "drawer":
            cells += _drawers(rng, y0, y1, base, height, int(rng.integers(1, 3)))
        elif outer and ends == "left":
            cells.append(_door(rng, y0, y1, base, height, 0))
        else:
            cells.append(Cell(y0, y1, base, height, "open", shelves=int(rng.integers(0, 2))))
    add_base(builder, rng, kind, depth, width, base, look.metal if kind == "sled" else look.body)
    add_case(builder, look, (-depth / 2, -width / 2, base), (depth / 2, width / 2, height), cells)
    if chance(rng, 0.5):
        _top(builder, rng, depth, width, height, look.panel)
    return _finish(builder, "tv_stand")


def filing(rng: Rng) -> Shape:
    """Steel filing cabinet or a pedestal on casters."""
    builder = ShapeBuilder()
    body = paint(rng) if chance(rng, 0.8) else plastic(rng)
    look: Look = replace(random_look(rng, body), front="flat", panel=body)
    look = replace(look, handle=str(rng.choice(["pull", "lip", "bar"])))
    lateral = chance(rng, 0.3)
    width = float(rng.uniform(0.75, 1.1) if lateral else rng.uniform(0.36, 0.5))
    depth = float(rng.uniform(0.42, 0.52) if lateral else rng.uniform(0.5, 0.68))
    drawers = int(rng.integers(2, 5))
    casters = drawers == 2 and chance(rng, 0.6)
    base = float(rng.uniform(0.05, 0.08) if casters else rng.uniform(0.02, 0.06))
    height = base + drawers * float(rng.uniform(0.24, 0.34))
    cells = [
        replace(cell, pulled=opened(rng, 0.15))
        for cell in _drawers(rng, -width / 2, width / 2, base, height, drawers)
    ]
    kind = "casters" if casters else "plinth"
    add_base(builder, rng, kind, depth, width, base, look.metal)
    add_case(builder, look, (-depth / 2, -width / 2, base), (depth / 2, width / 2, height), cells)
    for cell in cells[: 3 if chance(rng, 0.5) else 0]:
        if not cell.pulled:
            z = cell.z0 + 0.8 * (cell.z1 - cell.z0)
            builder.add(box((0.01, 0.08, 0.04), (depth / 2 + look.proud, 0, z)), look.metal)
    return _finish(builder, "filing")


def hutch(rng: Rng) -> Shape:
    """Buffet with a shallower display cabinet on top."""
    builder, look = ShapeBuilder(), random_look(rng)
    width, depth = float(rng.uniform(0.8, 1.6)), float(rng.uniform(0.4, 0.55))
    waist, height = float(rng.uniform(0.75, 0.95)), float(rng.uniform(1.75, 2.2))
    base, upper = float(rng.uniform(0.04, 0.12)), float(rng.uniform(0.55, 0.8)) * depth
    kind = str(rng.choice(["plinth", "bun", "bracket"]))
    split = waist - float(rng.uniform(0.12, 0.2))
    columns = int(rng.integers(2, 4)) if width > 1.1 else 2
    cells: list[Cell] = []
    for y0, y1 in _pairs(splits(rng, -width / 2, width / 2, columns)):
        cells += [_door(rng, y0, y1, base, split), *_drawers(rng, y0, y1, split, waist, 1)]
    add_base(builder, rng, kind, depth, width, base, look.body)
    add_case(builder, look, (-depth / 2, -width / 2, base), (depth / 2, width / 2, waist), cells)
    _top(builder, rng, depth, width, waist, look.body)
    lift = waist + (float(rng.uniform(0.2, 0.4)) if chance(rng, 0.4) else 0.0)
    if lift > waist:
        size = (0.02, width, lift - waist + 0.04)
        builder.add(box(size, (0.01 - depth / 2, 0, (lift + waist) / 2)), look.body)
        for y in (-width / 2 + 0.015, width / 2 - 0.015):
            low = (-depth / 2, y - 0.015, waist)
            builder.add(box_between(low, (upper - depth / 2, y + 0.015, lift)), look.body)
    is_open = chance(rng, 0.35)
    shown = replace(look, front="glass" if chance(rng, 0.7) else look.front)
    low, high = (-depth / 2, -width / 2 + 0.01, lift), (upper - depth / 2, width / 2 - 0.01, height)
    doors = [
        Cell(y0, y1, lift, height, "open", shelves=2)
        if is_open
        else _door(rng, y0, y1, lift, height)
        for y0, y1 in _pairs(splits(rng, low[1], high[1], 2))
    ]
    add_case(builder, shown, low, high, doors)
    if chance(rng, 0.6):
        size = (upper + 0.05, width + 0.04, 0.05)
        builder.add(rounded_box(size, ((upper - depth) / 2, 0, height + 0.02), 0.015), look.body)
    return _finish(builder, "hutch")


def pantry(rng: Rng) -> Shape:
    """Tall and narrow: doors above one another, sometimes an open bay."""
    builder, look = ShapeBuilder(), random_look(rng)
    width, depth, height = rng.uniform(0.4, 1.0), rng.uniform(0.35, 0.62), rng.uniform(1.7, 2.4)
    base = float(rng.uniform(0.04, 0.12))
    count = int(rng.integers(2, 4))
    cells: list[Cell] = []
    for row, (z0, z1) in enumerate(_pairs(splits(rng, base, height, count, 0.25))):
        if row == 1 and chance(rng, 0.4):
            cells.append(Cell(-width / 2, width / 2, z0, z1, "open", shelves=int(rng.integers(3))))
        elif row == 0 and chance(rng, 0.3):
            cells += _drawers(rng, -width / 2, width / 2, z0, z1, int(rng.integers(2, 4)))
        else:
            cells.append(_door(rng, -width / 2, width / 2, z0, z1, 2))
    add_base(builder, rng, "plinth", depth, width, base, look.body)
    add_case(builder, look, (-depth / 2, -width / 2, base), (depth / 2, width / 2, height), cells)
    return _finish(builder, "pantry")


def corner(rng: Rng) -> Shape:
    """Pentagonal, for the corner of a room: its front is cut at 45 degrees."""
    builder, look = ShapeBuilder(), random_look(rng)
    side, wing = float(rng.uniform(0.55, 0.95)), float(rng.uniform(0.15, 0.35))
    height = float(rng.choice([rng.uniform(0.7, 0.95), rng.uniform(1.6, 2.1)]))
    base = float(rng.uniform(0.04, 0.12))
    # the room's corner at the origin of this plan, the walls along +a and +b
    plan = np.array([(0, 0), (side, 0), (side, wing), (wing, side), (0, side)])
    turn = np.array([[1, 1], [-1, 1]]) / np.sqrt(2)  # the plan's diagonal becomes +x
    outline = plan @ turn.T
    builder.add(extrude(outline * 0.96, base), look.body)
    builder.add(extrude(outline, height - base, base), look.body)
    front, half = float(outline[2, 0]), float(abs(outline[2, 1])) * 0.96
    split = base + (height - base) * float(rng.uniform(0.4, 0.6)) if height > 1.5 else height
    for z0, z1 in [(base, split)] + ([(split, height)] if split < height else []):
        door = replace(_door(rng, -half, half, z0 + 0.01, z1 - 0.01), pulled=0.0)
        low, high = (front - 0.05, -half, z0 + 0.01), (front, half, z1 - 0.01)
        add_case(builder, look, low, high, [door])
    if chance(rng, 0.6):
        builder.add(extrude(outline * 1.03 - (0.01, 0), 0.03, height), look.body)
    return _finish(builder, "corner")


def bow_front(rng: Rng) -> Shape:
    """Commode with a curved front on legs."""
    builder, look = ShapeBuilder(), random_look(rng, carcass(rng))
    width, depth, height = rng.uniform(0.6, 1.3), rng.uniform(0.38, 0.5), rng.uniform(0.7, 0.95)
    bow, base = float(rng.uniform(0.04, 0.14)), float(rng.uniform(0.1, 0.3))
    radius = (width**2 / 4 + bow**2) / (2 * bow)
    reach = float(np.arcsin(width / 2 / radius))
    curve = arc((depth / 2 + bow - radius, 0.0), radius, -reach, reach, 10)
    back = np.array([(-depth / 2, width / 2), (-depth / 2, -width / 2)])
    outline = np.concatenate([curve, back])
    builder.add(extrude(outline, height - base, base), look.body)
    builder.add(extrude(outline * 1.04, 0.025, height), look.panel)
    rows = int(rng.integers(2, 4))
    for z0, z1 in _pairs(splits(rng, base + 0.02, height - 0.01, rows)):
        outside, inside = np.add(curve, (0.012, 0)), np.subtract(curve[::-1], (0.05, 0))
        grown = np.concatenate([outside, inside]) * (1, 0.95)
        builder.add(extrude(grown, z1 - z0 - 0.012, z0 + 0.006), look.panel)
        for y in (-width / 4, width / 4):
            x = depth / 2 + bow - radius + float(np.sqrt(radius**2 - y**2)) + 0.01
            z = (z0 + z1) / 2
            pull = [
                (x, y - 0.05, z),
                (x + 0.03, y - 0.03, z),
                (x + 0.03, y + 0.03, z),
                (x, y + 0.05, z),
            ]
            builder.add(tube(pull, 0.006, 6), look.metal)
    add_base(builder, rng, "legs", depth * 0.9, width, base, look.body)
    return _finish(builder, "bow_front")


STYLES: dict[str, dict[str, Callable[[Rng], Shape]]] = {
    "cabinet": {
        builder.__name__: builder
        for builder in (
            kitchen_base,
            wall_unit,
            wardrobe,
            sliding_wardrobe,
            sideboard,
            nightstand,
            dresser,
            tv_stand,
            filing,
            hutch,
            pantry,
            corner,
            bow_front,
        )
    }
}
