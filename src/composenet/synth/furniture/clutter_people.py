"""Figures of people: they stand, walk or sit in rooms and are no furniture."""

from __future__ import annotations

import numpy as np

from composenet.records import Symmetry
from composenet.synth.furniture.clutter_parts import head, limb, torso
from composenet.synth.furniture.parts import Rng, chance, cushion, fabric, leather, rounded_box
from composenet.synth.shape import Material, Shape, ShapeBuilder

_SKIN = ((0.87, 0.70, 0.58), (0.72, 0.53, 0.40), (0.45, 0.30, 0.21), (0.30, 0.20, 0.15))


def _add_upper_body(
    builder: ShapeBuilder, rng: Rng, tall: float, hip: np.ndarray, lean: float, reach: float
) -> None:
    """Torso, arms and head of a person so tall, above the hip. reach: how far (radians) the
    fore arms are lifted to the front."""
    skin, hair = Material(_SKIN[rng.integers(4)]), Material((0.15, 0.1, 0.08))
    cloth, build = fabric(rng), rng.uniform(0.85, 1.3)
    neck = hip + np.array([lean, 0, 0.30 * tall])
    widths = 0.2 * tall * np.array([0.95, 0.8, 0.98, 1.08, 0.4]) * np.sqrt(build)
    depths = 0.125 * tall * np.array([1.0, 0.9, 1.05, 0.75, 0.45]) * build
    builder.add(torso(hip - (0, 0, 0.03), neck, widths, depths), cloth)
    for side in (1, -1):
        shoulder = neck + np.array([0, side * 0.105 * tall, -0.03 * tall])
        out = rng.uniform(0.0, 0.05) * tall
        swing = rng.uniform(-0.25, 0.3)
        elbow = shoulder + 0.17 * tall * np.array([np.sin(swing), side * out, -np.cos(swing)])
        lift = swing + reach * rng.uniform(0.6, 1.1) + rng.uniform(0, 0.3)
        wrist = elbow + 0.19 * tall * np.array([np.sin(lift), -side * 0.1, -np.cos(lift)])
        thick = 0.026 * tall * np.sqrt(build)
        for solid in limb([shoulder, elbow, wrist], thick * np.array([1.1, 0.9, 0.65])):
            builder.add(solid, cloth)
        builder.add(cushion((0.07, 0.05, 0.09), wrist, 2.5, 6), skin)
    skull, cap = head(rng, neck, 0.135 * tall)
    for solid in skull:
        builder.add(solid, skin)
    builder.add(cap, hair)


def standing(rng: Rng) -> Shape:
    """Standing or walking, 1.1 to 1.95 m tall."""
    builder, tall = (
        ShapeBuilder(),
        rng.uniform(1.1, 1.5) if chance(rng, 0.15) else rng.uniform(1.5, 1.95),
    )
    stride, trousers, shoes = rng.uniform(-0.35, 0.35), fabric(rng), leather(rng)
    hip = np.array([0, 0, 0.50 * tall])
    for side in (1, -1):
        angle, bend = stride * side, rng.uniform(0, 0.3)
        joint = hip + np.array([0, side * 0.05 * tall, 0])
        knee = joint + 0.25 * tall * np.array([np.sin(angle), 0, -np.cos(angle)])
        foot = np.array([knee[0] + 0.22 * tall * np.sin(angle - bend), knee[1], 0.06])
        thick = 0.043 * tall * np.array([1.15, 0.85, 0.6])
        for solid in limb([joint, knee, foot], thick):
            builder.add(solid, trousers)
        builder.add(rounded_box((0.25, 0.09, 0.08), foot + np.array([0.06, 0, -0.02]), 0.03), shoes)
    if chance(rng, 0.2):  # a skirt
        low = hip - np.array([0, 0, rng.uniform(0.12, 0.35) * tall])
        builder.add(
            torso(low, hip, [0.34 * tall * 0.8, 0.2 * tall], [0.3 * tall * 0.8, 0.14 * tall]),
            trousers,
        )
    _add_upper_body(builder, rng, tall, hip, rng.uniform(-0.02, 0.06), rng.choice([0.0, 1.2]))
    return builder.build("clutter", "standing_person", Symmetry.NONE)


def sitting(rng: Rng) -> Shape:
    """Sitting on a pouf or on the floor, legs to the front."""
    builder, tall = ShapeBuilder(), rng.uniform(1.2, 1.9)
    trousers, shoes, height = fabric(rng), leather(rng), rng.uniform(0.0, 0.48)
    if height > 0.2:
        builder.add(rounded_box((0.42, 0.45, height), (0.02, 0, height / 2), 0.04), fabric(rng))
    else:
        height = 0.02
    hip = np.array([0, 0, height + 0.06 * tall])
    for side in (1, -1):
        joint = hip + np.array([0, side * 0.055 * tall, 0])
        spread = rng.uniform(0.0, 0.3) * side
        lift = 0.0 if height > 0.2 else rng.uniform(0.1, 0.9)
        knee = joint + 0.24 * tall * np.array(
            [np.cos(lift) * np.cos(spread), np.sin(spread), np.sin(lift)]
        )
        drop = max(knee[2] - 0.06, 0.02)
        forward = np.sqrt(max((0.23 * tall) ** 2 - drop**2, 0.0)) * (0.3 if height > 0.2 else 0.9)
        foot = np.array([knee[0] + forward, knee[1], 0.06])
        for solid in limb([joint, knee, foot], 0.043 * tall * np.array([1.2, 0.85, 0.6])):
            builder.add(solid, trousers)
        builder.add(rounded_box((0.25, 0.09, 0.08), foot + np.array([0.06, 0, -0.02]), 0.03), shoes)
    _add_upper_body(builder, rng, tall, hip, rng.uniform(-0.12, 0.15), rng.uniform(0.5, 1.5))
    return builder.build("clutter", "sitting_person", Symmetry.NONE)
