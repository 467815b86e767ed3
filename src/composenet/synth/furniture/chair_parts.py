"""Backs, legs, seats and bases that chairs are put together from.

Corners and legs go front left, front right, back right, back left.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from composenet.synth.furniture.curves import bent_path, plate, post, soft_slab
from composenet.synth.furniture.parts import (
    Rng,
    Solid,
    bar,
    chance,
    cone,
    cylinder,
    extrude,
    fabric,
    leather,
    oval,
    ring,
    rod,
    rounded_rectangle,
    tube,
)
from composenet.synth.shape import Material, ShapeBuilder

Corners = NDArray[np.float64]


@dataclass(frozen=True)
class Plan:
    """Measures of a chair, metres: seat width (Y), depth (X), height of its upper side, length
    of the back along its slope, its rake (radians), how far its middle lies behind its sides
    (wrap) and how far it bulges forward half-way up (bow)."""

    width: float
    depth: float
    height: float
    back: float
    rake: float
    wrap: float = 0.0
    bow: float = 0.0

    def at(self, y: ArrayLike, s: ArrayLike) -> NDArray[np.float64]:
        """Points (..., 3) of the back at y, a length s above the seat."""
        y, s = np.broadcast_arrays(np.asarray(y, dtype=float), np.asarray(s, dtype=float))
        across, up = (2 * y / self.width) ** 2, np.clip(s / self.back, 0, 1)
        x = self.wrap * (across - 1) + self.bow * np.sin(np.pi * up) - np.sin(self.rake) * s
        return np.stack([x - self.depth / 2, y, self.height + np.cos(self.rake) * s], axis=-1)

    def corners(self, z: float, inset: float = 0.0, splay: float = 0.0) -> Corners:
        """(4, 3) leg positions at height z, moved in by inset and out by splay."""
        out = np.array([(1, 1), (1, -1), (-1, -1), (-1, 1)], dtype=float)
        half = np.array([self.depth, self.width]) / 2 - inset + splay
        return np.column_stack([out * half, np.full(4, z)])


def draw_plan(rng: Rng, low: bool = False) -> Plan:
    """Measures of a dining chair; of an easy chair if low."""
    u = rng.uniform
    if low:
        return Plan(
            u(0.50, 0.66), u(0.50, 0.62), u(0.34, 0.42), u(0.40, 0.65), u(0.2, 0.45), u(0, 0.04)
        )
    return Plan(
        width=u(0.37, 0.52),
        depth=u(0.37, 0.48),
        height=u(0.42, 0.50),
        back=u(0.34, 0.62),
        rake=u(0.03, 0.26),
        wrap=u(0, 0.05),
        bow=u(-0.02, 0.03),
    )


# --- backs ----------------------------------------------------------------------------------


def rail(
    plan: Plan, low: float, high: float, thickness: float, crown: float = 0.0, reach: float = 1.0
) -> Solid:
    """A board across the back from s = low to high; crown lifts its middle."""
    y = np.linspace(-1, 1, 7)[:, None] * plan.width / 2 * reach
    s = np.linspace(low, high, 3)[None] + crown * (1 - (2 * y / plan.width) ** 2)
    return plate(plan.at(y, s), thickness)


def stile(plan: Plan, y: float, low: float, high: float, width: float, thickness: float) -> Solid:
    """A board up the back about y."""
    s = np.linspace(low, high, 5)[None]
    return plate(plan.at(np.array([[y - width / 2], [y + width / 2]]), s), thickness)


def horizontal_slats(plan: Plan, rng: Rng) -> list[Solid]:
    """A top rail and slats below it."""
    count, crown = int(rng.integers(2, 7)), rng.uniform(0, 0.03) * rng.integers(2)
    head = rng.uniform(0.04, 0.10)
    low = rng.uniform(0.08, 0.35) * plan.back
    room = (plan.back - head - low) / count
    slat, thick = room * rng.uniform(0.3, 0.75), rng.uniform(0.010, 0.022)
    slats = [rail(plan, low + i * room, low + i * room + slat, thick) for i in range(count)]
    return [*slats, rail(plan, plan.back - head, plan.back, thick * 1.4, crown)]


def vertical_slats(plan: Plan, rng: Rng) -> list[Solid]:
    """Boards standing between two rails."""
    count = int(rng.integers(3, 8))
    head, foot = rng.uniform(0.04, 0.10), rng.uniform(0.03, 0.06)
    low, thick = rng.uniform(0.05, 0.2) * plan.back, rng.uniform(0.010, 0.018)
    places = (np.arange(count) + 0.5) / count - 0.5
    width = plan.width / count * rng.uniform(0.25, 0.7)
    slats = [
        stile(plan, y, low, plan.back - head / 2, width, thick)
        for y in places * plan.width * rng.uniform(0.6, 0.95)
    ]
    crown = rng.uniform(0, 0.03)
    rails = [(low, low + foot, 0.0), (plan.back - head, plan.back, crown)]
    return slats + [rail(plan, a, b, thick * 1.6, lift) for a, b, lift in rails]


def ladder_rungs(plan: Plan, rng: Rng) -> list[Solid]:
    """Arched rungs between the posts."""
    count, crown = int(rng.integers(3, 6)), rng.uniform(0.01, 0.04)
    room = plan.back * 0.88 / count
    size = room * rng.uniform(0.3, 0.6)
    high = plan.back * 0.98 - crown
    return [rail(plan, high - i * room - size, high - i * room, 0.014, crown) for i in range(count)]


def solid_panel(plan: Plan, rng: Rng) -> list[Solid]:
    """One board, from the seat or hanging between the posts."""
    low = plan.back * rng.choice([0.0, rng.uniform(0.2, 0.55)])
    crown = rng.uniform(0, 0.05)
    return [rail(plan, low, plan.back - crown, rng.uniform(0.012, 0.03), crown, 1.02)]


def padded_panel(plan: Plan, rng: Rng) -> list[Solid]:
    """An upholstered back."""
    low = plan.back * rng.choice([0.0, rng.uniform(0.1, 0.4)])
    crown = rng.choice([0.0, rng.uniform(0.01, 0.06)])
    thick = rng.uniform(0.035, 0.085)
    return [pad(plan, low, plan.back - crown, thick, crown)]


def pad(plan: Plan, low: float, high: float, thickness: float, crown: float = 0.0) -> Solid:
    """A cushion along the back from s = low to high, thin at its edges."""
    u, v = np.linspace(-1, 1, 9)[:, None], np.linspace(-1, 1, 7)[None]
    y = u * plan.width / 2
    s = low + (v + 1) / 2 * (high - low) + crown * (1 - u**2) * (v + 1) / 2
    swell = np.sqrt(np.clip((1.06 - u**6) * (1.06 - v**6), 0.05, None))
    return plate(plan.at(y, s), thickness * swell)


def splat(plan: Plan, rng: Rng) -> list[Solid]:
    """A shaped board in the middle under a top rail."""
    head, crown = rng.uniform(0.05, 0.09), rng.uniform(0, 0.05)
    v = np.linspace(0, 1, 9)
    half = plan.width * (0.16 + rng.uniform(0.03, 0.08) * np.cos(v * rng.uniform(4, 9)))
    y = np.stack([-half, half])
    board = plate(plan.at(y, np.broadcast_to(v * (plan.back - head / 2 + crown), y.shape)), 0.014)
    return [board, rail(plan, plan.back - head, plan.back, 0.024, crown, 1.05)]


def crossed(plan: Plan, rng: Rng) -> list[Solid]:
    """Two crossing bars between rails."""
    low, head = plan.back * rng.uniform(0.05, 0.3), rng.uniform(0.03, 0.08)
    y, radius = plan.width * 0.46, rng.uniform(0.008, 0.012)
    t = np.linspace(-1, 1, 5)
    s = low + (t + 1) / 2 * (plan.back - low - head / 2)
    shift = [(0, 0, 0), (radius, 0, 0)]
    bars = [tube(plan.at(side * y * t, s) + shift[i], radius) for i, side in enumerate((1, -1))]
    rails = [(low - 0.03, low), (plan.back - head, plan.back)]
    return bars + [rail(plan, a, b, 0.02) for a, b in rails]


def spindles(plan: Plan, rng: Rng) -> list[Solid]:
    """Thin rods from the seat to a comb."""
    count, head = int(rng.integers(5, 10)), rng.uniform(0.03, 0.08)
    crown, fan = rng.uniform(0, 0.04), rng.uniform(0.65, 1.0)
    y = np.linspace(-0.42, 0.42, count) * plan.width
    radius = rng.uniform(0.006, 0.010)
    rods = [rod(plan.at(a * fan, 0.0), plan.at(a, plan.back - head / 2), radius) for a in y]
    return [*rods, rail(plan, plan.back - head, plan.back, 0.02, crown, 1.04)]


def hoop(plan: Plan, rng: Rng, sticks: int) -> list[Solid]:
    """A bent hoop with upright sticks inside (Windsor, bistro)."""
    power, radius = rng.uniform(2.2, 4.0), rng.uniform(0.010, 0.016)
    angle = np.linspace(0, np.pi, 13)
    shape = np.stack([np.cos(angle), np.sin(angle)])
    shape = np.sign(shape) * np.abs(shape) ** (2 / power)
    solids = [tube(plan.at(shape[0] * plan.width * 0.47, shape[1] * plan.back), radius)]
    for y in np.linspace(-0.75, 0.75, sticks):
        top = (1 - abs(y) ** power) ** (1 / power) * plan.back
        path = plan.at(np.full(3, y * plan.width * 0.47), np.linspace(0, top, 3))
        solids.append(tube(path, radius * 0.6, 6))
    return solids


# --- seats, legs and bases ------------------------------------------------------------------


def seat_outline(plan: Plan, rng: Rng, overhang: float = 0.01) -> NDArray[np.float64]:
    """(K, 2) outline of the seat, a little wider in front."""
    corner = rng.choice([0.015, 0.04, 0.1]) * rng.uniform(0.7, 1.3)
    flat = rounded_rectangle(plan.depth + 2 * overhang, plan.width + 2 * overhang, corner)
    narrow = rng.uniform(0.0, 0.12)
    flat[:, 1] *= 1 - narrow * (0.5 - flat[:, 0] / plan.depth)
    return flat


def seat(plan: Plan, rng: Rng, thickness: float, edge: float = 0.008) -> Solid:
    """A board (small edge) or cushion (large edge) whose upper side is at plan.height."""
    return soft_slab(seat_outline(plan, rng), plan.height - thickness, thickness, edge)


def legs_between(
    feet: Corners, tops: Corners, size: float, taper: float, segments: int
) -> list[Solid]:
    """Legs from feet up to tops; taper is the foot's size over the top's."""
    return [post([a, b], [size * taper, size], segments) for a, b in zip(feet, tops, strict=True)]


def stretchers(feet: Corners, tops: Corners, rng: Rng, round_bars: bool) -> list[Solid]:
    """Bars between the legs: none, sides, H, box or crossed."""
    size = rng.uniform(0.014, 0.026)

    def bar_at(share: float, i: int, j: int) -> Solid:
        a, b = feet[i] + share * (tops[i] - feet[i]), feet[j] + share * (tops[j] - feet[j])
        return rod(a, b, size / 2) if round_bars else bar(a, b, size * 0.8, size * 1.3)

    low, high = rng.uniform(0.18, 0.4), rng.uniform(0.3, 0.65)
    kind = rng.integers(5)
    sides = [bar_at(low, 0, 3), bar_at(low, 1, 2)]
    if kind == 0:
        return []
    if kind == 1:
        return sides
    if kind == 2:
        at = feet + low * (tops - feet)
        left, right = (at[0] + at[3]) / 2, (at[1] + at[2]) / 2
        cross = rod(left, right, size / 2) if round_bars else bar(left, right, size * 0.8, size)
        return [*sides, cross]
    if kind == 3:
        return [*sides, bar_at(high, 0, 1), bar_at(high, 3, 2)]
    return [bar_at(low, 0, 2), bar_at(low, 1, 3)]


def apron(tops: Corners, height: float, thickness: float) -> list[Solid]:
    """Boards between the leg tops, under a seat or table top."""
    drop = np.array([0, 0, height / 2])
    return [
        bar(tops[i] - drop, tops[(i + 1) % 4] - drop, thickness, height) for i in range(len(tops))
    ]


def star_base(rng: Rng, height: float, arms: int = 5, casters: bool = True) -> list[Solid]:
    """Spokes, casters and a gas column up to height."""
    reach, hub = rng.uniform(0.26, 0.34), rng.uniform(0.09, 0.13)
    lift, size = 0.06 if casters else 0.012, rng.uniform(0.03, 0.05)
    solids = [
        cone(0.04, 0.03, 0.09, (0, 0, hub - 0.04), 12),
        cylinder(rng.uniform(0.02, 0.028), height - hub, (0, 0, hub), 10),
    ]
    turn = rng.uniform(0, 2 * np.pi) if casters else 0.0
    for angle in turn + np.arange(arms) * 2 * np.pi / arms:
        way = np.array([np.cos(angle), np.sin(angle), 0.0])
        tip = reach * way + (0, 0, lift + 0.01)
        solids.append(bar((0, 0, hub), tip, size, size * 0.8, 0.6))
        if casters:
            side = 0.022 * np.array([-way[1], way[0], 0.0])
            wheel = reach * way + (0, 0, 0.028)
            solids.append(rod(wheel - side, wheel + side, 0.028, segments=8))
    return solids


def sled_base(plan: Plan, rng: Rng, radius: float, height: float) -> list[Solid]:
    """Two bent tube loops on the floor, carrying the seat at height."""
    y, lean = plan.width * rng.uniform(0.4, 0.5), rng.uniform(0, 0.06)
    front, back = plan.depth * 0.42, -plan.depth * 0.45
    solids = []
    for side in (y, -y):
        loop = [(back, side * 0.8, height), (back - lean, side, radius),
                (front + lean, side, radius), (front, side * 0.8, height)]  # fmt: skip
        solids.append(tube(bent_path(loop, 0.05), radius))
    for x in (front, back):
        solids.append(rod((x, -y * 0.8, height), (x, y * 0.8, height), radius, segments=8))
    return solids


def tulip_base(rng: Rng, height: float, radius: float) -> list[Solid]:
    """A flat round foot with a column, sometimes flowing into one another."""
    column = rng.uniform(0.022, 0.045)
    foot = [cone(radius, radius * 0.9, 0.018, segments=24), cylinder(column, height)]
    if chance(rng, 0.6):
        foot.append(cone(radius * 0.85, column, rng.uniform(0.04, 0.12), (0, 0, 0.015)))
        foot.append(cone(column, column * 2.5, height * 0.2, (0, 0, height * 0.8)))
    return foot


def wire_base(plan: Plan, rng: Rng, height: float) -> list[Solid]:
    """Splayed thin rods with struts between them (Eiffel)."""
    feet, tops = plan.corners(0.0, 0.02, rng.uniform(0, 0.03)), plan.corners(height, 0.13)
    radius = rng.uniform(0.006, 0.01)
    solids = [rod(a, b, radius, segments=8) for a, b in zip(feet, tops, strict=True)]
    share = rng.uniform(0.45, 0.7)
    middle = (1 - share) * feet + share * tops
    for i in range(4):
        j = (i + 1) % 4
        strut = radius * 0.7
        solids += [rod(middle[i], tops[j], strut, segments=6),
                   rod(middle[j], tops[i], strut, segments=6)]  # fmt: skip
    return solids


def foot_ring(rng: Rng, radius: float, z: float) -> Solid:
    """The ring of a bar stool."""
    return ring(radius, rng.uniform(0.008, 0.013), (0, 0, z))


def round_slab(rng: Rng, radius: float, top_z: float) -> Solid:
    """A round stool seat: a board or a cushion."""
    thick = rng.uniform(0.025, 0.09)
    if chance(rng, 0.3):
        return extrude(oval(2 * radius, 2 * radius), thick, top_z - thick)
    return soft_slab(oval(2 * radius, 2 * radius), top_z - thick, thick, thick * 0.4)


BackMaker = Callable[[Plan, Rng], list[Solid]]


def add_all(builder: ShapeBuilder, solids: list[Solid], material: Material) -> None:
    """Add solids of one material."""
    for solid in solids:
        builder.add(solid, material)


def cover_of(rng: Rng) -> Material:
    """Cloth or leather."""
    return fabric(rng) if chance(rng, 0.6) else leather(rng)
