"""A world whose floor is not at z = 0 is told of, and no other."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from composenet.pipeline import load_tracker
from composenet.records import Camera, Frame
from composenet.sequences import open_sequence
from composenet.sequences.checks import HeightCheck


@pytest.fixture(scope="module")
def frames(recordings: Path) -> list[Frame]:
    return list(open_sequence(recordings / "val_00000"))


def raised(frame: Frame, by_m: float) -> Frame:
    T = frame.T_world_camera.copy()
    T[2, 3] += by_m
    return replace(frame, T_world_camera=T)


def test_a_level_world_is_not_doubted(frames: list[Frame]) -> None:
    check = HeightCheck()
    assert [check(frame) for frame in frames] == [None] * len(frames)


@pytest.mark.parametrize(("by_m", "where"), [(-1.5, "below the floor"), (4, "above 3 m")])
def test_a_floor_elsewhere_is_told_of_once(frames: list[Frame], by_m: float, where: str) -> None:
    check = HeightCheck()
    said = [check(raised(frame, by_m)) for frame in 2 * frames]
    (line,) = [text for text in said if text]
    assert where in line and "floor at z = 0" in line
    assert said.index(line) >= 4  # not after a single frame


def test_some_odd_frames_are_no_reason(frames: list[Frame]) -> None:
    check = HeightCheck()
    for frame in 4 * frames:
        assert check(frame) is None
        assert check(frame) is None
        assert check(raised(frame, -1.5)) is None


@pytest.mark.parametrize(("width", "cx"), [(3, 1.0), (40, 1.0), (40, 39.0)])
def test_odd_cameras_are_no_trouble(width: int, cx: float) -> None:
    camera = Camera(np.array([[30.0, 0, cx], [0, 30, 1], [0, 0, 1]]), width, 3)
    frame = Frame(0, np.ones((3, width), np.float32), camera, np.eye(4))
    assert HeightCheck()(frame) is None


def test_a_frame_without_depth_says_nothing(frames: list[Frame]) -> None:
    check, empty = HeightCheck(), replace(frames[0], depth_m=0 * frames[0].depth_m)
    assert [check(empty) for _ in range(9)] == [None] * 9


def test_the_tracker_warns(frames: list[Frame], tiny_weights: Path) -> None:
    tracker = load_tracker(tiny_weights, device="cpu")
    with pytest.warns(UserWarning, match="floor at z = 0") as caught:
        for frame in frames:
            tracker(raised(frame, -1.5))
    assert len(caught) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for frame in frames:
            load_tracker(tiny_weights, device="cpu")(frame)
