"""How things and the camera move, frame by frame, in the room frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from composenet.synth.collision import Footprint, Item, inside, overlaps, touches
from composenet.synth.placement import Layout

MIN_MOVING_FRAMES = 5


@dataclass(frozen=True)
class Walk:
    """How a mover goes on while it goes. Metres and radians a frame."""

    heading: float
    step_m: float
    turn: float
    until: int


def move_items(layout: Layout, frames: int) -> NDArray[np.float64] | None:
    """(F, N, 3) x, y and yaw of every item's centre: one to three pieces of furniture (and
    sometimes another thing) move along the floor, stop and go, touching nothing; what stands
    on them comes along. None where nothing has room to move."""
    rng, items = layout.rng, layout.items
    paths = np.tile([[*item.xyz[:2], item.yaw] for item in items], (frames, 1, 1))
    floor = [i for i, item in enumerate(items) if item.on_floor]
    furniture = [
        i for i in floor if items[i].shape.class_name != "clutter" and not _built_in(items[i])
    ]
    wanted, moved = int(rng.integers(1, 4)), 0
    # Small things are moved more often, as they are in life.
    size = np.array([np.prod(items[i].extents_m[:2]) for i in furniture])
    order = np.argsort(size * rng.exponential(1.0, len(size)))
    for index in np.array(furniture)[order]:
        path = _roam(layout, paths, int(index))
        if _moving_frames(path) >= min(MIN_MOVING_FRAMES, frames // 3):
            paths[:, index], moved = path, moved + 1
        if moved == wanted:
            break
    if moved == 0:
        return None
    others = [i for i in floor if items[i].shape.class_name == "clutter"]
    if others and rng.random() < 0.3:
        index = int(rng.choice(others))
        paths[:, index] = _roam(layout, paths, index)
    _carry(items, paths)
    return paths


def _built_in(item: Item) -> bool:
    return item.shape.style in ("kitchen_base", "sink_base", "kitchen")


def _moving_frames(path: NDArray[np.float64]) -> int:
    return int(np.count_nonzero(np.abs(np.diff(path, axis=0)).sum(axis=1) > 0.01))


def _roam(layout: Layout, paths: NDArray[np.float64], index: int) -> NDArray[np.float64]:
    """(F, 3): one mover among the others, stop and go."""
    rng, mover = layout.rng, layout.items[index]
    _, _, _, hx, hy = mover.footprint
    others = [i for i, o in enumerate(layout.items) if o.support is None and i != index]
    things = [layout.items[i] for i in others]
    path = paths[:, index].copy()
    going, walk = bool(rng.random() < 0.5), _walk(rng, int(rng.integers(2, 6)))
    for f in range(1, len(path)):
        path[f] = path[f - 1]
        if f >= walk.until:
            going = not going
            walk = _walk(rng, f + int(rng.integers(6, 18) if going else rng.integers(2, 6)))
        if not going:
            continue
        for attempt in range(10):
            heading = walk.heading if attempt == 0 else rng.uniform(-np.pi, np.pi)
            burst = 2.6 if rng.random() < 0.04 else rng.uniform(0.8, 1.2)
            step = walk.step_m * burst * np.array([np.cos(heading), np.sin(heading)])
            x, y = path[f - 1, :2] + step
            turn = walk.turn * burst * (1 if attempt < 5 else -1)
            place = (float(x), float(y), float(path[f - 1, 2] + turn))
            if inside(layout.room, (*place, hx, hy)) and not touches(
                mover, place, things, paths[f, others], 0.01
            ):
                path[f] = place
                walk = Walk(heading + rng.normal(0, 0.1), walk.step_m, walk.turn, walk.until)
                break
    return path


def _walk(rng: np.random.Generator, until: int) -> Walk:
    turn = np.radians(rng.uniform(4.0, 9.5)) * rng.choice([-1, 1])
    return Walk(rng.uniform(-np.pi, np.pi), rng.uniform(0.085, 0.14), float(turn), until)


def _carry(items: list[Item], paths: NDArray[np.float64]) -> None:
    """Move what stands on a mover with it."""
    for index, item in enumerate(items):
        if item.support is None:
            continue
        x0, y0, yaw0 = paths[0, item.support]
        dx, dy = item.xyz[0] - x0, item.xyz[1] - y0
        turn = paths[:, item.support, 2] - yaw0
        paths[:, index, 0] = paths[:, item.support, 0] + np.cos(turn) * dx - np.sin(turn) * dy
        paths[:, index, 1] = paths[:, item.support, 1] + np.sin(turn) * dx + np.cos(turn) * dy
        paths[:, index, 2] = item.yaw + turn


def move_camera(
    layout: Layout, paths: NDArray[np.float64], half_view: float
) -> NDArray[np.float64]:
    """(F, 4, 4) T_room_camera of a hand-held camera: it walks between the furniture, looks at
    some of it, sweeps, pans away and comes back. half_view: half the horizontal view, radians."""
    rng, frames = layout.rng, len(paths)
    eye = float(rng.uniform(1.0, 1.8))
    position = _stroll(layout, paths, eye, half_view)
    yaw, pitch = _gaze(layout, paths, position, eye, half_view)
    shake = _smooth_noise(rng, frames, 3) * np.radians([1.2, 1.2, 2.5])
    height = eye + 0.03 * _smooth_noise(rng, frames, 1)[:, 0]
    poses = np.tile(np.eye(4), (frames, 1, 1))
    for f in range(frames):
        poses[f, :3, :3] = look(yaw[f] + shake[f, 0], pitch[f] + shake[f, 1], shake[f, 2])
        poses[f, :3, 3] = [*position[f], height[f]]
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
            score += 1.0 - 0.4 * off / half + (0.5 if distance > 1.3 else 0.0)
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
    layout: Layout, paths: NDArray[np.float64], eye: float, half_view: float
) -> NDArray[np.float64]:
    """(F, 2) where the walker is: from a place with a good view to others, round things."""
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

    rated = sorted(spots, key=rating, reverse=True)
    position[0], goals = rated[0], rated[1:5] or rated
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
        if np.hypot(*(goal - position[f])) < 0.2 or rng.random() < 0.05 or abs(turn) > 1.5:
            goal = goals[int(rng.integers(len(goals)))]
    return position


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
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(F,) yaw and pitch: looks at a piece of furniture, sweeping, with pans away and back."""
    rng, frames = layout.rng, len(position)
    away, side = _excursions(rng, frames), 0.0
    in_view = _free_places(layout, paths, 0.05, eye - 0.4)
    sweep = np.radians(rng.uniform(4, 11))
    period, phase = rng.uniform(9, 16), rng.uniform(0, 2 * np.pi)
    rate = np.radians(rng.uniform(14, 22))
    _, yaw_now, target = _best_view(layout, paths[0], position[0], half_view)
    pitch_now: float | None = None
    yaw, pitch = np.empty(frames), np.empty(frames)
    for f in range(frames):
        dx, dy = paths[f, target, :2] - position[f]
        distance = float(np.hypot(dx, dy))
        if rng.random() < (0.5 if distance < 1.0 else 0.04):
            target = _best_view(layout, paths[f], position[f], half_view)[2]
        wanted = np.arctan2(dy, dx) + sweep * np.sin(2 * np.pi * f / period + phase)
        if away[f] and not (f and away[f - 1]):
            left, right = (
                _clearance_m(in_view, position[f], wanted + s * away[f], f) for s in (1, -1)
            )
            side = 1.0 if left + rng.uniform(-0.5, 0.5) > right else -1.0
        wanted += side * away[f]
        yaw_now += float(np.clip(0.7 * _wrap(wanted - yaw_now), -rate, rate))
        down = float(np.clip(np.arctan2(eye - 0.5, max(distance, 0.6)), 0.1, 0.75))
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
