"""Tall cabinets: wardrobes, hutches, pantries, corner cabinets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from composenet.synth.furniture.cabinet_parts import add_top, door, finish, pairs, stacked_drawers
from composenet.synth.furniture.cases import (
    Cell,
    add_base,
    add_case,
    random_look,
    splits,
)
from composenet.synth.furniture.parts import (
    Rng,
    box,
    box_between,
    chance,
    extrude,
    rounded_box,
)
from composenet.synth.shape import Shape, ShapeBuilder


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
    for y0, y1 in pairs(splits(rng, -width / 2, width / 2, max(1, round(doors / 2)))):
        if split > base:
            cells += stacked_drawers(rng, y0, y1, base, split, int(rng.integers(1, 3)))
        cells.append(door(rng, y0, y1, split, height, int(rng.integers(1, 4))))
    add_base(builder, rng, kind, depth, width, base, look.body)
    add_case(builder, look, (-depth / 2, -width / 2, base), (depth / 2, width / 2, height), cells)
    if chance(rng, 0.5):
        add_top(builder, rng, depth + 0.03, width + 0.03, height, look.body)
    return finish(builder, "wardrobe")


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
    for index, (y0, y1) in enumerate(pairs(edges)):
        x = depth / 2 - 0.055 + 0.027 * (index % 2)
        low, high = (x, y0 - 0.015, 0.05), (x + 0.022, y1 + 0.015, height - 0.045)
        builder.add(box_between(low, high), panels[index % 2])
        for z in (height / 3, 2 * height / 3) if look.front == "frame" else ():
            rail = ((x, y0 - 0.015, z - 0.015), (x + 0.028, y1 + 0.015, z + 0.015))
            builder.add(box_between(*rail), look.metal)
    return finish(builder, "sliding_wardrobe")


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
    for y0, y1 in pairs(splits(rng, -width / 2, width / 2, columns)):
        cells += [door(rng, y0, y1, base, split), *stacked_drawers(rng, y0, y1, split, waist, 1)]
    add_base(builder, rng, kind, depth, width, base, look.body)
    add_case(builder, look, (-depth / 2, -width / 2, base), (depth / 2, width / 2, waist), cells)
    add_top(builder, rng, depth, width, waist, look.body)
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
        else door(rng, y0, y1, lift, height)
        for y0, y1 in pairs(splits(rng, low[1], high[1], 2))
    ]
    add_case(builder, shown, low, high, doors)
    if chance(rng, 0.6):
        size = (upper + 0.05, width + 0.04, 0.05)
        builder.add(rounded_box(size, ((upper - depth) / 2, 0, height + 0.02), 0.015), look.body)
    return finish(builder, "hutch")


def pantry(rng: Rng) -> Shape:
    """Tall and narrow: doors above one another, sometimes an open bay."""
    builder, look = ShapeBuilder(), random_look(rng)
    width, depth, height = rng.uniform(0.4, 1.0), rng.uniform(0.35, 0.62), rng.uniform(1.7, 2.4)
    base = float(rng.uniform(0.04, 0.12))
    count = int(rng.integers(2, 4))
    cells: list[Cell] = []
    for row, (z0, z1) in enumerate(pairs(splits(rng, base, height, count, 0.25))):
        if row == 1 and chance(rng, 0.4):
            cells.append(Cell(-width / 2, width / 2, z0, z1, "open", shelves=int(rng.integers(3))))
        elif row == 0 and chance(rng, 0.3):
            cells += stacked_drawers(rng, -width / 2, width / 2, z0, z1, int(rng.integers(2, 4)))
        else:
            cells.append(door(rng, -width / 2, width / 2, z0, z1, 2))
    add_base(builder, rng, "plinth", depth, width, base, look.body)
    add_case(builder, look, (-depth / 2, -width / 2, base), (depth / 2, width / 2, height), cells)
    return finish(builder, "pantry")


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
        bay = replace(door(rng, -half, half, z0 + 0.01, z1 - 0.01), pulled=0.0)
        low, high = (front - 0.05, -half, z0 + 0.01), (front, half, z1 - 0.01)
        add_case(builder, look, low, high, [bay])
    if chance(rng, 0.6):
        builder.add(extrude(outline * 1.03 - (0.01, 0), 0.03, height), look.body)
    return finish(builder, "corner")
