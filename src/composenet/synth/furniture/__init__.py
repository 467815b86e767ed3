"""Procedural furniture of the ten classes and clutter: `make_furniture("chair", rng)`."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from composenet.synth.furniture import (
    bathtubs,
    beds,
    bookshelves,
    cabinets,
    chairs,
    clutter,
    desks,
    heavy,
    heavy_beds,
    sinks,
    sofas,
    tables,
    toilets,
)
from composenet.synth.shape import Shape

_MODULES = (
    bathtubs,
    beds,
    bookshelves,
    cabinets,
    chairs,
    clutter,
    desks,
    sinks,
    sofas,
    tables,
    toilets,
)
Builders = dict[str, Callable[[np.random.Generator], Shape]]
STYLES: dict[str, Builders] = {
    class_name: builders for module in _MODULES for class_name, builders in module.STYLES.items()
}
FURTHER_STYLES: dict[str, Builders] = (
    {name: {} for name in STYLES} | heavy.STYLES | heavy_beds.STYLES | toilets.FURTHER_STYLES
)
"""Drawn by training alone: they came after the val and test splits had been fixed."""


def styles(class_name: str) -> tuple[str, ...]:
    """Names of a class's styles, those of training alone last. Raises KeyError for an unknown
    class."""
    return (*STYLES[class_name], *FURTHER_STYLES[class_name])


def make_furniture(
    class_name: str, rng: np.random.Generator, style: str | None = None, *, further: bool = False
) -> Shape:
    """One random piece of furniture (or "clutter"), metres, object axes, centred.

    style: one of styles(class_name), or None for a random one, with further True of all of them.
    Deterministic from rng. Raises KeyError for an unknown class or style.
    """
    builders = STYLES[class_name]
    if further or style is not None:
        builders = builders | FURTHER_STYLES[class_name]
    chosen = str(rng.choice(list(builders))) if style is None else style
    return builders[chosen](rng)
