"""Things that stand on the floor of rooms and belong to none of the ten classes."""

from __future__ import annotations

import numpy as np

from composenet.records import Symmetry
from composenet.synth.furniture.clutter_parts import assemble, foliage, shade, vase, vessel
from composenet.synth.furniture.curves import bent_path, plate, post, soft_slab
from composenet.synth.furniture.parts import (
    Rng,
    Solid,
    bar,
    box,
    ceramic,
    chance,
    cone,
    cushion,
    cylinder,
    extrude,
    fabric,
    metal,
    oval,
    paint,
    plastic,
    rod,
    rounded_box,
    rounded_rectangle,
    tube,
    wood,
)
from composenet.synth.shape import Material, Shape, ShapeBuilder

_GREEN = Material((0.18, 0.40, 0.15), "fabric", 0.05)
_DARK = Material((0.04, 0.04, 0.05), shininess=0.6)
_CARD = Material((0.62, 0.48, 0.33))


def floor_lamp(rng: Rng) -> Shape:
    """A straight, tripod or arched lamp."""
    steel, tall, radius = metal(rng), rng.uniform(1.3, 1.85), rng.uniform(0.12, 0.26)
    cover, high = fabric(rng), rng.uniform(0.15, 0.4)
    kind = rng.integers(4)
    if kind == 0:  # arched
        reach = rng.uniform(0.5, 1.0)
        stem = bent_path(
            [(0, 0, 0), (0, 0, tall), (reach, 0, tall), (reach, 0, tall - 0.3)], 0.45, 5
        )
        lamp = shade(rng, radius, 0.2, tall - 0.42).translate((reach, 0, 0))
        return assemble(
            "arc_lamp", ([cone(0.17, 0.15, 0.04), tube(stem, 0.013)], steel), (lamp, cover)
        )
    if kind == 1:  # tripod
        feet = np.arange(3) * 2 * np.pi / 3
        legs = [
            rod((0.3 * np.cos(a), 0.3 * np.sin(a), 0), (0, 0, tall - high), 0.014) for a in feet
        ]
        return assemble(
            "tripod_lamp", (legs, wood(rng)), (shade(rng, radius, high, tall - high), cover)
        )
    stem = cylinder(rng.uniform(0.01, 0.02), tall - high / 2, segments=10)
    parts = [cone(rng.uniform(0.12, 0.17), 0.1, 0.03), stem]
    return assemble(
        "floor_lamp",
        (parts, steel),
        (shade(rng, radius, high, tall - high), cover),
    )


def plant(rng: Rng) -> Shape:
    """A potted plant of one of five kinds, 0.4 to 2 m tall."""
    tall, wide = rng.uniform(0.15, 0.45), rng.uniform(0.2, 0.45)
    square = chance(rng, 0.3)
    pot = post(
        [(0, 0, 0), (0, 0, tall)],
        wide * np.array([rng.uniform(0.6, 1.0), 1.0]),
        4 if square else 18,
    )
    leaves = foliage(rng, tall, rng.uniform(0.3, 1.5), rng.uniform(0.3, 0.8))
    return assemble(
        "plant", (pot, ceramic(rng) if chance(rng, 0.5) else paint(rng)), (leaves, _GREEN)
    )


def boxes(rng: Rng) -> Shape:
    """Cardboard boxes, stacked and turned, the uppermost perhaps open."""
    builder, z = ShapeBuilder(), 0.0
    size = rng.uniform((0.25, 0.3, 0.2), (0.5, 0.65, 0.5))
    spot = np.zeros(2)
    for level in range(int(rng.integers(1, 5))):
        turn = float(rng.normal(0, 8 if level else 0))
        body = box(size, (0, 0, size[2] / 2))
        last = chance(rng, 0.4)
        if last:
            body -= box(size - 0.02, (0, 0, size[2] / 2 + 0.02))
            for side in (1, -1):
                flap = box((size[0] * 0.5, size[1], 0.008), (side * size[0] * 0.25, 0, 0))
                flap = flap.rotate((0, float(side * rng.uniform(-70, 40)), 0))
                builder.add(flap.translate((side * size[0] / 2, 0, size[2])).rotate((0, 0, turn))
                            .translate((*spot, z)), _CARD)  # fmt: skip
        builder.add(body.rotate((0, 0, turn)).translate((*spot, z)), _CARD)
        z += size[2]
        size = size * rng.uniform(0.65, 1.0, 3)
        spot = spot + rng.uniform(-0.06, 0.06, 2)
        if last or z > 1.2:
            break
    return builder.build("clutter", "boxes", Symmetry.NONE)


def television(rng: Rng) -> Shape:
    """A large screen on feet or on a stand."""
    wide = rng.uniform(0.7, 1.5)
    tall, lift = wide * 0.57, 0.06 if chance(rng, 0.4) else rng.uniform(0.4, 0.9)
    screen = box((rng.uniform(0.03, 0.07), wide, tall), (0, 0, lift + tall / 2))
    if lift < 0.1:
        stand: list[Solid] = [
            bar((0.12, y, 0.01), (-0.12, y, 0.01), 0.03, 0.02) for y in (-wide / 3, wide / 3)
        ]
        stand += [bar((0, y, 0), (0, y, lift + 0.02), 0.03, 0.03) for y in (-wide / 3, wide / 3)]
    else:
        stand = [
            cone(0.3, 0.28, 0.02),
            box((0.05, 0.1, lift + tall / 2), (-0.04, 0, (lift + tall / 2) / 2)),
        ]
    return assemble("television", (screen, _DARK), (stand, metal(rng)))


def bin_or_basket(rng: Rng) -> Shape:
    """A waste bin, bucket or laundry basket, open or lidded."""
    tall, radius = rng.uniform(0.25, 0.65), rng.uniform(0.12, 0.24)
    stuff = [plastic, metal, wood][rng.integers(3)](rng)
    kind = rng.integers(3)
    body = vessel([radius * rng.uniform(0.65, 1.0), radius], [0.0, tall], 0.012)
    if kind == 0:
        return assemble("bin", (body, stuff))
    if kind == 1:
        lid = cushion((2 * radius, 2 * radius, 0.2), (0, 0, tall), 2.2, 18)
        return assemble("lidded_bin", ([body, lid], stuff))
    angle = np.linspace(0, np.pi, 9)
    up = float(rng.choice([1, -0.3]))
    bow = np.stack(
        [
            0.25 * radius * np.sin(angle) * (up < 0) * 4,
            radius * np.cos(angle),
            tall - 0.02 + up * radius * np.sin(angle),
        ],
        1,
    )
    return assemble("bucket", (body, stuff), (tube(bow, 0.006, 6), metal(rng)))


def suitcase(rng: Rng) -> Shape:
    """Upright on wheels with its handle out, or lying."""
    size = rng.uniform((0.2, 0.35, 0.5), (0.32, 0.5, 0.78))
    body = rounded_box(size, (0, 0, size[2] / 2 + 0.04), 0.05)
    wheels = [
        rod((x, y - 0.015, 0.025), (x, y + 0.015, 0.025), 0.025, segments=8)
        for x in (-size[0] * 0.35, size[0] * 0.35)
        for y in (-size[1] * 0.4, size[1] * 0.4)
    ]
    grip: list[Solid] = []
    if chance(rng, 0.6):
        z, y = size[2] + 0.03, size[1] * 0.25
        up = z + rng.uniform(0.1, 0.4)
        path = bent_path(
            [
                (-size[0] * 0.4, -y, z - 0.1),
                (-size[0] * 0.4, -y, up),
                (-size[0] * 0.4, y, up),
                (-size[0] * 0.4, y, z - 0.1),
            ],
            0.03,
        )
        grip = [tube(path, 0.01, 6)]
    return assemble("suitcase", (body, plastic(rng)), (wheels + grip, _DARK))


def curtain(rng: Rng) -> Shape:
    """Cloth in folds from a rail to the floor."""
    wide, tall = rng.uniform(0.5, 1.6), rng.uniform(1.8, 2.4)
    y = np.linspace(-wide / 2, wide / 2, 33)[:, None]
    fold = rng.uniform(0.02, 0.06) * np.cos(y * rng.uniform(25, 50) + rng.uniform(0, 6))
    gather = 1 + rng.uniform(-0.35, 0.1) * np.array([[0.0, 0.6, 0.6, 0.0]])
    z = tall * np.array([[0.0, 0.35, 0.5, 1.0]])
    grid = np.stack(np.broadcast_arrays(fold + 0 * z, y * gather, z), axis=-1)
    rail = rod((0, -wide * 0.55, tall + 0.01), (0, wide * 0.55, tall + 0.01), 0.014)
    return assemble("curtain", (plate(grid, 0.012), fabric(rng)), (rail, metal(rng)))


def guitar(rng: Rng) -> Shape:
    """A guitar leaning in its stand."""
    t = np.arange(24) * 2 * np.pi / 24
    x = 0.25 * np.cos(t)
    waist = 1 - rng.uniform(0.25, 0.4) * np.exp(-(((x - 0.06) / 0.07) ** 2)) - 0.6 * x
    outline = np.stack([x, 0.18 * waist * np.sign(np.sin(t)) * np.abs(np.sin(t)) ** 0.7], 1)
    body = extrude(outline, rng.uniform(0.05, 0.11))
    whole = (
        body + box((0.48, 0.05, 0.025), (0.44, 0, 0.09)) + box((0.14, 0.07, 0.02), (0.72, 0, 0.085))
    )
    lean = float(rng.uniform(-80, -68))
    foot = [rod((0.1, s * 0.15, 0), (-0.05, s * 0.06, 0.3), 0.01) for s in (1, -1)]
    return assemble(
        "guitar", (whole.rotate((0, lean, 0)).translate((0, 0, 0.28)), wood(rng)), (foot, _DARK)
    )


def ball(rng: Rng) -> Shape:
    """A ball, an exercise ball or a bean bag."""
    size = rng.uniform(0.2, 0.75)
    if chance(rng, 0.5):
        return assemble(
            "ball",
            (cushion(np.full(3, size), (0, 0, size / 2), 2.0, 20), plastic(rng)),
        )
    wide = rng.uniform(0.6, 0.95)
    bag = [
        cushion((wide, wide, wide * 0.55), (0, 0, wide * 0.27), 2.3, 16),
        cushion((wide * 0.55, wide * 0.75, wide * 0.75), (-wide * 0.18, 0, wide * 0.5), 2.2, 14),
    ]
    return assemble("bean_bag", (bag, fabric(rng)))


def pillows(rng: Rng) -> Shape:
    """Pillows heaped on the floor."""
    builder, z = ShapeBuilder(), 0.0
    for _ in range(int(rng.integers(1, 4))):
        wide, thick = rng.uniform(0.38, 0.65), rng.uniform(0.1, 0.18)
        pillow = cushion((wide, wide * rng.uniform(0.7, 1.0), thick), (0, 0, thick / 2), 3.2, 14)
        builder.add(
            pillow.rotate((0, 0, float(rng.uniform(0, 90)))).translate(
                (*rng.normal(0, 0.06, 2), z)
            ),
            fabric(rng),
        )
        z += thick * 0.8
    return builder.build("clutter", "pillows", Symmetry.NONE)


def pouf(rng: Rng) -> Shape:
    """A round or square padded footstool, low."""
    wide, tall = rng.uniform(0.38, 0.75), rng.uniform(0.28, 0.42)
    square = chance(rng, 0.4)
    outline = rounded_rectangle(wide, wide, 0.06) if square else oval(wide, wide)
    solid = soft_slab(outline, 0.0, tall, rng.uniform(0.02, 0.15))
    return assemble("pouf", (solid, fabric(rng)))


def picture(rng: Rng) -> Shape:
    """A large framed picture or mirror leaning backwards."""
    wide, tall = rng.uniform(0.4, 1.1), rng.uniform(0.5, 1.8)
    tilt = -float(rng.uniform(4, 12))
    frame = box((0.03, wide, tall), (0, 0, tall / 2)).rotate((0, tilt, 0))
    inside = box((0.03, wide - 0.1, tall - 0.1), (0.005, 0, tall / 2)).rotate((0, tilt, 0))
    return assemble("picture", (frame, wood(rng)), (inside, paint(rng)))


def door_leaf(rng: Rng) -> Shape:
    """A door standing open: leaf, panels, handles."""
    wide, tall, thick = rng.uniform(0.7, 0.95), rng.uniform(1.95, 2.1), rng.uniform(0.035, 0.05)
    leaf = box((thick, wide, tall), (0, 0, tall / 2))
    parts = [
        box((thick + 0.012, wide * 0.65, tall * s), (0, 0, tall * c))
        for s, c in ((0.3, 0.25), (0.35, 0.7))
    ]
    handle = rod((-0.06, wide * 0.42, 1.02), (0.06, wide * 0.42, 1.02), 0.012)
    lever = [rod((x, wide * 0.42, 1.02), (x, wide * 0.28, 1.02), 0.01) for x in (-0.06, 0.06)]
    solids = [leaf, *parts] if chance(rng, 0.5) else [leaf]
    return assemble(
        "door",
        (solids, paint(rng) if chance(rng, 0.6) else wood(rng)),
        ([handle, *lever], metal(rng)),
    )


def big_vase(rng: Rng) -> Shape:
    """A floor vase or an umbrella stand."""
    return assemble(
        "floor_vase",
        (vase(rng, rng.uniform(0.4, 0.9), rng.uniform(0.2, 0.4)), ceramic(rng)),
    )
