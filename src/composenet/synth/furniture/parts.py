"""What furniture is made of: closed solids and random materials.

Lengths are metres in object axes (+X front, +Y left, +Z up). Every function returns one closed
manifold; manifolds combine with `+`, `-` and `^` and move with `.translate` and `.rotate`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import TypeAlias

import manifold3d as m3
import numpy as np
from numpy.typing import ArrayLike, NDArray

from composenet.synth.shape import Material

Solid: TypeAlias = m3.Manifold
Rng: TypeAlias = np.random.Generator
_CORNER = np.array(list(product((0.0, 1.0), repeat=3)))[1:]
_CORNER /= np.linalg.norm(_CORNER, axis=1, keepdims=True)
_SIGNS = np.array(list(product((-1.0, 1.0), repeat=3)))
_ROUND_CORNERS = (_CORNER[None] * _SIGNS[:, None]).reshape(-1, 3)  # 7 directions a corner


def chance(rng: Rng, probability: float) -> bool:
    """True with the given probability."""
    return bool(rng.random() < probability)


def point(values: ArrayLike) -> tuple[float, float, float]:
    """Three plain floats."""
    x, y, z = np.asarray(values, dtype=float).tolist()
    return x, y, z


# --- solids ---------------------------------------------------------------------------------


def box(size: ArrayLike, center: ArrayLike = (0, 0, 0)) -> Solid:
    """Box of the given full size (3,) about its centre."""
    return Solid.cube(point(size), True).translate(point(center))


def box_between(low: ArrayLike, high: ArrayLike) -> Solid:
    """Box from its lowest to its highest corner, each (3,)."""
    low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    return box(high - low, (low + high) / 2)


def rounded_box(size: ArrayLike, center: ArrayLike = (0, 0, 0), radius: float = 0.01) -> Solid:
    """Box with all edges and corners rounded (108 faces); radius is limited by the size."""
    half = np.asarray(size, dtype=float) / 2
    radius = min(radius, 0.98 * float(half.min()))
    corners = np.repeat(_SIGNS * (half - radius), len(_CORNER), axis=0)
    return Solid.hull_points(corners + radius * _ROUND_CORNERS + np.asarray(center, dtype=float))


def cushion(
    size: ArrayLike, center: ArrayLike = (0, 0, 0), power: float = 4.0, segments: int = 16
) -> Solid:
    """Superellipsoid |x/a|^p + |y/b|^p + |z/c|^p = 1 of the given full size: 2 is an ellipsoid,
    4 a plump cushion, 8 nearly a box."""
    rings = max(segments // 2, 6)
    turn = np.arange(segments) * 2 * np.pi / segments
    lift = (np.arange(rings) + 0.5) / rings * np.pi - np.pi / 2
    direction = np.stack(
        [
            np.outer(np.cos(lift), np.cos(turn)),
            np.outer(np.cos(lift), np.sin(turn)),
            np.outer(np.sin(lift), np.ones(segments)),
        ],
        axis=-1,
    ).reshape(-1, 3)
    direction = np.sign(direction) * np.abs(direction) ** (2 / power)
    direction /= np.abs(direction).max(axis=0)
    return Solid.hull_points(direction * np.asarray(size) / 2 + np.asarray(center, dtype=float))


def cylinder(
    radius: float, height: float, base: ArrayLike = (0, 0, 0), segments: int = 20
) -> Solid:
    """Upright cylinder standing on the point base."""
    return cone(radius, radius, height, base, segments)


def cone(
    radius: float, radius_top: float, height: float, base: ArrayLike = (0, 0, 0), segments: int = 20
) -> Solid:
    """Upright (truncated) cone standing on the point base; radius_top may be 0."""
    return Solid.cylinder(height, radius, radius_top, segments).translate(point(base))


def rod(
    start: ArrayLike,
    end: ArrayLike,
    radius: float,
    radius_end: float | None = None,
    segments: int = 10,
) -> Solid:
    """Round (tapered) bar between two points."""
    start, end = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    side, third = _across(end - start)
    angle = np.arange(segments) * 2 * np.pi / segments
    circle = np.outer(np.cos(angle), side) + np.outer(np.sin(angle), third)
    last = radius if radius_end is None else radius_end
    return Solid.hull_points(np.concatenate([start + radius * circle, end + last * circle]))


def bar(start: ArrayLike, end: ArrayLike, width: float, depth: float, taper: float = 1.0) -> Solid:
    """Rectangular bar between two points. width is horizontal, across the bar (along Y for an
    upright one), depth across both (along X for an upright one); taper scales the far end."""
    start, end = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    side, third = _across(end - start)
    square = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) / 2
    corners = np.outer(square[:, 0] * width, side) + np.outer(square[:, 1] * depth, third)
    return Solid.hull_points(np.concatenate([start + corners, end + taper * corners]))


def tube(points: ArrayLike, radius: float, segments: int = 8) -> Solid:
    """Round tube along a polyline (P, 3), mitred at its bends (which stay under 150 degrees)."""
    path = np.asarray(points, dtype=float)
    steps = np.diff(path, axis=0)
    steps /= np.linalg.norm(steps, axis=1, keepdims=True)
    side, third = _across(steps[0])
    angle = np.arange(segments) * 2 * np.pi / segments
    circle = np.outer(np.cos(angle), side) + np.outer(np.sin(angle), third)
    rings = [path[0] + radius * circle]
    for index, step in enumerate(steps):
        normal = step + steps[min(index + 1, len(steps) - 1)]
        reach = (path[index + 1] - rings[-1]) @ normal / (step @ normal)
        rings.append(rings[-1] + reach[:, None] * step)
    return loft(np.stack(rings))


def loft(rings: ArrayLike) -> Solid:
    """Skin over rings (R, K, 3), each counter-clockwise seen from the end towards which they
    follow one another; the end rings are closed by fans about their means (so they are
    star-shaped about it)."""
    points = np.asarray(rings, dtype=np.float32)
    count, size = points.shape[:2]
    here = np.arange(size)
    there = np.roll(here, -1)
    base = (np.arange(count - 1) * size)[:, None]
    low, low_next = (base + here).ravel(), (base + there).ravel()
    first, last = count * size, count * size + 1
    top = (count - 1) * size
    faces = np.concatenate(
        [
            np.stack([low, low_next, low_next + size], axis=1),
            np.stack([low, low_next + size, low + size], axis=1),
            np.stack([there, here, np.full(size, first)], axis=1),
            np.stack([top + here, top + there, np.full(size, last)], axis=1),
        ]
    )
    ends = points[[0, -1]].mean(axis=1)
    mesh = m3.Mesh(np.concatenate([points.reshape(-1, 3), ends]), faces.astype(np.uint32))
    return Solid(mesh)


def loft_z(sections: Sequence[ArrayLike], heights: Sequence[float]) -> Solid:
    """Loft through counter-clockwise outlines (K, 2) in x, y at rising heights."""
    outlines = np.asarray(sections, dtype=float)
    lift = np.broadcast_to(np.asarray(heights)[:, None, None], (*outlines.shape[:2], 1))
    return loft(np.concatenate([outlines, lift], axis=2))


def extrude(polygon_xy: ArrayLike, height: float, base_z: float = 0.0) -> Solid:
    """Prism over a simple polygon (K, 2) in x, y, from base_z upwards."""
    return _prism(polygon_xy, height).translate((0.0, 0.0, float(base_z)))


def extrude_x(polygon_yz: ArrayLike, length: float, center_x: float = 0.0) -> Solid:
    """Prism over a polygon (K, 2) in y, z, along x about center_x."""
    matrix = np.array([[0, 0, 1, center_x - length / 2], [1, 0, 0, 0], [0, 1, 0, 0]], dtype=float)
    return _prism(polygon_yz, length).transform(matrix)


def extrude_y(polygon_xz: ArrayLike, length: float, center_y: float = 0.0) -> Solid:
    """Prism over a polygon (K, 2) in x, z, along y about center_y: side profiles."""
    matrix = np.array([[1, 0, 0, 0], [0, 0, -1, center_y + length / 2], [0, 1, 0, 0]], dtype=float)
    return _prism(polygon_xz, length).transform(matrix)


def revolve(profile_rz: ArrayLike, segments: int = 24, center: ArrayLike = (0, 0)) -> Solid:
    """Solid of revolution of a polygon (K, 2) in radius, z about the vertical through center."""
    x, y = np.asarray(center, dtype=float).tolist()
    return _section(profile_rz).revolve(segments).translate((x, y, 0.0))


def ring(radius: float, thickness: float, center: ArrayLike, segments: int = 20) -> Solid:
    """Horizontal torus of tube radius `thickness`."""
    angle = np.arange(8) * np.pi / 4
    profile = np.stack([radius + thickness * np.cos(angle), thickness * np.sin(angle)], axis=1)
    return revolve(profile, segments).translate(point(center))


# --- outlines -------------------------------------------------------------------------------


def oval(
    length_x: float,
    length_y: float,
    power: float = 2.0,
    segments: int = 24,
    center: ArrayLike = (0, 0),
) -> NDArray[np.float64]:
    """Superellipse outline (segments, 2), counter-clockwise: 2 an ellipse, 4 a rounded
    rectangle, 10 nearly a rectangle."""
    angle = (np.arange(segments) + 0.5) * 2 * np.pi / segments
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    direction = np.sign(direction) * np.abs(direction) ** (2 / power)
    return direction * (length_x / 2, length_y / 2) + np.asarray(center, dtype=float)


def rounded_rectangle(
    length_x: float,
    length_y: float,
    radius: float,
    corner_segments: int = 4,
    center: ArrayLike = (0, 0),
) -> NDArray[np.float64]:
    """Rectangle outline (4 * (corner_segments + 1), 2) with round corners, counter-clockwise."""
    half = np.array([length_x, length_y]) / 2
    radius = min(radius, 0.98 * float(half.min()))
    quarter = np.arange(corner_segments + 1) * np.pi / 2 / corner_segments
    outline = []
    for turn, sign in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        angle = quarter + turn * np.pi / 2
        arc = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        outline.append(np.asarray(sign) * (half - radius) + arc)
    return np.concatenate(outline) + np.asarray(center, dtype=float)


def arc(
    center: ArrayLike, radius: float, start: float, end: float, steps: int = 8
) -> NDArray[np.float64]:
    """Points (steps + 1, 2) on a circle from one angle to another, radians."""
    angle = np.linspace(start, end, steps + 1)
    return np.asarray(center) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


# --- materials ------------------------------------------------------------------------------


def wood(rng: Rng) -> Material:
    """Anything from bleached ash to wenge."""
    tone = rng.uniform(0.08, 0.95)
    light, dark = np.array([0.87, 0.74, 0.56]), np.array([0.20, 0.11, 0.06])
    color = dark + (light - dark) * tone + rng.normal(0, 0.02, 3)
    return _material(color, "wood", rng.uniform(0.02, 0.12), rng.uniform(0.05, 0.35))


def fabric(rng: Rng) -> Material:
    """Woven or knitted cloth, plain or patterned."""
    pattern = str(rng.choice(["fabric", "fabric", "fabric", "stripes", "checker"]))
    return _material(_hue(rng, 0.6), pattern, rng.uniform(0.01, 0.08), 0.02)


def leather(rng: Rng) -> Material:
    """Smooth upholstery: black, brown, cream, now and then coloured."""
    shades = [(0.08, 0.08, 0.08), (0.33, 0.18, 0.10), (0.75, 0.68, 0.58), (0.45, 0.10, 0.10)]
    color = np.array(shades[rng.integers(len(shades))]) + rng.normal(0, 0.03, 3)
    return _material(color, "plain", 0.1, rng.uniform(0.15, 0.4))


def paint(rng: Rng) -> Material:
    """Lacquer: mostly white and grey, often coloured."""
    if chance(rng, 0.5):
        color = np.full(3, rng.uniform(0.25, 0.95)) + rng.normal(0, 0.02, 3)
    else:
        color = _hue(rng, 0.5)
    return _material(color, "plain", 0.1, rng.uniform(0.05, 0.5))


def plastic(rng: Rng) -> Material:
    """Coloured, black or white plastic."""
    color = _hue(rng, 0.9) if chance(rng, 0.5) else np.full(3, rng.choice([0.06, 0.3, 0.92]))
    return _material(color, "plain", 0.1, rng.uniform(0.1, 0.4))


def metal(rng: Rng) -> Material:
    """Chrome, brushed steel, black or brass-like metal."""
    shades = [(0.75, 0.76, 0.78), (0.55, 0.56, 0.58), (0.07, 0.07, 0.08), (0.66, 0.54, 0.30)]
    color = np.array(shades[rng.integers(len(shades))]) + rng.normal(0, 0.02, 3)
    return _material(color, "plain", 0.1, rng.uniform(0.5, 0.9))


def ceramic(rng: Rng) -> Material:
    """Sanitary ware: white, seldom cream, grey or black."""
    shades = [(0.95, 0.95, 0.94)] * 5 + [(0.90, 0.86, 0.76), (0.55, 0.56, 0.58), (0.12, 0.12, 0.13)]
    color = np.array(shades[rng.integers(len(shades))]) + rng.normal(0, 0.01, 3)
    return _material(color, "plain", 0.1, rng.uniform(0.4, 0.7))


def stone(rng: Rng) -> Material:
    """Marble, granite, concrete."""
    color = np.full(3, rng.uniform(0.2, 0.9)) + rng.normal(0, 0.03, 3)
    return _material(color, "fabric", rng.uniform(0.05, 0.2), rng.uniform(0.1, 0.6))


def glass(rng: Rng) -> Material:
    """Tinted glass whose surface is seen (`unseen.as_cameras_fail` makes it clear)."""
    color = np.array([0.55, 0.68, 0.68]) * rng.uniform(0.4, 1.2)
    return replace(_material(color, "plain", 0.1, rng.uniform(0.8, 0.95)), glass=True)


def carcass(rng: Rng) -> Material:
    """Wood or lacquer, as case furniture has it."""
    return wood(rng) if chance(rng, 0.6) else paint(rng)


def _hue(rng: Rng, saturation: float) -> NDArray[np.float64]:
    """Random colour, no more saturated than asked."""
    raw = rng.uniform(0, 1, 3)
    gray = float(rng.uniform(0.15, 0.85))
    return gray + (raw - raw.mean()) * float(rng.uniform(0, saturation))


def _material(color: ArrayLike, pattern: str, pattern_m: float, shininess: float) -> Material:
    red, green, blue = (round(float(c), 3) for c in np.clip(np.asarray(color), 0.02, 0.98))
    return Material((red, green, blue), pattern, round(pattern_m, 3), round(shininess, 2))


def _across(direction: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Unit vectors (side, third), right-handed with direction; side is horizontal."""
    unit = direction / np.linalg.norm(direction)
    side = np.array([-unit[1], unit[0], 0.0])
    length = np.linalg.norm(side)
    side = np.array([0.0, 1.0, 0.0]) if length < 1e-6 else side / length
    return side, np.cross(unit, side)


def _section(polygon: ArrayLike) -> m3.CrossSection:
    return m3.CrossSection([np.asarray(polygon, dtype=float)], m3.FillRule.NonZero)


def _prism(polygon: ArrayLike, height: float) -> Solid:
    return Solid.extrude(_section(polygon), float(height))
