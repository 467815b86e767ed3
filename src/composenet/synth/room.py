"""Empty rooms: floor, walls with doors and windows, skirting, rugs, sometimes a ceiling.

Room frame: z up, floor at z = 0, walls along x and y, one corner at the origin. An L-shaped
room is its rectangle without a notch in one corner.
"""

from __future__ import annotations

from dataclasses import dataclass

import manifold3d as m3
import numpy as np

from composenet.records import Symmetry
from composenet.synth.shape import Material, Shape, ShapeBuilder

WALL_M = 0.12
DOOR_CLEARANCE_M = 0.7
_FLOOR_LOW = (-2.0, -2.0, -0.05)  # the floor goes on behind doors


@dataclass(frozen=True)
class Opening:
    """A hole in a wall. Along the wall from its start, and above the floor, metres."""

    start_m: float
    end_m: float
    bottom_m: float
    top_m: float


@dataclass(frozen=True)
class Wall:
    """Inner face from start to end (x, y), with the room on the left of that direction.
    yaw: direction of the inward normal, radians."""

    start: tuple[float, float]
    end: tuple[float, float]
    openings: tuple[Opening, ...]

    @property
    def length_m(self) -> float:
        return float(np.hypot(self.end[0] - self.start[0], self.end[1] - self.start[1]))

    @property
    def yaw(self) -> float:
        return float(
            np.arctan2(self.end[1] - self.start[1], self.end[0] - self.start[0]) + np.pi / 2
        )

    def point(self, along_m: float, inward_m: float) -> tuple[float, float]:
        """(x, y) of a place along the wall and in front of it."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        return (
            float(self.start[0] + along_m * s + inward_m * c),
            float(self.start[1] - along_m * c + inward_m * s),
        )


@dataclass(frozen=True)
class Room:
    """size_m: (x, y) of the outer rectangle. notch: (x, y, yaw, half x, half y) of the part
    cut out, or None. keep_free: footprints before doors. shape: the geometry; its origin lies
    at `origin` of the room frame."""

    size_m: tuple[float, float]
    height_m: float
    notch: tuple[float, float, float, float, float] | None
    walls: tuple[Wall, ...]
    keep_free: tuple[tuple[float, float, float, float, float], ...]
    shape: Shape
    origin: np.ndarray


def make_room(rng: np.random.Generator, size_m: tuple[float, float]) -> Room:
    """A room of the given outer size, L-shaped in a third of the cases where it is wide enough."""
    height = float(rng.uniform(2.4, 3.0))
    corners, notch = _outline(rng, size_m)
    walls = tuple(
        Wall(start, end, _openings(rng, float(np.hypot(end[0] - start[0], end[1] - start[1]))))
        for start, end in zip(corners, corners[1:] + corners[:1], strict=True)
    )
    builder = ShapeBuilder()
    _add_floor_and_ceiling(builder, rng, size_m, height)
    wall_paint, skirting = _wall_paint(rng), _paint(rng, 0.75, 1.0)
    skirting_m = float(rng.uniform(0.05, 0.14)) if rng.random() < 0.8 else 0.0
    within = _within(size_m, notch)
    for wall in walls:
        _add_wall(builder, rng, wall, height, wall_paint, skirting, skirting_m, within)
    shape, origin = _centred(builder)
    return Room(size_m, height, notch, walls, _door_areas(walls), shape, origin)


def _outline(rng: np.random.Generator, size_m: tuple[float, float]):  # type: ignore[no-untyped-def]
    """Corners, counter-clockwise, and the notch."""
    width, depth = size_m
    corners = [(0.0, 0.0), (width, 0.0), (width, depth), (0.0, depth)]
    if min(size_m) < 4.0 or rng.random() > 0.35:
        return corners, None
    nx, ny = width * rng.uniform(0.25, 0.45), depth * rng.uniform(0.25, 0.45)
    at = int(rng.integers(4))
    signs = [(1, 1), (-1, 1), (-1, -1), (1, -1)][at]
    cx, cy = corners[at]
    inner = (cx + signs[0] * nx, cy + signs[1] * ny)
    before = (cx, inner[1]) if at in (0, 2) else (inner[0], cy)
    after = (inner[0], cy) if at in (0, 2) else (cx, inner[1])
    corners[at : at + 1] = [before, inner, after]
    return corners, (cx + signs[0] * nx / 2, cy + signs[1] * ny / 2, 0.0, nx / 2, ny / 2)


def _openings(rng: np.random.Generator, length_m: float) -> tuple[Opening, ...]:
    openings = []
    draw = rng.random()
    if length_m > 1.6 and draw < 0.35:
        width = rng.uniform(0.75, 1.0)
        start = rng.uniform(0.2, length_m - width - 0.2)
        openings.append(Opening(start, start + width, 0.0, rng.uniform(1.95, 2.1)))
    elif length_m > 2.0 and draw < 0.75:
        width = rng.uniform(0.7, min(2.4, length_m - 0.8))
        start = rng.uniform(0.4, length_m - width - 0.4)
        openings.append(
            Opening(start, start + width, rng.uniform(0.7, 1.1), rng.uniform(1.9, 2.25))
        )
    return tuple(openings)


def _paint(rng: np.random.Generator, low: float, high: float) -> Material:
    base = rng.uniform(low, high)
    tint = np.clip(base + rng.uniform(-0.08, 0.08, 3), 0.05, 1.0)
    return Material((float(tint[0]), float(tint[1]), float(tint[2])), "plain", 0.3, 0.1)


def _wall_paint(rng: np.random.Generator) -> Material:
    paint = _paint(rng, 0.55, 0.95)
    pattern = str(rng.choice(["plain", "plain", "plain", "stripes", "checker"]))
    return Material(paint.color, pattern, float(rng.uniform(0.15, 0.5)), 0.1)


def _floor_material(rng: np.random.Generator) -> Material:
    kind = rng.integers(3)
    if kind == 0:
        shade = rng.uniform(0.35, 0.9)
        color = (shade, shade * rng.uniform(0.65, 0.85), shade * rng.uniform(0.4, 0.65))
        return Material(color, "wood", float(rng.uniform(0.12, 0.25)), 0.25)
    paint = _paint(rng, 0.3, 0.85)
    if kind == 1:
        return Material(paint.color, "checker", float(rng.uniform(0.2, 0.5)), 0.35)
    return Material(paint.color, "fabric", float(rng.uniform(0.03, 0.08)), 0.02)


def _block(low: tuple[float, float, float], high: tuple[float, float, float]) -> m3.Manifold:
    size = [b - a for a, b in zip(low, high, strict=True)]
    return m3.Manifold.cube(size).translate(low)


def _within(
    size_m: tuple[float, float], notch: tuple[float, float, float, float, float] | None
) -> m3.Manifold:
    """What lies between the walls, and above."""
    rectangle = _block((0, 0, -1), (*size_m, 5))
    if notch is None:
        return rectangle
    x, y, _, half_x, half_y = notch
    return rectangle - _block((x - half_x, y - half_y, -2), (x + half_x, y + half_y, 6))


def _add_floor_and_ceiling(
    builder: ShapeBuilder, rng: np.random.Generator, size_m: tuple[float, float], height: float
) -> None:
    width, depth = size_m
    floor = _block(_FLOOR_LOW, (width - _FLOOR_LOW[0], depth - _FLOOR_LOW[1], 0.0))
    builder.add(floor, _floor_material(rng))
    if rng.random() < 0.6:
        builder.add(_block((0, 0, height), (width, depth, height + 0.05)), _paint(rng, 0.85, 1.0))
    for _ in range(int(rng.integers(0, 3))):
        rug_size = rng.uniform(0.4, 0.9, 2) * np.array(size_m) * 0.6
        x, y = rng.uniform(0.1, 0.9, 2) * (np.array(size_m) - rug_size)
        thick = float(rng.uniform(0.004, 0.02))
        rug = _block((x, y, 0.0), (x + rug_size[0], y + rug_size[1], thick))
        color = tuple(float(c) for c in rng.uniform(0.15, 0.85, 3))
        pattern = str(rng.choice(["fabric", "stripes", "checker"]))
        builder.add(rug, Material(color, pattern, float(rng.uniform(0.06, 0.3)), 0.0))  # type: ignore[arg-type]


def _add_wall(
    builder: ShapeBuilder,
    rng: np.random.Generator,
    wall: Wall,
    height: float,
    paint: Material,
    skirting: Material,
    skirting_m: float,
    within: m3.Manifold,
) -> None:
    """The wall in its own frame (x along it, the room at y > 0), turned into place. within: the
    room's inside."""
    long, deg = wall.length_m, float(np.degrees(wall.yaw)) - 90.0

    def place(part: m3.Manifold) -> m3.Manifold:
        return part.rotate([0, 0, deg]).translate([wall.start[0], wall.start[1], 0])

    solid = _block((0, -WALL_M, 0), (long, 0, height))
    strip = _block((0, 0, 0), (long, 0.012, skirting_m)) if skirting_m else m3.Manifold()
    for hole in wall.openings:
        low, high = (hole.start_m, -1.0, hole.bottom_m), (hole.end_m, 1.0, hole.top_m)
        gap = _block(low, high)
        solid, strip = solid - gap, strip - gap
        _add_frame(builder, hole, skirting, place)
        if hole.bottom_m == 0.0:
            _add_door(builder, rng, hole, place, within)
    builder.add(place(solid), paint)
    builder.add(place(strip), skirting)


def _add_frame(builder: ShapeBuilder, hole: Opening, material: Material, place) -> None:  # type: ignore[no-untyped-def]
    """A frame around an opening, and the bars of a window."""
    t, y0, y1 = 0.05, -WALL_M, 0.015
    outer = _block(
        (hole.start_m - t, y0, hole.bottom_m - t if hole.bottom_m else 0.0),
        (hole.end_m + t, y1, hole.top_m + t),
    )
    inner = _block((hole.start_m, -1, hole.bottom_m), (hole.end_m, 1, hole.top_m))
    builder.add(place(outer - inner), material)
    if hole.bottom_m:
        middle = (hole.start_m + hole.end_m) / 2
        bar = _block((middle - 0.025, -0.08, hole.bottom_m), (middle + 0.025, -0.04, hole.top_m))
        builder.add(place(bar), material)


def _add_door(  # type: ignore[no-untyped-def]
    builder: ShapeBuilder, rng: np.random.Generator, hole: Opening, place, within: m3.Manifold
) -> None:
    """A closed leaf, or a corridor wall seen through the open door: behind a notch's wall it ends
    where the room goes on."""
    if rng.random() < 0.6:
        leaf = _block((hole.start_m, -0.07, 0.01), (hole.end_m, -0.03, hole.top_m))
        builder.add(place(leaf), _paint(rng, 0.4, 0.95))
        return
    far = -float(rng.uniform(1.0, 1.8))
    corridor = _block((hole.start_m - 2, far - 0.05, 0), (hole.end_m + 2, far, hole.top_m + 0.4))
    builder.add(place(corridor) - within, _paint(rng, 0.5, 0.95))


def _door_areas(walls: tuple[Wall, ...]) -> tuple[tuple[float, float, float, float, float], ...]:
    areas = []
    for wall in walls:
        for hole in wall.openings:
            if hole.bottom_m == 0.0:
                half = (hole.end_m - hole.start_m) / 2
                x, y = wall.point(hole.start_m + half, DOOR_CLEARANCE_M / 2)
                areas.append((x, y, wall.yaw, DOOR_CLEARANCE_M / 2, half))
    return tuple(areas)


def _centred(builder: ShapeBuilder) -> tuple[Shape, np.ndarray]:
    """The shape and where its centre lies: the floor, the first part, has a known corner."""
    shape = builder.build("clutter", "room", Symmetry.NONE)
    floor = shape.vertices[shape.faces[shape.face_part == 0]].reshape(-1, 3)
    return shape, np.array(_FLOOR_LOW) - floor.min(axis=0)
