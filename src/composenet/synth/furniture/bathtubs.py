"""Bathtubs, all hollow. The long side runs along Y; +X looks into the room."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from composenet.records import Symmetry
from composenet.synth.furniture.parts import (
    Rng,
    Solid,
    arc,
    bar,
    box,
    box_between,
    ceramic,
    chance,
    cylinder,
    glass,
    metal,
    oval,
    revolve,
    rounded_box,
    stone,
    tube,
    wood,
)
from composenet.synth.furniture.sanitary import Outline, add_tap, basin
from composenet.synth.shape import Shape, ShapeBuilder


def _oval_tub(
    rng: Rng, length: float, width: float, height: float, rise: float, power: float, lift: float
) -> Solid:
    """A tub with sloping walls. rise: how much the rim is higher at the -y end; lift: height of
    its bottom above the floor."""
    slope, wall = float(rng.uniform(0.72, 0.95)), float(rng.uniform(0.025, 0.06))
    outer = oval(width, length, power, 28)
    rim = lift + height + rise * np.clip(-outer[:, 1] / (length / 2), 0, 1) ** 2
    belly = lift + 0.45 * height
    inner = oval(width - 2 * wall, length - 2 * wall, power, 28)
    lip = float(rng.uniform(1.0, 1.05))
    floor = lift + float(rng.uniform(0.05, 0.1))
    return basin(
        [
            (outer * slope * 0.93, lift),
            (outer * (slope + 0.02), lift + 0.05),
            (outer * (0.4 * slope + 0.6), belly),
            (outer * lip, rim - 0.03),
            (outer * lip, rim),
            (inner, rim),
            (inner * (0.45 * slope + 0.5), belly),
            (inner * slope * 0.9, floor),
        ]
    )


def freestanding(rng: Rng) -> Shape:
    """Modern oval tub on the floor, level rim, sometimes with a floor tap."""
    builder, body = ShapeBuilder(), ceramic(rng)
    length, width = float(rng.uniform(1.4, 1.85)), float(rng.uniform(0.68, 0.9))
    height, power = float(rng.uniform(0.5, 0.65)), float(rng.uniform(2.0, 4.0))
    builder.add(_oval_tub(rng, length, width, height, 0.0, power, 0.0), body)
    tap = chance(rng, 0.4)
    if tap:
        side = width / 2 + float(rng.uniform(0.04, 0.1))
        foot = (-side, float(rng.uniform(-0.2, 0.2)), 0.0)
        builder.add(cylinder(0.04, 0.02, foot, 12), metal(rng))
        add_tap(
            builder, rng, foot, (1, 0), height + float(rng.uniform(0.15, 0.35)), 0.25, metal(rng)
        )
    return builder.build("bathtub", "freestanding", Symmetry.NONE if tap else Symmetry.TWO)


def slipper(rng: Rng) -> Shape:
    """One end high for the back, on a plinth or straight on the floor."""
    builder, body = ShapeBuilder(), ceramic(rng)
    length, width = float(rng.uniform(1.45, 1.8)), float(rng.uniform(0.68, 0.82))
    lift = float(rng.choice([0.0, rng.uniform(0.04, 0.1)]))
    rise, power = float(rng.uniform(0.12, 0.28)), float(rng.uniform(2.0, 2.8))
    height = float(rng.uniform(0.48, 0.58))
    builder.add(_oval_tub(rng, length, width, height, rise, power, lift), body)
    if lift:
        builder.add(box((0.55 * width, 0.55 * length, lift + 0.04), (0, 0, lift / 2 + 0.02)), body)
    return builder.build("bathtub", "slipper", Symmetry.NONE)


def clawfoot(rng: Rng) -> Shape:
    """Cast-iron tub with a rolled rim on four feet, taps at one end."""
    builder, body, fittings = ShapeBuilder(), ceramic(rng), metal(rng)
    length, width = float(rng.uniform(1.4, 1.8)), float(rng.uniform(0.68, 0.8))
    lift, height = float(rng.uniform(0.1, 0.18)), float(rng.uniform(0.4, 0.5))
    rise = float(rng.choice([0.0, rng.uniform(0.08, 0.2)]))
    builder.add(_oval_tub(rng, length, width, height, rise, 2.4, lift), body)
    for x in (-0.3 * width, 0.3 * width):
        for y in (-0.3 * length, 0.3 * length):
            out = np.array([np.sign(x) * 0.05, np.sign(y) * 0.03, 0])
            hip = np.array([x, y, lift + 0.1]) + out
            claw = [
                hip - out,
                np.subtract(hip, (0, 0, 0.04)),
                (x * 1.12, y, lift * 0.4),
                (x * 1.25, y, 0.02),
            ]
            builder.add(tube(np.array(claw, dtype=float), 0.025, 6), fittings)
    if chance(rng, 0.7):
        end, rim = length / 2 + 0.02, lift + height
        foot = (0.0, end, 0.0) if chance(rng, 0.5) else (0.0, end - 0.05, rim)
        add_tap(builder, rng, foot, (0, -1), rim + 0.15 - foot[2], 0.18, fittings)
    return builder.build("bathtub", "clawfoot", Symmetry.NONE)


def _sunk(
    rng: Rng, width: float, length: float, height: float, rim: tuple[float, float], power: float
) -> list[tuple[Outline, float]]:
    """Inside of a built-in tub, from the rim down. rim: its breadth across and along."""
    slope = float(rng.uniform(0.72, 0.9))
    inner = oval(width - 2 * rim[0], length - 2 * rim[1], power, 28)
    shift = np.array([0.0, float(rng.uniform(-0.03, 0.03)) * length])
    return [
        (inner, height),
        (inner * (0.5 + 0.5 * slope) + 0.5 * shift, 0.5 * height),
        (inner * slope * (0.95, 1.0) + shift, float(rng.uniform(0.08, 0.16))),
    ]


def alcove(rng: Rng) -> Shape:
    """Built in along a wall: a box with an apron, tap at an end, sometimes a shower screen."""
    builder, body = ShapeBuilder(), ceramic(rng)
    length, width = float(rng.uniform(1.4, 1.85)), float(rng.uniform(0.68, 0.85))
    height = float(rng.uniform(0.42, 0.62))
    outer = oval(width, length, 40.0, 28)
    rim = (float(rng.uniform(0.04, 0.09)), float(rng.uniform(0.06, 0.14)))
    inside = _sunk(rng, width, length, height, rim, float(rng.uniform(2.5, 8.0)))
    builder.add(basin([(outer, 0.0), (outer, height), *inside]), body)
    if chance(rng, 0.5):  # apron with a lip over it
        low, high = (width / 2, -length / 2, height - 0.05), (width / 2 + 0.02, length / 2, height)
        builder.add(box_between(low, high), body)
    if chance(rng, 0.3):
        panel = box((0.02, 0.9 * length, 0.7 * height), (width / 2, 0, 0.45 * height))
        builder.add(panel, wood(rng))
    side = float(rng.choice([-1, 1]))
    if chance(rng, 0.7):
        foot = (0.0, side * (length / 2 - rim[1] / 2), height)
        add_tap(builder, rng, foot, (0, -side), 0.12, 0.16, metal(rng))
    if chance(rng, 0.2):
        wide = float(rng.uniform(0.6, 0.9))
        at = (width / 2 - 0.02, side * (length / 2 - wide / 2), height + 0.7)
        builder.add(box((0.012, wide, 1.4), at), glass(rng))
    return builder.build("bathtub", "alcove", Symmetry.NONE)


def rectangular(rng: Rng) -> Shape:
    """Free-standing block or thin-walled box, rectangular inside."""
    builder, body = ShapeBuilder(), ceramic(rng) if chance(rng, 0.7) else stone(rng)
    length, width = float(rng.uniform(1.45, 1.9)), float(rng.uniform(0.7, 0.95))
    height, wall = float(rng.uniform(0.48, 0.62)), float(rng.uniform(0.03, 0.1))
    taper = float(rng.uniform(0.88, 1.0))
    outer = oval(width, length, float(rng.uniform(8, 30)), 28)
    inner = oval(width - 2 * wall, length - 2 * wall, float(rng.uniform(5, 16)), 28)
    floor = float(rng.uniform(0.06, 0.14))
    tub = basin(
        [(outer * taper, 0), (outer, height), (inner, height), (inner * taper * 0.94, floor)]
    )
    builder.add(tub, body)
    tap = chance(rng, 0.5)
    if tap:
        foot = (-width / 2 + wall / 2, float(rng.uniform(-0.3, 0.3)), height)
        add_tap(builder, rng, foot, (1, 0), 0.15, 0.18, metal(rng))
    return builder.build("bathtub", "rectangular", Symmetry.NONE if tap else Symmetry.TWO)


def corner(rng: Rng) -> Shape:
    """Quarter-round or five-sided, its corner at the back (-x)."""
    builder, body = ShapeBuilder(), ceramic(rng)
    side, height = float(rng.uniform(1.2, 1.55)), float(rng.uniform(0.48, 0.62))
    bulge = float(rng.uniform(0.45, 0.62)) * side
    reach = float(rng.uniform(0.0, 0.35))
    front = arc((side - bulge, side - bulge), bulge, -reach, np.pi / 2 + reach, 12)
    plan = np.concatenate([[(0.0, 0.0), (side * 0.98, 0.0)], front, [(0.0, side * 0.98)]])
    plan = np.clip(plan, 0.0, side)
    turn = np.array([[1, 1], [-1, 1]]) / np.sqrt(2)
    outer = plan @ turn.T
    centre = np.array([0.42 * side * np.sqrt(2), 0.0])
    angle = np.arctan2(*(outer - centre).T[::-1])
    long, short = 0.62 * side, 0.4 * side
    inner = centre + np.stack([short * np.cos(angle), long * np.sin(angle)], axis=1)
    bottom = centre + (inner - centre) * 0.72
    rings = [(outer, 0.0), (outer, height), (inner, height), (bottom, 0.12)]
    builder.add(basin([(outline - centre, z) for outline, z in rings]), body)
    if chance(rng, 0.6):
        add_tap(builder, rng, (0.08 - 0.35 * side, 0, height), (1, 0), 0.12, 0.2, metal(rng))
    if chance(rng, 0.4):
        seat = box((0.14, 0.3, 0.03), (0.08 - 0.3 * side, 0, height + 0.015))
        builder.add(seat, body)
    return builder.build("bathtub", "corner", Symmetry.NONE)


def back_to_wall(rng: Rng) -> Shape:
    """Flat behind, round in front."""
    builder, body = ShapeBuilder(), ceramic(rng)
    length, width = float(rng.uniform(1.45, 1.8)), float(rng.uniform(0.7, 0.85))
    height, wall = float(rng.uniform(0.5, 0.62)), float(rng.uniform(0.03, 0.07))
    outer = oval(2 * width, length, float(rng.uniform(2.2, 3.5)), 40)
    outer = np.where(outer[:, :1] < 0, outer * (0.0, 1.0), outer) - (width / 2, 0)
    inner = outer * (1 - 2 * wall / width, 1 - 2.5 * wall / length)
    slope = float(rng.uniform(0.7, 0.92))
    rings = [(outer * (0.97, slope), 0.0), (outer, height), (inner, height), (inner * slope, 0.1)]
    builder.add(basin(rings), body)
    if chance(rng, 0.5):
        foot = (wall / 2 - width / 2, 0.0, height)
        add_tap(builder, rng, foot, (1, 0), 0.12, 0.16, metal(rng))
    return builder.build("bathtub", "back_to_wall", Symmetry.NONE)


def soaking(rng: Rng) -> Shape:
    """Deep round tub of staves or acrylic."""
    builder, body = ShapeBuilder(), wood(rng) if chance(rng, 0.6) else ceramic(rng)
    radius, height = float(rng.uniform(0.5, 0.8)), float(rng.uniform(0.6, 0.85))
    wall, taper = float(rng.uniform(0.03, 0.06)), float(rng.uniform(0.85, 1.0))
    circle = oval(2 * radius, 2 * radius, 2.0, 36)
    inner = circle * (1 - wall / radius)
    rings = [(circle * taper, 0.0), (circle, height), (inner, height), (inner * taper, 0.08)]
    builder.add(basin(rings), body)
    if chance(rng, 0.6):
        band = metal(rng)
        for share in (0.25, 0.75):
            r, z = radius * (taper + (1 - taper) * share), share * height
            profile = [
                (r - wall / 2, z),
                (r + 0.008, z),
                (r + 0.008, z + 0.03),
                (r - wall / 2, z + 0.03),
            ]
            builder.add(revolve(profile, 36), band)
    steps = chance(rng, 0.3)
    if steps:
        x = radius + 0.14
        builder.add(rounded_box((0.28, 0.5, 0.24), (x, 0, 0.12), 0.01), body)
        builder.add(bar((x - 0.14, 0, 0.24), (x - 0.14, 0, 0.45), 0.5, 0.06), body)
    return builder.build("bathtub", "soaking", Symmetry.NONE if steps else Symmetry.INF)


STYLES: dict[str, dict[str, Callable[[Rng], Shape]]] = {
    "bathtub": {
        builder.__name__: builder
        for builder in (
            freestanding,
            slipper,
            clawfoot,
            alcove,
            rectangular,
            corner,
            back_to_wall,
            soaking,
        )
    }
}
