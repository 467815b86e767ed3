"""Small things that lie on tables and shelves, under half a metre."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from composenet.records import Symmetry
from composenet.synth.furniture.clutter_parts import assemble, foliage, shade, vase, vessel
from composenet.synth.furniture.curves import bent_path, plate
from composenet.synth.furniture.parts import (
    Rng,
    Solid,
    box,
    ceramic,
    chance,
    cone,
    cushion,
    cylinder,
    extrude_y,
    fabric,
    glass,
    metal,
    paint,
    plastic,
    rod,
    rounded_box,
    stone,
    tube,
    wood,
)
from composenet.synth.shape import Material, Shape, ShapeBuilder

_GREEN = Material((0.20, 0.42, 0.16), "fabric", 0.05)
_DARK = Material((0.04, 0.04, 0.05), shininess=0.6)


def table_lamp(rng: Rng) -> Shape:
    """Foot and shade, or a desk lamp with a jointed arm."""
    body, tall = metal(rng) if chance(rng, 0.5) else ceramic(rng), rng.uniform(0.25, 0.48)
    foot = cone(rng.uniform(0.06, 0.09), 0.05, 0.02)
    if chance(rng, 0.35):
        knee = np.array([-rng.uniform(0.04, 0.1), 0, tall * 0.6])
        arm = [rod((0, 0, 0), knee, 0.008), rod(knee, (0.1, 0, tall * 0.95), 0.008)]
        lamp = cone(0.06, 0.025, 0.1, (0.12, 0, tall * 0.95 - 0.1), 16)
        return assemble("desk_lamp", ([foot, *arm], body), (lamp, paint(rng)))
    size = rng.uniform(0.08, 0.15)
    stem = (
        vase(rng, tall * 0.6, rng.uniform(0.06, 0.15))
        if chance(rng, 0.5)
        else cylinder(0.01, tall * 0.7)
    )
    cap = shade(rng, size, tall * 0.42, tall * 0.58)
    return assemble("table_lamp", ([foot, stem], body), (cap, fabric(rng)))


def small_plant(rng: Rng) -> Shape:
    """A plant in a little pot."""
    size, tall = rng.uniform(0.07, 0.14), rng.uniform(0.06, 0.13)
    pot = cone(size * rng.uniform(0.3, 0.5), size / 2, tall, segments=16)
    room = rng.uniform(0.1, 0.45 - tall)
    leaves = foliage(rng, tall, room, min(room, 0.25))
    return assemble("small_plant", (pot, ceramic(rng)), (leaves, _GREEN))


def books(rng: Rng) -> Shape:
    """A stack lying or a row standing."""
    builder, count, standing = ShapeBuilder(), int(rng.integers(1, 8)), chance(rng, 0.5)
    at = 0.0
    for _ in range(count):
        thick, long, wide = (
            rng.uniform(0.012, 0.05),
            rng.uniform(0.17, 0.31),
            rng.uniform(0.12, 0.23),
        )
        if standing:
            book = box((wide, thick * 0.97, long), (0, at + thick / 2, long / 2))
        else:
            book = box((wide, long, thick), (0, 0, at + thick / 2)).rotate((0, 0, rng.normal(0, 9)))
        builder.add(book, paint(rng))
        at += thick
    return builder.build("clutter", "books", Symmetry.NONE)


def laptop(rng: Rng) -> Shape:
    """Open at some angle, or shut."""
    wide, deep, open_by = rng.uniform(0.28, 0.38), rng.uniform(0.2, 0.26), rng.uniform(75, 130)
    base = box((deep, wide, 0.018), (0, 0, 0.009))
    lid = box((0.01, wide, deep), (0, 0, deep / 2)).rotate((0, 90 - float(open_by), 0))
    body = metal(rng)
    if chance(rng, 0.2):
        return assemble("laptop", (box((deep, wide, 0.024), (0, 0, 0.012)), body))
    return assemble("laptop", (base, body), (lid.translate((-deep / 2, 0, 0.015)), _DARK))


def monitor(rng: Rng) -> Shape:
    """A screen on a foot."""
    wide = rng.uniform(0.38, 0.49)
    tall = wide * rng.uniform(0.5, 0.66)
    lift = rng.uniform(0.06, 0.1)
    u = np.linspace(-1, 1, 7)[:, None]
    bend = rng.choice([0.0, 0.03])
    grid = np.stack(
        np.broadcast_arrays(bend * u**2, u * wide / 2, lift + np.array([[0.0, 1.0]]) * tall),
        axis=-1,
    )
    stand = [
        box((0.16, 0.22, 0.015), (-0.02, 0, 0.008)),
        box((0.03, 0.06, lift + 0.1), (-0.03, 0, lift / 2 + 0.05)),
    ]
    return assemble("monitor", (plate(grid, rng.uniform(0.02, 0.05)), _DARK), (stand, plastic(rng)))


def vessels(rng: Rng) -> Shape:
    """A vase, jar or bottle."""
    tall, wide = rng.uniform(0.1, 0.4), rng.uniform(0.07, 0.2)
    stuff = [ceramic, glass, paint, stone][rng.integers(4)](rng)
    return assemble("vase", (vase(rng, tall, wide), stuff))


def bottle(rng: Rng) -> Shape:
    """A bottle with a neck."""
    tall, radius = rng.uniform(0.18, 0.34), rng.uniform(0.03, 0.05)
    neck = rng.uniform(0.25, 0.45)
    parts: list[Solid] = [
        cylinder(radius, tall * (1 - neck), segments=14),
        cone(radius, radius * 0.4, tall * neck * 0.5, (0, 0, tall * (1 - neck)), 14),
        cylinder(radius * 0.4, tall, segments=10),
    ]
    return assemble("bottle", (parts, glass(rng) if chance(rng, 0.6) else plastic(rng)))


def mug(rng: Rng) -> Shape:
    """A cup with a handle, open above."""
    tall, radius = rng.uniform(0.07, 0.13), rng.uniform(0.035, 0.05)
    cup = vessel([radius * rng.uniform(0.7, 1.0), radius], [0.0, tall], 0.005)
    grip = bent_path(
        [
            (radius - 0.003, 0, tall * 0.8),
            (radius + 0.03, 0, tall * 0.75),
            (radius + 0.03, 0, tall * 0.3),
            (radius - 0.008, 0, tall * 0.22),
        ],
        0.02,
    )
    return assemble(
        "mug", ([cup, tube(grip, 0.005, 6)], ceramic(rng) if chance(rng, 0.5) else paint(rng))
    )


def bowl(rng: Rng) -> Shape:
    """A bowl or plate, with or without fruit."""
    radius, tall = rng.uniform(0.08, 0.18), rng.uniform(0.02, 0.11)
    t = np.linspace(0, 1, 5)
    dish = vessel(radius * (0.4 + 0.6 * np.sqrt(t)), tall * t, 0.006)
    if chance(rng, 0.5):
        return assemble("bowl", (dish, ceramic(rng)))
    fruit = [
        cushion(
            np.full(3, rng.uniform(0.06, 0.08)),
            (*(rng.uniform(-0.5, 0.5, 2) * radius), 0.04 + tall * 0.4),
            2,
            8,
        )
        for _ in range(int(rng.integers(1, 6)))
    ]
    return assemble("fruit_bowl", (dish, ceramic(rng)), (fruit, paint(rng)))


def small_box(rng: Rng) -> Shape:
    """A parcel, a basket or a plastic tub with its lid."""
    size = rng.uniform((0.1, 0.12, 0.05), (0.3, 0.42, 0.25))
    kind = rng.integers(3)
    lid = box((size[0] * 1.05, size[1] * 1.05, 0.02), (0, 0, size[2]))
    if kind == 0:
        return assemble("parcel", (box(size, (0, 0, size[2] / 2)), Material((0.62, 0.48, 0.33))))
    hollow = box(size, (0, 0, size[2] / 2)) - box(size - 0.02, (0, 0, size[2] / 2 + 0.02))
    if kind == 1:
        return assemble("basket", (hollow, wood(rng)))
    return assemble("tub", (hollow, plastic(rng)), (lid, plastic(rng)))


def papers(rng: Rng) -> Shape:
    """Magazines and sheets, nearly flat."""
    builder = ShapeBuilder()
    for i in range(int(rng.integers(1, 6))):
        sheet = box((0.21, 0.297, 0.006), (*rng.normal(0, 0.05, 2), 0.003 + 0.005 * i))
        builder.add(sheet.rotate((0, 0, float(rng.normal(0, 25)))), paint(rng))
    return builder.build("clutter", "papers", Symmetry.NONE)


def picture_frame(rng: Rng) -> Shape:
    """A framed photograph leaning on its strut."""
    wide, tall, thick = rng.uniform(0.1, 0.3), rng.uniform(0.13, 0.35), 0.016
    frame = box((thick, wide, tall), (0, 0, tall / 2)).rotate((0, -14.0, 0))
    photo = box((thick, wide * 0.8, tall * 0.8), (0.002, 0, tall / 2)).rotate((0, -14.0, 0))
    strut = box((0.006, 0.03, tall * 0.7), (0, 0, tall * 0.35)).rotate((0, 16.0, 0))
    back = strut.translate((-0.28 * tall * 1.3, 0, 0))
    return assemble("photograph", ([frame, back], wood(rng)), (photo, paint(rng)))


def clock(rng: Rng) -> Shape:
    """A round clock or mirror on feet, or a loudspeaker."""
    if chance(rng, 0.5):
        size = rng.uniform((0.12, 0.1, 0.15), (0.26, 0.24, 0.45))
        dome = cushion(
            (0.03, size[1] * 0.75, size[1] * 0.75), (size[0] / 2, 0, size[2] * 0.4), 2.0, 12
        )
        return assemble(
            "speaker", (rounded_box(size, (0, 0, size[2] / 2), 0.01), wood(rng)), (dome, _DARK)
        )
    radius = rng.uniform(0.06, 0.18)
    disc = rod((-0.015, 0, radius + 0.02), (0.015, 0, radius + 0.02), radius, segments=20)
    feet = [
        rod((0, s * radius * 0.6, 0), (0, s * radius * 0.4, radius * 0.4), 0.008) for s in (1, -1)
    ]
    return assemble("clock", (disc, paint(rng)), (feet, metal(rng)))


def kitchen_machine(rng: Rng) -> Shape:
    """A microwave, toaster, kettle or coffee machine."""
    kind, body = rng.integers(4), metal(rng) if chance(rng, 0.5) else plastic(rng)
    if kind == 0:
        size = rng.uniform((0.3, 0.42, 0.24), (0.36, 0.49, 0.29))
        door = box((0.012, size[1] * 0.7, size[2] * 0.8), (size[0] / 2, size[1] * 0.1, size[2] / 2))
        return assemble("microwave", (box(size, (0, 0, size[2] / 2)), body), (door, _DARK))
    if kind == 1:
        slots = [box((0.03, 0.22, 0.02), (x, 0, 0.18)) for x in (-0.035, 0.035)]
        return assemble(
            "toaster", (rounded_box((0.16, 0.28, 0.19), (0, 0, 0.095), 0.03), body), (slots, _DARK)
        )
    if kind == 2:
        jug = cone(0.085, 0.06, rng.uniform(0.18, 0.25), segments=16)
        grip = tube(
            bent_path([(0.06, 0, 0.17), (0.13, 0, 0.17), (0.13, 0, 0.05), (0.075, 0, 0.04)], 0.04),
            0.011,
        )
        return assemble("kettle", (jug, body), (grip, _DARK))
    profile = [
        (-0.14, 0),
        (0.13, 0),
        (0.13, 0.04),
        (-0.03, 0.04),
        (-0.03, 0.24),
        (0.1, 0.24),
        (0.1, 0.33),
        (-0.14, 0.33),
    ]
    can = cylinder(0.05, 0.13, (0.055, 0, 0.04), 12)
    return assemble(
        "coffee_machine", (extrude_y(profile, rng.uniform(0.15, 0.22)), body), (can, _DARK)
    )


def toy(rng: Rng) -> Shape:
    """A ball or a teddy bear."""
    size = rng.uniform(0.08, 0.25)
    if chance(rng, 0.5):
        ball = cushion((size, size, size), (0, 0, size / 2), 2.0, 16)
        return assemble("ball", (ball, plastic(rng)))
    s = size / 0.25
    parts = [cushion((0.16 * s, 0.18 * s, 0.2 * s), (0, 0, 0.1 * s), 2.0, 10),
             cushion((0.13 * s, 0.14 * s, 0.13 * s), (0.01 * s, 0, 0.25 * s), 2.0, 10)]  # fmt: skip
    for side in (1, -1):
        parts.append(
            rod((0, side * 0.07 * s, 0.17 * s), (0.08 * s, side * 0.11 * s, 0.1 * s), 0.03 * s)
        )
        parts.append(
            rod(
                (0.04 * s, side * 0.06 * s, 0.04 * s),
                (0.16 * s, side * 0.08 * s, 0.03 * s),
                0.035 * s,
            )
        )
        parts.append(cushion(np.full(3, 0.05 * s), (0, side * 0.06 * s, 0.31 * s), 2.0, 8))
    return assemble("teddy", (parts, fabric(rng)))


SMALL: dict[str, Callable[[Rng], Shape]] = {
    "table_lamp": table_lamp,
    "small_plant": small_plant,
    "books": books,
    "laptop": laptop,
    "monitor": monitor,
    "vase": vessels,
    "bottle": bottle,
    "mug": mug,
    "bowl": bowl,
    "small_box": small_box,
    "papers": papers,
    "picture_frame": picture_frame,
    "clock": clock,
    "kitchen_machine": kitchen_machine,
    "toy": toy,
}
