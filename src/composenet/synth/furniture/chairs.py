"""Chairs: the sitter faces +X, the back rest is at -X."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from composenet.records import Symmetry
from composenet.synth.furniture import chair_parts as cp
from composenet.synth.furniture.chair_parts import BackMaker, Plan
from composenet.synth.furniture.curves import bent_path, post, soft_slab
from composenet.synth.furniture.easy_chairs import EASY
from composenet.synth.furniture.modern_chairs import MODERN
from composenet.synth.furniture.parts import (
    Rng,
    Solid,
    bar,
    chance,
    metal,
    oval,
    paint,
    rod,
    tube,
    wood,
)
from composenet.synth.shape import Material, Shape, ShapeBuilder


def _frame(rng: Rng) -> Material:
    return wood(rng) if chance(rng, 0.75) else paint(rng)


def _wood_seat(builder: ShapeBuilder, plan: Plan, rng: Rng, frame: Material) -> None:
    """A bare board, a board with a cushion, or an upholstered or rush seat."""
    kind = rng.integers(3)
    board = rng.uniform(0.018, 0.035)
    if kind == 0:
        builder.add(cp.seat(plan, rng, board), frame)
        return
    pad = rng.uniform(0.03, 0.075)
    builder.add(cp.seat(plan, rng, pad, edge=rng.uniform(0.4, 1) * pad), cp.cover_of(rng))
    if kind == 2:
        builder.add(cp.seat(replace(plan, height=plan.height - pad * 0.8), rng, board), frame)


def _wood_arms(plan: Plan, rng: Rng) -> list[Solid]:
    """Arm rests on supports that rise from the sides of the seat."""
    lift, y = rng.uniform(0.17, 0.25), plan.width / 2 + 0.012
    wide, thick = rng.uniform(0.025, 0.06), rng.uniform(0.015, 0.035)
    front = plan.depth * rng.uniform(0.2, 0.5)
    solids = []
    for side in (y, -y):
        back = plan.at(plan.width / 2, lift)[0]
        z = plan.height + lift
        solids.append(bar((back, side, z), (front + 0.03, side, z), wide, thick))
        solids.append(
            post([(front, side, plan.height - 0.05), (front, side, plan.height + lift)], 0.028)
        )
    return solids


def _posts(plan: Plan, size: float, segments: int, kick: float, over: float) -> list[Solid]:
    """Back legs that go on as the posts of the back, `over` past its length."""
    solids = []
    for y in (-plan.width / 2, plan.width / 2):
        seat = plan.at(y, 0.0)
        up = plan.at(np.full(3, y), np.array([0.33, 0.66, 1.0]) * (plan.back + over))
        path = [(seat[0] - kick, y, 0.0), seat - (0, 0, 0.1), *up]
        solids.append(post(path, size * np.array([0.9, 1, 1, 0.95, 0.8]), segments))
    return solids


def _wooden(rng: Rng, style: str, back: BackMaker, arms: float = 0.1) -> Shape:
    """Four legs, the hind pair rising as posts; stretchers, an apron, any back between."""
    builder, frame, plan = ShapeBuilder(), _frame(rng), cp.draw_plan(rng)
    if chance(rng, arms):
        plan = replace(plan, width=plan.width + 0.08)
        cp.add_all(builder, _wood_arms(plan, rng), frame)
    segments, size = int(rng.choice([4, 4, 10])), rng.uniform(0.026, 0.055)
    taper, kick = rng.uniform(0.55, 1.0), rng.uniform(-0.01, 0.09)
    under = plan.height - 0.02
    feet, tops = plan.corners(0.0, size / 2), plan.corners(under, size / 2)
    feet[2:, 0], tops[2:, 0] = -plan.depth / 2 - kick, -plan.depth / 2
    feet[2:, 1], tops[2:, 1] = (-plan.width / 2, plan.width / 2), (-plan.width / 2, plan.width / 2)
    cp.add_all(builder, cp.legs_between(feet[:2], tops[:2], size, taper, segments), frame)
    over = rng.choice([0.0, rng.uniform(0.01, 0.06)])
    cp.add_all(builder, _posts(plan, size * rng.uniform(0.7, 1), segments, kick, over), frame)
    cp.add_all(builder, cp.stretchers(feet, tops, rng, segments != 4), frame)
    if chance(rng, 0.6):
        cp.add_all(builder, cp.apron(tops, rng.uniform(0.04, 0.08), 0.018), frame)
    _wood_seat(builder, plan, rng, frame)
    cp.add_all(builder, back(plan, rng), cp.cover_of(rng) if back is cp.padded_panel else frame)
    return builder.build("chair", style, Symmetry.NONE)


def _windsor(rng: Rng) -> Shape:
    """Saddle seat, turned splayed legs, spindles under a comb or hoop."""
    builder, frame, plan = ShapeBuilder(), _frame(rng), cp.draw_plan(rng)
    feet = plan.corners(0.0, 0.03, rng.uniform(0.02, 0.06))
    tops = plan.corners(plan.height - 0.02, 0.07)
    size = rng.uniform(0.028, 0.042)
    for a, b in zip(feet, tops, strict=True):
        bulge = size * np.array([0.6, 1.0, 0.7, 1.0, 0.6])
        builder.add(post(a + np.linspace(0, 1, 5)[:, None] * (b - a), bulge, 8), frame)
    cp.add_all(builder, cp.stretchers(feet, tops, rng, True), frame)
    builder.add(cp.seat(plan, rng, rng.uniform(0.03, 0.05), 0.02), frame)
    narrow = replace(plan, depth=plan.depth - 0.04, width=plan.width - 0.02)
    if chance(rng, 0.5):
        cp.add_all(builder, cp.hoop(narrow, rng, int(rng.integers(4, 8))), frame)
    else:
        cp.add_all(builder, cp.spindles(narrow, rng), frame)
    if chance(rng, 0.25):
        cp.add_all(builder, _wood_arms(plan, rng), frame)
    return builder.build("chair", "windsor", Symmetry.NONE)


def _bistro(rng: Rng) -> Shape:
    """Round seat, bent-wood or metal hoops."""
    builder, plan = ShapeBuilder(), cp.draw_plan(rng)
    frame = wood(rng) if chance(rng, 0.5) else metal(rng)
    width = rng.uniform(0.36, 0.44)
    plan = replace(plan, width=width, depth=width, wrap=0.02)
    feet, tops = plan.corners(0.0, 0.03, 0.01), plan.corners(plan.height - 0.02, 0.06)
    cp.add_all(builder, cp.legs_between(feet, tops, rng.uniform(0.022, 0.032), 0.8, 8), frame)
    if chance(rng, 0.7):
        z = plan.height * rng.uniform(0.35, 0.6)
        builder.add(cp.foot_ring(rng, float(np.hypot(*feet[0, :2])) * 0.88, z), frame)
    outline = oval(width + 0.02, width + 0.02, rng.choice([2.0, 3.0]))
    builder.add(soft_slab(outline, plan.height - 0.03, 0.035, 0.012),
                cp.cover_of(rng) if chance(rng, 0.4) else frame)  # fmt: skip
    back = replace(plan, depth=width - 0.06, width=width)
    cp.add_all(builder, cp.hoop(back, rng, int(rng.integers(0, 4))), frame)
    inner = replace(back, width=width * 0.6, back=back.back * 0.75)
    if chance(rng, 0.5):
        cp.add_all(builder, cp.hoop(inner, rng, 0), frame)
    return builder.build("chair", "bistro", Symmetry.NONE)


def _stool(rng: Rng) -> Shape:
    """Stool or bar stool without a back."""
    builder, frame = ShapeBuilder(), _frame(rng) if chance(rng, 0.6) else metal(rng)
    height = rng.uniform(0.43, 0.50) if chance(rng, 0.4) else rng.uniform(0.60, 0.80)
    width = rng.uniform(0.29, 0.42)
    plan = Plan(width, width, height, 0.3, 0.0)
    top = cp.cover_of(rng) if chance(rng, 0.5) else frame
    if chance(rng, 0.3):
        steel, rest = metal(rng), height > 0.55
        cp.add_all(builder, cp.tulip_base(rng, height - 0.02, width * rng.uniform(0.5, 0.6)), steel)
        if rest:
            z, reach = height * 0.35, width * 0.4
            builder.add(cp.foot_ring(rng, reach, z), steel)
            for way in ((reach, 0), (0, reach)):
                builder.add(rod((-way[0], -way[1], z), (*way, z), 0.008, segments=8), steel)
        builder.add(cp.round_slab(rng, width / 2, height), top)
        return builder.build("chair", "stool", Symmetry.FOUR if rest else Symmetry.INF)
    disc = chance(rng, 0.5)
    inset = width * 0.17 if disc else rng.uniform(0.02, 0.05)
    feet, tops = plan.corners(0.0, inset, rng.uniform(0, 0.06)), plan.corners(height - 0.02, inset)
    segments = int(rng.choice([4, 8]))
    cp.add_all(
        builder, cp.legs_between(feet, tops, rng.uniform(0.024, 0.045), 0.8, segments), frame
    )
    low, high = np.sort(rng.uniform(0.15, 0.75, 2))
    for share in (low, high):
        at = feet + share * (tops - feet)
        cp.add_all(
            builder, [rod(at[i], at[(i + 1) % 4], 0.01, segments=8) for i in range(4)], frame
        )
    if disc:
        builder.add(cp.round_slab(rng, width / 2, height), top)
    else:
        builder.add(soft_slab(oval(width, width, 6.0), height - 0.05, 0.05, 0.015), top)
    return builder.build("chair", "stool", Symmetry.FOUR)


def _bar_chair(rng: Rng) -> Shape:
    """A high stool with a low back, on four legs or a pedestal."""
    builder, frame = ShapeBuilder(), wood(rng) if chance(rng, 0.5) else metal(rng)
    width, height = rng.uniform(0.36, 0.44), rng.uniform(0.62, 0.80)
    plan = Plan(width, width, height, rng.uniform(0.16, 0.4), rng.uniform(0.05, 0.2), 0.05)
    if chance(rng, 0.4):
        cp.add_all(builder, cp.tulip_base(rng, height - 0.03, rng.uniform(0.19, 0.24)), frame)
        z, reach = height * 0.35, width * 0.42
        loop = [(0, 0, z), (0, reach, z), (reach, reach, z), (reach, -reach, z), (0, -reach, z),
                (0, 0, z)]  # fmt: skip
        builder.add(tube(bent_path(loop, 0.06), 0.01), frame)
    else:
        feet = plan.corners(0.0, 0.02, rng.uniform(0, 0.05))
        tops = plan.corners(height - 0.02, 0.03)
        segments = int(rng.choice([4, 8]))
        cp.add_all(
            builder, cp.legs_between(feet, tops, rng.uniform(0.024, 0.04), 0.8, segments), frame
        )
        at = feet + rng.uniform(0.25, 0.45) * (tops - feet)
        cp.add_all(
            builder, [rod(at[i], at[(i + 1) % 4], 0.01, segments=8) for i in range(4)], frame
        )
    cover = cp.cover_of(rng) if chance(rng, 0.6) else frame
    builder.add(cp.seat(plan, rng, rng.uniform(0.03, 0.07), 0.02), cover)
    makers: list[BackMaker] = [cp.padded_panel, cp.solid_panel, cp.horizontal_slats, cp.spindles]
    cp.add_all(builder, makers[rng.integers(4)](plan, rng), cover)
    for y in (-width * 0.42, width * 0.42):
        s = np.linspace(-0.03, plan.back * 0.8, 3)
        builder.add(tube(plan.at(np.full(3, y), s) - (0.01, 0, 0), 0.01), frame)
    return builder.build("chair", "bar_chair", Symmetry.NONE)


_WOODEN: dict[str, tuple[BackMaker, float]] = {
    "kitchen_slatted": (cp.horizontal_slats, 0.06),
    "vertical_slatted": (cp.vertical_slats, 0.1),
    "ladder_back": (cp.ladder_rungs, 0.15),
    "solid_back": (cp.solid_panel, 0.1),
    "padded_back": (cp.padded_panel, 0.15),
    "splat_back": (cp.splat, 0.2),
    "cross_back": (cp.crossed, 0.1),
    "spindle_back": (cp.spindles, 0.1),
    "dining_armchair": (cp.vertical_slats, 1.0),
}

STYLES: dict[str, dict[str, Callable[[Rng], Shape]]] = {
    "chair": {
        **{
            name: partial(_wooden, style=name, back=back, arms=arms)
            for name, (back, arms) in _WOODEN.items()
        },
        "windsor": _windsor,
        "bistro": _bistro,
        "stool": _stool,
        "bar_chair": _bar_chair,
        **MODERN,
        **EASY,
    }
}
