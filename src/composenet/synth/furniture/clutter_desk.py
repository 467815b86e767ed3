"""What stands on desks and nowhere else. The sitter's side is +X."""

from __future__ import annotations

from composenet.synth.furniture.clutter_parts import assemble
from composenet.synth.furniture.clutter_small import monitor
from composenet.synth.furniture.parts import (
    Rng,
    box,
    chance,
    cushion,
    cylinder,
    plastic,
    rounded_box,
)
from composenet.synth.shape import Material, Shape

_DARK = Material((0.04, 0.04, 0.05), shininess=0.6)


def screen(rng: Rng) -> Shape:
    """A monitor, seldom one with a picture tube."""
    return _picture_tube(rng) if chance(rng, 0.2) else monitor(rng)


def keyboard(rng: Rng) -> Shape:
    """A keyboard, on most desks with a mouse at the sitter's right."""
    wide, deep = rng.uniform(0.28, 0.46), rng.uniform(0.11, 0.17)
    keys = box((deep, wide, 0.022), (0, 0, 0.011))
    mouse = cushion((0.11, 0.06, 0.035), (0, wide / 2 + rng.uniform(0.05, 0.1), 0.017), 2.5, 8)
    stuff = plastic(rng)
    return assemble("keyboard", ([keys, mouse] if chance(rng, 0.8) else keys, stuff))


def _picture_tube(rng: Rng) -> Shape:
    """An old, deep screen: a front and a back that narrows."""
    wide, deep, lift = rng.uniform(0.36, 0.46), rng.uniform(0.36, 0.45), 0.05
    tall = wide * rng.uniform(0.8, 0.95)
    front = rounded_box((deep * 0.4, wide, tall), (deep * 0.3, 0, lift + tall / 2), 0.02)
    middle = (-deep * 0.2, 0, lift + tall * 0.48)
    back = rounded_box((deep * 0.6, wide * 0.75, tall * 0.75), middle, 0.04)
    face = box((0.01, wide * 0.86, tall * 0.82), (deep * 0.5, 0, lift + tall / 2))
    foot = cylinder(0.13, lift + 0.01, segments=14)
    body = plastic(rng)
    return assemble("picture_tube", ([front, back, foot], body), (face, _DARK))
