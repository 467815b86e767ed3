"""Chairs to sit back in, and chairs to fold: armchairs, tubs, wing chairs, parsons, folding."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np

from composenet.records import Symmetry
from composenet.synth.furniture import chair_parts as cp
from composenet.synth.furniture.couches import draw_couch, upholster, wooden_couch
from composenet.synth.furniture.curves import bent_path, plate, post, soft_slab
from composenet.synth.furniture.parts import (
    Rng,
    Solid,
    bar,
    box,
    chance,
    cylinder,
    metal,
    oval,
    paint,
    plastic,
    rod,
    tube,
    wood,
)
from composenet.synth.shape import Shape, ShapeBuilder


def _armchair(rng: Rng) -> Shape:
    """A sofa for one."""
    builder, c = ShapeBuilder(), draw_couch(rng, 1)
    c = replace(c, depth=rng.uniform(0.68, 0.92), arm_width=rng.uniform(0.06, 0.2))
    upholster(rng, builder, c, int(rng.choice([-1, 0, 1, 2, 3, 4])), cp.cover_of(rng))
    return builder.build("chair", "armchair", Symmetry.NONE)


def _wood_easy(rng: Rng) -> Shape:
    """Loose cushions in an open wooden frame, low and reclined."""
    builder, c = ShapeBuilder(), draw_couch(rng, 1)
    c = replace(c, depth=rng.uniform(0.64, 0.82), lean=rng.uniform(0.08, 0.24),
                cushion=rng.uniform(0.06, 0.13), pitch=rng.uniform(0.48, 0.6))  # fmt: skip
    wooden_couch(rng, builder, c)
    return builder.build("chair", "wood_easy", Symmetry.NONE)


def _tub(rng: Rng) -> Shape:
    """A back that runs round to the arms."""
    builder, cover = ShapeBuilder(), cp.cover_of(rng)
    radius, seat = rng.uniform(0.27, 0.38), rng.uniform(0.38, 0.48)
    deep, turn = radius * rng.uniform(0.9, 1.15), rng.uniform(1.45, 2.1)
    clear = rng.uniform(0.1, 0.22) if chance(rng, 0.7) else 0.0
    low = clear + 0.02 if chance(rng, 0.6) else seat - 0.05
    high, arm = seat + rng.uniform(0.22, 0.42), seat + rng.uniform(0.1, 0.24)
    angle = np.linspace(-1, 1, 17)[:, None]
    up = np.linspace(0, 1, 4)[None]
    blend = np.abs(angle) ** rng.uniform(1.5, 5.0)
    z = low + up * (high + (min(arm, high) - high) * blend - low)
    flare = 1 + rng.uniform(0, 0.15) * up
    x, y = -deep * np.cos(angle * turn) * flare, radius * np.sin(angle * turn) * flare
    grid = np.stack(np.broadcast_arrays(x, y, z), axis=-1)
    builder.add(plate(grid, rng.uniform(0.03, 0.11)), cover)
    outline = oval(2 * deep * 0.97, 2 * radius * 0.97, rng.uniform(2.2, 3.5))
    thick = rng.uniform(0.1, 0.16)
    builder.add(soft_slab(outline, seat - thick, thick, 0.04), cover)
    if clear == 0.0:
        builder.add(soft_slab(outline * 0.95, 0.0, seat - thick + 0.01, 0.01), cover)
    elif chance(rng, 0.3):
        base = cp.star_base(rng, seat - thick + 0.01, 4, chance(rng, 0.4))
        cp.add_all(builder, base, metal(rng))
    else:
        feet = np.array([(1, 1), (1, -1), (-1, -1), (-1, 1)]) * (deep * 0.66, radius * 0.66)
        legs, spread = wood(rng), rng.uniform(1.0, 1.15)
        for spot in feet:
            path = [(*spot * spread, 0), (*spot, seat - thick + 0.02)]
            builder.add(post(path, [0.024, 0.04], int(rng.choice([4, 8]))), legs)
    return builder.build("chair", "tub", Symmetry.NONE)


def _wing(rng: Rng) -> Shape:
    """A high back with wings over the arms."""
    builder, cover = ShapeBuilder(), cp.cover_of(rng)
    c = replace(draw_couch(rng, 1), clear=rng.uniform(0.1, 0.2), depth=rng.uniform(0.72, 0.88))
    c = replace(c, back=c.seat + rng.uniform(0.55, 0.72), arm_width=rng.uniform(0.08, 0.14),
                back_thick=rng.uniform(0.1, 0.16), cushion=rng.uniform(0.08, 0.13))  # fmt: skip
    upholster(rng, builder, c, int(rng.choice([0, 1, 3, 4])), cover)
    reach, y = rng.uniform(0.16, 0.3), c.inner + c.arm_width * 0.4
    z = np.linspace(c.arm - 0.05, c.back * rng.uniform(0.95, 1.0), 7)
    t = np.linspace(0, 1, 7)
    wide = reach * np.sqrt(np.clip(1.05 - t**4, 0.1, 1)) * (0.75 + 0.25 * np.sin(np.pi * t))
    rear = -c.depth / 2 - c.lean * np.clip((z - c.seat) / (c.back - c.seat), 0, 1)
    edge = np.stack([np.zeros(7), np.full(7, y), z], axis=1)
    for side in (1, -1):
        back_edge, front_edge = edge * (1, side, 1), edge * (1, side, 1)
        back_edge[:, 0], front_edge[:, 0] = rear + 0.02, rear + c.back_thick + wide
        grid = np.stack([back_edge, front_edge])[:, ::-side]
        builder.add(plate(grid, rng.uniform(0.05, 0.06)), cover)
    return builder.build("chair", "wing", Symmetry.NONE)


def _parsons(rng: Rng) -> Shape:
    """Fully upholstered dining chair on short or covered legs."""
    builder, cover = ShapeBuilder(), cp.cover_of(rng)
    plan = cp.draw_plan(rng)
    plan = replace(plan, wrap=0.0, back=rng.uniform(0.45, 0.68), rake=rng.uniform(0.02, 0.2))
    thick, size = rng.uniform(0.08, 0.22), rng.uniform(0.03, 0.06)
    feet, tops = plan.corners(0.0, size / 2), plan.corners(plan.height - thick + 0.01, size / 2)
    feet[2:, 0] -= rng.uniform(0, 0.06)
    skirt = chance(rng, 0.15)
    if skirt:
        builder.add(box((plan.depth, plan.width, plan.height - 0.03),
                        (0, 0, (plan.height - 0.03) / 2)), cover)  # fmt: skip
    else:
        legs = cp.legs_between(feet, tops, size, rng.uniform(0.6, 1), int(rng.choice([4, 4, 8])))
        cp.add_all(builder, legs, wood(rng) if chance(rng, 0.8) else metal(rng))
    builder.add(cp.seat(plan, rng, thick, rng.uniform(0.01, 0.04)), cover)
    crown = rng.choice([0.0, -0.03, 0.05]) * rng.uniform(0.5, 1)
    padding = rng.uniform(0.05, 0.11)
    inner = replace(plan, depth=plan.depth - padding)
    builder.add(cp.pad(inner, -thick * 0.6, plan.back, padding, crown), cover)
    if chance(rng, 0.2):
        for y in (-plan.width / 2, plan.width / 2):
            path = [
                (plan.depth * 0.3, y, plan.height - 0.05),
                (plan.depth * 0.3, y, plan.height + 0.2),
                (-plan.depth / 2, y, plan.height + 0.22),
            ]
            builder.add(tube(bent_path(path, 0.06), 0.022), cover)
    return builder.build("chair", "parsons", Symmetry.NONE)


def _folding(rng: Rng) -> Shape:
    """Two crossing frames, a seat on the shorter, the back on the longer."""
    builder = ShapeBuilder()
    steel = chance(rng, 0.5)
    frame = metal(rng) if steel else wood(rng)
    cover = plastic(rng) if chance(rng, 0.4) else frame
    width, height = rng.uniform(0.38, 0.46), rng.uniform(0.42, 0.47)
    front, rear, top = rng.uniform(0.2, 0.27), -rng.uniform(0.2, 0.3), rng.uniform(0.76, 0.9)
    size = rng.uniform(0.018, 0.03)
    seat_back, seat_front = -0.16, 0.2

    def strut(a: tuple[float, ...], b: tuple[float, ...]) -> Solid:
        return rod(a, b, size / 2, segments=8) if steel else bar(a, b, size * 0.7, size * 1.3)

    crest = -rng.uniform(0.18, 0.3)
    for side in (1, -1):
        y, inner = side * width / 2, side * (width / 2 - size * 1.1)
        builder.add(strut((front, y, size / 2), (crest, y, top)), frame)
        builder.add(
            strut((rear, inner, size / 2), (seat_front - 0.02, inner, height - 0.01)), frame
        )
    for spot in ((front, size / 2), (rear, size / 2), (front * 0.75, height * 0.25)):
        builder.add(strut((spot[0], -width / 2, spot[1]), (spot[0], width / 2, spot[1])), frame)
    slats = int(rng.choice([1, 1, 5, 7]))
    edges = np.linspace(seat_back, seat_front, slats + 1)
    for a, b in pairwise(edges):
        wide = (b - a) * (1.0 if slats == 1 else 0.75)
        builder.add(box((wide, width - 3 * size, 0.016), ((a + b) / 2, 0, height)), cover)
    low = rng.uniform(0.62, 0.7) * top / 0.8
    boards = int(rng.integers(1, 4))
    for i in range(boards):
        z = np.array([i + 0.0, i + 0.8]) / boards * (top - low) + low
        x = front + (crest - front) * (z - size / 2) / (top - size / 2)
        u = np.linspace(-1, 1, 5)[:, None]
        grid = np.stack(
            np.broadcast_arrays(x[None] - 0.03 * (1 - u**2), u * width / 2, z[None]), -1
        )
        builder.add(plate(grid, 0.012), cover)
    return builder.build("chair", "folding", Symmetry.NONE)


def _director(rng: Rng) -> Shape:
    """Cloth seat and back in an X-legged frame with arms."""
    builder, frame, cloth = ShapeBuilder(), wood(rng), cp.cover_of(rng)
    width, height, deep = rng.uniform(0.5, 0.58), rng.uniform(0.43, 0.5), rng.uniform(0.38, 0.44)
    arm, top, size = height + rng.uniform(0.16, 0.22), rng.uniform(0.8, 0.92), 0.03
    y, x = width / 2, deep / 2
    for fore in (x, -x):
        builder.add(bar((fore, -y, 0.02), (fore, y, height), 0.02, size), frame)
        builder.add(bar((fore + 0.02, y, 0.02), (fore + 0.02, -y, height), 0.02, size), frame)
    for side in (y, -y):
        builder.add(box((deep + 0.1, size, 0.025), (0, side, 0.0125)), frame)
        builder.add(box((deep + 0.1, size * 1.8, 0.02), (0.02, side, arm)), frame)
        builder.add(post([(x * 0.8, side, height - 0.02), (x * 0.8, side, arm)], size), frame)
        builder.add(post([(-x, side, height - 0.02), (-x - 0.03, side, top)], size), frame)
        builder.add(box((deep + 0.06, size, size), (0, side, height)), frame)
    sag = rng.uniform(0.01, 0.05)
    across = np.linspace(-1, 1, 7)[:, None]
    up = np.linspace(rng.uniform(0.6, 0.7) * top, top - 0.02, 2)[None]
    seat = np.stack(
        np.broadcast_arrays(np.array([[x, -x]]), across * y, height - sag * (1 - across**2)), -1
    )
    back = np.stack(np.broadcast_arrays(-x - 0.02 - sag * (1 - across**2), across * y, up), -1)
    builder.add(plate(seat, 0.008), cloth)
    builder.add(plate(back, 0.008), cloth)
    return builder.build("chair", "director", Symmetry.NONE)


def _sling(rng: Rng) -> Shape:
    """A long bent seat and back in one sweep, on a bent-wood or tube frame."""
    builder, plan = ShapeBuilder(), cp.draw_plan(rng, low=True)
    plan = replace(plan, back=rng.uniform(0.55, 0.75), rake=rng.uniform(0.3, 0.55))
    frame, cover = wood(rng) if chance(rng, 0.5) else metal(rng), cp.cover_of(rng)
    front, rear, y = plan.depth / 2, -plan.depth / 2, plan.width / 2
    drop = rng.uniform(0.02, 0.09)
    run = [(front, 0, plan.height), (rear, 0, plan.height - drop), plan.at(0.0, plan.back)]
    sweep = bent_path(run, rng.uniform(0.1, 0.2), 5)
    u = np.linspace(-1, 1, 5)[:, None, None]
    cushion = sweep[None] + u * (0, y * 0.96, 0)
    builder.add(plate(cushion, rng.choice([0.02, 0.05, 0.09])), cover)
    lift = rng.uniform(0.14, 0.22)
    arms, radius = chance(rng, 0.7), rng.uniform(0.011, 0.018)
    for side in (y, -y):
        builder.add(tube(sweep + np.array([0, side, -0.03]), radius), frame)
        top = plan.height + lift if arms else plan.height - 0.03
        loop = [(rear, side, top - 0.04), (front, side, top), (front + 0.03, side, radius),
                (rear - 0.05, side, radius)]  # fmt: skip
        if chance(rng, 0.5) and not arms:
            loop = [(rear + 0.05, side, top - drop), (rear - 0.08, side, radius),
                    (front + 0.05, side, radius), (front - 0.05, side, top)]  # fmt: skip
        elif arms:
            loop.append((rear - 0.02, side, top - 0.03))
        builder.add(tube(bent_path(loop, 0.08), radius), frame)
    for x in (rear * 0.6, front * 0.7):
        builder.add(rod((x, -y, plan.height - drop), (x, y, plan.height - drop), radius), frame)
    return builder.build("chair", "sling", Symmetry.NONE)


def _ball_lounge(rng: Rng) -> Shape:
    """A wide moulded lounge chair on a swivel foot, with its cushions."""
    builder, plan = ShapeBuilder(), cp.draw_plan(rng, low=True)
    shell, cover = (wood if chance(rng, 0.5) else paint)(rng), cp.cover_of(rng)
    seat, back = replace(plan, height=plan.height + 0.02), rng.uniform(0.45, 0.7)
    tall = replace(plan, back=back, wrap=0.06)
    builder.add(cp.pad(tall, 0.02, back, rng.uniform(0.08, 0.12)), cover)
    builder.add(cp.seat(seat, rng, rng.uniform(0.1, 0.14), 0.05), cover)
    behind = replace(tall, depth=plan.depth + 0.1)
    builder.add(cp.rail(behind, -0.02, back * 0.95, 0.015), shell)
    builder.add(cp.seat(replace(plan, height=plan.height - 0.06), rng, 0.04, 0.015), shell)
    for y in (-plan.width / 2 - 0.03, plan.width / 2 + 0.03):
        path = [
            (plan.depth * 0.3, y, plan.height - 0.08),
            (plan.depth * 0.3, y, plan.height + 0.16),
            (-plan.depth / 2, y, plan.height + 0.18),
        ]
        builder.add(tube(bent_path(path, 0.08), rng.uniform(0.02, 0.035)), cover)
    cp.add_all(builder, cp.star_base(rng, plan.height - 0.09, int(rng.integers(4, 6)), False),
               metal(rng))  # fmt: skip
    builder.add(cylinder(0.1, 0.03, (0, 0, plan.height - 0.12)), metal(rng))
    return builder.build("chair", "swivel_lounge", Symmetry.NONE)


EASY: dict[str, Callable[[Rng], Shape]] = {
    "armchair": _armchair,
    "wood_easy": _wood_easy,
    "tub": _tub,
    "wing": _wing,
    "parsons": _parsons,
    "folding": _folding,
    "director": _director,
    "sling": _sling,
    "swivel_lounge": _ball_lounge,
}
