"""Round vessels, leaves and bodies of which clutter is made."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from composenet.records import Symmetry
from composenet.synth.furniture.curves import plate, post
from composenet.synth.furniture.parts import (
    Rng,
    Solid,
    chance,
    cone,
    cushion,
    cylinder,
    revolve,
    rod,
)
from composenet.synth.shape import Material, Shape, ShapeBuilder


def assemble(style: str, *parts: tuple[Solid | list[Solid], Material]) -> Shape:
    """Clutter from solids (or lists of them), each with its material; no symmetry is declared, as
    no pose of it is ever asked for."""
    builder = ShapeBuilder()
    for solids, material in parts:
        for solid in solids if isinstance(solids, list) else [solids]:
            builder.add(solid, material)
    return builder.build("clutter", style, Symmetry.NONE)


def vessel(radii: ArrayLike, heights: ArrayLike, wall: float, segments: int = 20) -> Solid:
    """An open round vessel: outer radii at rising heights from 0, a wall and a bottom."""
    r, z = np.asarray(radii, dtype=float), np.asarray(heights, dtype=float)
    inner = np.maximum(r - wall, 0.3 * wall)
    inner_z = np.maximum(z, wall)
    profile = [(0.0, 0.0), *zip(r, z, strict=True), *zip(inner[::-1], inner_z[::-1], strict=True)]
    return revolve([*profile, (0.0, wall)], segments)


def vase(rng: Rng, height: float, width: float) -> Solid:
    """A turned vase, bottle or jar: a smooth random outline."""
    t = np.linspace(0, 1, 9)
    wave = 0.6 + 0.4 * np.sin(rng.uniform(0, 3) + t * rng.uniform(2.5, 6.5))
    radii = np.clip(wave * (1 - rng.uniform(-0.3, 0.6) * t), 0.22, 1.0)
    return vessel(width / 2 * radii / radii.max(), height * t, 0.006 + 0.02 * width)


def leaf(
    root: ArrayLike, angle: float, length: float, width: float, rise: float, droop: float
) -> Solid:
    """A long leaf that rises from its root towards the angle about z and hangs over."""
    t = np.linspace(0, 1, 6)
    out = length * np.sin(np.clip(rise + droop * t, -1.5, 3.0)).cumsum() / 6
    up = length * np.cos(np.clip(rise + droop * t, -1.5, 3.0)).cumsum() / 6
    half = width / 2 * np.sin(np.pi * (0.12 + 0.8 * t)) + 0.002
    way, side = (
        np.array([np.cos(angle), np.sin(angle), 0]),
        np.array([-np.sin(angle), np.cos(angle), 0]),
    )
    spine = np.asarray(root, dtype=float) + np.outer(out, way) + np.outer(up, (0, 0, 1))
    grid = np.stack([spine + half[:, None] * side, spine - half[:, None] * side])
    return plate(grid, 0.006)


def foliage(rng: Rng, root_z: float, height: float, spread: float) -> list[Solid]:
    """Sword leaves, a bush, a cactus, a palm or a little tree, rising from root_z."""
    kind = rng.integers(5)
    if kind == 0:  # sword leaves
        return [
            leaf((0, 0, root_z), a, height * rng.uniform(0.6, 1.0), rng.uniform(0.04, 0.09),
                 rng.uniform(0.05, 0.5), rng.uniform(0.0, 0.5))
            for a in rng.uniform(0, 2 * np.pi, int(rng.integers(7, 14)))
        ]  # fmt: skip
    if kind == 1:  # bush
        blobs = []
        for _ in range(int(rng.integers(4, 8))):
            size = spread * rng.uniform(0.45, 0.8)
            spot = rng.normal((0, 0, root_z + height * 0.55), spread * 0.17)
            lift = max(0.0, root_z + size * 0.4 - spot[2])
            tall = size * rng.uniform(0.7, 1.2)
            blobs.append(cushion((size, size, tall), spot + np.array([0, 0, lift]), 2.0, 10))
        return [*blobs, rod((0, 0, root_z - 0.05), (0, 0, root_z + height * 0.5), 0.015)]
    if kind == 2:  # cactus
        radius = spread * rng.uniform(0.15, 0.25)
        arms = [cushion((2 * radius, 2 * radius, height), (0, 0, root_z + height * 0.47), 3.0, 12)]
        for a in rng.uniform(0, 2 * np.pi, int(rng.integers(0, 3))):
            way = np.array([np.cos(a), np.sin(a), 0]) * radius * 2.2
            z = root_z + height * rng.uniform(0.3, 0.5)
            arms.append(rod((0, 0, z), way + np.array([0, 0, z]), radius * 0.5))
            arms.append(
                cushion(
                    (radius, radius, height * 0.4),
                    way + np.array([0, 0, z + height * 0.15]),
                    3.0,
                    10,
                )
            )
        return arms
    trunk = rod((0, 0, root_z - 0.05), (0, 0, root_z + height * 0.55), 0.018, 0.014)
    if kind == 3:  # palm
        return [trunk] + [
            leaf(
                (0, 0, root_z + height * rng.uniform(0.35, 0.55)),
                a,
                height * rng.uniform(0.4, 0.6),
                rng.uniform(0.05, 0.14),
                rng.uniform(0.2, 0.9),
                rng.uniform(0.8, 1.8),
            )
            for a in rng.uniform(0, 2 * np.pi, int(rng.integers(8, 15)))
        ]
    crown = [  # little tree
        cushion(np.full(3, spread * rng.uniform(0.35, 0.6)),
                rng.normal((0, 0, root_z + height * 0.8), spread * 0.15), 2.0, 10)
        for _ in range(int(rng.integers(3, 7)))
    ]  # fmt: skip
    stem = rod((0, 0, root_z), (0, 0, root_z + height * 0.85), 0.018, 0.012)
    return [stem, *crown]


def shade(rng: Rng, radius: float, height: float, z: float) -> Solid:
    """A lamp shade: conical, cylindrical, a globe or a dome."""
    kind = rng.integers(4)
    if kind == 0:
        return cone(radius, radius * rng.uniform(0.3, 0.8), height, (0, 0, z), 20)
    if kind == 1:
        return cylinder(radius, height, (0, 0, z), 20)
    if kind == 2:
        return cushion((2 * radius, 2 * radius, height), (0, 0, z + height / 2), 2.0, 16)
    t = np.linspace(0, np.pi / 2, 6)
    rim = np.stack([radius * np.cos(t), z + height * np.sin(t)], axis=1)
    return revolve([(0.0, z), *rim[:-1], (0.0, z + height)], 20)


def limb(points: ArrayLike, radii: ArrayLike) -> list[Solid]:
    """An arm or leg: tapering rods with round joints."""
    joints, r = np.asarray(points, dtype=float), np.asarray(radii, dtype=float)
    solids = [
        rod(joints[i], joints[i + 1], r[i], r[i + 1], segments=8) for i in range(len(joints) - 1)
    ]
    return solids + [cushion(np.full(3, 2 * r[i]), joints[i], 2.0, 6) for i in range(1, len(r))]


def torso(hip: ArrayLike, neck: ArrayLike, widths: ArrayLike, depths: ArrayLike) -> Solid:
    """A body from hip to neck: elliptic sections of given widths (Y) and depths (X)."""
    count = len(np.asarray(widths))
    path = np.linspace(np.asarray(hip, dtype=float), np.asarray(neck, dtype=float), count)
    return post(path, np.stack([depths, widths], axis=1), 12)


def head(rng: Rng, neck: ArrayLike, size: float) -> tuple[list[Solid], Solid]:
    """Skull and neck, and hair."""
    at = np.asarray(neck, dtype=float)
    skull = cushion((size * 0.85, size * 0.7, size), at + np.array([0.01, 0, size * 0.62]), 2.2, 10)
    long = rng.uniform(0.5, 1.0) if chance(rng, 0.6) else 1.3
    hair = cushion((size * 0.86, size * 0.78, size * long),
                   at + np.array([-0.03, 0, size * (1.2 - long / 2)]), 2.2, 10)  # fmt: skip
    return [skull, cylinder(size * 0.25, size * 0.4, at - np.array([0, 0, size * 0.1]), 8)], hair
