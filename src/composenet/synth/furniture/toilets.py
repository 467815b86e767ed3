"""Toilets: with tank, one-piece, wall-hung, square, high tank. The wall is at -X."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from composenet.records import Symmetry
from composenet.synth.furniture.parts import (
    Rng,
    Solid,
    box,
    ceramic,
    chance,
    cylinder,
    loft_z,
    metal,
    oval,
    plastic,
    rod,
    rounded_box,
    tube,
    wood,
)
from composenet.synth.furniture.sanitary import basin
from composenet.synth.shape import Material, Shape, ShapeBuilder

Outline = NDArray[np.float64]


def _finish(builder: ShapeBuilder, style: str) -> Shape:
    return builder.build("toilet", style, Symmetry.NONE)


def _egg(length: float, width: float, power: float, back: float, corners: int = 28) -> Outline:
    """Outline of a seat from x = 0 (hinge) to x = length: blunt behind, round in front.
    back: 0 round .. 1 straight sides."""
    outline = oval(length, width, power, corners)
    rear = outline[:, 0] < 0
    blunt = oval(length, width, power + 6 * back, corners)
    outline[rear] = blunt[rear]
    return outline + np.array([length / 2, 0])


def _scaled(outline: Outline, x: float, y: float, keep: float) -> Outline:
    """Outline scaled by x and y; keep in 0..1 is the point of its length that stays."""
    pivot = np.array([keep * outline[:, 0].max() + (1 - keep) * outline[:, 0].min(), 0.0])
    return (outline - pivot) * (x, y) + pivot


def _bowl(seat: Outline, rim: float, low: list[tuple[Outline, float]]) -> Solid:
    """Bowl with the rim outline `seat` at height rim, over the outer sections `low`."""
    inner = _scaled(seat, 0.72, 0.72, 0.55)
    return basin(
        [
            *low,
            (seat, rim - 0.06),
            (seat, rim),
            (inner, rim),
            (_scaled(inner, 0.9, 0.9, 0.5), rim - 0.08),
            (_scaled(inner, 0.4, 0.4, 0.45), rim - 0.2),
        ]
    )


def _seat_and_lid(
    builder: ShapeBuilder, rng: Rng, seat: Outline, rim: float, lid_material: Material
) -> None:
    """Seat ring, and a lid: closed, open (leaning back), or none."""
    thick = float(rng.uniform(0.015, 0.028))
    outer, hole = _scaled(seat, 0.99, 1.02, 0.6), _scaled(seat, 0.62, 0.62, 0.6)
    plate = loft_z([outer, outer, _scaled(outer, 0.94, 0.94, 0.5)], [0, 0.6 * thick, thick])
    roll = rng.random()
    if roll < 0.5:
        height = rim + thick + 0.004
        builder.add(loft_z([outer, outer], [rim, rim + thick]), lid_material)
        builder.add(plate.translate((0, 0, height)), lid_material)
        return
    hollow = loft_z([outer, outer], [rim + 0.001, rim + thick])
    hollow = hollow - loft_z([hole, hole], [rim - 1, rim + 1])
    hinge = float(outer[:, 0].min()) + 0.03
    lean = float(rng.uniform(92, 104))

    def lifted(part: Solid, angle: float) -> Solid:
        moved = part.translate((-hinge, 0, 0)).rotate((0, -angle, 0))
        return moved.translate((hinge, 0, rim + thick))

    if roll < 0.9:
        builder.add(lifted(plate, lean), lid_material)
        raised = chance(rng, 0.25)
        builder.add(
            lifted(hollow.translate((0, 0, -rim - thick)), lean - 4) if raised else hollow,
            lid_material,
        )
    else:
        builder.add(hollow, lid_material)


def _tank(
    builder: ShapeBuilder, rng: Rng, x: float, width: float, z: float, height: float, body: Material
) -> None:
    """Tank against the wall at x, with a lid and a button or a lever."""
    depth, wide = float(rng.uniform(0.15, 0.21)), width * float(rng.uniform(0.95, 1.2))
    top, radius = float(rng.uniform(0.94, 1.08)), float(rng.choice([3.0, 5.0, 14.0]))
    section = oval(depth, wide, radius, 20, (x + depth / 2, 0))
    upper = oval(depth, wide * top, radius, 20, (x + depth / 2, 0))
    builder.add(loft_z([section, upper], [z, z + height]), body)
    lid = _scaled(upper, 1.06, 1.04, 0.0)
    builder.add(loft_z([lid, lid], [z + height, z + height + 0.03]), body)
    if chance(rng, 0.5):
        builder.add(cylinder(0.025, 0.01, (x + depth / 2, 0, z + height + 0.03), 12), metal(rng))
    else:
        start = np.array([x + depth, 0.35 * wide, z + 0.85 * height])
        axle, lever = start + np.array([0.03, 0, 0]), start + np.array([0.03, -0.08, -0.01])
        builder.add(rod(start, axle, 0.012, segments=8), metal(rng))
        builder.add(rod(axle, lever, 0.008, segments=8), metal(rng))


def _foot(seat: Outline, rim: float, rng: Rng) -> list[tuple[Outline, float]]:
    """Sections of a waisted foot under the rim outline."""
    narrow, short = float(rng.uniform(0.5, 0.7)), float(rng.uniform(0.62, 0.8))
    return [
        (_scaled(seat, short * 1.05, narrow * 1.1, 0.1), 0.0),
        (_scaled(seat, short, narrow, 0.1), 0.06),
        (_scaled(seat, short * 0.95, narrow * 0.9, 0.1), 0.4 * rim),
        (_scaled(seat, 0.93, 0.9, 0.25), 0.75 * rim),
    ]


def _proportions(rng: Rng) -> tuple[float, float, float]:
    """length of the seat, width, rim height."""
    sizes = rng.uniform((0.42, 0.34, 0.37), (0.52, 0.4, 0.44))
    return float(sizes[0]), float(sizes[1]), float(sizes[2])


def _lid_material(rng: Rng, body: Material) -> Material:
    return body if chance(rng, 0.7) else wood(rng) if chance(rng, 0.5) else plastic(rng)


def _classic(rng: Rng, style: str, power: float, back: float) -> Shape:
    builder, body = ShapeBuilder(), ceramic(rng)
    length, width, rim = _proportions(rng)
    seat = _egg(length, width, power, back)
    builder.add(_bowl(seat, rim, _foot(seat, rim, rng)), body)
    gap, deep = float(rng.uniform(0.02, 0.06)), 0.19
    shelf = box((deep + gap + 0.08, 0.6 * width, 0.08), ((0.08 - deep - gap) / 2, 0, rim - 0.04))
    builder.add(shelf, body)
    _seat_and_lid(builder, rng, seat, rim, _lid_material(rng, body))
    _tank(builder, rng, -deep - gap, width, rim, float(rng.uniform(0.28, 0.4)), body)
    return _finish(builder, style)


def two_piece(rng: Rng) -> Shape:
    """The classic: bowl on a waisted foot, tank behind."""
    return _classic(rng, "two_piece", float(rng.uniform(2.0, 2.6)), float(rng.uniform(0.1, 0.5)))


def square(rng: Rng) -> Shape:
    """Straight-sided bowl on a boxy foot, square tank."""
    builder, body = ShapeBuilder(), ceramic(rng)
    length, width, rim = _proportions(rng)
    power = float(rng.uniform(5.0, 9.0))
    seat = _egg(length, width, power, 1.0)
    narrow = float(rng.uniform(0.75, 0.98))
    low = [(_scaled(seat, 0.9, narrow, 0.0), 0.0), (_scaled(seat, 0.96, narrow, 0.0), 0.5 * rim)]
    builder.add(_bowl(seat, rim, low), body)
    deep = 0.19
    size = (deep + 0.1, narrow * width, rim)
    builder.add(rounded_box(size, ((0.1 - deep) / 2 - 0.02, 0, rim / 2), 0.02), body)
    _seat_and_lid(builder, rng, seat, rim, _lid_material(rng, body))
    height = float(rng.uniform(0.3, 0.42))
    tank = rounded_box((0.18, width, height), (-0.12, 0, rim + height / 2), 0.012)
    builder.add(tank, body)
    builder.add(box((0.19, width + 0.01, 0.025), (-0.12, 0, rim + height + 0.008)), body)
    builder.add(cylinder(0.025, 0.008, (-0.12, 0, rim + height + 0.02), 12), metal(rng))
    return _finish(builder, "square")


def one_piece(rng: Rng) -> Shape:
    """Skirted to the floor; the low tank flows out of the bowl."""
    builder, body = ShapeBuilder(), ceramic(rng)
    length, width, rim = _proportions(rng)
    seat = _egg(length, width, float(rng.uniform(2.0, 3.0)), float(rng.uniform(0.2, 0.8)))
    narrow = float(rng.uniform(0.62, 0.85))
    low = [
        (_scaled(seat, 0.9, narrow, 0.0), 0.0),
        (_scaled(seat, 0.95, 0.5 + 0.5 * narrow, 0.0), 0.6 * rim),
    ]
    builder.add(_bowl(seat, rim, low), body)
    back, height = float(rng.uniform(0.17, 0.22)), float(rng.uniform(0.15, 0.3))
    sections, levels = [], [0.0, rim, rim + 0.4 * height, rim + height]
    for share, grow in ((0.95, narrow), (1.0, 0.97), (0.92, 0.97), (0.85, 0.95)):
        deep = (back + 0.12) * share if share > 0.94 else back * share
        sections.append(oval(deep, width * grow, 5.0, 24, (deep / 2 - back, 0)))
    builder.add(loft_z(sections, levels), body)
    _seat_and_lid(builder, rng, seat, rim, body)
    button = (-back / 2, 0.0, rim + height)
    builder.add(cylinder(0.025, 0.01, button, 12), metal(rng))
    return _finish(builder, "one_piece")


def wall_hung(rng: Rng) -> Shape:
    """A bowl that hangs on the wall or from a boxed-in frame, clear of the floor."""
    builder, body = ShapeBuilder(), ceramic(rng)
    length, width, rim = _proportions(rng)
    seat = _egg(length, width, float(rng.uniform(2.0, 5.0)), float(rng.uniform(0.3, 1.0)))
    under = float(rng.uniform(0.5, 0.7))
    drop = float(rng.uniform(0.26, 0.33))
    low = [
        (_scaled(seat, under, under, 0.0), rim - drop),
        (_scaled(seat, 0.9, 0.93, 0.0), rim - 0.45 * drop),
    ]
    builder.add(_bowl(seat, rim, low), body)
    neck = loft_z(
        [oval(0.12, width * k, 6.0, 20, (-0.02, 0)) for k in (0.6, 0.9, 0.95)],
        [rim - drop, rim - 0.4 * drop, rim],
    )
    builder.add(neck, body)
    _seat_and_lid(builder, rng, seat, rim, _lid_material(rng, body))
    if chance(rng, 0.5):  # the frame is behind the wall
        return builder.build("toilet", "wall_hung", Symmetry.NONE, rim - drop)
    wide, high = float(rng.uniform(0.45, 0.8)), float(rng.uniform(0.85, 1.15))
    panel = box((0.14, wide, high), (-0.145, 0, high / 2))
    builder.add(panel, wood(rng) if chance(rng, 0.3) else ceramic(rng))
    builder.add(box((0.012, 0.24, 0.16), (-0.072, 0, high - 0.14)), metal(rng))
    return _finish(builder, "wall_hung")


def high_tank(rng: Rng) -> Shape:
    """Old-fashioned: the tank high on the wall, a pipe and a chain."""
    builder, body, fittings = ShapeBuilder(), ceramic(rng), metal(rng)
    length, width, rim = _proportions(rng)
    seat = _egg(length, width, 2.2, float(rng.uniform(0.1, 0.4)))
    builder.add(_bowl(seat, rim, _foot(seat, rim, rng)), body)
    builder.add(box((0.16, 0.3 * width, 0.1), (-0.05, 0, rim - 0.06)), body)
    _seat_and_lid(builder, rng, seat, rim, wood(rng) if chance(rng, 0.6) else body)
    base = float(rng.uniform(1.3, 1.7))
    pipe = [(-0.1, 0, rim - 0.05), (-0.1, 0, base + 0.02)]
    builder.add(tube(pipe, float(rng.uniform(0.016, 0.025)), 10), fittings)
    tank = rounded_box((0.2, 0.46, 0.28), (-0.12, 0, base + 0.14), 0.02)
    builder.add(tank, body if chance(rng, 0.7) else wood(rng))
    builder.add(
        rod((-0.05, 0.19, base + 0.1), (-0.05, 0.19, base - 0.45), 0.005, segments=6), fittings
    )
    builder.add(cylinder(0.015, 0.07, (-0.05, 0.19, base - 0.5), 8), fittings)
    return _finish(builder, "high_tank")


def bench(rng: Rng) -> Shape:
    """Low round bowl with a wide flat tank shelf: the compact bathroom unit."""
    builder, body = ShapeBuilder(), ceramic(rng)
    length, width, rim = _proportions(rng)
    seat = _egg(length * 0.92, width, float(rng.uniform(2.0, 2.4)), 0.0)
    builder.add(_bowl(seat, rim, _foot(seat, rim, rng)), body)
    wide, deep = float(rng.uniform(0.5, 0.9)), float(rng.uniform(0.16, 0.22))
    high = float(rng.uniform(0.72, 0.9))
    case = box((deep, wide, high), (-deep / 2 - 0.01, 0, high / 2))
    builder.add(case, wood(rng) if chance(rng, 0.6) else ceramic(rng))
    builder.add(box((deep + 0.02, wide + 0.02, 0.025), (-deep / 2, 0, high + 0.01)), body)
    builder.add(cylinder(0.03, 0.012, (-deep / 2, 0, high + 0.02), 12), metal(rng))
    builder.add(box((0.08, 0.5 * width, 0.12), (0.02, 0, rim - 0.08)), body)
    _seat_and_lid(builder, rng, seat, rim, _lid_material(rng, body))
    return _finish(builder, "bench")


def _tank_section(x: float, deep: float, wide: float) -> Outline:
    return np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (deep / 2, wide / 2) + np.array([x, 0])


def faceted(rng: Rng) -> Shape:
    """Few flat faces: a bowl of six to ten corners, a thick lid, a tank that widens upwards."""
    builder, body = ShapeBuilder(), ceramic(rng)
    size = rng.uniform((0.45, 0.38, 0.36), (0.62, 0.5, 0.46))
    length, width, rim = float(size[0]), float(size[1]), float(size[2])
    corners = int(rng.choice([6, 8, 10]))
    seat = _egg(length, width, float(rng.uniform(2.0, 6.0)), float(rng.uniform(0, 1)), corners)
    builder.add(_bowl(seat, rim, _foot(seat, rim, rng)), body)
    thick = float(rng.uniform(0.03, 0.07))
    lid = [seat, seat, _scaled(seat, float(rng.uniform(0.75, 0.95)), 0.85, 0.4)]
    builder.add(loft_z(lid, [rim - 0.002, rim + 0.6 * thick, rim + thick]), body)
    gap, deep = float(rng.uniform(0.0, 0.06)), float(rng.uniform(0.18, 0.26))
    wide, tall = width * float(rng.uniform(0.9, 1.15)), float(rng.uniform(0.28, 0.45))
    x, low = -gap - deep / 2, rim + float(rng.uniform(-0.05, 0.06))
    base, top = float(rng.uniform(0.75, 1.0)), low + tall
    builder.add(loft_z([_tank_section(x, deep * k, wide * k) for k in (base, 1)], [low, top]), body)
    over = float(rng.uniform(1.03, 1.15))
    cap = box((over * deep, over * wide, 0.05), (x, 0, top + 0.02))
    builder.add(cap, body)
    neck = box((deep + gap + 0.12, 0.4 * width, 0.12), ((0.12 - deep - gap) / 2, 0, low - 0.03))
    builder.add(neck, body)
    lever = (x + deep / 2, 0.3 * wide, low + 0.85 * tall)
    builder.add(box((0.05, 0.08, 0.04), lever), metal(rng))
    return _finish(builder, "faceted")


FURTHER_STYLES: dict[str, dict[str, Callable[[Rng], Shape]]] = {"toilet": {"faceted": faceted}}
STYLES: dict[str, dict[str, Callable[[Rng], Shape]]] = {
    "toilet": {
        builder.__name__: builder
        for builder in (two_piece, square, one_piece, wall_hung, high_tank, bench)
    }
}
