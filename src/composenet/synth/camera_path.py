"""How the camera moves, frame by frame, in the room frame."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from composenet.synth.collision import Footprint, inside, overlaps
from composenet.synth.placement import Layout

_ROUND_A_TABLE = 0.6  # share of the sequences with a table
_AT_A_DESK = 0.45  # share of the training sequences with a desk


def move_camera(
    layout: Layout, paths: NDArray[np.float64], half_view: float, training: bool = False
) -> NDArray[np.float64]:
    """(F, 4, 4) T_room_camera of a hand-held camera: it walks between the furniture or round a
    table, looks at some of it, sweeps, pans away and comes back. half_view: half the horizontal
    view, radians. training: it may also be held by someone who sits or stands at a desk."""
    rng, frames = layout.rng, len(paths)
    if training:
        desks = [i for i, item in enumerate(layout.items) if item.shape.class_name == "desk"]
        if desks and rng.random() < _AT_A_DESK:
            for _ in range(6):
                poses = _at_a_desk(layout, paths, int(rng.choice(desks)))
                free = _free_places(layout, paths, 0.1, float(poses[:, 2, 3].min()) - 0.1)
                if all(free(poses[f, :2, 3], f) for f in range(frames)):
                    return poses
    eye = float(rng.uniform(1.0, 1.8))
    tables = [i for i, item in enumerate(layout.items) if item.shape.class_name == "table"]
    centre = int(rng.choice(tables)) if tables and rng.random() < _ROUND_A_TABLE else None
    position = _stroll(layout, paths, eye, half_view, centre)
    yaw, pitch = _gaze(layout, paths, position, eye, half_view, centre)
    shake = _smooth_noise(rng, frames, 3) * np.radians([1.2, 1.2, 2.5])
    height = eye + 0.03 * _smooth_noise(rng, frames, 1)[:, 0]
    poses = np.tile(np.eye(4), (frames, 1, 1))
    for f in range(frames):
        poses[f, :3, :3] = look(yaw[f] + shake[f, 0], pitch[f] + shake[f, 1], shake[f, 2])
        poses[f, :3, 3] = [*position[f], height[f]]
    return poses


def _at_a_desk(layout: Layout, paths: NDArray[np.float64], desk: int) -> NDArray[np.float64]:
    """(F, 4, 4) T_room_camera of a camera that is held over or before the sitter's side of a
    desk, moves little and looks over it and around."""
    rng, frames = layout.rng, len(paths)
    x, y, angle = paths[0, desk]
    deep, wide, tall = layout.items[desk].extents_m
    eye = max(float(rng.uniform(1.0, 1.65)), tall + 0.15)
    forth = deep / 2 + rng.uniform(-0.1, 1.1)
    aside = rng.uniform(-0.6, 0.6) * wide
    c, s = np.cos(angle), np.sin(angle)
    start = np.array([x + forth * c - aside * s, y + forth * s + aside * c, eye])
    drift = np.cumsum(rng.normal(0, 0.012, (frames, 3)), axis=0)
    eyes = start + drift * (1.0, 1.0, 0.5) + 0.01 * _smooth_noise(rng, frames, 3)
    shake = _smooth_noise(rng, frames, 3) * np.radians([1.2, 1.2, 2.5])
    ahead = float(np.arctan2(y - start[1], x - start[0]))
    swing, period = np.radians(rng.uniform(10, 75)), rng.uniform(12, 40)
    period = max(period, 2 * np.pi * swing / np.radians(20))  # no faster than a hand turns
    phase, nod, roll = rng.uniform(0, 2 * np.pi), rng.uniform(0.05, 0.3), rng.uniform(0.02, 0.15)
    down = float(rng.uniform(0.1, 0.55))
    poses = np.tile(np.eye(4), (frames, 1, 1))
    for f in range(frames):
        turn = 2 * np.pi * f / period + phase
        yaw, pitch = ahead + swing * np.sin(turn), down + nod * np.sin(1.7 * turn)
        tilt = roll * np.sin(0.6 * turn)
        poses[f, :3, :3] = look(yaw + shake[f, 0], pitch + shake[f, 1], tilt + shake[f, 2])
        poses[f, :3, 3] = eyes[f]
    return poses


def look(yaw: float, pitch: float, roll: float) -> NDArray[np.float64]:
    """(3, 3) R_world_camera looking along yaw, pitch downwards, turned by roll about the view."""
    forward = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), -np.sin(pitch)])
    right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
    down = np.cross(forward, right)
    c, s = np.cos(roll), np.sin(roll)
    return np.stack([c * right + s * down, c * down - s * right, forward], axis=1)


def _smooth_noise(rng: np.random.Generator, frames: int, columns: int) -> NDArray[np.float64]:
    """(F, columns) noise of unit spread whose neighbours resemble each other."""
    white = rng.standard_normal((frames + 2, columns))
    return (0.5 * white[:-2] + 0.7 * white[1:-1] + 0.5 * white[2:]).astype(np.float64)


def _view_score(
    layout: Layout, places: NDArray[np.float64], at: NDArray[np.float64], yaw: float, half: float
) -> float:
    """How much furniture stands in view at a good distance."""
    score = 0.0
    for item, (x, y, _) in zip(layout.items, places, strict=True):
        if item.shape.class_name == "clutter":
            continue
        distance = float(np.hypot(x - at[0], y - at[1]))
        off = abs(_wrap(np.arctan2(y - at[1], x - at[0]) - yaw))
        if off < half and 0.8 < distance < 5.0:
            score += 1.0 - 0.4 * off / half + (0.5 if 1.2 < distance < 3.0 else 0.0)
    return score


def _best_view(
    layout: Layout, places: NDArray[np.float64], at: NDArray[np.float64], half: float
) -> tuple[float, float, int]:
    """(score, yaw, item) of the piece of furniture best looked at from here."""
    best = (-1.0, 0.0, 0)
    for index, item in enumerate(layout.items):
        if item.shape.class_name == "clutter":
            continue
        yaw = float(np.arctan2(places[index, 1] - at[1], places[index, 0] - at[0]))
        score = _view_score(layout, places, at, yaw, half) + layout.rng.uniform(0, 0.5)
        if score > best[0]:
            best = (score, yaw, index)
    return best


def _stroll(
    layout: Layout,
    paths: NDArray[np.float64],
    eye: float,
    half_view: float,
    centre: int | None,
) -> NDArray[np.float64]:
    """(F, 2) where the walker is: from a place with a good view to others, past things; or
    round the item `centre` at arm's length and more."""
    rng, size = layout.rng, np.array(layout.room.size_m)
    # In a crowded room the walker comes closer to things, then holds the camera over low ones.
    for radius, above_m in ((0.35, 0.0), (0.2, 0.0), (0.2, eye - 0.3)):
        is_free = _free_places(layout, paths, radius, above_m)
        spots = [s for s in rng.uniform(0.05, 0.95, (30, 2)) * size if is_free(s, 0)]
        if len(spots) >= 4:
            break
    spots = spots[:10] or [size / 2]
    position = np.empty((len(paths), 2))
    in_view = _free_places(layout, paths, 0.05, eye - 0.4)

    def rating(at: NDArray[np.float64]) -> float:
        score, yaw, _ = _best_view(layout, paths[0], at, half_view)
        return score - (2.0 if _clearance_m(in_view, at, yaw, 0) < 1.0 else 0.0)

    goals = _ring(layout, centre, is_free) if centre is not None else []
    in_order = len(goals) >= 3
    if not in_order:
        goals = sorted(spots, key=rating, reverse=True)[:5]
    position[0], goals = goals[0], goals[1:] or goals
    goal, pace = goals[0], rng.uniform(0.06, 0.12)
    for f in range(1, len(paths)):
        position[f] = position[f - 1]
        step = pace * (2.6 if rng.random() < 0.03 else rng.uniform(0.7, 1.3))
        for turn in (0.0, 0.5, -0.5, 1.0, -1.0, 1.6, -1.6, 2.3, -2.3, 3.1):
            heading = np.arctan2(*(goal - position[f - 1])[::-1]) + turn
            to = position[f - 1] + step * np.array([np.cos(heading), np.sin(heading)])
            if is_free(to, f):
                position[f] = to
                break
        arrived = float(np.hypot(*(goal - position[f]))) < 0.2
        if in_order and (arrived or abs(turn) > 1.5):
            goals = [*goals[1:], goals[0]]
            goal = goals[0]
        elif not in_order and (arrived or rng.random() < 0.05 or abs(turn) > 1.5):
            goal = goals[int(rng.integers(len(goals)))]
    return position


def _ring(
    layout: Layout, centre: int, is_free: Callable[[NDArray[np.float64], int], bool]
) -> list[NDArray[np.float64]]:
    """Free places round an item, 1 to 2 m from its middle, in order."""
    rng, (x, y, _) = layout.rng, layout.items[centre].place
    start, way = rng.uniform(-np.pi, np.pi), rng.choice([-1, 1])
    angles = start + way * np.arange(14) * 2 * np.pi / 14
    radii = max(1.0, layout.items[centre].extents_m[:2].max() / 2 + 0.5) + rng.uniform(0, 0.7, 14)
    spots = np.stack([x + radii * np.cos(angles), y + radii * np.sin(angles)], axis=1)
    return [spot for spot in spots if is_free(spot, 0)]


def _free_places(
    layout: Layout, paths: NDArray[np.float64], radius: float, above_m: float
) -> Callable[[NDArray[np.float64], int], bool]:
    """Whether a body of that radius may stand at a place (2,) in a frame, among the things on
    the floor that reach higher than above_m."""
    items = layout.items
    tall = [i for i, o in enumerate(items) if o.support is None and o.span_m[1] > above_m]
    half = np.array([items[i].footprint[3:] for i in tall]).reshape(-1, 2)

    def is_free(at: NDArray[np.float64], frame: int) -> bool:
        body: Footprint = (float(at[0]), float(at[1]), 0.0, radius, radius)
        obstacles = np.concatenate([paths[frame, tall].reshape(-1, 3), half], axis=1)
        return inside(layout.room, body) and not overlaps(body, obstacles, 0.0)

    return is_free


def _clearance_m(
    is_free: Callable[[NDArray[np.float64], int], bool],
    at: NDArray[np.float64],
    yaw: float,
    frame: int,
) -> float:
    """How far one sees along yaw before a wall or a thing, at most 2 m."""
    ahead = np.array([np.cos(yaw), np.sin(yaw)])
    for distance in np.arange(0.3, 2.0, 0.2):
        if not is_free(at + distance * ahead, frame):
            return float(distance)
    return 2.0


def _gaze(
    layout: Layout,
    paths: NDArray[np.float64],
    position: NDArray[np.float64],
    eye: float,
    half_view: float,
    centre: int | None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(F,) yaw and pitch: looks at a piece of furniture (mostly the item `centre`, where one is
    walked round), sweeping, with pans away and back."""
    rng, frames = layout.rng, len(position)
    away, side = _excursions(rng, frames), 0.0
    in_view = _free_places(layout, paths, 0.05, eye - 0.4)
    sweep = np.radians(rng.uniform(4, 11))
    period, phase = rng.uniform(9, 16), rng.uniform(0, 2 * np.pi)
    rate = np.radians(rng.uniform(14, 22))
    _, yaw_now, target = _best_view(layout, paths[0], position[0], half_view)
    if centre is not None:
        target = centre
        yaw_now = float(np.arctan2(*(paths[0, centre, :2] - position[0])[::-1]))
    pitch_now: float | None = None
    lower = rng.uniform(-0.1, 0.15)
    yaw, pitch = np.empty(frames), np.empty(frames)
    for f in range(frames):
        dx, dy = paths[f, target, :2] - position[f]
        distance = float(np.hypot(dx, dy))
        if rng.random() < (0.5 if distance < 1.0 else 0.04):
            target = _best_view(layout, paths[f], position[f], half_view)[2]
            if centre is not None and rng.random() < 0.7:
                target = centre
        wanted = np.arctan2(dy, dx) + sweep * np.sin(2 * np.pi * f / period + phase)
        if away[f] and not (f and away[f - 1]):
            left, right = (
                _clearance_m(in_view, position[f], wanted + s * away[f], f) for s in (1, -1)
            )
            side = 1.0 if left + rng.uniform(-0.5, 0.5) > right else -1.0
        wanted += side * away[f]
        yaw_now += float(np.clip(0.7 * _wrap(wanted - yaw_now), -rate, rate))
        down = float(np.clip(np.arctan2(eye - 0.5, max(distance, 0.6)) + lower, 0.0, 0.58))
        pitch_now = down if pitch_now is None else 0.8 * pitch_now + 0.2 * down
        yaw[f], pitch[f] = yaw_now, pitch_now
    return yaw, pitch


def _excursions(rng: np.random.Generator, frames: int) -> NDArray[np.float64]:
    """(F,) radians to look aside: one or two pans away for some frames."""
    away = np.zeros(frames)
    for _ in range(1 + int(rng.random() < 0.1)):
        start = int(rng.integers(3, max(4, frames - 10)))
        away[start : start + int(rng.integers(4, 8))] = np.radians(rng.uniform(40, 85))
    return away


def _wrap(angle: float) -> float:
    return float((angle + np.pi) % (2 * np.pi) - np.pi)
