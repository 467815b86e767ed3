"""What bathtubs, sinks and toilets share: hollow vessels and taps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from composenet.synth.furniture.parts import Rng, Solid, box, chance, loft, loft_z, oval, rod, tube
from composenet.synth.shape import Material, ShapeBuilder

Outline = NDArray[np.float64]


def basin(sections: Sequence[tuple[Outline, float | NDArray[np.float64]]]) -> Solid:
    """A hollow vessel as one skin: outlines (K, 2) with their heights (a number or (K,)), up the
    outside, over the rim and down the inside."""
    rings = [
        np.column_stack([outline, np.broadcast_to(height, len(outline))])
        for outline, height in sections
    ]
    return loft(np.stack(rings))


def add_tap(
    builder: ShapeBuilder,
    rng: Rng,
    foot: tuple[float, float, float],
    towards: tuple[float, float],
    height: float,
    reach: float,
    material: Material,
) -> None:
    """A tap standing on `foot` with its spout turned to the direction `towards` (x, y)."""
    at, way = np.array(foot), np.array([*towards, 0.0]) / np.hypot(*towards)
    up = np.array([0.0, 0.0, 1.0])
    top = at + height * up
    if chance(rng, 0.5):  # an arched spout
        bow = [at, top - 0.3 * reach * up, top + 0.15 * reach * way, top + 0.75 * reach * way]
        bow.append(top + reach * way - 0.35 * min(height, reach) * up)
    else:
        bow = [at, top, top + reach * way - 0.1 * reach * up]
    builder.add(tube(bow, float(rng.uniform(0.01, 0.016)), 8), material)
    across = np.array([-way[1], way[0], 0.0])
    if chance(rng, 0.5):  # two handles
        for side in (-0.09, 0.09):
            base = at + side * across
            builder.add(rod(base, base + 0.05 * up, 0.016, 0.02, 8), material)
    else:
        lever = at + 0.6 * height * up
        builder.add(rod(lever, lever + 0.07 * across + 0.02 * up, 0.009, 0.006, 8), material)


def top_with_bowl(
    rng: Rng,
    size: tuple[float, float, float],
    z: float,
    bowls: list[tuple[float, float]],
    deep: float,
    power: float,
) -> tuple[Solid, list[Solid], list[Solid]]:
    """A counter slab of `size` whose top is at z with bowls (centre y, width) sunk into it.
    Returns the slab with its holes, the bowls, and what they displace in a case below."""
    depth, width, thick = size
    front, back = float(rng.uniform(0.04, 0.08)), float(rng.uniform(0.1, 0.16))
    x0, x1 = back - depth / 2, depth / 2 - front
    slab = box((depth, width, thick), (0, 0, z - thick / 2))
    vessels, cuts = [], []
    for y, bowl_width in bowls:
        hole = oval(x1 - x0, bowl_width, power, 24, ((x0 + x1) / 2, y))
        centre = np.array([(x0 + x1) / 2, y])
        slab = slab - loft_z([hole, hole], [z - thick - 1, z + 1])
        outer = (hole - centre) * 1.05 + centre
        shrunk = (hole - centre) * 0.8 + centre
        wall = (hole - centre) * 0.76 + centre
        cuts.append(loft_z([wall, hole, hole], [z - deep + 0.008, z - 0.5 * deep, z + 0.1]))
        vessels.append(
            basin(
                [
                    (shrunk, z - deep),
                    (outer, z - 0.5 * deep),
                    (outer, z + 0.004),
                    ((hole - centre) * 0.97 + centre, z + 0.004),
                    ((hole - centre) * 0.95 + centre, z - 0.5 * deep),
                    ((hole - centre) * 0.72 + centre, z - deep + 0.015),
                ]
            )
        )
    return slab, vessels, cuts
