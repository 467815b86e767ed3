"""Clutter: what stands, lies and lives in rooms beside the ten classes."""

from __future__ import annotations

from collections.abc import Callable

from composenet.records import Symmetry
from composenet.synth.furniture import clutter_floor as floor
from composenet.synth.furniture import clutter_household as household
from composenet.synth.furniture import clutter_people as people
from composenet.synth.furniture.clutter_parts import assemble
from composenet.synth.furniture.clutter_small import SMALL
from composenet.synth.furniture.parts import (
    Rng,
    Solid,
    box,
    chance,
    metal,
    paint,
    rod,
    rounded_box,
)
from composenet.synth.shape import Material, Shape, ShapeBuilder

_DARK = Material((0.05, 0.05, 0.06), shininess=0.5)


def _refrigerator(rng: Rng) -> Shape:
    """One door over another, long handles."""
    size = rng.uniform((0.56, 0.54, 1.2), (0.72, 0.75, 1.95))
    deep, wide, tall = map(float, size)
    split = tall * rng.uniform(0.3, 0.7)
    body, doors = box((deep, wide, tall), (0, 0, tall / 2)), []
    for low, high in ((0.05, split), (split, tall)):
        doors.append(rounded_box((0.06, wide - 0.006, high - low - 0.012),
                                 (deep / 2 + 0.02, 0, (low + high) / 2), 0.015))  # fmt: skip
    side = 1 if chance(rng, 0.5) else -1
    x, y = deep / 2 + 0.075, side * wide * 0.42
    grips: list[Solid] = [
        rod((x, y, z - 0.15), (x, y, z + 0.15), 0.012) for z in (split - 0.22, split + 0.22)
    ]
    shell = metal(rng) if chance(rng, 0.4) else paint(rng)
    return assemble("refrigerator", ([body, *doors], shell), (grips, metal(rng)))


def _oven(rng: Rng) -> Shape:
    """A free-standing cooker: hob, oven door, knobs."""
    deep, wide, tall = rng.uniform(0.55, 0.66), rng.uniform(0.5, 0.75), rng.uniform(0.82, 0.92)
    body = box((deep, wide, tall), (0, 0, tall / 2))
    window = box((0.02, wide * 0.75, tall * 0.4), (deep / 2, 0, tall * 0.45))
    grip = rod(
        (deep / 2 + 0.04, -wide * 0.38, tall * 0.72),
        (deep / 2 + 0.04, wide * 0.38, tall * 0.72),
        0.011,
    )
    knobs = [
        rod(
            (deep / 2, wide * s, tall * 0.88),
            (deep / 2 + 0.03, wide * s, tall * 0.88),
            0.018,
            segments=8,
        )
        for s in (-0.35, -0.18, 0.0, 0.18, 0.35)
    ]
    hobs = [
        rod((x, y, tall), (x, y, tall + 0.015), r, segments=16)
        for x, y, r in (
            (0.14, 0.14, 0.09),
            (0.14, -0.14, 0.07),
            (-0.14, 0.14, 0.07),
            (-0.14, -0.14, 0.1),
        )
    ]
    return assemble(
        "oven", (body, paint(rng)), ([window, *hobs], _DARK), ([grip, *knobs], metal(rng))
    )


def _washing_machine(rng: Rng) -> Shape:
    """A white box with a round door."""
    deep, wide, tall = rng.uniform(0.45, 0.62), rng.uniform(0.55, 0.62), rng.uniform(0.82, 0.9)
    body = rounded_box((deep, wide, tall), (0, 0, tall / 2), 0.015)
    radius, x = rng.uniform(0.15, 0.2), deep / 2
    frame = rod(
        (x - 0.01, 0, tall * 0.48), (x + 0.04, 0, tall * 0.48), radius, radius * 0.92, segments=20
    )
    glass = rod(
        (x, 0, tall * 0.48), (x + 0.05, 0, tall * 0.48), radius * 0.7, radius * 0.6, segments=16
    )
    panel = box((0.02, wide * 0.9, 0.09), (x, 0, tall - 0.07))
    dial = rod((x, 0.0, tall - 0.07), (x + 0.035, 0.0, tall - 0.07), 0.03, segments=10)
    return assemble(
        "washing_machine", ([body, panel], paint(rng)), ([frame, dial], metal(rng)), (glass, _DARK)
    )


def _water_dispenser(rng: Rng) -> Shape:
    """A column with a bottle, or a computer tower."""
    if chance(rng, 0.5):
        size = rng.uniform((0.38, 0.16, 0.35), (0.5, 0.24, 0.5))
        front = box((0.01, size[1] * 0.9, size[2] * 0.9), (size[0] / 2, 0, size[2] / 2))
        return assemble(
            "computer_tower", (box(size, (0, 0, size[2] / 2)), paint(rng)), (front, _DARK)
        )
    builder, tall = ShapeBuilder(), rng.uniform(0.85, 1.05)
    builder.add(
        box((0.3, 0.3, tall), (0, 0, tall / 2)) - box((0.1, 0.2, 0.2), (0.15, 0, tall - 0.25)),
        paint(rng),
    )
    blue = Material((0.45, 0.6, 0.8), shininess=0.7)
    builder.add(rod((0, 0, tall), (0, 0, tall + 0.06), 0.06, 0.135, segments=16), blue)
    builder.add(rod((0, 0, tall + 0.06), (0, 0, tall + 0.38), 0.135, segments=16), blue)
    return builder.build("clutter", "water_dispenser", Symmetry.NONE)


STYLES: dict[str, dict[str, Callable[[Rng], Shape]]] = {
    "clutter": {
        "floor_lamp": floor.floor_lamp,
        "plant": floor.plant,
        "boxes": floor.boxes,
        "television": floor.television,
        "bin": floor.bin_or_basket,
        "standing_person": people.standing,
        "sitting_person": people.sitting,
        "suitcase": floor.suitcase,
        "fan": household.fan,
        "curtain": floor.curtain,
        "radiator": household.radiator,
        "guitar": floor.guitar,
        "ball": floor.ball,
        "pillows": floor.pillows,
        "pouf": floor.pouf,
        "picture": floor.picture,
        "door": floor.door_leaf,
        "step_ladder": household.step_ladder,
        "coat_rack": household.coat_rack,
        "drying_rack": household.drying_rack,
        "bicycle": household.bicycle,
        "vacuum_cleaner": household.vacuum_cleaner,
        "floor_vase": floor.big_vase,
        "white_board": household.easel_board,
        "refrigerator": _refrigerator,
        "oven": _oven,
        "washing_machine": _washing_machine,
        "water_dispenser": _water_dispenser,
    }
}


def make_clutter(rng: Rng) -> Shape:
    """A thing that stands on the floor, 0.1 to 2.5 m tall; class_name "clutter"."""
    builders = list(STYLES["clutter"].values())
    return builders[int(rng.integers(len(builders)))](rng)


def make_small_clutter(rng: Rng) -> Shape:
    """A thing to lie on a table or shelf, no side over 0.5 m; class_name "clutter"."""
    builders = list(SMALL.values())
    return builders[int(rng.integers(len(builders)))](rng)
