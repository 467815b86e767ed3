"""Procedural furniture of the ten classes and clutter: `make_furniture("chair", rng)`."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib import import_module
from importlib.util import find_spec

import numpy as np

from composenet.synth.shape import Shape

Builder = Callable[[np.random.Generator], Shape]

_MODULES = (
    "bathtubs",
    "beds",
    "bookshelves",
    "cabinets",
    "chairs",
    "clutter",
    "sinks",
    "sofas",
    "tables",
    "toilets",
)


@cache
def _registry() -> dict[str, dict[str, Builder]]:
    """class -> style -> builder, of all modules."""
    registry: dict[str, dict[str, Builder]] = {}
    for name in _MODULES:
        if find_spec(f"{__name__}.{name}") is None:
            continue
        for class_name, builders in import_module(f"{__name__}.{name}").STYLES.items():
            registry.setdefault(class_name, {}).update(builders)
    return registry


def styles(class_name: str) -> tuple[str, ...]:
    """Names of a class's styles. Raises KeyError for an unknown class."""
    return tuple(_registry()[class_name])


def make_furniture(class_name: str, rng: np.random.Generator, style: str | None = None) -> Shape:
    """One random piece of furniture (or "clutter"), metres, object axes, centred.

    style: one of styles(class_name), or None for a random one. Deterministic from rng.
    Raises KeyError for an unknown class or style.
    """
    builders = _registry()[class_name]
    chosen = str(rng.choice(list(builders))) if style is None else style
    return builders[chosen](rng)
