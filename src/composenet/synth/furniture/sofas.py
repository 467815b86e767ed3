"""Sofas: wide along Y, the sitter faces +X, the back is at -X."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from composenet.records import Symmetry
from composenet.synth.furniture.couches import (
    couch_body,
    cover_of,
    draw_couch,
    pillow_of,
    seat_cushions,
    upholster,
    wooden_couch,
)
from composenet.synth.furniture.curves import bent_path, plate, post
from composenet.synth.furniture.parts import (
    Rng,
    box,
    box_between,
    chance,
    cushion,
    cylinder,
    leather,
    metal,
    rod,
    rounded_box,
    tube,
    wood,
)
from composenet.synth.shape import Shape, ShapeBuilder


def _standard(rng: Rng, style: str, seats: tuple[int, ...], arms: bool) -> Shape:
    builder, c = ShapeBuilder(), draw_couch(rng, int(rng.choice(seats)))
    kind = int(rng.integers(5)) if arms else -1
    upholster(rng, builder, c, kind, cover_of(rng))
    return builder.build("sofa", style, Symmetry.NONE)


def _chaise(rng: Rng) -> Shape:
    """One end runs forward as a place to lie (L-shaped)."""
    builder, cover = ShapeBuilder(), cover_of(rng)
    c = draw_couch(rng, int(rng.integers(2, 4)))
    side, extra = int(rng.choice([-1, 1])), rng.uniform(0.45, 0.85)
    upholster(rng, builder, c, int(rng.choice([-1, 0, 2, 3, 4])), cover)
    width = c.pitch * rng.uniform(0.95, 1.15)
    y = side * (c.inner - width / 2 + 0.01)
    x = c.depth / 2 + extra / 2 - 0.05
    low = c.clear
    base = (extra + 0.1, width, c.seat - c.cushion - low)
    builder.add(rounded_box(base, (x, y, low + base[2] / 2), min(c.round, 0.02)), cover)
    pad = pillow_of((extra + 0.12, width, c.cushion), rng.uniform(0, 0.8))
    builder.add(pad.translate((x, y, c.seat - c.cushion / 2)), cover)
    if low > 0.02:
        for dy in (-0.4, 0.4):
            spot = (c.depth / 2 + extra - 0.1, y + dy * width, 0.0)
            builder.add(cylinder(0.02, low + 0.02, spot, 10), wood(rng))
    return builder.build("sofa", "chaise", Symmetry.NONE)


def _corner(rng: Rng) -> Shape:
    """Two wings with backs, meeting in a corner; low modules or on feet."""
    builder, cover = ShapeBuilder(), cover_of(rng)
    c = draw_couch(rng, int(rng.integers(3, 5)))
    c = replace(c, pitch=rng.uniform(0.6, 0.78), lean=rng.uniform(0, 0.06))
    side, places = int(rng.choice([-1, 1])), int(rng.integers(1, 3))
    upholster(rng, builder, c, -1, cover)
    long = places * c.pitch
    start, end = c.depth / 2 - 0.02, c.depth / 2 + long
    y_out, y_in = side * (c.inner), side * (c.inner - c.depth + 0.02)
    y = np.sort([y_out, y_in])
    builder.add(box_between((start, y[0], c.clear), (end, y[1], c.seat - c.cushion)), cover)
    for i in range(places):
        pad = pillow_of((c.pitch * 0.99, abs(y_out - y_in) - c.back_thick, c.cushion), 0.3)
        middle = (y_in + y_out - side * c.back_thick) / 2
        builder.add(
            pad.translate((start + (i + 0.5) * c.pitch, middle, c.seat - c.cushion / 2)), cover
        )
    wall = np.sort([y_out, y_out - side * c.back_thick])
    builder.add(
        rounded_box(
            (end + c.depth / 2 - 0.02, c.back_thick, c.back - c.clear),
            ((end - c.depth / 2) / 2, wall.mean(), (c.back + c.clear) / 2),
            c.round,
        ),
        cover,
    )
    if c.clear > 0.02:
        for dy in (y_in + side * 0.08, y_out - side * 0.08):
            builder.add(cylinder(0.025, c.clear + 0.02, (end - 0.08, dy, 0), 10), wood(rng))
    return builder.build("sofa", "corner", Symmetry.NONE)


def _chesterfield(rng: Rng) -> Shape:
    """A roll runs over arms and back at one height; buttons between."""
    builder, cover = ShapeBuilder(), cover_of(rng) if chance(rng, 0.4) else leather(rng)
    c = replace(draw_couch(rng, int(rng.integers(2, 4))), lean=0.0, clear=rng.uniform(0.04, 0.12))
    c = replace(c, arm_width=rng.uniform(0.1, 0.16), back_thick=rng.uniform(0.12, 0.2))
    roll = rng.uniform(0.07, 0.11)
    top = c.seat + rng.uniform(0.2, 0.36)
    c = replace(c, back=top, arm=top - rng.choice([0.0, 0.06]))
    half = couch_body(builder, c, rng, cover, 4)
    y, x = half - c.arm_width / 2, -c.depth / 2 + c.back_thick / 2
    run = [(c.depth / 2, y, c.arm), (x, y, c.arm), (x, -y, c.arm), (c.depth / 2, -y, c.arm)]
    builder.add(tube(bent_path(run, 0.14, 4), roll, 12), cover)
    if c.back > c.arm:
        builder.add(rod((x, -y, c.back), (x, y, c.back), roll, segments=12), cover)
    for part in seat_cushions(c, rng, rng.uniform(0.1, 0.7), False):
        builder.add(part, cover)
    rows, columns = 2, 3 * c.seats
    for i in range(rows):
        for j in range(columns + i % 2 - 1):
            spot = (c.rear, ((j + 1 - 0.5 * (i % 2)) / columns - 0.5) * 2 * c.inner,
                    c.seat + (c.back - c.seat) * (0.25 + 0.35 * i))  # fmt: skip
            builder.add(box((0.03, 0.03, 0.03), spot), cover)
    return builder.build("sofa", "chesterfield", Symmetry.NONE)


def _camelback(rng: Rng) -> Shape:
    """An arched back, slender legs."""
    builder, cover = ShapeBuilder(), cover_of(rng)
    c = replace(draw_couch(rng, int(rng.integers(2, 4))), clear=rng.uniform(0.1, 0.2), cushion=0.1)
    c = replace(c, back=c.seat + rng.uniform(0.2, 0.3))
    half = couch_body(builder, c, rng, cover, int(rng.choice([1, 3, 4])))
    u, v = np.linspace(-1, 1, 17)[:, None], np.linspace(0, 1, 5)[None]
    humps = rng.choice([1, 1, 1, 2])
    arch = (
        rng.uniform(0.08, 0.2)
        / humps
        * np.abs(np.cos(u * np.pi / 2 * humps + (humps == 2) * np.pi / 2))
    )
    z = c.seat - 0.05 + v * (c.back - c.seat + arch + 0.05)
    x = c.rear - c.back_thick * 0.4 - c.lean * v
    grid = np.stack(np.broadcast_arrays(x, u * half * 0.98, z), axis=-1)
    builder.add(plate(grid, c.back_thick * 0.8 * (1 - 0.4 * v**6)), cover)
    for part in seat_cushions(c, rng, rng.uniform(0.2, 0.9), chance(rng, 0.5)):
        builder.add(part, cover)
    return builder.build("sofa", "camelback", Symmetry.NONE)


def _wood_frame(rng: Rng) -> Shape:
    builder, c = ShapeBuilder(), draw_couch(rng, int(rng.integers(2, 4)))
    wooden_couch(rng, builder, replace(c, depth=rng.uniform(0.7, 0.88)))
    return builder.build("sofa", "wood_frame", Symmetry.NONE)


def _daybed(rng: Rng) -> Shape:
    """A long tufted mattress on legs with a low rail behind and a roll at one or both ends."""
    builder, cover = ShapeBuilder(), cover_of(rng)
    long, deep = rng.uniform(1.5, 2.1), rng.uniform(0.65, 0.95)
    height, thick = rng.uniform(0.38, 0.48), rng.uniform(0.1, 0.18)
    rows, columns = 2, int(rng.integers(3, 6))
    size = (deep / rows, long / columns)
    for i in range(rows):
        for j in range(columns):
            spot = (
                (i + 0.5) * size[0] - deep / 2,
                (j + 0.5) * size[1] - long / 2,
                height - thick / 2,
            )
            builder.add(
                rounded_box((size[0], size[1], thick), spot, rng.uniform(0.015, 0.02)), cover
            )
    frame = wood(rng) if chance(rng, 0.6) else metal(rng)
    builder.add(box((deep, long, 0.05), (0, 0, height - thick - 0.02)), frame)
    for x in (-0.45 * deep, 0.45 * deep):
        for y in (-0.46 * long, 0.46 * long):
            builder.add(
                post([(x * 1.03, y * 1.02, 0), (x, y, height - thick)], [0.025, 0.045]), frame
            )
    radius = rng.uniform(0.07, 0.11)
    for side in (-1, 1) if chance(rng, 0.5) else (int(rng.choice([-1, 1])),):
        y = side * (long / 2 - radius)
        roll = rod(
            (-deep / 2, y, height + radius * 0.9),
            (deep / 2, y, height + radius * 0.9),
            radius,
            segments=14,
        )
        builder.add(roll, cover)
    tall = rng.uniform(0.15, 0.4)
    builder.add(
        rounded_box(
            (0.08, long * rng.uniform(0.6, 1), tall + thick),
            (-deep / 2 - 0.03, 0, height - thick + (tall + thick) / 2),
            0.03,
        ),
        cover,
    )
    return builder.build("sofa", "daybed", Symmetry.NONE)


def _modular(rng: Rng) -> Shape:
    """Separate blocks on the floor: seat, back and arm modules with gaps."""
    builder, cover = ShapeBuilder(), cover_of(rng)
    seats = int(rng.integers(2, 5))
    c = replace(draw_couch(rng, seats), clear=rng.uniform(0.0, 0.04), lean=0.0)
    c = replace(c, back=c.seat + rng.uniform(0.2, 0.36), back_thick=rng.uniform(0.18, 0.3))
    gap, radius = 0.012, rng.uniform(0.02, 0.08)
    arms = [chance(rng, 0.7), chance(rng, 0.7)]
    for i in range(seats):
        y = (i - (seats - 1) / 2) * c.pitch
        long = c.depth / 2 - c.rear
        block = (long, c.pitch - gap, c.seat)
        builder.add(rounded_box(block, (c.rear + long / 2, y, c.seat / 2), radius), cover)
        tall = c.back * rng.uniform(0.97, 1.0)
        builder.add(
            rounded_box(
                (c.back_thick - gap, c.pitch - gap, tall),
                (c.rear - c.back_thick / 2, y, tall / 2),
                radius,
            ),
            cover,
        )
        if chance(rng, 0.6):
            pillow = cushion((0.16, c.pitch * 0.8, 0.4), power=3.5, segments=12)
            builder.add(
                pillow.rotate((0.0, -15.0, 0.0)).translate((c.rear + 0.1, y, c.seat + 0.16)), cover
            )
    for there, side in zip(arms, (-1, 1), strict=True):
        if there:
            y = side * (c.inner + c.arm_width / 2)
            builder.add(
                rounded_box((c.depth - gap, c.arm_width - gap, c.arm), (0, y, c.arm / 2), radius),
                cover,
            )
    return builder.build("sofa", "modular", Symmetry.NONE)


STYLES: dict[str, dict[str, Callable[[Rng], Shape]]] = {
    "sofa": {
        "two_seater": partial(_standard, style="two_seater", seats=(2,), arms=True),
        "three_seater": partial(_standard, style="three_seater", seats=(3, 3, 4), arms=True),
        "armless": partial(_standard, style="armless", seats=(2, 3), arms=False),
        "chaise": _chaise,
        "corner": _corner,
        "chesterfield": _chesterfield,
        "camelback": _camelback,
        "wood_frame": _wood_frame,
        "daybed": _daybed,
        "modular": _modular,
    }
}
