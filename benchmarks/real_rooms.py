"""What is found in real rooms that nothing was chosen on.

python benchmarks/real_rooms.py CLONES --out benchmarks/results/real_rooms.json

CLONES is a folder with clones of the public repositories that `real_rooms.json` names, which hold
recordings and single images of other people's benchmarks. That file says by hand what stands there:
of each piece of furniture a pixel or two on it, and which classes are right.

A thing is seen in a frame that shows one of its points: the depth there is the point's, to 10 cm.
It is found if an object that is reported as seen has a right class and its box holds one of the
points, to 5 cm; each object is at most one thing. What is left is false, unless its box holds
any point (of a thing that another object found, or of another class, or that says that what stands
there does not count).
"""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
import tyro
from scipy.optimize import linear_sum_assignment

import composenet
from composenet.errors import DataError
from composenet.geometry.camera import back_project, project
from composenet.geometry.transform import apply_T, inverse_T
from composenet.metrics.report import RunInfo
from composenet.network.weights import default_weights, weights_id
from composenet.records import FloatArray, Frame, TrackedObject
from composenet.sequences import RecordedSequence, SequenceOptions, open_sequence

ROOMS = Path(__file__).with_suffix(".json")
_SAME_DEPTH_M = 0.1
_SLACK_M = 0.05
_FAR_M = 5.5  # beyond it the network looks at nothing


@dataclass(frozen=True)
class Thing:
    """A piece of furniture. points: (N, 3) on its surface, world."""

    name: str
    classes: tuple[str, ...]
    points: FloatArray

    def shown_by(self, frame: Frame) -> bool:
        """Whether the frame sees one of the points."""
        at_camera = apply_T(inverse_T(frame.T_world_camera), self.points)
        ahead = at_camera[(at_camera[:, 2] > 0) & (at_camera[:, 2] < _FAR_M)]
        u, v = np.round(project(ahead, frame.camera)).astype(int).T
        height, width = frame.depth_m.shape
        inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
        apart_m = frame.depth_m[v[inside], u[inside]] - ahead[inside, 2]
        return bool((np.abs(apart_m) < _SAME_DEPTH_M).any())


def holds(entry: TrackedObject, points: FloatArray) -> bool:
    """Whether the object's box, turned as it is, holds one of the points."""
    S = entry.S_world_canonical
    local = (points - S.t) @ S.R
    return bool((np.abs(local) <= entry.extents_m / 2 + _SLACK_M).all(axis=1).any())


def recording(room: dict[str, Any], clones: Path, scratch: Path) -> RecordedSequence:
    """The room's own folder, or one of links to its images. Raises DataError."""
    options = SequenceOptions(
        intrinsics=tuple(room["intrinsics"]) if "intrinsics" in room else None,
        depth_scale=room.get("depth_scale"),
        odometry="depth" in room,
    )
    if "folder" in room:
        return open_sequence(clones / room["folder"], stride=room.get("stride", 1), options=options)
    for kind in ("depth", "color"):
        files = sorted(clones.resolve().glob(room[kind]))
        if not files:
            raise DataError(f"{clones / room[kind]}: no such file; clone {room['from']} there")
        (scratch / kind).mkdir(parents=True)
        for index, file in enumerate(files):
            (scratch / kind / f"{index:06d}{file.suffix}").symlink_to(file)
    return open_sequence(scratch, options=options)


def placed(room: dict[str, Any], sequence: RecordedSequence) -> tuple[list[Thing], FloatArray]:
    """The things, and the points (N, 3) at which nothing counts."""
    wanted = {name for spec in room["things"].values() for name, *_ in spec["at"]}
    wanted |= {name for name, *_ in room.get("ignored", [])}
    frames = {frame.name: frame for frame in sequence if frame.name in wanted}
    factor = room["width"] / sequence.camera.width

    def point(name: str, u: float, v: float) -> FloatArray:
        frame = frames[name]
        row, column = round(v / factor), round(u / factor)
        near = frame.depth_m[row - 2 : row + 3, column - 2 : column + 3]
        if not (near > 0).any():
            raise DataError(f"{sequence.name} {name}: no depth at {u}, {v}")
        depth_m = np.zeros_like(frame.depth_m)
        depth_m[row, column] = np.median(near[near > 0])
        return apply_T(frame.T_world_camera, back_project(depth_m, frame.camera)[row, column])

    things = [
        Thing(name, tuple(spec["classes"]), np.array([point(*at) for at in spec["at"]]))
        for name, spec in room["things"].items()
    ]
    return things, np.array([point(*at) for at in room.get("ignored", [])]).reshape(-1, 3)


def matches(things: list[Thing], found: list[TrackedObject]) -> Iterator[tuple[int, int]]:
    """Pairs (thing, object) of right classes, each in at most one of them."""
    fits = np.array(
        [
            [e.class_name in thing.classes and holds(e, thing.points) for e in found]
            for thing in things
        ],
        float,
    ).reshape(len(things), len(found))
    for i, j in zip(*linear_sum_assignment(fits, maximize=True), strict=True):
        if fits[i, j]:
            yield int(i), int(j)


def score(room: dict[str, Any], sequence: RecordedSequence) -> dict[str, Any]:
    """Counts of one room."""
    things, ignored = placed(room, sequence)
    anywhere = np.concatenate([*(thing.points for thing in things), ignored])
    tracker = composenet.load_tracker()
    seen, right, false = Counter(), Counter(), Counter()
    identities: dict[str, Counter[int]] = defaultdict(Counter)
    told_as: dict[str, Counter[str]] = defaultdict(Counter)
    frames = 0
    for frame in sequence:
        frames += 1
        found = [entry for entry in tracker(frame).objects if entry.observed]
        shown = [thing for thing in things if thing.shown_by(frame)]
        seen.update(thing.name for thing in shown)
        pairs = list(matches(shown, found))
        for i, j in pairs:
            right[shown[i].name] += 1
            identities[shown[i].name][found[j].track_id] += 1
        left = set(range(len(found))) - {j for _, j in pairs}
        for thing in (thing for i, thing in enumerate(shown) if i not in dict(pairs)):
            there = {e.class_name for e in found if holds(e, thing.points)}
            told_as[thing.name].update(there or {"nothing"})
        false.update(found[j].class_name for j in left if not holds(found[j], anywhere))
    return {
        "from": room["from"],
        "frames": frames,
        "things": len(things),
        "things_found": sum(right[thing.name] > 0 for thing in things),
        "object_frames": sum(seen.values()),
        "object_frames_found": sum(right.values()),
        "false": sum(false.values()),
        "false_by_class": dict(false),
        "by_thing": {
            thing.name: {
                "seen": seen[thing.name],
                "found": right[thing.name],
                "identities": dict(identities[thing.name]),
                "else_told_as": dict(told_as[thing.name]),
            }
            for thing in things
        },
    }


def main(clones: Annotated[Path, tyro.conf.Positional], out: Path | None = None) -> None:
    """Print the counts of every room."""
    rows = {}
    for name, room in json.loads(ROOMS.read_text()).items():
        with TemporaryDirectory() as scratch:
            rows[name] = score(room, recording(room, clones, Path(scratch) / name))
        print(name, {key: value for key, value in rows[name].items() if key != "by_thing"})
        for thing, counts in rows[name]["by_thing"].items():
            print(f"    {thing}: {counts}")
    if out is not None:
        weights = weights_id(default_weights())
        info = RunInfo("real rooms", 0, "python benchmarks/real_rooms.py CLONES", weights)
        out.write_text(json.dumps(asdict(info) | {"rooms": rows}, indent=2) + "\n")


if __name__ == "__main__":
    tyro.cli(main)
