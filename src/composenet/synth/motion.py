"""How things move, frame by frame, in the room frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from composenet.synth.collision import Item, inside, touches
from composenet.synth.columns import Place, as_place
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
    """(F, 3): one mover among the others, stop and go, making way for those that come its way.
    It stays where it was for good if it cannot."""
    rng, mover = layout.rng, layout.items[index]
    _, _, _, hx, hy = mover.footprint
    others = [i for i, o in enumerate(layout.items) if o.support is None and i != index]
    things = [layout.items[i] for i in others]
    alone = not np.ptp(paths[:, others], axis=0).any()

    def is_free(place: Place, f: int) -> bool:
        return inside(layout.room, (*place, hx, hy)) and not touches(
            mover, place, things, paths[f, others], 0.01
        )

    path = paths[:, index].copy()
    going, walk = bool(rng.random() < 0.5), _walk(rng, int(rng.integers(2, 6)))
    for f in range(1, len(path)):
        path[f] = path[f - 1]
        if f >= walk.until:
            going = not going
            walk = _walk(rng, f + int(rng.integers(6, 18) if going else rng.integers(2, 6)))
        may_stay = alone or is_free(as_place(path[f]), f)
        if may_stay and not going:
            continue
        for attempt in range(10):
            heading = walk.heading if attempt == 0 else rng.uniform(-np.pi, np.pi)
            burst = 2.6 if rng.random() < 0.04 else rng.uniform(0.8, 1.2)
            step = walk.step_m * burst * np.array([np.cos(heading), np.sin(heading)])
            turn = walk.turn * burst * (1 if attempt < 5 else -1)
            place = as_place(path[f - 1] + [*step, turn])
            if is_free(place, f):
                path[f] = place
                walk = Walk(heading + rng.normal(0, 0.1), walk.step_m, walk.turn, walk.until)
                break
        else:
            if not may_stay:
                return paths[:, index].copy()
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
