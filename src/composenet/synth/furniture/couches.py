"""Upholstered bodies and wooden frames of which sofas and armchairs are made."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from composenet.synth.furniture.curves import bent_path, post
from composenet.synth.furniture.parts import (
    Rng,
    Solid,
    arc,
    bar,
    box,
    box_between,
    chance,
    cushion,
    extrude_x,
    extrude_y,
    fabric,
    leather,
    metal,
    paint,
    rounded_box,
    tube,
    wood,
)
from composenet.synth.shape import Material, ShapeBuilder


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


def pillow_of(size: tuple[float, float, float], plump: float) -> Solid:
    """Seat or back cushion: boxy for plump near 0, a swollen pillow near 1."""
    if plump < 0.5:
        return rounded_box(size, radius=0.02 + 0.08 * plump)
    return cushion(size, power=9 - 5.5 * plump, segments=12)


def seat_cushions(c: Couch, rng: Rng, plump: float, bench: bool) -> list[Solid]:
    """One cushion a seat, or one for all."""
    count = 1 if bench else c.seats
    width = 2 * c.inner / count
    over = rng.uniform(-0.01, 0.03)
    long = c.depth / 2 - c.rear + over
    middle = (c.depth / 2 + over + c.rear) / 2
    size = (long, width * 0.995, c.cushion * (1.15 if plump > 0.5 else 1.0))
    places = (np.arange(count) - (count - 1) / 2) * width
    return [pillow_of(size, plump).translate((middle, y, c.seat - c.cushion / 2)) for y in places]


def _back_cushions(c: Couch, rng: Rng, plump: float, count: int) -> list[Solid]:
    """Loose cushions leaning against the back."""
    width, thick = 2 * c.inner / count, rng.uniform(0.1, 0.2)
    tall = (c.back - c.seat) * rng.uniform(0.8, 1.15)
    tilt = -np.degrees(np.arctan2(c.lean, c.back - c.seat)) - rng.uniform(0, 10)
    pillow = pillow_of((thick, width * 0.98, tall), plump).rotate((0.0, float(tilt), 0.0))
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


def couch_body(builder: ShapeBuilder, c: Couch, rng: Rng, cover: Material, arms: int) -> float:
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
    couch_body(builder, c, rng, cover, arms)
    plump, bench = rng.random(), chance(rng, 0.25)
    for part in seat_cushions(c, rng, plump, bench):
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
        start, end = (rear, y, c.arm + rng.uniform(0, 0.03)), (front + 0.05, y, c.arm + 0.01)
        builder.add(bar(start, end, rng.uniform(1, 2.2) * size, size * 0.7), frame)
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
    for part in seat_cushions(c, rng, plump, False) + _back_cushions(c, rng, plump, c.seats):
        builder.add(part, cover)
