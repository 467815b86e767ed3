"""Counts of what is found in labelled rooms, with a tracker that finds what a test wants."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import real_rooms
from PIL import Image

import composenet
from composenet.errors import DataError
from composenet.geometry.camera import back_project
from composenet.geometry.transform import apply_T, rotation_z
from composenet.records import (
    CLASS_NAMES,
    Box,
    Camera,
    Frame,
    Similarity,
    TrackedObject,
    TrackState,
)

CAMERA = Camera(K=np.array([[20.0, 0, 7.5], [0, 20.0, 5.5], [0, 0, 1]]), width=16, height=12)
EXTENTS = np.array([0.2, 1.0, 0.4])


def entry(
    track_id: int, name: str, at: np.ndarray, turn: float = 0.0, observed: bool = True
) -> TrackedObject:
    S = Similarity(1.0, rotation_z(turn), np.asarray(at, float))
    state = TrackState.TRACKED if observed else TrackState.OCCLUDED
    return TrackedObject(
        track_id, 0, CLASS_NAMES.index(name), state, 0.9, Box(S.t, np.ones(3)), S, EXTENTS, observed
    )


def test_a_box_holds_what_lies_in_it_as_it_is_turned() -> None:
    along = np.array([[0.0, 0.5, 0]])
    assert real_rooms.holds(entry(1, "chair", np.zeros(3)), along)
    assert not real_rooms.holds(entry(1, "chair", np.zeros(3), turn=np.pi / 2), along)
    assert real_rooms.holds(entry(1, "chair", np.zeros(3), turn=np.pi / 2), along[:, [1, 0, 2]])
    assert real_rooms.holds(entry(1, "chair", np.zeros(3)), np.array([[9.0, 9, 9], [0.14, 0, 0]]))
    assert not real_rooms.holds(entry(1, "chair", np.zeros(3)), np.array([[0.16, 0, 0]]))


@pytest.mark.parametrize(
    ("point", "shown"),
    [
        ([0.0, 0, 2.05], True),
        ([0.0, 0, 2.15], False),  # behind what is seen
        ([0.0, 0, 1.85], False),  # in front of it
        ([2.0, 0, 2.0], False),  # beside the image
        ([0.0, 0, -2.0], False),
        ([0.0, 0, 0], False),
        ([0.0, 1.5, 6.0], False),  # farther than anything is looked for
    ],
)
def test_a_thing_is_shown_where_depth_is_its_own(point, shown) -> None:
    depth_m = np.full((12, 16), 2.0, np.float32)
    depth_m[10:] = 6.0
    frame = Frame(0, depth_m, CAMERA, np.eye(4))
    assert real_rooms.Thing("a", ("chair",), np.array([point])).shown_by(frame) == shown


def test_each_object_is_one_thing_and_each_thing_one_object() -> None:
    here, there = np.zeros((1, 3)), np.array([[0.0, 0.4, 0]])
    things = [
        real_rooms.Thing("a", ("chair",), here),
        real_rooms.Thing("b", ("chair", "table"), there),
        real_rooms.Thing("c", ("sofa",), here),
    ]
    one = entry(1, "chair", np.zeros(3))  # holds both
    assert len(list(real_rooms.matches(things, [one]))) == 1
    both = [one, entry(2, "table", there[0])]
    assert sorted(real_rooms.matches(things, both)) == [(0, 0), (1, 1)]
    assert list(real_rooms.matches(things, [])) == []


def test_counts_of_a_recording(recordings: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    room = {
        "from": "here",
        "folder": "val_00000",
        "width": 320,  # as if the images had been twice as wide
        "stride": 2,
        "things": {
            "a": {"classes": ["chair"], "at": [["0", 160, 140]]},
            "b": {"classes": ["sofa"], "at": [["0", 40, 200]]},
        },
        "ignored": [["2", 280, 200]],
    }
    sequence = real_rooms.recording(room, recordings, Path("unused"))
    first, second, third = sequence

    def at(frame: Frame, row: int, column: int) -> np.ndarray:
        return apply_T(frame.T_world_camera, back_project(frame.depth_m, frame.camera))[row, column]

    a, b, ignored = at(first, 70, 80), at(first, 100, 20), at(second, 100, 140)
    found = [
        entry(7, "chair", a),
        entry(8, "table", b),  # another class: neither found nor false
        entry(9, "bed", ignored),
        entry(10, "bed", a + np.array([0, 0, 50])),  # false
        entry(11, "sofa", b, observed=False),
    ]
    monkeypatch.setattr(
        composenet, "load_tracker", lambda: lambda frame: SimpleNamespace(objects=found)
    )
    counts = real_rooms.score(room, sequence)
    seen = counts["by_thing"]["a"]["seen"]
    assert 1 <= seen <= counts["frames"] == 3 and third.index == 4
    assert counts["by_thing"]["a"] == {
        "seen": seen,
        "found": seen,
        "identities": {7: seen},
        "else_told_as": {},
    }
    missed = counts["by_thing"]["b"]["seen"]
    assert missed >= 1 and counts["by_thing"]["b"] == {
        "seen": missed,
        "found": 0,
        "identities": {},
        "else_told_as": {"table": missed},
    }
    assert (counts["things"], counts["things_found"]) == (2, 1)
    assert counts["object_frames_found"] == seen < counts["object_frames"]
    assert counts["false"] == 3 and counts["false_by_class"] == {"bed": 3}


def test_single_images_are_linked_together(tmp_path: Path) -> None:
    depth_mm = np.full((12, 16), 2000, np.uint16)
    for name in ("7_depth", "9_depth"):
        Image.fromarray(depth_mm).save(tmp_path / f"{name}.png")
        Image.new("RGB", (16, 12)).save(tmp_path / f"{name.replace('depth', 'rgb')}.jpg")
    room = {"from": "github.com/a/b", "depth": "*_depth.png", "color": "*_rgb.jpg"}
    room |= {"intrinsics": [20, 20, 7.5, 5.5]}
    with pytest.raises(DataError, match=r"clone github.com/a/b there"):
        real_rooms.recording(room | {"color": "*.bmp"}, tmp_path, tmp_path / "scratch0")
    room["depth_scale"] = 500
    sequence = real_rooms.recording(room, tmp_path, tmp_path / "scratch")
    assert sequence.has_poses and not sequence.own_poses and len(sequence) == 2
    assert next(iter(sequence)).depth_m.max() == 4
    assert sorted(p.name for p in (tmp_path / "scratch/color").iterdir()) == [
        "000000.jpg",
        "000001.jpg",
    ]


def test_the_labels_are_whole() -> None:
    rooms = json.loads(real_rooms.ROOMS.read_text())
    for room in rooms.values():
        assert room["from"] and room["width"] > 0 and ("folder" in room) != ("depth" in room)
        for thing in room["things"].values():
            assert thing["at"] and set(thing["classes"]) <= set(CLASS_NAMES)
