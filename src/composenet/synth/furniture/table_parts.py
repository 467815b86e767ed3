"""Tops and supports that tables and desks are put together from."""

from __future__ import annotations

from dataclasses import dataclass
from math import gcd

import numpy as np
from numpy.typing import NDArray

from composenet.records import Symmetry
from composenet.synth.furniture.chair_parts import apron, legs_between, star_base, tulip_base
from composenet.synth.furniture.curves import bent_path, post, soft_slab
from composenet.synth.furniture.parts import (
    Rng,
    Solid,
    bar,
    box,
    chance,
    extrude,
    oval,
    ring,
    rod,
    rounded_rectangle,
    tube,
)

_SYMMETRIES = {0: Symmetry.INF, 4: Symmetry.FOUR, 2: Symmetry.TWO}


@dataclass(frozen=True)
class Board:
    """A table top. outline: (K, 2), centred, metres; deep (X), long (Y), height of its upper
    side, thickness; order: how often a full turn repeats it (0: any angle);
    square: share of the half widths that its diagonal corners reach."""

    outline: NDArray[np.float64]
    deep: float
    long: float
    height: float
    thick: float
    order: int
    square: float

    @property
    def under(self) -> float:
        """Height of its lower side."""
        return self.height - self.thick

    def corners(self, z: float, inset: float) -> NDArray[np.float64]:
        """(4, 3) leg positions under the board, further in where it is round."""
        out = np.array([(1, 1), (1, -1), (-1, -1), (-1, 1)], dtype=float)
        half = np.array([self.deep, self.long]) / 2
        return np.column_stack([out * (half * self.square - inset), np.full(4, z)])


def symmetry_of(*orders: int) -> Symmetry:
    """Symmetry of parts that each repeat so often in a full turn (0: round)."""
    return _SYMMETRIES.get(gcd(*orders), Symmetry.NONE)


def dining_height(rng: Rng) -> float:
    """Height of a table to sit at on a chair, metres."""
    return float(rng.uniform(0.70, 0.79))


def thickness(rng: Rng) -> float:
    """Thickness of a table top, metres."""
    return float(rng.uniform(0.016, 0.06))


def rectangle(rng: Rng, deep: float, long: float, height: float) -> Board:
    """Sharp, round-cornered or boat-shaped (bulging sides)."""
    kind, square = rng.integers(3), 1.0
    if kind == 0:
        outline = rounded_rectangle(deep, long, 0.003, 1)
    elif kind == 1:
        radius = rng.uniform(0.02, 0.16)
        outline, square = rounded_rectangle(deep, long, radius, 3), 1 - 0.6 * radius / deep
    else:
        power = rng.uniform(6, 12)
        outline, square = oval(deep, long, power, 20), 2 ** (-1 / power)
    order = 4 if deep == long else 2
    return Board(outline, deep, long, height, thickness(rng), order, square)


def round_board(rng: Rng, across: float, height: float, long: float | None = None) -> Board:
    """Round, or oval where long differs."""
    long = across if long is None else long
    outline = oval(across, long, 2.0 if long == across else rng.uniform(2, 2.8), 28)
    return Board(outline, across, long, height, thickness(rng), 0 if long == across else 2, 0.7)


def top(board: Board, rng: Rng) -> list[Solid]:
    """The board itself: square-edged, rounded or bevelled underneath."""
    kind = rng.integers(3)
    if kind == 0:
        return [extrude(board.outline, board.thick, board.under)]
    if kind == 1:
        return [soft_slab(board.outline, board.under, board.thick, board.thick)]
    upper = extrude(board.outline, board.thick * 0.6, board.under + board.thick * 0.4)
    lower = extrude(board.outline * 0.97, board.thick * 0.5, board.under)
    return [upper, lower]


def four_legs(board: Board, rng: Rng) -> list[Solid]:
    """Straight, tapered, turned, splayed or hairpin legs, most often with an apron."""
    kind = rng.integers(5)
    size = rng.uniform(0.035, 0.125) * min(1.0, 0.4 + board.height)
    inset = size / 2 + rng.choice([0.0, rng.uniform(0, 0.08)])
    tops = board.corners(board.under + 0.003, inset)
    if kind == 0:  # hairpin
        legs, span = [], rng.uniform(0.05, 0.09)
        for spot in tops:
            foot = spot * (1.02, 1.02, 0) + (0, 0, 0.006)
            for shift in ((0, span * np.sign(spot[1])), (span * np.sign(spot[0]), 0)):
                legs.append(rod(foot, spot - (*shift, 0), 0.006, segments=6))
        return legs
    feet = tops * (1, 1, 0)
    if kind == 1:  # turned
        legs = []
        for a, b in zip(feet, tops, strict=True):
            bulge = size * np.array([0.55, 0.8, 0.5, 1.0, 0.6, 1.0, 1.0])
            legs.append(post(a + np.linspace(0, 1, 7)[:, None] * (b - a), bulge, 10))
    elif kind == 2:  # splayed
        tops[:, :2] -= np.sign(tops[:, :2]) * rng.uniform(0.03, 0.12)
        legs = legs_between(feet, tops, size * 0.8, 0.6, int(rng.choice([4, 10])))
    else:
        legs = legs_between(feet, tops, size, rng.uniform(0.5, 1.0), int(rng.choice([4, 4, 10])))
    if chance(rng, 0.7):
        legs += apron(tops, rng.uniform(0.05, 0.13) * min(1.0, 0.3 + board.height), 0.02)
    if chance(rng, 0.2):
        at = feet + rng.uniform(0.1, 0.3) * (tops - feet)
        legs += [rod(at[i], at[(i + 1) % 4], 0.012, segments=8) for i in range(4)]
    return legs


def round_legs(board: Board, rng: Rng, count: int) -> list[Solid]:
    """Legs on a circle, splayed, with a ring or a lower disc now and then."""
    turn = np.pi / count + np.arange(count) * 2 * np.pi / count
    way = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    reach = board.deep / 2 * rng.uniform(0.6, 0.9)
    tops = way * reach * rng.uniform(0.6, 1.0) + (0, 0, board.under + 0.003)
    size = rng.uniform(0.025, 0.06)
    legs = legs_between(way * reach, tops, size, rng.uniform(0.5, 1), 10)
    if chance(rng, 0.4):
        share = rng.uniform(0.15, 0.6)
        radius = float(np.linalg.norm((way * reach * (1 - share) + tops * share)[0, :2]))
        legs.append(ring(radius, 0.012, (0, 0, share * board.under), 24))
    return legs


def pedestal(board: Board, rng: Rng) -> tuple[list[Solid], int]:
    """One column on a disc (order 0) or on curved feet (3 or 4)."""
    reach = board.deep * rng.uniform(0.26, 0.36)
    if chance(rng, 0.5):
        foot = tulip_base(rng, board.under + 0.003, reach)
        return foot, 0
    count = int(rng.choice([3, 4, 4]))
    if chance(rng, 0.3):
        return star_base(rng, board.under + 0.003, count, casters=False), count
    column = rng.uniform(0.04, 0.09)
    lift = board.height * rng.uniform(0.2, 0.45)
    path = np.linspace((0, 0, lift * 0.4), (0, 0, board.under + 0.003), 6)
    solids = [post(path, column * np.array([1.4, 1.0, 1.5, 1.0, 0.9, 1.8]), 12)]
    for angle in np.arange(count) * 2 * np.pi / count + np.pi / count:
        way = np.array([np.cos(angle), np.sin(angle), 0.0]) * reach
        foot = [(0, 0, lift), way * 0.5 + (0, 0, lift * 0.95), way + np.array([0, 0, 0.02])]
        solids.append(tube(bent_path(foot, 0.2, 3), rng.uniform(0.018, 0.021), 8))
    return solids, count


def trestle(board: Board, rng: Rng) -> list[Solid]:
    """Two supports near the ends and a beam between them: posts on feet, A-frames or X."""
    y, half = board.long * rng.uniform(0.28, 0.4), board.deep * rng.uniform(0.32, 0.46)
    size, under = rng.uniform(0.04, 0.09), board.under + 0.003
    kind = rng.integers(4)
    solids: list[Solid] = []
    for side in (y, -y):
        if kind == 0:  # post on a foot
            solids.append(box((2 * half, size * 1.2, size), (0, side, size / 2)))
            solids.append(box((2 * half * 0.9, size * 1.2, size), (0, side, under - size / 2)))
            columns = (0.0,) if half < 0.35 else (-half * 0.3, half * 0.3)
            solids += [box((size * 2, size, under), (x, side, under / 2)) for x in columns]
            continue
        spread = {1: (half, 0.25 * half), 2: (half, -half), 3: (0.7 * half, half)}[int(kind)]
        for fore in (1, -1):
            solids.append(bar((fore * spread[0], side, 0), (fore * spread[1], side, under),
                              size, size * 0.8))  # fmt: skip
        solids.append(box((2 * half * 0.95, size, size * 0.7), (0, side, under - size * 0.35)))
        if kind == 3:
            solids.append(box((2 * half * 0.7, size, size * 0.6), (0, side, 0.02 + size * 0.3)))
    if kind != 3 or chance(rng, 0.5):
        z = under * (0.5 if kind == 2 else rng.uniform(0.2, 0.6))
        solids.append(box((size * 0.6, 2 * y, size * 1.4), (0, 0, z)))
        if kind in (1, 3):
            solids.append(box((2 * half * 0.8, size * 0.8, size * 0.8), (0, y, z)))
            solids.append(box((2 * half * 0.8, size * 0.8, size * 0.8), (0, -y, z)))
    return solids


def cross_legs(board: Board, rng: Rng) -> list[Solid]:
    """Two inclined frames that cross in the middle, seen from the long side."""
    y, x = board.long * rng.uniform(0.3, 0.44), board.deep * rng.uniform(0.3, 0.44)
    size, under = rng.uniform(0.03, 0.07), board.under + 0.003
    solids = []
    for side in (1, -1):
        legs = [bar((fore, side * y, 0), (fore, -side * y, under), size, size) for fore in (x, -x)]
        solids += legs
        for z, share in ((size, 1.0), (under - size, -1.0)):
            spot = side * y * share * (1 - 2 * size / under)
            solids.append(box((2 * x, size, size), (0, spot, z)))
    solids.append(box((2 * x, size, size), (0, 0, under / 2)))
    return solids


def loops(board: Board, rng: Rng) -> list[Solid]:
    """Closed frames or slabs at both ends."""
    y, half = board.long / 2 - rng.uniform(0.03, 0.25), board.deep / 2 - rng.uniform(0, 0.06)
    size, under = rng.uniform(0.02, 0.08), board.under
    if chance(rng, 0.35):
        return [box((2 * half, size, under + 0.004), (0, s, under / 2)) for s in (y, -y)]
    wide, solids = rng.uniform(0.02, 0.1), []
    tilt = rng.choice([0.0, rng.uniform(0, 0.2)]) * half
    for side in (y, -y):
        for fore in (1, -1):
            solids.append(
                bar(
                    (fore * (half - size / 2), side, size / 2),
                    (fore * (half - size / 2 - tilt), side, under),
                    wide,
                    size,
                )
            )
        solids.append(box((2 * half, wide, size), (0, side, size / 2)))
        solids.append(box((2 * (half - tilt), wide, size), (0, side, under - size / 2 + 0.003)))
    return solids


def drum(board: Board, rng: Rng, low: float, high: float) -> list[Solid]:
    """One thick round body, waisted or bulging; its radius is that share of the depth."""
    path = np.linspace((0, 0, 0), (0, 0, board.under + 0.003), 5)
    swell = 1 + rng.uniform(-0.3, 0.06) * np.sin(np.linspace(0, np.pi, 5))
    return [post(path, 2 * board.deep * rng.uniform(low, high) * swell, 28)]
