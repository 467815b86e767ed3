"""Tools of a household that stand about: fans, radiators, racks, ladders, a bicycle."""

from __future__ import annotations

import numpy as np

from composenet.synth.furniture.chair_parts import star_base
from composenet.synth.furniture.clutter_parts import assemble
from composenet.synth.furniture.curves import bent_path, post
from composenet.synth.furniture.parts import (
    Rng,
    bar,
    box,
    chance,
    cone,
    cushion,
    cylinder,
    fabric,
    leather,
    metal,
    paint,
    plastic,
    ring,
    rod,
    tube,
    wood,
)
from composenet.synth.shape import Material, Shape

_GREEN = Material((0.18, 0.40, 0.15), "fabric", 0.05)
_DARK = Material((0.04, 0.04, 0.05), shininess=0.6)
_CARD = Material((0.62, 0.48, 0.33))


def fan(rng: Rng) -> Shape:
    """A fan on a pole: cage, hub and blades."""
    tall, radius = rng.uniform(0.7, 1.2), rng.uniform(0.17, 0.24)
    centre = np.array([0.06, 0, tall])
    cage = [
        ring(radius * share, 0.006, (0, 0, 0), 16)
        .rotate((0, 90, 0))
        .translate((0.06 + x, 0.0, float(tall)))
        for share, x in ((1.0, 0.0), (0.9, 0.05), (0.6, 0.07))
    ]
    turn = np.arange(5) * 2 * np.pi / 5
    blades = [
        bar(centre, centre + radius * 0.9 * np.array([0, np.cos(a), np.sin(a)]), 0.02, 0.1)
        for a in turn
    ]
    stand = [cone(0.2, 0.15, 0.03), cylinder(0.015, tall), rod(centre - (0.16, 0, 0), centre, 0.05)]
    return assemble("fan", (cage + stand, plastic(rng)), (blades, plastic(rng)))


def radiator(rng: Rng) -> Shape:
    """A ribbed heater: flat panels or columns."""
    wide, tall, count = rng.uniform(0.4, 1.4), rng.uniform(0.4, 0.75), int(rng.integers(6, 18))
    y = (np.arange(count) + 0.5) * wide / count - wide / 2
    deep, lift = rng.uniform(0.06, 0.14), rng.uniform(0.08, 0.15)
    ribs = [box((deep, wide / count * 0.6, tall), (0, a, lift + tall / 2)) for a in y]
    body = [box((deep * 0.5, wide, 0.04), (0, 0, lift + tall * s)) for s in (0.08, 0.92)]
    feet = [box((deep, 0.03, lift + 0.02), (0, s * wide * 0.4, lift / 2 + 0.01)) for s in (1, -1)]
    return assemble("radiator", (ribs + body + feet, paint(rng)))


def step_ladder(rng: Rng) -> Shape:
    """Two leaning frames with steps."""
    tall, wide, spread = rng.uniform(0.7, 1.7), rng.uniform(0.35, 0.5), rng.uniform(0.25, 0.45)
    size = rng.uniform(0.025, 0.045)
    steel = metal(rng)
    rails = [
        bar((x, s * wide / 2, 0), (0, s * wide * 0.4, tall), size, size)
        for x in (spread, -spread)
        for s in (1, -1)
    ]
    steps = []
    for z in np.linspace(0, tall, int(tall / 0.25) + 1)[1:]:
        x = spread * (1 - z / tall)
        steps.append(box((0.09, wide * 0.9, 0.025), (x, 0, z - 0.012)))
    return assemble("step_ladder", (rails, steel), (steps, steel))


def coat_rack(rng: Rng) -> Shape:
    """A pole with hooks and a coat or two."""
    tall = rng.uniform(1.6, 1.9)
    pole = [cylinder(0.02, tall, segments=10), *star_base(rng, 0.3, 4, casters=False)]
    turns = np.arange(5) * 2 * np.pi / 5
    hooks = [
        rod((0, 0, tall - 0.15), (0.14 * np.cos(a), 0.14 * np.sin(a), tall - 0.04), 0.009)
        for a in turns
    ]
    coats = []
    for a in turns[: int(rng.integers(0, 4))]:
        low, spot = tall - rng.uniform(0.6, 1.1), np.array([0.14 * np.cos(a), 0.14 * np.sin(a)])
        path = [(*spot, low), (*spot, tall - 0.3), (*spot * 0.8, tall - 0.06)]
        coats.append(post(path, np.array([[0.2, 0.3], [0.2, 0.28], [0.05, 0.05]]), 10))
    return assemble("coat_rack", (pole + hooks, wood(rng)), (coats, fabric(rng)))


def drying_rack(rng: Rng) -> Shape:
    """A folding rack with clothes hung over its bars."""
    wide, tall, reach = rng.uniform(0.5, 0.65), rng.uniform(0.85, 1.1), rng.uniform(0.5, 0.9)
    steel = metal(rng)
    frame = [
        rod((s * 0.3, y, 0), (-s * 0.3, y, tall), 0.008)
        for s in (1, -1)
        for y in (-wide / 2, wide / 2)
    ]
    bars = np.linspace(-reach, reach, 8)
    frame += [rod((x, -wide / 2, tall), (x, wide / 2, tall), 0.004, segments=6) for x in bars]
    frame += [rod((-reach, y, tall), (reach, y, tall), 0.008) for y in (-wide / 2, wide / 2)]
    clothes = [
        box((0.03, wide * rng.uniform(0.3, 0.9), d), (x, 0, tall - d / 2))
        for x in bars
        if chance(rng, 0.6)
        for d in (rng.uniform(0.2, 0.7),)
    ]
    return assemble("drying_rack", (frame, steel), (clothes, fabric(rng)))


def bicycle(rng: Rng) -> Shape:
    """Two wheels, a frame, saddle and handlebar."""
    radius, base = rng.uniform(0.25, 0.35), rng.uniform(0.9, 1.08)
    rear, front = np.array([-base / 2, 0, radius]), np.array([base / 2, 0, radius])
    wheels = [
        ring(radius - 0.02, 0.02, (0, 0, 0), 24).rotate((90, 0, 0)).translate(tuple(c))
        for c in (rear, front)
    ]
    side = np.array([0, rng.uniform(0.2, 0.3), 0])
    crank, seat = np.array([-0.1, 0, radius * 0.9]), np.array([-0.22, 0, radius + 0.5])
    fork = np.array([base / 2 - 0.14, 0, radius + 0.5])
    grip = fork + np.array([0, 0, 0.12])
    pairs = [
        (rear, crank),
        (rear, seat),
        (crank, seat),
        (crank, fork),
        (seat - (0, 0, 0.08), fork),
        (fork, front),
    ]
    frame = [rod(a, b, 0.016, segments=8) for a, b in pairs]
    frame += [
        rod(fork, grip, 0.014),
        rod(grip - side, grip + side, 0.012),
    ]
    saddle = cushion((0.26, 0.15, 0.07), seat + np.array([0, 0, 0.06]), 2.5, 10)
    return assemble("bicycle", (wheels, _DARK), (frame, paint(rng)), (saddle, leather(rng)))


def vacuum_cleaner(rng: Rng) -> Shape:
    """A canister with its hose and wand."""
    body = cushion((0.42, 0.28, 0.26), (0, 0, 0.13), 2.8, 14)
    tall = rng.uniform(0.7, 1.0)
    hose = bent_path(
        [(0.18, 0, 0.2), (0.45, 0.1, 0.5), (0.5, 0.3, tall), (0.62, 0.35, 0.03)], 0.25, 5
    )
    nozzle = box((0.1, 0.28, 0.05), (0.64, 0.35, 0.025))
    return assemble("vacuum_cleaner", (body, plastic(rng)), ([tube(hose, 0.02), nozzle], _DARK))


def easel_board(rng: Rng) -> Shape:
    """A white board or flip chart on two feet."""
    wide, tall, low = rng.uniform(0.7, 1.5), rng.uniform(0.8, 1.1), rng.uniform(0.75, 0.95)
    board = box((0.025, wide, tall), (0, 0, low + tall / 2))
    legs = [bar((0, y, 0), (0, y, low + tall), 0.03, 0.03) for y in (-wide / 2, wide / 2)]
    feet = [bar((-0.28, y, 0.02), (0.28, y, 0.02), 0.04, 0.04) for y in (-wide / 2, wide / 2)]
    return assemble("white_board", (board, paint(rng)), (legs + feet, metal(rng)))
