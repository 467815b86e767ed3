"""Tables: rectangular ones are long along Y; symmetric as their tops and legs are."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from composenet.records import Symmetry
from composenet.synth.furniture.chair_parts import legs_between
from composenet.synth.furniture.parts import (
    Rng,
    Solid,
    box,
    chance,
    extrude,
    fabric,
    glass,
    loft_z,
    metal,
    oval,
    paint,
    rounded_rectangle,
    stone,
    wood,
)
from composenet.synth.furniture.table_parts import (
    Board,
    cross_legs,
    dining_height,
    drum,
    four_legs,
    loops,
    pedestal,
    rectangle,
    round_board,
    round_legs,
    symmetry_of,
    top,
    trestle,
)
from composenet.synth.shape import Material, Shape, ShapeBuilder


def _material(rng: Rng) -> tuple[Material, Material]:
    """Of the top and of the legs."""
    legs = wood(rng) if chance(rng, 0.65) else (metal(rng) if chance(rng, 0.6) else paint(rng))
    if chance(rng, 0.6):
        return legs, legs
    return [wood, wood, paint, stone, glass][rng.integers(5)](rng), legs


def _finish(
    board: Board, solids: list[Solid], order: int, rng: Rng, style: str, lower: bool = False
) -> Shape:
    """Top on legs, with a shelf below if asked."""
    builder = ShapeBuilder()
    surface, legs = _material(rng)
    if style == "glass":
        surface = glass(rng)
    for solid in top(board, rng):
        builder.add(solid, surface)
    for solid in solids:
        builder.add(solid, legs)
    if lower:
        z = board.height * rng.uniform(0.15, 0.5)
        shrink = 0.9 * board.square
        builder.add(extrude(board.outline * shrink, rng.uniform(0.012, 0.03), z), legs)
    return builder.build("table", style, symmetry_of(board.order, order))


def _dining_table(rng: Rng) -> Shape:
    deep = rng.uniform(0.68, 1.05)
    board = rectangle(rng, deep, deep * rng.uniform(1.25, 2.4), dining_height(rng))
    return _finish(board, four_legs(board, rng), 2, rng, "dining")


def _square_table(rng: Rng) -> Shape:
    side = rng.uniform(0.6, 1.15)
    board = rectangle(rng, side, side, dining_height(rng))
    if chance(rng, 0.3):
        column, order = pedestal(board, rng)
        return _finish(board, column, order, rng, "square")
    return _finish(board, four_legs(board, rng), 4, rng, "square")


def _round_pedestal_table(rng: Rng) -> Shape:
    height = rng.uniform(1.0, 1.12) if chance(rng, 0.14) else dining_height(rng)
    board = round_board(
        rng, rng.uniform(0.6, 0.75) if height > 0.9 else rng.uniform(0.6, 1.4), height
    )
    column, order = pedestal(board, rng)
    return _finish(board, column, order, rng, "round_pedestal")


def _round_table(rng: Rng) -> Shape:
    board, count = (
        round_board(rng, rng.uniform(0.75, 1.5), dining_height(rng)),
        int(rng.choice([3, 4])),
    )
    return _finish(board, round_legs(board, rng, count), count, rng, "round_legs")


def _oval_table(rng: Rng) -> Shape:
    deep = rng.uniform(0.75, 1.15)
    board = round_board(rng, deep, dining_height(rng), deep * rng.uniform(1.35, 2.1))
    legs = [four_legs, four_legs, trestle][rng.integers(3)]
    return _finish(board, legs(board, rng), 2, rng, "oval")


def _trestle_table(rng: Rng) -> Shape:
    board = rectangle(rng, rng.uniform(0.65, 1.0), rng.uniform(1.3, 2.4), dining_height(rng))
    return _finish(board, trestle(board, rng), 2, rng, "trestle")


def _x_table(rng: Rng) -> Shape:
    board = rectangle(rng, rng.uniform(0.55, 0.95), rng.uniform(0.95, 2.0), dining_height(rng))
    return _finish(board, cross_legs(board, rng), 2, rng, "x_legs")


def _block_table(rng: Rng) -> Shape:
    """Parsons, waterfall and frame tables."""
    low = chance(rng, 0.4)
    height = rng.uniform(0.32, 0.48) if low else dining_height(rng)
    deep = rng.uniform(0.45, 0.95)
    board = rectangle(rng, deep, deep * rng.uniform(1.2, 2.3), height)
    return _finish(board, loops(board, rng), 2, rng, "block")


def _coffee_table(rng: Rng) -> Shape:
    deep, height = rng.uniform(0.45, 0.85), rng.uniform(0.3, 0.5)
    board = rectangle(rng, deep, deep * rng.choice([1.0, rng.uniform(1.2, 2.4)]), height)
    legs, order = four_legs(board, rng), board.order
    return _finish(board, legs, order, rng, "coffee", lower=chance(rng, 0.65))


def _coffee_round(rng: Rng) -> Shape:
    """Low and round: legs, pedestal, drum or nested discs."""
    board = round_board(rng, rng.uniform(0.5, 1.05), rng.uniform(0.3, 0.5))
    kind = rng.integers(4)
    if kind == 0:
        count = int(rng.choice([3, 4]))
        legs = round_legs(board, rng, count)
        return _finish(board, legs, count, rng, "coffee_round", lower=chance(rng, 0.3))
    if kind == 1:
        column, order = pedestal(board, rng)
        return _finish(board, column, order, rng, "coffee_round")
    return _finish(board, drum(board, rng, 0.2, 0.46), 0, rng, "coffee_round")


def _side_table(rng: Rng) -> Shape:
    """Small, beside a bed or sofa."""
    height, across = rng.uniform(0.42, 0.68), rng.uniform(0.3, 0.55)
    if chance(rng, 0.5):
        board = round_board(rng, across, height)
        if chance(rng, 0.5):
            column, order = pedestal(board, rng)
            return _finish(board, column, order, rng, "side")
        count = int(rng.choice([3, 4]))
        return _finish(board, round_legs(board, rng, count), count, rng, "side", chance(rng, 0.3))
    board = rectangle(rng, across, across * rng.choice([1.0, rng.uniform(1.1, 1.5)]), height)
    return _finish(board, four_legs(board, rng), board.order, rng, "side", chance(rng, 0.5))


def _console_table(rng: Rng) -> Shape:
    """Narrow, against a wall; now and then with shelves."""
    board = rectangle(rng, rng.uniform(0.28, 0.45), rng.uniform(0.8, 1.6), rng.uniform(0.72, 0.92))
    kind = rng.integers(3)
    legs = [four_legs, loops, cross_legs][kind](board, rng)
    return _finish(board, legs, 2, rng, "console", lower=bool(kind < 2) and chance(rng, 0.5))


def _glass_table(rng: Rng) -> Shape:
    height = rng.uniform(0.34, 0.46) if chance(rng, 0.5) else dining_height(rng)
    if chance(rng, 0.4):
        board = round_board(rng, rng.uniform(0.7, 1.2), height)
        column, order = pedestal(board, rng)
        return _finish(board, column, order, rng, "glass")
    deep = rng.uniform(0.55, 0.95)
    board = rectangle(rng, deep, deep * rng.uniform(1.2, 2.0), height)
    legs = [four_legs, loops, cross_legs][rng.integers(3)](board, rng)
    return _finish(board, legs, 2, rng, "glass")


def _drop_leaf_table(rng: Rng) -> Shape:
    """Narrow middle, leaves hanging on one or both sides or folded out."""
    builder, surface = ShapeBuilder(), wood(rng)
    deep, middle, height = rng.uniform(0.65, 0.95), rng.uniform(0.35, 0.6), dining_height(rng)
    leaf, thick = rng.uniform(0.28, 0.45), rng.uniform(0.018, 0.03)
    core = rectangle(rng, deep, middle, height)
    board = Board(rounded_rectangle(deep, middle, 0.003, 1), deep, middle, height, thick, 2, 1.0)
    builder.add(extrude(board.outline, thick, board.under), surface)
    state = int(rng.integers(3))  # leaves hanging: both, one, on neither side
    for side, hangs in ((1, state < 2), (-1, state == 0)):
        size = (deep, thick, leaf) if hangs else (deep, leaf, thick)
        y = middle / 2 + (thick / 2 + 0.002 if hangs else leaf / 2 - 0.002)
        z = height - (leaf / 2 if hangs else thick / 2)
        builder.add(box(size, (0, side * y, z)), surface)
    for solid in four_legs(core, rng):
        builder.add(solid, surface)
    return builder.build("table", "drop_leaf", Symmetry.NONE if state == 1 else Symmetry.TWO)


def _double_pedestal(rng: Rng) -> Shape:
    """Long, on two columns: discs, feet or drums."""
    deep = rng.uniform(0.85, 1.2)
    long, height = deep * rng.uniform(1.6, 2.6), dining_height(rng)
    oblong = chance(rng, 0.5)
    board = round_board(rng, deep, height, long) if oblong else rectangle(rng, deep, long, height)
    column = pedestal(board, rng)[0] if chance(rng, 0.6) else drum(board, rng, 0.2, 0.34)
    y = long * rng.uniform(0.22, 0.3)
    turned = [solid.rotate((0.0, 0.0, 180.0)).translate((0.0, -y, 0.0)) for solid in column]
    both = [solid.translate((0.0, y, 0.0)) for solid in column] + turned
    return _finish(board, both, 2, rng, "double_pedestal")


def _cloth(rng: Rng) -> Shape:
    """Under a table cloth that hangs in folds, more or less far down."""
    builder, cloth, height = ShapeBuilder(), fabric(rng), dining_height(rng)
    deep = rng.uniform(0.7, 1.1)
    long = deep * rng.choice([1.0, rng.uniform(1.3, 2.2)])
    is_round = chance(rng, 0.5)
    power = 2.0 if is_round else 8.0
    outline = oval(deep, long, power, 48)
    hang = rng.uniform(0.15, 0.98) * height if chance(rng, 0.6) else rng.uniform(0.12, 0.3)
    folds, wave = 4 * int(rng.integers(2, 4)), rng.uniform(0.0, 0.045)
    turn = (np.arange(48) + 0.5) * 2 * np.pi / 48
    skirt = outline * (1 + wave * (1 + np.cos(folds * turn)))[:, None]
    heights = np.array([height - hang, height - 0.4 * hang, height - 0.01, height])
    shares = np.array([1.0, 0.6, 0.0, -0.05])
    builder.add(
        loft_z([outline + share * (skirt - outline) for share in shares], heights.tolist()), cloth
    )
    board = Board(outline, deep, long, height - hang + 0.01, 0.005, 0, 0.68 if is_round else 0.9)
    if hang < 0.9 * height:
        for solid in legs_between(
            board.corners(0.0, 0.05), board.corners(board.under, 0.05), 0.05, 0.8, 4
        ):
            builder.add(solid, wood(rng))
    return builder.build("table", "cloth", Symmetry.FOUR if deep == long else Symmetry.TWO)


def _high(rng: Rng) -> Shape:
    """Counter or bar height."""
    deep, height = rng.uniform(0.5, 0.8), rng.uniform(0.88, 1.1)
    board = rectangle(rng, deep, deep * rng.uniform(1.2, 2.6), height)
    legs = [four_legs, trestle, loops][rng.integers(3)]
    return _finish(board, legs(board, rng), 2, rng, "high", lower=chance(rng, 0.2))


STYLES: dict[str, dict[str, Callable[[Rng], Shape]]] = {
    "table": {
        "dining": _dining_table,
        "square": _square_table,
        "round_pedestal": _round_pedestal_table,
        "round_legs": _round_table,
        "oval": _oval_table,
        "trestle": _trestle_table,
        "x_legs": _x_table,
        "block": _block_table,
        "coffee": _coffee_table,
        "coffee_round": _coffee_round,
        "side": _side_table,
        "console": _console_table,
        "glass": _glass_table,
        "drop_leaf": _drop_leaf_table,
        "double_pedestal": _double_pedestal,
        "cloth": _cloth,
        "high": _high,
    }
}
