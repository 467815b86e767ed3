"""Bookshelves: boarded, open, ladder, cube, tall, low, corner, industrial, stepped, with doors."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from composenet.records import Symmetry
from composenet.synth.furniture.cases import Cell, add_base, add_case, random_look, splits
from composenet.synth.furniture.parts import (
    Rng,
    arc,
    bar,
    box,
    box_between,
    carcass,
    chance,
    extrude,
    fabric,
    metal,
    paint,
    plastic,
    rod,
)
from composenet.synth.shape import Material, Shape, ShapeBuilder


def _books(
    builder: ShapeBuilder, rng: Rng, x: float, y0: float, y1: float, z0: float, room: float
) -> None:
    """A row of books (blocks of a few each) standing on z0, spines near the front edge x."""
    if room < 0.12 or y1 - y0 < 0.08:
        return
    y, end = y0, y0 + (y1 - y0) * float(rng.uniform(0.3, 1.0))
    while y < end - 0.02:
        wide = min(float(rng.uniform(0.03, 0.16)), end - y)
        tall, deep = room * float(rng.uniform(0.55, 0.95)), float(rng.uniform(0.12, 0.2))
        front = x - float(rng.uniform(0.01, 0.04))
        cover = paint(rng) if chance(rng, 0.5) else fabric(rng)
        builder.add(box_between((front - deep, y, z0), (front, y + wide - 0.003, z0 + tall)), cover)
        y += wide


def _fill(
    builder: ShapeBuilder,
    rng: Rng,
    depth: float,
    y: tuple[float, float],
    z: list[float],
    board: float,
) -> None:
    """Books on some of the shelves whose boards are centred on z."""
    density = float(rng.uniform(0.3, 1.0))
    for low, high in pairwise(z):
        if chance(rng, density):
            inner = y[0] + board / 2, y[1] - board / 2
            _books(builder, rng, depth / 2, *inner, low + board / 2, high - low - board)


def _boards(
    builder: ShapeBuilder,
    depth: float,
    width: float,
    z: list[float],
    board: float,
    material: Material,
    uprights: int = 2,
) -> None:
    """Sides (and dividers) from the floor to the top, and a board at every z."""
    top = z[-1] + board / 2
    for y in np.linspace(-width / 2 + board / 2, width / 2 - board / 2, uprights):
        builder.add(box((depth, board, top), (0, y, top / 2)), material)
    for level in z:
        builder.add(box((depth, width, board), (0, 0, level)), material)


def _shelved(
    rng: Rng, style: str, width: float, depth: float, height: float, shelves: int, back: bool
) -> Shape:
    builder, material = ShapeBuilder(), carcass(rng)
    board = float(rng.uniform(0.015, 0.04))
    lift = float(rng.choice([board / 2, rng.uniform(0.04, 0.12)]))
    z = splits(rng, lift, height - board / 2, shelves, 0.0 if chance(rng, 0.5) else 0.15)
    uprights = 2 if width < 1.1 else int(rng.integers(2, 4))
    _boards(builder, depth, width, z, board, material, uprights)
    if back:
        size = (0.012, width - 0.004, z[-1] - lift)
        panel = box(size, (0.006 - depth / 2, 0, (z[-1] + lift) / 2))
        builder.add(panel, material if chance(rng, 0.7) else carcass(rng))
        if lift > board:
            low = (-depth / 2, -width / 2, 0)
            builder.add(box_between(low, (depth / 2 - 0.03, width / 2, lift)), material)
    filled = chance(rng, 0.5)
    if filled:
        ys = np.linspace(-width / 2, width / 2, uprights)
        for y in pairwise(ys.tolist()):
            _fill(builder, rng, depth, y, z, board)
    plain = not back and not filled
    return builder.build("bookshelf", style, Symmetry.TWO if plain else Symmetry.NONE)


def backed(rng: Rng) -> Shape:
    """The classic bookcase."""
    width, height = float(rng.uniform(0.6, 1.6)), float(rng.uniform(1.2, 2.2))
    shelves = max(3, round(height / float(rng.uniform(0.27, 0.4))))
    return _shelved(rng, "backed", width, float(rng.uniform(0.22, 0.4)), height, shelves, True)


def see_through(rng: Rng) -> Shape:
    """No back: a room divider."""
    width, height = float(rng.uniform(0.6, 1.6)), float(rng.uniform(1.0, 2.1))
    shelves = max(2, round(height / float(rng.uniform(0.28, 0.45))))
    depth = float(rng.uniform(0.24, 0.42))
    return _shelved(rng, "see_through", width, depth, height, shelves, False)


def tall_narrow(rng: Rng) -> Shape:
    """A tower."""
    width, height = float(rng.uniform(0.22, 0.5)), float(rng.uniform(1.4, 2.2))
    shelves = max(4, round(height / float(rng.uniform(0.25, 0.38))))
    depth = float(rng.uniform(0.18, 0.32))
    return _shelved(rng, "tall_narrow", width, depth, height, shelves, chance(rng, 0.7))


def low_wide(rng: Rng) -> Shape:
    """Under a window."""
    width, height = float(rng.uniform(0.9, 2.0)), float(rng.uniform(0.55, 1.05))
    depth = float(rng.uniform(0.25, 0.4))
    return _shelved(
        rng, "low_wide", width, depth, height, int(rng.integers(2, 4)), chance(rng, 0.75)
    )


def cubes(rng: Rng) -> Shape:
    """Square grid of boxes, some with books or baskets."""
    builder, material = ShapeBuilder(), carcass(rng)
    columns, rows = int(rng.integers(1, 5)), int(rng.integers(2, 6))
    pitch, board = float(rng.uniform(0.3, 0.42)), float(rng.uniform(0.016, 0.04))
    width, height = columns * pitch, rows * pitch
    depth = float(rng.uniform(0.28, 0.42))
    z = splits(rng, board / 2, height - board / 2, rows)
    _boards(builder, depth, width, z, board, material, columns + 1)
    back = chance(rng, 0.4)
    if back:
        builder.add(box((0.01, width, height), (0.005 - depth / 2, 0, height / 2)), material)
    basket, things = fabric(rng), chance(rng, 0.6)
    for y0, y1 in pairwise(np.linspace(-width / 2, width / 2, columns + 1).tolist()):
        for z0, z1 in pairwise(z) if things else ():
            roll = rng.random()
            if roll < 0.3:
                _books(builder, rng, depth / 2, y0 + board, y1 - board, z0 + board / 2, z1 - z0)
            elif roll < 0.5:
                low = (-depth / 2 + 0.02, y0 + board, z0 + board / 2)
                high = (depth / 2 - 0.01, y1 - board, z1 - board * 1.5)
                builder.add(box_between(low, high), basket)
    plain = not back and not things
    return builder.build("bookshelf", "cubes", Symmetry.TWO if plain else Symmetry.NONE)


def ladder(rng: Rng) -> Shape:
    """Leans against a wall: sloping rails, shelves deeper towards the floor."""
    builder, material = ShapeBuilder(), carcass(rng)
    frame = material if chance(rng, 0.5) else metal(rng)
    width, height = float(rng.uniform(0.5, 0.9)), float(rng.uniform(1.6, 2.0))
    depth, thick = float(rng.uniform(0.35, 0.5)), float(rng.uniform(0.025, 0.045))
    board, shelves = float(rng.uniform(0.015, 0.03)), int(rng.integers(4, 6))
    boxed = chance(rng, 0.3)
    for y in (-width / 2, width / 2):
        builder.add(bar((depth, y, 0), (thick, y, height), thick * 0.6, thick), frame)
        if chance(rng, 0.4):
            builder.add(bar((0, y, 0), (0, y, height), thick * 0.6, thick), frame)
    for z in np.linspace(0.08, 0.92, shelves) * height:
        front = depth + (thick - depth) * z / height + 0.02
        front = max(front, 0.12)
        low = (-thick / 2, -width / 2, z)
        builder.add(box_between(low, (front, width / 2, z + board)), material)
        if boxed:
            lip = box((board, width, 0.06), (front, 0, z + 0.03))
            builder.add(lip, material)
        if chance(rng, 0.3):
            _books(builder, rng, front, -width / 2 + 0.04, width / 2 - 0.04, z + board, 0.28)
    return builder.build("bookshelf", "ladder", Symmetry.NONE)


def industrial(rng: Rng) -> Shape:
    """Boards in a metal frame, often braced behind."""
    builder, frame, material = ShapeBuilder(), metal(rng), carcass(rng)
    width, depth = float(rng.uniform(0.6, 1.5)), float(rng.uniform(0.28, 0.45))
    height, thick = float(rng.uniform(1.2, 2.0)), float(rng.uniform(0.018, 0.035))
    board, round_posts = float(rng.uniform(0.018, 0.04)), chance(rng, 0.4)
    x, y = depth / 2 - thick / 2, width / 2 - thick / 2
    for side_x in (-x, x):
        for side_y in (-y, y):
            foot, head = (side_x, side_y, 0), (side_x, side_y, height)
            square = bar(foot, head, thick, thick)
            builder.add(rod(foot, head, thick / 2, segments=8) if round_posts else square, frame)
    levels = splits(rng, 0.1, height - board / 2, int(rng.integers(3, 6)), 0.1)
    for z in levels:
        builder.add(box((depth, width, board), (0, 0, z)), material)
    braced, filled = chance(rng, 0.4), chance(rng, 0.4)
    if braced:
        low, high = levels[0], levels[-1]
        builder.add(bar((-x, -y, low), (-x, y, high), 0.012, 0.006), frame)
        builder.add(bar((-x, y, low), (-x, -y, high), 0.012, 0.006), frame)
    if filled:
        _fill(builder, rng, depth, (-width / 2 + 0.03, width / 2 - 0.03), levels, board)
    plain = not braced and not filled
    return builder.build("bookshelf", "industrial", Symmetry.TWO if plain else Symmetry.NONE)


def corner(rng: Rng) -> Shape:
    """Quarter-round or five-sided boards in the corner of a room."""
    builder, material = ShapeBuilder(), carcass(rng)
    side, height = float(rng.uniform(0.28, 0.6)), float(rng.uniform(1.0, 2.0))
    board = float(rng.uniform(0.015, 0.03))
    if chance(rng, 0.5):
        edge = arc((0, 0), side, 0, np.pi / 2, 8)
    else:
        wing = side * float(rng.uniform(0.35, 0.6))
        edge = np.array([(side, 0), (side, wing), (wing, side), (0, side)])
    turn = np.array([[1, 1], [-1, 1]]) / np.sqrt(2)  # the corner at the back, the opening at +x
    plan = np.concatenate([[(0.0, 0.0)], edge]) @ turn.T
    levels = splits(rng, float(rng.uniform(0, 0.1)), height - board, int(rng.integers(3, 6)))
    for z in levels:
        builder.add(extrude(plan, board, z), material)
    if chance(rng, 0.7):
        for end in ((side, 0.0), (0.0, side)):
            x, y = (np.array(end) @ turn.T / 2).tolist()
            wall = box((side, board, height)).rotate((0, 0, float(np.degrees(np.arctan2(y, x)))))
            builder.add(wall.translate((x, y, height / 2)), material)
    else:
        for end in ((0.02, 0.02), (side - 0.03, 0.02), (0.02, side - 0.03)):
            x, y = (np.array(end) @ turn.T).tolist()
            builder.add(rod((x, y, 0), (x, y, height), 0.014), metal(rng))
    return builder.build("bookshelf", "corner", Symmetry.NONE)


def stepped(rng: Rng) -> Shape:
    """A stair of boxes, or columns of unequal height."""
    builder, material = ShapeBuilder(), carcass(rng)
    columns, pitch = int(rng.integers(2, 5)), float(rng.uniform(0.3, 0.42))
    depth, board = float(rng.uniform(0.26, 0.4)), float(rng.uniform(0.016, 0.035))
    rows = np.arange(1, columns + 1)
    rows = (
        rows if chance(rng, 0.5) else rows[::-1] if chance(rng, 0.6) else rng.permutation(rows + 1)
    )
    for column, count in enumerate(rows.tolist()):
        y0 = (column - columns / 2) * pitch
        for y in (y0, y0 + pitch):
            builder.add(box((depth, board, count * pitch), (0, y, count * pitch / 2)), material)
        for z in np.linspace(board / 2, count * pitch - board / 2, count + 1):
            builder.add(box((depth, pitch + board, board), (0, y0 + pitch / 2, z)), material)
        low = (-depth / 2, y0, 0)
        builder.add(box_between(low, (0.01 - depth / 2, y0 + pitch, count * pitch)), material)
        for level in range(count) if chance(rng, 0.4) else ():
            z = level * pitch + board
            _books(builder, rng, depth / 2, y0 + board, y0 + pitch - board, z, pitch - 0.05)
    return builder.build("bookshelf", "stepped", Symmetry.NONE)


def doored(rng: Rng) -> Shape:
    """Open shelves above, doors or drawers below."""
    builder, look = ShapeBuilder(), random_look(rng)
    width, depth = float(rng.uniform(0.6, 1.3)), float(rng.uniform(0.3, 0.42))
    height, base = float(rng.uniform(1.5, 2.2)), float(rng.uniform(0.04, 0.1))
    waist = float(rng.uniform(0.3, 0.45)) * height
    kind = "double" if chance(rng, 0.7) else "drawer"
    shelves = int(rng.integers(2, 5))
    cells = [
        Cell(-width / 2, width / 2, base, waist, kind),
        Cell(-width / 2, width / 2, waist, height, "open", shelves=shelves),
    ]
    add_base(builder, rng, "plinth", depth, width, base, look.body)
    add_case(builder, look, (-depth / 2, -width / 2, base), (depth / 2, width / 2, height), cells)
    if chance(rng, 0.5):
        levels = np.linspace(waist, height, shelves + 2).tolist()
        _fill(builder, rng, depth, (-width / 2 + 0.03, width / 2 - 0.03), levels, look.board)
    return builder.build("bookshelf", "doored", Symmetry.NONE)


def a_frame(rng: Rng) -> Shape:
    """Legs that meet upwards, boards that shrink with them."""
    builder = ShapeBuilder()
    material = plastic(rng) if chance(rng, 0.3) else carcass(rng)
    width, foot = float(rng.uniform(0.5, 0.9)), float(rng.uniform(0.4, 0.6))
    height, thick = float(rng.uniform(1.1, 1.8)), float(rng.uniform(0.025, 0.04))
    head = float(rng.uniform(0.12, 0.25))
    for y in (-width / 2, width / 2):
        for sign in (-1, 1):
            leg = bar((sign * foot / 2, y, 0), (sign * head / 2, y, height), thick * 0.6, thick)
            builder.add(leg, material)
    for z in np.linspace(float(rng.uniform(0.1, 0.25)), height - 0.03, int(rng.integers(3, 6))):
        deep = foot + (head - foot) * z / height
        builder.add(box((deep, width, 0.022), (0, 0, z)), material)
    return builder.build("bookshelf", "a_frame", Symmetry.TWO)


STYLES: dict[str, dict[str, Callable[[Rng], Shape]]] = {
    "bookshelf": {
        "backed": backed,
        "see_through": see_through,
        "tall_narrow": tall_narrow,
        "low_wide": low_wide,
        "cubes": cubes,
        "ladder": ladder,
        "industrial": industrial,
        "corner": corner,
        "stepped": stepped,
        "doored": doored,
        "a_frame": a_frame,
    }
}
