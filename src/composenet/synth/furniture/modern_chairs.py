"""Chairs of the last hundred years: moulded shells, cantilevers, office chairs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from composenet.records import Symmetry
from composenet.synth.furniture import chair_parts as cp
from composenet.synth.furniture.chair_parts import Plan
from composenet.synth.furniture.curves import bent_path, plate, post
from composenet.synth.furniture.parts import (
    Rng,
    Solid,
    bar,
    box,
    chance,
    fabric,
    metal,
    paint,
    plastic,
    rounded_box,
    tube,
    wood,
)
from composenet.synth.shape import Material, Shape, ShapeBuilder


def _shell_surface(plan: Plan, rng: Rng, arms: bool) -> np.ndarray:
    """(9, P, 3) grid of a bent seat and back in one piece, front edge to top."""
    front, back = plan.depth / 2, -plan.depth / 2
    lip = rng.uniform(0.0, 0.05)
    top = plan.at(0.0, plan.back)
    profile = bent_path(
        [(front, 0, plan.height - lip), (front - 0.1, 0, plan.height),
         (back, 0, plan.height - rng.uniform(0, 0.03)), top],
        rng.uniform(0.08, 0.16), steps=4,
    )  # fmt: skip
    t = np.linspace(0, 1, len(profile))
    u = np.linspace(-1, 1, 9)[:, None]
    swell = 1 - rng.uniform(0, 0.3) * np.clip(t - 0.6, 0, 1) / 0.4 - 0.25 * (t > 0.97)
    y = u * plan.width / 2 * swell
    sides = rng.uniform(0.02, 0.06) + (rng.uniform(0.08, 0.16) if arms else 0.0)
    lift = sides * np.abs(u) ** 3 * np.sin(np.pi * np.clip(t * 1.05, 0, 1)) ** 0.7
    tangent = np.gradient(profile, axis=0)
    normal = np.cross((0.0, 1.0, 0.0), tangent)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    grid = profile[None] + lift[..., None] * (normal + np.array([0, 0, 0.4 if arms else 0.0]))
    grid[..., 1] = y
    return grid


def _shell(rng: Rng) -> Shape:
    """A moulded shell on splayed legs, wires, a sled, a tulip or a star."""
    builder, plan = ShapeBuilder(), cp.draw_plan(rng)
    plan = replace(plan, width=plan.width + 0.03, rake=rng.uniform(0.12, 0.35))
    arms = chance(rng, 0.35)
    plan = replace(plan, width=plan.width + 0.1 * arms)
    skin = [plastic, wood, paint, fabric][rng.integers(4)](rng)
    grid = _shell_surface(plan, rng, arms)
    builder.add(plate(grid, rng.choice([0.012, 0.03])), skin)
    under, kind = plan.height - 0.03, rng.integers(5)
    if kind == 0:
        feet, tops = plan.corners(0.0, 0.02, rng.uniform(0, 0.04)), plan.corners(under, 0.1)
        cp.add_all(
            builder, cp.legs_between(feet, tops, rng.uniform(0.03, 0.042), 0.6, 8), wood(rng)
        )
        builder.add(box((0.26, 0.2, 0.02), (0, 0, under)), metal(rng))
    elif kind == 1:
        cp.add_all(builder, cp.wire_base(plan, rng, under), metal(rng))
    elif kind == 2:
        cp.add_all(builder, cp.sled_base(plan, rng, rng.uniform(0.007, 0.013), under), metal(rng))
    elif kind == 3:
        cp.add_all(builder, cp.tulip_base(rng, under, rng.uniform(0.2, 0.26)), paint(rng))
    else:
        base = cp.star_base(rng, under, int(rng.integers(4, 6)), chance(rng, 0.5))
        cp.add_all(builder, base, metal(rng))
    if chance(rng, 0.3):
        cushion = replace(plan, width=plan.width * 0.8, depth=plan.depth * 0.8)
        builder.add(cp.seat(replace(cushion, height=plan.height + 0.03), rng, 0.04, 0.02),
                    cp.cover_of(rng))  # fmt: skip
    return builder.build("chair", "shell", Symmetry.NONE)


def _cantilever(rng: Rng) -> Shape:
    """One bent steel tube: back, seat, front legs, floor loop; no hind legs."""
    builder, steel, plan = ShapeBuilder(), metal(rng), cp.draw_plan(rng)
    radius, y = rng.uniform(0.010, 0.016), plan.width / 2
    front, back = plan.depth / 2, -plan.depth / 2
    lean = rng.uniform(0, 0.06)
    arms = chance(rng, 0.35)
    floor_back = back - rng.uniform(-0.02, 0.08)
    for side in (y, -y):
        run = [plan.at(side, plan.back), plan.at(side, 0.0) - (0, 0, 0.01),
               (front, side, plan.height - 0.01), (front + lean, side, radius),
               (floor_back, side, radius), (floor_back, 0.0, radius)]  # fmt: skip
        builder.add(tube(bent_path(run, 0.07, 3), radius), steel)
        if arms:
            z = plan.height + rng.uniform(0.18, 0.24)
            loop = [plan.at(side, 0.25), (front - 0.03, side, z), (front - 0.03, side, plan.height)]
            builder.add(tube(bent_path(loop, 0.06), radius), steel)
    cover = cp.cover_of(rng) if chance(rng, 0.7) else wood(rng)
    thick = rng.uniform(0.012, 0.06)
    inner = replace(plan, width=plan.width - 0.01)
    builder.add(cp.seat(replace(inner, height=plan.height + thick / 2), rng, thick, thick), cover)
    low = plan.back * rng.uniform(0.05, 0.5)
    builder.add(cp.pad(inner, low, plan.back * 1.01, max(thick, 0.02)), cover)
    return builder.build("chair", "cantilever", Symmetry.NONE)


def _office_back(builder: ShapeBuilder, plan: Plan, rng: Rng, cover: Material) -> None:
    """A mesh, padded or executive back on its spine."""
    low = rng.uniform(0.02, 0.16)
    spine = [(0.0, 0, plan.height - 0.07), (-plan.depth / 2 - 0.04, 0, plan.height - 0.05),
             plan.at(0.0, low + 0.15) - (0.015, 0, 0)]  # fmt: skip
    builder.add(tube(bent_path(spine, 0.06), 0.018), metal(rng))
    builder.add(cp.pad(plan, low, plan.back, rng.choice([0.02, 0.05, 0.09]),
                       rng.uniform(0, 0.04)), cover)  # fmt: skip
    if plan.back < 0.62 and chance(rng, 0.35):
        narrow = replace(plan, width=plan.width * 0.6)
        builder.add(cp.pad(narrow, plan.back + 0.03, plan.back + 0.16, 0.05), cover)
        builder.add(cp.stile(plan, 0.0, plan.back - 0.1, plan.back + 0.08, 0.05, 0.015), metal(rng))


def _office_arms(plan: Plan, rng: Rng) -> list[Solid]:
    """T-shaped or looped arm rests."""
    lift, y, size = rng.uniform(0.18, 0.26), plan.width / 2 + 0.03, rng.uniform(0.03, 0.05)
    length, z = rng.uniform(0.2, 0.3), plan.height + lift
    loop = chance(rng, 0.35)
    solids: list[Solid] = []
    for side in (y, -y):
        solids.append(rounded_box((length, 0.07, 0.03), (0.0, side, z), 0.012))
        solids.append(bar((0, side * 0.6, plan.height - 0.06), (0, side, plan.height - 0.06),
                          0.05, 0.02))  # fmt: skip
        if loop:
            path = [(-0.12, side, z), (-0.08, side, plan.height - 0.06),
                    (0.08, side, plan.height - 0.06), (0.12, side, z)]  # fmt: skip
            solids.append(tube(bent_path(path, 0.06), size / 2.5))
        else:
            solids.append(post([(0, side, plan.height - 0.07), (0, side, z)], size))
    return solids


def _office(rng: Rng) -> Shape:
    """Swivel chair: star base with casters, gas column, most often arms."""
    builder, plan, dark = ShapeBuilder(), cp.draw_plan(rng), plastic(rng)
    plan = replace(
        plan,
        width=rng.uniform(0.44, 0.54),
        depth=rng.uniform(0.42, 0.52),
        back=rng.uniform(0.38, 0.74),
        bow=rng.uniform(0, 0.05),
        rake=rng.uniform(0.05, 0.2),
        wrap=rng.uniform(0, 0.07),
        height=rng.uniform(0.42, 0.55),
    )
    cover, thick = cp.cover_of(rng), rng.uniform(0.04, 0.10)
    cp.add_all(
        builder, cp.star_base(rng, plan.height - thick), metal(rng) if chance(rng, 0.5) else dark
    )
    builder.add(box((0.2, 0.16, 0.04), (0, 0, plan.height - thick - 0.02)), dark)
    builder.add(cp.seat(plan, rng, thick, 0.03), cover)
    _office_back(builder, replace(plan, width=plan.width * rng.uniform(0.8, 1.0)), rng, cover)
    if chance(rng, 0.75):
        cp.add_all(builder, _office_arms(plan, rng), dark)
    return builder.build("chair", "office", Symmetry.NONE)


MODERN: dict[str, Callable[[Rng], Shape]] = {
    "shell": _shell,
    "cantilever": _cantilever,
    "office": _office,
}
