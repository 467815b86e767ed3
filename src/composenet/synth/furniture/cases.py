"""Case furniture: carcasses with doors, drawers, handles and bases (cabinets, vanities, desks)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import manifold3d as m3
import numpy as np
from numpy.typing import ArrayLike

from composenet.synth.furniture.parts import (
    Rng,
    Solid,
    bar,
    box_between,
    carcass,
    chance,
    cone,
    cushion,
    cylinder,
    glass,
    metal,
    rod,
    tube,
)
from composenet.synth.shape import Material, ShapeBuilder

FRONTS = ("flat", "flat", "flat", "frame", "raised")
HANDLES = ("knob", "bar", "bar", "pull", "lip", "none")
BASES = ("plinth", "legs", "splayed", "sled", "bun", "bracket", "none")


@dataclass(frozen=True)
class Look:
    """What all fronts of one piece share. Lengths in metres; handle one of HANDLES, front one of
    FRONTS or "glass" or "louvre"."""

    front: str
    handle: str
    body: Material
    panel: Material
    metal: Material
    pane: Material
    board: float
    proud: float
    gap: float
    handle_length: float
    handle_depth: float


@dataclass(frozen=True)
class Cell:
    """One compartment in the front plane. kind: left | right (door by its hinge), double, drawer,
    open; pulled: how far a drawer is out (of its depth) or a door is open (of 110 degrees)."""

    y0: float
    y1: float
    z0: float
    z1: float
    kind: str
    pulled: float = 0.0
    shelves: int = 0


def random_look(rng: Rng, body: Material | None = None) -> Look:
    """A consistent look of fronts, handles and materials."""
    body = body or carcass(rng)
    return Look(
        front=str(rng.choice(FRONTS)),
        handle=str(rng.choice(HANDLES)),
        body=body,
        panel=body if chance(rng, 0.55) else carcass(rng),
        metal=metal(rng),
        pane=glass(rng),
        board=float(rng.uniform(0.014, 0.035)),
        proud=float(rng.choice([rng.uniform(0.003, 0.008), rng.uniform(0.015, 0.024)])),
        gap=float(rng.uniform(0.002, 0.012)),
        handle_length=float(rng.uniform(0.08, 0.3)),
        handle_depth=float(rng.uniform(0.02, 0.045)),
    )


def splits(rng: Rng, low: float, high: float, count: int, jitter: float = 0.0) -> list[float]:
    """count + 1 edges from low to high; jitter 0..0.4 of a step moves the inner ones."""
    edges = np.linspace(low, high, count + 1)
    edges[1:-1] += rng.uniform(-jitter, jitter, count - 1) * (high - low) / count
    return [float(edge) for edge in edges]


def opened(rng: Rng, probability: float = 0.12) -> float:
    """How far a front stands open: mostly 0."""
    return float(rng.uniform(0.15, 0.9)) if chance(rng, probability) else 0.0


def add_case(
    builder: ShapeBuilder,
    look: Look,
    low: ArrayLike,
    high: ArrayLike,
    cells: Sequence[Cell],
    cuts: Sequence[Solid] = (),
    turn_deg: float = 0.0,
) -> None:
    """A carcass between two corners with its front at the high x, and what its cells hold.
    Closed cells are solid, open ones hollow; cuts are taken out of the carcass. At last all is
    turned about z."""
    low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    back, front = float(low[0]), float(high[0])
    hollow = [
        box_between(
            (back + look.board, cell.y0 + look.board / 2, cell.z0 + look.board / 2),
            (front + 0.1, cell.y1 - look.board / 2, cell.z1 - look.board / 2),
        )
        for cell in cells
        if cell.kind == "open" or cell.pulled
    ]
    body = box_between(low, high)
    if hollow or cuts:
        body = Solid.batch_boolean([body, *hollow, *cuts], m3.OpType.Subtract)
    parts = [(body, look.body)]
    for cell in cells:
        parts += _cell(look, cell, back, front)
    for part, material in parts:
        builder.add(part.rotate((0, 0, turn_deg)) if turn_deg else part, material)


def _cell(look: Look, cell: Cell, back: float, front: float) -> list[tuple[Solid, Material]]:
    """Shelves, doors or the drawer of one compartment."""
    parts: list[tuple[Solid, Material]] = []
    if cell.kind == "open" or (cell.pulled and cell.kind != "drawer"):
        half = look.board / 2
        for z in np.linspace(cell.z0, cell.z1, cell.shelves + 2)[1:-1]:
            low, high = (back + half, cell.y0, z - half), (front - look.board, cell.y1, z + half)
            parts.append((box_between(low, high), look.body))
    if cell.kind == "open":
        return parts
    y0, y1 = cell.y0 + look.gap / 2, cell.y1 - look.gap / 2
    z0, z1 = cell.z0 + look.gap / 2, cell.z1 - look.gap / 2
    if cell.kind == "drawer":
        out = cell.pulled * 0.8 * (front - back)
        if cell.pulled:
            parts.append((_tray(look, cell, back + out + 0.02, front + out), look.body))
        return parts + _front(look, front + out, y0, y1, z0, z1, "middle")
    leaves = [(y0, y1, cell.kind)]
    if cell.kind == "double":
        middle = (y0 + y1) / 2
        leaves = [(y0, middle - look.gap / 2, "right"), (middle + look.gap / 2, y1, "left")]
    for y_low, y_high, hinge in leaves:
        side = "right" if hinge == "left" else "left"
        hinge_y, angle = (y_high, 110.0) if hinge == "left" else (y_low, -110.0)
        for part, material in _front(look, front, y_low, y_high, z0, z1, side):
            if cell.pulled:
                part = part.translate((-front, -hinge_y, 0.0)).rotate((0, 0, angle * cell.pulled))
                part = part.translate((front, hinge_y, 0.0))
            parts.append((part, material))
    return parts


def _tray(look: Look, cell: Cell, back: float, front: float) -> Solid:
    """Drawer box, open at the top."""
    low = np.array([back, cell.y0 + look.board, cell.z0 + look.board])
    high = np.array([front, cell.y1 - look.board, cell.z0 + 0.75 * (cell.z1 - cell.z0)])
    return box_between(low, high) - box_between(low + 0.012, high - np.array((0.012, 0.012, -0.1)))


def _front(
    look: Look, x: float, y0: float, y1: float, z0: float, z1: float, handle_side: str
) -> list[tuple[Solid, Material]]:
    """A door or drawer front standing on the plane x, with its handle."""
    thick = look.proud
    parts: list[tuple[Solid, Material]] = []
    rail = min(0.07, 0.22 * (y1 - y0), 0.3 * (z1 - z0))
    if look.front in ("frame", "glass", "louvre"):
        edges = (
            ((y0, z0), (y0 + rail, z1)),
            ((y1 - rail, z0), (y1, z1)),
            ((y0 + rail, z0), (y1 - rail, z0 + rail)),
            ((y0 + rail, z1 - rail), (y1 - rail, z1)),
        )
        for (ya, za), (yb, zb) in edges:
            parts.append((box_between((x, ya, za), (x + thick + 0.006, yb, zb)), look.panel))
        pane = look.pane if look.front == "glass" else look.panel
        parts.append((box_between((x, y0, z0), (x + 0.4 * thick, y1, z1)), pane))
        if look.front == "louvre":
            for z in np.arange(z0 + rail, z1 - rail, max(0.06, (z1 - z0) / 14)):
                slat = box_between((x, y0 + rail, z), (x + thick, y1 - rail, z + 0.03))
                parts.append((slat, look.panel))
    else:
        parts.append((box_between((x, y0, z0), (x + thick, y1, z1)), look.panel))
        if look.front == "raised":
            low, high = (x, y0 + rail, z0 + rail), (x + thick + 0.008, y1 - rail, z1 - rail)
            parts.append((box_between(low, high), look.panel))
    parts.extend(_handle(look, x + thick, y0, y1, z0, z1, handle_side))
    return parts


def _handle(
    look: Look, x: float, y0: float, y1: float, z0: float, z1: float, side: str
) -> list[tuple[Solid, Material]]:
    wide, high = y1 - y0, z1 - z0
    edge = min(0.05, 0.15 * wide)
    y = {"middle": (y0 + y1) / 2, "left": y1 - edge, "right": y0 + edge}[side]
    z = (z0 + z1) / 2 if side == "middle" or high > 1.0 or z0 > 1.0 else z1 - 0.3 * high
    deep, half = look.handle_depth, min(look.handle_length / 2, 0.4 * wide, 0.4 * high)
    along = np.array([0.0, 1.0, 0.0]) if side == "middle" else np.array([0.0, 0.0, 1.0])
    if side == "middle":
        half = min(look.handle_length / 2, 0.4 * wide)
    at, out = np.array([x, y, z]), np.array([deep, 0.0, 0.0])
    if look.handle == "knob":
        return [(rod(at, at + 0.8 * out, 0.009, 0.016, 8), look.metal)]
    if look.handle == "bar":
        grip = at + out
        posts = [bar(at + s * along, at + s * along + out, 0.01, 0.01) for s in (-half, half)]
        return [
            (part, look.metal)
            for part in (
                bar(grip - 1.15 * half * along, grip + 1.15 * half * along, 0.012, 0.012),
                *posts,
            )
        ]
    if look.handle == "pull":
        bow = [at - half * along, at - 0.7 * half * along + out]
        bow += [at + 0.7 * half * along + out, at + half * along]
        return [(tube(bow, 0.006, 6), look.metal)]
    if look.handle == "lip" and side == "middle":
        return [(box_between((x, y0, z1 - 0.012), (x + 0.7 * deep, y1, z1)), look.metal)]
    return []


def add_base(
    builder: ShapeBuilder,
    rng: Rng,
    kind: str,
    depth: float,
    width: float,
    height: float,
    material: Material,
) -> None:
    """What a case (centred on x = y = 0) stands on, from the floor to `height`. kind: one of
    BASES, or "blocks" or "casters"; "none" adds nothing."""
    thick = float(rng.uniform(0.02, 0.05))
    inset = float(rng.uniform(0.0, 0.08))
    x, y = depth / 2 - thick / 2 - inset, width / 2 - thick / 2 - inset
    if kind == "plinth":
        back, front = -depth / 2, depth / 2 - rng.uniform(0.02, 0.08)
        builder.add(box_between((back, -width / 2, 0), (front, width / 2, height)), material)
    elif kind == "bracket":
        builder.add(_bracket(rng, depth, width, height), material)
    elif kind == "sled":
        for side in (-y, y):
            loop = [
                (-x, side, height),
                (-x, side, thick / 4),
                (x, side, thick / 4),
                (x, side, height),
            ]
            for start, end in pairwise(loop):
                builder.add(bar(start, end, thick / 2, thick / 2), material)
    elif kind != "none":
        columns = 3 if width > 1.5 and chance(rng, 0.6) else 2
        square, taper = chance(rng, 0.4), float(rng.uniform(0.45, 1.0))
        for side_x in (-x, x):
            for side_y in np.linspace(-y, y, columns):
                top = np.array([side_x, side_y, height])
                foot = _foot(rng, kind, top, thick, square, taper)
                builder.add(foot, material)


def _foot(rng: Rng, kind: str, top: ArrayLike, thick: float, square: bool, taper: float) -> Solid:
    x, y, height = np.asarray(top, dtype=float).tolist()
    if kind == "bun":
        return cushion((1.6 * thick, 1.6 * thick, 1.15 * height), (x, y, height * 0.575), 2.2, 8)
    if kind == "casters":
        wheel = rod((x - 0, y - thick / 3, height / 2), (x, y + thick / 3, height / 2), height / 2)
        return wheel + cylinder(0.008, height / 2 + 0.01, (x, y, height / 2), 8)
    if kind == "blocks":
        return box_between((x - thick, y - thick, 0), (x + thick, y + thick, height))
    spread = 0.25 * height if kind == "splayed" else 0.0
    foot = (x + np.sign(x) * spread, y + np.sign(y) * spread, 0.0)
    if square:
        return bar((x, y, height), foot, thick, thick, taper)
    if spread == 0:
        return cone(thick / 2 * taper, thick / 2, height, (x, y, 0), 10)
    return rod((x, y, height), foot, thick / 2, thick / 2 * taper)


def _bracket(rng: Rng, depth: float, width: float, height: float) -> Solid:
    """A frame whose aprons are cut out between corner feet."""
    foot = min(float(rng.uniform(0.06, 0.14)), 0.3 * depth)
    lift = float(rng.uniform(0.55, 0.85)) * height
    frame = box_between((-depth / 2, -width / 2, 0), (depth / 2, width / 2, height))
    along_y = box_between((-depth, foot - width / 2, -1), (depth, width / 2 - foot, lift))
    along_x = box_between((foot - depth / 2, -width, -1), (depth / 2 - foot, width, lift))
    return frame - (along_y + along_x)
