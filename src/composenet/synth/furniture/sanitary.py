"""What bathtubs, sinks and toilets share: hollow vessels and taps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from composenet.synth.furniture.parts import Rng, Solid, chance, loft, rod, tube
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
