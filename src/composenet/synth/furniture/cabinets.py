"""Cabinets: kitchen bases, sideboards, nightstands, dressers, filing cabinets, ..."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from composenet.records import Symmetry
from composenet.synth.furniture.cabinet_parts import add_top, door, finish, pairs, stacked_drawers
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
from composenet.synth.furniture.kitchen_units import base_unit, random_style
from composenet.synth.furniture.parts import (
    Rng,
    arc,
    box,
    carcass,
    chance,
    extrude,
    paint,
    plastic,
    tube,
)
from composenet.synth.furniture.tall_cabinets import (
    corner,
    hutch,
    pantry,
    sliding_wardrobe,
    wardrobe,
)
from composenet.synth.shape import Shape, ShapeBuilder


def kitchen_base(rng: Rng) -> Shape:
    """Base units under a worktop."""
    return base_unit(rng, random_style(rng), float(rng.uniform(0.4, 2.0)))


def wall_unit(rng: Rng) -> Shape:
    """Cupboard that hangs on a wall."""
    builder, look = ShapeBuilder(), random_look(rng)
    width, depth, height = rng.uniform(0.35, 1.6), rng.uniform(0.18, 0.4), rng.uniform(0.4, 0.95)
    if chance(rng, 0.25):
        look = replace(look, front="glass")
    cells = []
    columns = max(1, round(width / 0.6))
    for y0, y1 in pairs(splits(rng, -width / 2, width / 2, columns)):
        if columns > 1 and chance(rng, 0.15):
            cells.append(Cell(y0, y1, 0.0, height, "open", shelves=int(rng.integers(1, 3))))
        else:
            cells.append(door(rng, y0, y1, 0.0, height, 2))
    add_case(builder, look, (-depth / 2, -width / 2, 0), (depth / 2, width / 2, height), cells)
    mount_m = float(rng.uniform(1.25, 1.55)) if chance(rng, 0.85) else 0.0
    return builder.build("cabinet", "wall_unit", Symmetry.NONE, mount_m)


def sideboard(rng: Rng) -> Shape:
    """Low and wide on legs: doors, drawers and open bays."""
    builder, look = ShapeBuilder(), random_look(rng)
    width, depth, height = rng.uniform(0.9, 2.1), rng.uniform(0.35, 0.52), rng.uniform(0.62, 0.98)
    kind = str(rng.choice(["legs", "splayed", "sled", "plinth", "bracket"]))
    base = float(rng.uniform(0.06, 0.1) if kind in ("plinth", "bracket") else rng.uniform(0.1, 0.3))
    cells: list[Cell] = []
    count = int(np.clip(round(width / rng.uniform(0.4, 0.7)), 2, 4))
    for y0, y1 in pairs(splits(rng, -width / 2, width / 2, count, 0.15)):
        roll = rng.random()
        if roll < 0.3:
            cells += stacked_drawers(rng, y0, y1, base, height, int(rng.integers(2, 5)))
        elif roll < 0.42:
            cells.append(Cell(y0, y1, base, height, "open", shelves=int(rng.integers(0, 3))))
        else:
            cells.append(door(rng, y0, y1, base, height))
    add_base(builder, rng, kind, depth, width, base, look.metal if kind == "sled" else look.body)
    add_case(builder, look, (-depth / 2, -width / 2, base), (depth / 2, width / 2, height), cells)
    if chance(rng, 0.6):
        add_top(builder, rng, depth, width, height, look.body)
    return finish(builder, "sideboard")


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
        cells = stacked_drawers(rng, -half, half, base, height, int(rng.integers(1, 4)))
    elif layout < 0.75:
        cells = [Cell(-half, half, base, split, "open")]
        cells += stacked_drawers(rng, -half, half, split, height, 1)
    else:
        cells = [door(rng, -half, half, base, split), Cell(-half, half, split, height, "open")]
    add_base(builder, rng, kind, depth, width, base, look.body)
    add_case(builder, look, (-depth / 2, -half, base), (depth / 2, half, height), cells)
    if chance(rng, 0.6):
        add_top(builder, rng, depth, width, height, look.body)
    return finish(builder, "nightstand")


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
    for y0, y1 in pairs(splits(rng, -width / 2, width / 2, columns)):
        cells += stacked_drawers(rng, y0, y1, base, height, rows)
    if len(cells) > 8 and look.front in ("frame", "raised"):
        look = replace(look, front="flat")
    add_base(builder, rng, kind, depth, width, base, look.body)
    add_case(builder, look, (-depth / 2, -width / 2, base), (depth / 2, width / 2, height), cells)
    add_top(builder, rng, depth, width, height, look.body)
    if chance(rng, 0.15):  # a mirror or gallery at the back
        tall = float(rng.uniform(0.1, 0.7))
        board = box((0.03, 0.8 * width, tall + 0.05), (0.03 - depth / 2, 0, height + tall / 2))
        builder.add(board, look.pane if tall > 0.3 else look.body)
    return finish(builder, "dresser")


def tv_stand(rng: Rng) -> Shape:
    """Low media bench: open bays between closed ones."""
    builder, look = ShapeBuilder(), random_look(rng)
    width, depth, height = rng.uniform(0.9, 2.4), rng.uniform(0.32, 0.52), rng.uniform(0.32, 0.62)
    kind = str(rng.choice(["legs", "splayed", "sled", "plinth", "blocks", "none"]))
    base = 0.0 if kind == "none" else float(rng.uniform(0.04, 0.17))
    ends = str(rng.choice(["drawer", "left", "open"]))
    edges = splits(rng, -width / 2, width / 2, int(rng.integers(2, 5)), 0.1)
    cells: list[Cell] = []
    for index, (y0, y1) in enumerate(pairs(edges)):
        outer = index in (0, len(edges) - 2)
        if outer and ends == "drawer":
            cells += stacked_drawers(rng, y0, y1, base, height, int(rng.integers(1, 3)))
        elif outer and ends == "left":
            cells.append(door(rng, y0, y1, base, height, 0))
        else:
            cells.append(Cell(y0, y1, base, height, "open", shelves=int(rng.integers(0, 2))))
    add_base(builder, rng, kind, depth, width, base, look.metal if kind == "sled" else look.body)
    add_case(builder, look, (-depth / 2, -width / 2, base), (depth / 2, width / 2, height), cells)
    if chance(rng, 0.5):
        add_top(builder, rng, depth, width, height, look.panel)
    return finish(builder, "tv_stand")


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
        for cell in stacked_drawers(rng, -width / 2, width / 2, base, height, drawers)
    ]
    kind = "casters" if casters else "plinth"
    add_base(builder, rng, kind, depth, width, base, look.metal)
    add_case(builder, look, (-depth / 2, -width / 2, base), (depth / 2, width / 2, height), cells)
    for cell in cells[: 3 if chance(rng, 0.5) else 0]:
        if not cell.pulled:
            z = cell.z0 + 0.8 * (cell.z1 - cell.z0)
            builder.add(box((0.01, 0.08, 0.04), (depth / 2 + look.proud, 0, z)), look.metal)
    return finish(builder, "filing")


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
    for z0, z1 in pairs(splits(rng, base + 0.02, height - 0.01, rows)):
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
    return finish(builder, "bow_front")


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
