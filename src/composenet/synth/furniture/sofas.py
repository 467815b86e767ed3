"""Sofas: wide along Y, the sitter faces +X, the back is at -X."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from composenet.records import Symmetry
from composenet.synth.furniture.curves import bent_path, plate, post
from composenet.synth.furniture.parts import (
    Rng,
    Solid,
    arc,
    bar,
    box,
    box_between,
    chance,
    cushion,
    cylinder,
    extrude_x,
    extrude_y,
    fabric,
    leather,
    metal,
    paint,
    rod,
    rounded_box,
    tube,
    wood,
)
from composenet.synth.shape import Material, Shape, ShapeBuilder


@dataclass(frozen=True)
class Couch:
    """Measures of an upholstered seat, metres: seats side by side, width of one, depth (X) and
    height of the seat, height of the back above the floor, its thickness and rake (metres that
    its top leans back), width and height of the arms (0: none), clearance under the body,
    thickness of the seat cushions, rounding of the edges."""

    seats: int
    pitch: float
    depth: float
    seat: float
    back: float
    back_thick: float
    lean: float
    arm_width: float
    arm: float
    clear: float
    cushion: float
    round: float

    @property
    def inner(self) -> float:
        """Half the width between the arms."""
        return self.seats * self.pitch / 2

    @property
    def rear(self) -> float:
        """x of the front of the back at seat height."""
        return -self.depth / 2 + self.back_thick


def draw_couch(rng: Rng, seats: int) -> Couch:
    """Random measures of a sofa with so many seats (1: an armchair)."""
    u = rng.uniform
    seat = u(0.37, 0.48)
    return Couch(
        seats=seats,
        pitch=u(0.52, 0.68) if seats == 1 else u(0.52, 0.80),
        depth=u(0.74, 1.02),
        seat=seat,
        back=seat + u(0.28, 0.52),
        back_thick=u(0.10, 0.26),
        lean=u(0.0, 0.14),
        arm_width=u(0.07, 0.28),
        arm=seat + u(0.08, 0.26),
        clear=u(0.0, 0.17) if chance(rng, 0.75) else 0.0,
        cushion=u(0.08, 0.2),
        round=u(0.01, 0.07),
    )


def _pillow(size: tuple[float, float, float], plump: float) -> Solid:
    """Seat or back cushion: boxy for plump near 0, a swollen pillow near 1."""
    if plump < 0.5:
        return rounded_box(size, radius=0.02 + 0.08 * plump)
    return cushion(size, power=9 - 5.5 * plump, segments=12)


def _seat_cushions(c: Couch, rng: Rng, plump: float, bench: bool) -> list[Solid]:
    count = 1 if bench else c.seats
    width = 2 * c.inner / count
    over = rng.uniform(-0.01, 0.03)
    long = c.depth / 2 - c.rear + over
    middle = (c.depth / 2 + over + c.rear) / 2
    size = (long, width * 0.995, c.cushion * (1.15 if plump > 0.5 else 1.0))
    places = (np.arange(count) - (count - 1) / 2) * width
    return [_pillow(size, plump).translate((middle, y, c.seat - c.cushion / 2)) for y in places]


def _back_cushions(c: Couch, rng: Rng, plump: float, count: int) -> list[Solid]:
    """Loose cushions leaning against the back."""
    width, thick = 2 * c.inner / count, rng.uniform(0.1, 0.2)
    tall = (c.back - c.seat) * rng.uniform(0.8, 1.15)
    tilt = -np.degrees(np.arctan2(c.lean, c.back - c.seat)) - rng.uniform(0, 10)
    pillow = _pillow((thick, width * 0.98, tall), plump).rotate((0.0, float(tilt), 0.0))
    x = c.rear + thick * 0.4 - c.lean / 2
    return [
        pillow.translate((x, y, c.seat + tall * 0.47))
        for y in (np.arange(count) - (count - 1) / 2) * width
    ]


def _back_frame(c: Couch, half_width: float, low: float) -> Solid:
    """The upholstered wall behind the seats, leaning back, its top rounded."""
    z = np.array([low, c.seat, c.back - c.round, c.back - c.round * 0.3, c.back])
    lean = c.lean * np.clip((z - c.seat) / (c.back - c.seat), 0, 1)
    thick = c.back_thick * np.array([1, 1, 0.9, 0.9, 0.9]) - c.round * np.array([0, 0, 0, 0.6, 2])
    path = np.stack([-c.depth / 2 + c.back_thick / 2 - lean, 0 * z, z], axis=1)
    wide = 2 * half_width - c.round * np.array([0, 0, 0, 0.6, 2])
    return post(path, np.stack([np.maximum(thick, 0.03), wide], axis=1))


def _arm(c: Couch, rng: Rng, kind: int, front: float) -> Solid:
    """One arm about y = 0, from the back to x = front."""
    low, width = c.clear, c.arm_width
    rear, long = -c.depth / 2, front + c.depth / 2
    if kind == 0:
        return rounded_box((long, width, c.arm - low), (rear + long / 2, 0, (c.arm + low) / 2),
                           c.round)  # fmt: skip
    if kind == 1:  # rolled
        roll = max(width * 0.55, 0.07)
        top = arc((0, c.arm - roll), roll, -0.5, np.pi + 0.5, 12)
        profile = [(-width * 0.4, low), (width * 0.4, low), *top]
        return extrude_x(profile, long, rear + long / 2)
    if kind == 2:  # slanting down to the front
        drop = c.arm - rng.uniform(0.3, 0.8) * (c.arm - c.seat)
        profile = [(rear, low), (front, low), (front, drop), (front - 0.06, drop + 0.03),
                   (rear + 0.1, c.arm), (rear, c.arm)]  # fmt: skip
        return extrude_y(profile, width)
    if kind == 3:  # rounded over
        half = width / 2
        top = arc((0, c.arm - half), half, 0, np.pi, 10)
        return extrude_x([(-half, low), (half, low), *top], long, rear + long / 2)
    flare = rng.uniform(0.0, 0.35) * width  # a plump wall
    size = np.array([[long, width], [long, width + flare], [long * 0.97, (width + flare) * 0.6]])
    path = [(rear + long / 2, 0, z) for z in (low, c.arm - 0.05, c.arm)]
    return post(path, size)


def _feet(c: Couch, half_width: float, rng: Rng) -> tuple[list[Solid], Material]:
    """Legs under the body, and what they are made of; none for a body on the floor."""
    if c.clear < 0.02:
        return [], wood(rng)
    x, y = c.depth / 2 - 0.06, half_width - 0.06
    if chance(rng, 0.2):
        runs = [[(x, s, c.clear + 0.01), (x, s, 0.01), (-x, s, 0.01), (-x, s, c.clear + 0.01)]
                for s in (y, -y)]  # fmt: skip
        return [tube(bent_path(run, 0.03), 0.012) for run in runs], metal(rng)
    size, splay, segments = rng.uniform(0.03, 0.07), rng.uniform(0, 0.04), int(rng.choice([4, 10]))
    spots = [(x, y), (x, -y), (-x, -y), (-x, y)] + ([(x, 0.0), (-x, 0.0)] if y > 0.9 else [])
    taper = rng.uniform(0.5, 1.0)
    legs = [
        post([(a + splay * np.sign(a), b + splay * np.sign(b), 0), (a, b, c.clear + 0.02)],
             [size * taper, size], segments)
        for a, b in spots
    ]  # fmt: skip
    return legs, wood(rng) if chance(rng, 0.7) else metal(rng)


def _throws(c: Couch, rng: Rng, builder: ShapeBuilder) -> None:
    """Scatter cushions in the corners."""
    for side in (-1, 1):
        if chance(rng, 0.3):
            size = rng.uniform(0.35, 0.5)
            pillow = cushion((0.14, size, size), power=3.2, segments=12)
            lean, turn = -rng.uniform(12, 30), -side * rng.uniform(0, 30)
            spot = (c.rear + 0.14, side * (c.inner - size * 0.5), c.seat + size * 0.45)
            builder.add(pillow.rotate((0.0, lean, turn)).translate(spot), fabric(rng))


def _body(builder: ShapeBuilder, c: Couch, rng: Rng, cover: Material, arms: int) -> float:
    """Base, back, feet and arms (kind, or -1 for none); returns half the whole width."""
    half = c.inner + (c.arm_width if arms >= 0 else 0.0)
    thick = c.seat - c.cushion - c.clear
    low = c.clear if thick > 0.03 else c.seat - c.cushion - 0.05
    c = replace(c, clear=max(low, 0.0))
    builder.add(
        rounded_box((c.depth - 0.01, 2 * c.inner + 0.02, max(thick, 0.05)),
                    (0, 0, c.clear + max(thick, 0.05) / 2), min(c.round, 0.02)), cover)  # fmt: skip
    feet, material = _feet(c, half, rng)
    for foot in feet:
        builder.add(foot, material)
    behind = half if chance(rng, 0.5) or arms < 0 else c.inner + 0.02
    builder.add(_back_frame(c, behind, c.clear), cover)
    if arms >= 0:
        front = c.depth / 2 - rng.choice([0.0, rng.uniform(0, 0.08)])
        arm = _arm(c, rng, arms, front)
        mirrored = arm.mirror((0.0, 1.0, 0.0))
        builder.add(arm.translate((0, c.inner + c.arm_width / 2, 0)), cover)
        builder.add(mirrored.translate((0, -c.inner - c.arm_width / 2, 0)), cover)
    return half


def upholster(rng: Rng, builder: ShapeBuilder, c: Couch, arms: int, cover: Material) -> None:
    """A whole couch: body, cushions, scatter cushions."""
    _body(builder, c, rng, cover, arms)
    plump, bench = rng.random(), chance(rng, 0.25)
    for part in _seat_cushions(c, rng, plump, bench):
        builder.add(part, cover)
    if chance(rng, 0.75):
        count = c.seats if chance(rng, 0.7) else max(1, c.seats - 1)
        for part in _back_cushions(c, rng, min(1.0, plump + 0.2), count):
            builder.add(part, cover)
    if c.seats > 1:
        _throws(c, rng, builder)


def cover_of(rng: Rng) -> Material:
    """Cloth or leather."""
    return fabric(rng) if chance(rng, 0.7) else leather(rng)


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
    pad = _pillow((extra + 0.12, width, c.cushion), rng.uniform(0, 0.8))
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
        pad = _pillow((c.pitch * 0.99, abs(y_out - y_in) - c.back_thick, c.cushion), 0.3)
        middle = (y_in + y_out - side * c.back_thick) / 2
        builder.add(
            pad.translate((start + (i + 0.5) * c.pitch, middle, c.seat - c.cushion / 2)), cover
        )
    wall = np.sort([y_out, y_out - side * c.back_thick])
    builder.add(rounded_box(
        (end + c.depth / 2 - 0.02, c.back_thick, c.back - c.clear),
        ((end - c.depth / 2) / 2, wall.mean(), (c.back + c.clear) / 2), c.round), cover)  # fmt: skip
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
    half = _body(builder, c, rng, cover, 4)
    y, x = half - c.arm_width / 2, -c.depth / 2 + c.back_thick / 2
    run = [(c.depth / 2, y, c.arm), (x, y, c.arm), (x, -y, c.arm), (c.depth / 2, -y, c.arm)]
    builder.add(tube(bent_path(run, 0.14, 4), roll, 12), cover)
    if c.back > c.arm:
        builder.add(rod((x, -y, c.back), (x, y, c.back), roll, segments=12), cover)
    for part in _seat_cushions(c, rng, rng.uniform(0.1, 0.7), False):
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
    half = _body(builder, c, rng, cover, int(rng.choice([1, 3, 4])))
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
    for part in _seat_cushions(c, rng, rng.uniform(0.2, 0.9), chance(rng, 0.5)):
        builder.add(part, cover)
    return builder.build("sofa", "camelback", Symmetry.NONE)


def wooden_couch(rng: Rng, builder: ShapeBuilder, c: Couch) -> None:
    """Loose cushions in an open wooden (or metal) frame with slatted sides."""
    frame = wood(rng) if chance(rng, 0.75) else (paint(rng) if chance(rng, 0.5) else metal(rng))
    cover, size = cover_of(rng), rng.uniform(0.03, 0.055)
    half, front = c.inner + size / 2, c.depth / 2 - rng.uniform(0, 0.08)
    under = c.seat - c.cushion - 0.03
    top = c.back - rng.uniform(0.05, 0.15)
    kick, rear = rng.uniform(0, 0.12), -c.depth / 2
    for y in (half, -half):
        builder.add(post([(front + 0.02, y, 0), (front, y, c.arm)], size), frame)
        builder.add(post([(rear + kick, y, 0), (rear + 0.04, y, c.seat), (rear - c.lean, y, top)],
                         size), frame)  # fmt: skip
        rest = [(rear, y, c.arm + rng.uniform(0, 0.03)), (front + 0.05, y, c.arm + 0.01)]
        builder.add(bar(*rest, rng.uniform(1, 2.2) * size, size * 0.7), frame)
        builder.add(bar((rear + 0.05, y, under), (front, y, under), size * 0.7, 0.06), frame)
        for x in np.linspace(rear, front, int(rng.choice([2, 2, 5, 8])))[1:-1]:
            builder.add(
                box_between((x - 0.01, y - 0.01, under), (x + 0.01, y + 0.01, c.arm)), frame
            )
    for x in (rear + 0.06, front):
        builder.add(box((size * 0.7, 2 * half, 0.06), (x, 0, under)), frame)
    builder.add(box((c.depth * 0.85, 2 * half, 0.02), (0, 0, under + 0.03)), frame)
    for z in np.linspace(c.seat + 0.1, top - 0.02, int(rng.integers(2, 5))):
        x = rear + 0.04 - (c.lean + 0.04) * (z - c.seat) / (top - c.seat)
        builder.add(box((0.02, 2 * half, rng.uniform(0.03, 0.07)), (x, 0, z)), frame)
    plump = rng.uniform(0, 0.7)
    c = replace(c, back_thick=0.06)
    for part in _seat_cushions(c, rng, plump, False) + _back_cushions(c, rng, plump, c.seats):
        builder.add(part, cover)


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
        roll = rod((-deep / 2, y, height + radius * 0.9), (deep / 2, y, height + radius * 0.9), radius,
                   segments=14)  # fmt: skip
        builder.add(roll, cover)
    tall = rng.uniform(0.15, 0.4)
    builder.add(rounded_box((0.08, long * rng.uniform(0.6, 1), tall + thick),
                            (-deep / 2 - 0.03, 0, height - thick + (tall + thick) / 2), 0.03), cover)  # fmt: skip
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
        builder.add(rounded_box((c.back_thick - gap, c.pitch - gap, tall),
                                (c.rear - c.back_thick / 2, y, tall / 2), radius), cover)  # fmt: skip
        if chance(rng, 0.6):
            pillow = cushion((0.16, c.pitch * 0.8, 0.4), power=3.5, segments=12)
            builder.add(pillow.rotate((0.0, -15.0, 0.0)).translate((c.rear + 0.1, y, c.seat + 0.16)),
                        cover)  # fmt: skip
    for there, side in zip(arms, (-1, 1), strict=True):
        if there:
            y = side * (c.inner + c.arm_width / 2)
            builder.add(rounded_box((c.depth - gap, c.arm_width - gap, c.arm), (0, y, c.arm / 2), radius),
                        cover)  # fmt: skip
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
