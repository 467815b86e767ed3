"""What cabinets share: tops, bays behind doors, stacks of drawers."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from composenet.records import Symmetry
from composenet.synth.furniture.cases import (
    Cell,
    opened,
)
from composenet.synth.furniture.parts import (
    Rng,
    box,
    chance,
    rounded_box,
)
from composenet.synth.shape import Material, Shape, ShapeBuilder


def finish(builder: ShapeBuilder, style: str) -> Shape:
    return builder.build("cabinet", style, Symmetry.NONE)


def add_top(
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


def door(rng: Rng, y0: float, y1: float, z0: float, z1: float, shelves: int = 1) -> Cell:
    """A compartment behind one door, or two where it is wide."""
    kind = "double" if y1 - y0 > 0.62 else str(rng.choice(["left", "right"]))
    return Cell(y0, y1, z0, z1, kind, opened(rng), shelves)


def stacked_drawers(rng: Rng, y0: float, y1: float, z0: float, z1: float, count: int) -> list[Cell]:
    """Drawers over one another, the lower ones often higher."""
    share = np.linspace(float(rng.uniform(1.0, 1.8)), 1.0, count)
    edges = z0 + (z1 - z0) * np.concatenate([[0.0], np.cumsum(share / share.sum())])
    return [
        Cell(y0, y1, float(low), float(high), "drawer", opened(rng, 0.08))
        for low, high in pairwise(edges)
    ]


def pairs(edges: list[float]) -> list[tuple[float, float]]:
    return list(pairwise(edges))
