"""Beds: panel, slatted, upholstered, platform, box, four-poster, bunk, daybed, sleigh, cot.

The head is at -X, so +X looks from the foot end into the room.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from composenet.records import Symmetry
from composenet.synth.furniture.bed_parts import (
    add_bedding,
    add_board,
    add_frame,
    random_plan,
)
from composenet.synth.furniture.cases import Cell, add_case, opened, random_look
from composenet.synth.furniture.parts import (
    Rng,
    arc,
    bar,
    box,
    carcass,
    chance,
    cone,
    cushion,
    extrude_y,
    fabric,
    leather,
    metal,
    paint,
    rod,
    rounded_box,
    tube,
)
from composenet.synth.shape import Shape, ShapeBuilder


def panel(rng: Rng) -> Shape:
    """Wooden frame with head and foot boards of many kinds."""
    builder, plan, material = ShapeBuilder(), random_plan(rng), carcass(rng)
    add_frame(builder, rng, plan, material)
    add_bedding(builder, rng, plan)
    width = plan.width + float(rng.uniform(0.04, 0.12))
    kind = str(rng.choice(["plain", "posts", "slats", "arch", "rungs"]))
    x = plan.length / 2 + 0.02
    low = float(rng.uniform(0.1, plan.slats))
    head = plan.top + float(rng.uniform(0.2, 0.7))
    add_board(builder, rng, -x, width, low, head, material, kind)
    if chance(rng, 0.65):
        foot = plan.slats + float(rng.uniform(0.05, 0.5)) * (head - plan.slats)
        add_board(builder, rng, x, width, low, foot, material, kind)
    return builder.build("bed", "panel", Symmetry.NONE)


def metal_frame(rng: Rng) -> Shape:
    """Tubes and rods."""
    builder, plan, material = ShapeBuilder(), random_plan(rng, (0.28, 0.42)), metal(rng)
    radius = float(rng.uniform(0.012, 0.022))
    half, x = plan.width / 2 + 0.02, plan.length / 2 + 0.02
    head = plan.top + float(rng.uniform(0.25, 0.6))
    foot = plan.top + float(rng.uniform(-0.1, 0.25))
    rounded = chance(rng, 0.5)
    for end, high in ((-x, head), (x, foot)):
        bend = float(rng.uniform(0.08, 0.2)) if rounded else 0.001
        hoop = [(end, -half, 0), (end, -half, high - bend)]
        hoop += [(end, -half + 0.3 * bend, high - 0.3 * bend), (end, -half + bend, high)]
        hoop += [(end, -y, z) for _, y, z in reversed(hoop)]
        builder.add(tube(hoop, radius, 8), material)
        low = plan.slats
        builder.add(rod((end, -half, low), (end, half, low), radius, segments=6), material)
        for y in np.linspace(-half, half, max(5, round(plan.width / 0.16)))[1:-1]:
            builder.add(
                rod((end, y, low), (end, y, high - 0.4 * bend), 0.4 * radius, segments=6), material
            )
    for y in (-half, half):
        builder.add(box((2 * x, 0.03, 0.04), (0, y, plan.slats)), material)
    builder.add(box((plan.length, plan.width, 0.03), (0, 0, plan.slats - 0.015)), material)
    add_bedding(builder, rng, plan)
    return builder.build("bed", "metal_frame", Symmetry.NONE)


def upholstered(rng: Rng) -> Shape:
    """Padded head board, cloth round the frame, short feet."""
    builder, plan = ShapeBuilder(), random_plan(rng, (0.2, 0.32))
    material = fabric(rng) if chance(rng, 0.7) else leather(rng)
    lift, pad = float(rng.uniform(0.03, 0.12)), float(rng.uniform(0.03, 0.08))
    length, width = plan.length + pad, plan.width + 2 * pad
    size = (length, width, plan.slats + 0.06 - lift)
    builder.add(rounded_box(size, (pad / 2, 0, (plan.slats + 0.06 + lift) / 2), 0.03), material)
    for x in (-length / 2 + 0.1, length / 2 - 0.05):
        for y in (-width / 2 + 0.1, width / 2 - 0.1):
            builder.add(box((0.06, 0.06, lift + 0.02), (x, y, lift / 2 + 0.01)), carcass(rng))
    add_bedding(builder, rng, plan)
    high = plan.top + float(rng.uniform(0.3, 0.85))
    wide = width + float(rng.choice([0.0, rng.uniform(0.0, 0.3)]))
    add_board(
        builder, rng, -plan.length / 2 - 0.06, wide, plan.slats * 0.8, high, material, "padded"
    )
    if chance(rng, 0.25):  # wings
        for side in (-1, 1):
            size = (0.2, 0.06, high - 0.05)
            wing = rounded_box(size, (0.06 - plan.length / 2, side * wide / 2, high / 2), 0.02)
            builder.add(wing, material)
    return builder.build("bed", "upholstered", Symmetry.NONE)


def platform(rng: Rng) -> Shape:
    """A wide low deck that floats on a recessed base; a low head board or none."""
    builder, plan, material = ShapeBuilder(), random_plan(rng, (0.14, 0.3)), carcass(rng)
    edge, thick = float(rng.uniform(0.02, 0.25)), float(rng.uniform(0.04, 0.12))
    deck = (plan.length + edge, plan.width + 2 * edge, thick)
    builder.add(box(deck, (edge / 2, 0, plan.slats - thick / 2)), material)
    base = (0.75 * plan.length, 0.75 * plan.width, plan.slats - thick / 2)
    builder.add(box(base, (0, 0, base[2] / 2)), material)
    add_bedding(builder, rng, plan)
    if chance(rng, 0.7):
        high = plan.top + float(rng.uniform(0.1, 0.5))
        wide = plan.width + 2 * edge + float(rng.choice([0.0, rng.uniform(0.0, 0.9)]))
        size = (0.06, wide, high - 0.1)
        builder.add(box(size, (-plan.length / 2 - 0.03, 0, 0.1 + size[2] / 2)), material)
    return builder.build("bed", "platform", Symmetry.NONE)


def storage_bed(rng: Rng) -> Shape:
    """Drawers under the mattress."""
    builder, look = ShapeBuilder(), random_look(rng)
    plan = random_plan(rng, (0.28, 0.45))
    half_x, half_y = plan.length / 2 + 0.02, plan.width / 2 + 0.02
    side = 1.0 if chance(rng, 0.5) else -1.0
    count = int(rng.integers(2, 4))
    edges = np.linspace(-half_x, half_x, count + 1)
    cells = [
        Cell(float(a), float(b), 0.03, plan.slats - 0.03, "drawer", opened(rng, 0.12))
        for a, b in pairwise(edges)
    ]
    low, high = (-half_y, -half_x, 0.0), (half_y, half_x, plan.slats)
    add_case(builder, look, low, high, cells, turn_deg=90 * side)
    add_bedding(builder, rng, plan)
    high_z = plan.top + float(rng.uniform(0.2, 0.6))
    add_board(builder, rng, -half_x - 0.03, 2 * half_y, 0.05, high_z, look.body, "plain")
    if chance(rng, 0.3):  # book-case head
        size = (0.25, 2 * half_y, high_z)
        shelf = box(size, (-half_x - 0.13, 0, high_z / 2))
        hole = box((0.2, 1.9 * half_y, 0.25), (-half_x - 0.08, 0, high_z - 0.17))
        builder.add(shelf - hole, look.body)
    return builder.build("bed", "storage", Symmetry.NONE)


def box_spring(rng: Rng) -> Shape:
    """Divan: thick upholstered base, mattress and topper; sometimes no head board at all."""
    builder, plan = ShapeBuilder(), random_plan(rng, (0.3, 0.42))
    cloth, lift = fabric(rng), float(rng.uniform(0.03, 0.14))
    halves = 2 if plan.width > 1.5 and chance(rng, 0.5) else 1
    for index in range(halves):
        wide = plan.width / halves
        y = (index - (halves - 1) / 2) * wide
        size = (plan.length, wide - 0.004, plan.slats - lift)
        builder.add(rounded_box(size, (0, y, (plan.slats + lift) / 2), 0.03), cloth)
        for x in (-plan.length / 2 + 0.12, plan.length / 2 - 0.12):
            for foot_y in (y - wide / 2 + 0.1, y + wide / 2 - 0.1):
                builder.add(cone(0.02, 0.03, lift + 0.02, (x, foot_y, 0), 8), metal(rng))
    add_bedding(builder, rng, plan)
    if chance(rng, 0.6):
        high = plan.top + float(rng.uniform(0.3, 0.7))
        add_board(builder, rng, -plan.length / 2 - 0.08, plan.width, lift, high, cloth, "padded")
    return builder.build("bed", "box_spring", Symmetry.NONE)


def four_poster(rng: Rng) -> Shape:
    """Posts to a frame above, sometimes a canopy."""
    builder, plan = ShapeBuilder(), random_plan(rng, (0.25, 0.42))
    material = carcass(rng) if chance(rng, 0.7) else metal(rng)
    add_frame(builder, rng, plan, material)
    add_bedding(builder, rng, plan)
    post, high = float(rng.uniform(0.035, 0.09)), float(rng.uniform(1.8, 2.15))
    x, y = plan.length / 2 + post / 2, plan.width / 2 + post / 2
    turned = chance(rng, 0.4)
    for side_x in (-x, x):
        for side_y in (-y, y):
            foot, head = (side_x, side_y, 0.0), (side_x, side_y, high)
            leg = rod(foot, head, post / 2, 0.35 * post) if turned else bar(foot, head, post, post)
            builder.add(leg, material)
    thin = 0.7 * post
    if chance(rng, 0.8):
        for side in (-1, 1):
            builder.add(box((2 * x, thin, thin), (0, side * y, high - thin / 2)), material)
            builder.add(box((thin, 2 * y, thin), (side * x, 0, high - thin / 2)), material)
        if chance(rng, 0.35):
            builder.add(box((2 * x, 2 * y, 0.02), (0, 0, high)), fabric(rng))
    kind = str(rng.choice(["plain", "slats", "arch", "rungs"]))
    board_top = plan.top + float(rng.uniform(0.25, 0.6))
    add_board(builder, rng, -x, 2 * y, plan.slats, board_top, material, kind)
    return builder.build("bed", "four_poster", Symmetry.NONE)


def bunk(rng: Rng) -> Shape:
    """Two beds over each other (or a loft over a void), guard rails and a ladder."""
    builder, plan = ShapeBuilder(), random_plan(rng, (0.2, 0.36), narrow=True)
    material = carcass(rng) if chance(rng, 0.7) else metal(rng)
    upper = float(rng.uniform(1.0, 1.25))
    post, x, y = float(rng.uniform(0.045, 0.08)), plan.length / 2 + 0.03, plan.width / 2 + 0.03
    high = upper + plan.top + float(rng.uniform(0.12, 0.3))
    for side_x in (-x, x):
        for side_y in (-y, y):
            builder.add(box((post, post, high), (side_x, side_y, high / 2)), material)
    for lift in (0.0, upper) if chance(rng, 0.8) else (upper,):
        z = lift + plan.slats
        for side in (-1, 1):
            builder.add(box((2 * x, 0.03, 0.14), (0, side * y, z)), material)
            builder.add(box((0.03, 2 * y, 0.14), (side * x, 0, z)), material)
            rail = (side * x, 0, z + plan.thick + 0.15)
            builder.add(box((0.025, 2 * y, 0.12), rail), material)
        builder.add(box((plan.length, plan.width, 0.03), (0, 0, z - 0.015)), material)
        add_bedding(builder, rng, plan, lift)
    open_side = float(rng.choice([-1, 1]))
    gap = float(rng.uniform(0.4, 0.5))
    for z in (high - 0.04, high - 0.18):
        builder.add(box((2 * x, 0.025, 0.07), (0, -open_side * y, z)), material)
        builder.add(box((2 * x - gap, 0.025, 0.07), (-gap / 2, open_side * y, z)), material)
    lean = float(rng.choice([0.0, rng.uniform(0.1, 0.35)]))
    for end in (x - gap, x - 0.05):
        foot, top = (
            (end, open_side * (y + 0.04 + lean), 0),
            (end, open_side * (y + 0.04), high - 0.1),
        )
        builder.add(bar(foot, top, 0.03, 0.05), material)
    for share in np.linspace(0.12, 0.85, 5):
        at = open_side * (y + 0.04 + lean * (1 - share))
        z = share * (high - 0.1)
        builder.add(rod((x - gap, at, z), (x - 0.05, at, z), 0.016, segments=6), material)
    return builder.build("bed", "bunk", Symmetry.NONE)


def daybed(rng: Rng) -> Shape:
    """Boards at both ends and along one side: a bed that is also a seat."""
    builder, plan, material = (
        ShapeBuilder(),
        random_plan(rng, (0.22, 0.36), narrow=True),
        carcass(rng),
    )
    add_frame(builder, rng, plan, material)
    add_bedding(builder, rng, plan)
    high = plan.top + float(rng.uniform(0.2, 0.45))
    x, kind = plan.length / 2 + 0.02, str(rng.choice(["plain", "slats", "posts"]))
    for end in (-x, x):
        add_board(builder, rng, end, plan.width + 0.06, 0.12, high, material, kind)
    side = float(rng.choice([-1, 1])) * (plan.width / 2 + 0.02)
    size = (plan.length, 0.03, high - 0.15)
    builder.add(box(size, (0, side, 0.15 + size[2] / 2)), material)
    return builder.build("bed", "daybed", Symmetry.NONE)


def sleigh(rng: Rng) -> Shape:
    """Head and foot boards that roll outwards."""
    builder, plan, material = ShapeBuilder(), random_plan(rng, (0.22, 0.34)), carcass(rng)
    add_frame(builder, rng, plan, material)
    add_bedding(builder, rng, plan)
    width, thick = plan.width + 0.08, float(rng.uniform(0.035, 0.06))
    roll = float(rng.uniform(0.06, 0.13))
    low = float(rng.uniform(0.0, 0.12))
    heights = (plan.top + float(rng.uniform(0.3, 0.6)), plan.top + float(rng.uniform(0.02, 0.3)))
    for sign, high in zip((-1, 1), heights, strict=True):
        middle = (plan.length / 2 + roll + thick / 2, high - roll)
        bend = arc(middle, roll + thick / 2, np.pi, 0.35 * np.pi, 8)
        inner = arc(middle, roll - thick / 2, np.pi, 0.35 * np.pi, 8)
        foot = plan.length / 2
        outline = np.concatenate([[(foot, low)], bend, inner[::-1], [(foot + thick, low)]])
        builder.add(extrude_y(outline * (sign, 1.0), width), material)
        plinth = box((0.05, width, 0.6 * plan.slats), (sign * (foot + 0.025), 0, 0.3 * plan.slats))
        builder.add(plinth, material)
    return builder.build("bed", "sleigh", Symmetry.NONE)


def cot(rng: Rng) -> Shape:
    """A baby's bed with barred sides."""
    builder, material = ShapeBuilder(), carcass(rng)
    length, width = float(rng.uniform(1.1, 1.4)), float(rng.uniform(0.58, 0.75))
    slats, high = float(rng.uniform(0.2, 0.5)), float(rng.uniform(0.8, 1.0))
    post = float(rng.uniform(0.03, 0.05))
    for x in (-length / 2, length / 2):
        for y in (-width / 2, width / 2):
            builder.add(box((post, post, high), (x, y, high / 2)), material)
        if chance(rng, 0.4):
            size = (0.02, width, high - slats - 0.02)
            builder.add(box(size, (x, 0, (high + slats) / 2 - 0.05)), material)
        for z in (slats - 0.05, high - 0.03):
            builder.add(box((0.6 * post, width, 0.05), (x, 0, z)), material)
    for y in (-width / 2, width / 2):
        for z in (slats - 0.05, high - 0.03):
            builder.add(box((length, 0.6 * post, 0.05), (0, y, z)), material)
        for x in np.linspace(-length / 2, length / 2, int(rng.integers(9, 14)))[1:-1]:
            builder.add(bar((x, y, slats - 0.05), (x, y, high - 0.03), 0.014, 0.014), material)
    size = (length - 0.02, width - 0.02, float(rng.uniform(0.06, 0.12)))
    builder.add(rounded_box(size, (0, 0, slats + size[2] / 2), 0.02), paint(rng))
    pillow = cushion((0.25, 0.4, 0.06), (-length / 2 + 0.18, 0, slats + size[2] + 0.02), 3, 12)
    builder.add(pillow, fabric(rng))
    return builder.build("bed", "cot", Symmetry.NONE)


STYLES: dict[str, dict[str, Callable[[Rng], Shape]]] = {
    "bed": {
        "panel": panel,
        "metal_frame": metal_frame,
        "upholstered": upholstered,
        "platform": platform,
        "storage": storage_bed,
        "box_spring": box_spring,
        "four_poster": four_poster,
        "bunk": bunk,
        "daybed": daybed,
        "sleigh": sleigh,
        "cot": cot,
    }
}
