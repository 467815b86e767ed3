"""How hard generated sequences are: the difficulty table of the benchmark, measured."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from composenet.geometry.transform import angle_between_deg
from composenet.metrics.records import counted_pixels
from composenet.records import CLASS_NAMES, FloatArray, SequenceTruth

_VANISH_FRAMES = 3


@dataclass(frozen=True)
class SequenceDifficulty:
    """Raw numbers of one sequence.

    Steps: (S,) metres and degrees between neighbouring frames; of objects only while they
    move. hidden / counted: counted object-frames with a visible fraction under 0.5, and all.
    returning / seen: tracks that vanish for 3 frames or more and return, and tracks ever
    counted. class_ids: of the tracks ever counted.
    """

    object_steps_m: FloatArray
    object_steps_deg: FloatArray
    camera_steps_m: FloatArray
    camera_steps_deg: FloatArray
    hidden: int
    counted: int
    returning: int
    seen: int
    class_ids: tuple[int, ...]


@dataclass(frozen=True)
class Requirement:
    """One line of the table: what was measured, the bound, and whether it holds."""

    quantity: str
    measured: str
    bound: str
    holds: bool


def difficulty(truth: SequenceTruth, T_world_camera: FloatArray) -> SequenceDifficulty:
    """Measure one sequence. T_world_camera: (F, 4, 4)."""
    pixels = np.array([[o.visible_pixels for o in frame] for frame in truth.frames])
    fraction = np.array([[o.visible_fraction for o in frame] for frame in truth.frames])
    counted = pixels >= counted_pixels(*truth.image_size)
    seen: NDArray[np.bool_] = np.any(counted, axis=0)
    moves = [
        _step(before[k].T_world_object, now[k].T_world_object)
        for before, now in pairwise(truth.frames)
        for k in range(len(now))
        if now[k].moving
    ]
    walks = [_step(a, b) for a, b in pairwise(T_world_camera)]
    object_steps, camera_steps = np.array(moves).reshape(-1, 2), np.array(walks).reshape(-1, 2)
    return SequenceDifficulty(
        object_steps_m=object_steps[:, 0],
        object_steps_deg=object_steps[:, 1],
        camera_steps_m=camera_steps[:, 0],
        camera_steps_deg=camera_steps[:, 1],
        hidden=int(np.count_nonzero(fraction[counted] < 0.5)),
        counted=int(np.count_nonzero(counted)),
        returning=sum(_returns(counted[:, k]) for k in range(counted.shape[1])),
        seen=int(np.count_nonzero(seen)),
        class_ids=tuple(o.class_id for o, s in zip(truth.objects, seen, strict=True) if s),
    )


def requirements(sequences: Iterable[SequenceDifficulty]) -> tuple[Requirement, ...]:
    """The table of the benchmark over a split. Bounds on tracks a class are for 100 sequences
    and scale with their number."""
    all_ = tuple(sequences)
    classes = Counter(c for s in all_ for c in s.class_ids)
    twice = sum(max(Counter(s.class_ids).values(), default=0) >= 2 for s in all_)
    rarest = min(range(len(CLASS_NAMES)), key=lambda c: classes[c])
    hidden = _share(sum(s.hidden for s in all_), sum(s.counted for s in all_))
    returning = _share(sum(s.returning for s in all_), sum(s.seen for s in all_))
    pairs, tracks = _share(twice, len(all_)), 30 * len(all_) / 100
    return (
        *_steps(
            "moving objects",
            np.concatenate([s.object_steps_m for s in all_]),
            np.concatenate([s.object_steps_deg for s in all_]),
            (8, 15, 4, 10, 25, 20),
        ),
        *_steps(
            "camera",
            np.concatenate([s.camera_steps_m for s in all_]),
            np.concatenate([s.camera_steps_deg for s in all_]),
            (5, 12, 3, 8, 20, 15),
        ),
        Requirement("visible fraction under 0.5", f"{hidden:.1f} %", ">= 30 %", hidden >= 30),
        Requirement("vanish and return", f"{returning:.1f} %", ">= 15 %", returning >= 15),
        Requirement(
            "tracks of the rarest class",
            f"{classes[rarest]} ({CLASS_NAMES[rarest]})",
            f">= {np.ceil(tracks):.0f}",
            classes[rarest] >= tracks,
        ),
        Requirement("two objects of one class", f"{pairs:.0f} %", ">= 40 %", pairs >= 40),
    )


def class_counts(sequences: Iterable[SequenceDifficulty]) -> dict[str, int]:
    """Tracks of each class."""
    counts = Counter(c for s in sequences for c in s.class_ids)
    return {name: counts[c] for c, name in enumerate(CLASS_NAMES)}


def as_table(lines: Iterable[Requirement]) -> Table:
    """For the terminal."""
    table = Table("quantity", "measured", "bound", "holds", title="Difficulty")
    for line in lines:
        table.add_row(line.quantity, line.measured, line.bound, "yes" if line.holds else "NO")
    return table


def _steps(
    name: str, metres: FloatArray, degrees: FloatArray, bounds: tuple[int, ...]
) -> tuple[Requirement, Requirement]:
    """Median and largest step against (low, high) cm, (low, high) deg, largest cm, deg."""
    if len(metres) == 0:
        metres = degrees = np.zeros(1)
    cm, deg = 100 * float(np.median(metres)), float(np.median(degrees))
    most_cm, most_deg = 100 * float(metres.max()), float(degrees.max())
    a, b, c, d, e, f = bounds
    return (
        Requirement(
            f"{name}: median step",
            f"{cm:.1f} cm, {deg:.1f} deg",
            f"{a}-{b} cm, {c}-{d} deg",
            a <= cm <= b and c <= deg <= d,
        ),
        Requirement(
            f"{name}: largest step",
            f"{most_cm:.0f} cm, {most_deg:.0f} deg",
            f">= {e} cm, {f} deg",
            most_cm >= e and most_deg >= f,
        ),
    )


def _step(T_before: FloatArray, T_now: FloatArray) -> tuple[float, float]:
    distance = float(np.linalg.norm(T_now[:3, 3] - T_before[:3, 3]))
    return distance, angle_between_deg(T_before[:3, :3], T_now[:3, :3])


def _returns(counted: NDArray[np.bool_]) -> bool:
    """Whether a track, once seen, is gone for some frames and seen again."""
    at = np.flatnonzero(counted)
    return bool((np.diff(at) > _VANISH_FRAMES).any())


def _share(part: int, whole: int) -> float:
    return 100.0 * part / max(whole, 1)
