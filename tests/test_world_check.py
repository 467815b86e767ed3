"""A world whose floor is not at z = 0, or whose z is not up, is told of, and no other."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from composenet.geometry.transform import make_T
from composenet.pipeline import load_tracker
from composenet.records import Camera, Frame
from composenet.sequences import level_camera, open_sequence
from composenet.sequences.checks import WorldCheck


@pytest.fixture(scope="module")
def frames(recordings: Path) -> list[Frame]:
    return list(open_sequence(recordings / "val_00000"))


def raised(frame: Frame, by_m: float) -> Frame:
    T = frame.T_world_camera.copy()
    T[2, 3] += by_m
    return replace(frame, T_world_camera=T)


def test_a_level_world_is_not_doubted(frames: list[Frame]) -> None:
    check = WorldCheck()
    assert [check(frame) for frame in frames] == [None] * len(frames)


@pytest.mark.parametrize(("by_m", "where"), [(-1.5, "below the floor"), (4, "above 3 m")])
def test_a_floor_elsewhere_is_told_of_once(frames: list[Frame], by_m: float, where: str) -> None:
    check = WorldCheck()
    said = [check(raised(frame, by_m)) for frame in 2 * frames]
    (line,) = [text for text in said if text]
    assert where in line and "floor at z = 0" in line
    assert said.index(line) >= 4  # not after a single frame


def test_doubts_of_all_kinds_count_together(frames: list[Frame]) -> None:
    check, wrong = WorldCheck(), [raised(frames[0], -1.5), raised(frames[0], 4.0)]
    said = [check(frame) for frame in [frames[1], *wrong] * 4]
    (line,) = [text for text in said if text]
    assert "in 3 of 8 frames" in line or "in 3 of 7 frames" in line


def test_a_world_that_moves_later_is_told_of_soon(frames: list[Frame]) -> None:
    check = WorldCheck()
    assert not any(check(frame) for frame in 20 * frames)
    said = [check(raised(frame, -1.5)) for frame in 10 * frames]
    assert [text is not None for text in said].index(True) < 50


@pytest.mark.parametrize("mistake", ["first camera", "OpenGL", "both"])
def test_other_axes_are_told_of(frames: list[Frame], mistake: str) -> None:
    flip = np.diag([1, -1, -1, 1]) if mistake != "first camera" else np.eye(4)
    first = frames[0].T_world_camera @ flip
    T_new_world = np.eye(4) if mistake == "OpenGL" else np.linalg.inv(first)
    check = WorldCheck()
    wrong = [replace(f, T_world_camera=T_new_world @ f.T_world_camera @ flip) for f in frames]
    (line,) = [text for frame in 3 * wrong if (text := check(frame))]
    assert ("faces down" in line or "below the floor" in line) and "z up" in line


def test_a_live_camera_gets_its_world_from_its_first_image(frames: list[Frame]) -> None:
    """Whatever world its poses have."""
    first = frames[0]
    T_world_camera = level_camera(first.depth_m, first.camera)
    assert T_world_camera is not None
    T_old_new = first.T_world_camera @ np.linalg.inv(T_world_camera)
    assert np.degrees(np.arccos(T_old_new[2, 2])) < 1 and abs(T_old_new[2, 3]) < 0.03
    assert np.abs(T_world_camera[:2, 3]).max() < 1e-9  # above the origin
    ahead = T_world_camera[:3, 2]
    assert ahead[0] > 0 and abs(ahead[1]) < 1e-9
    check = WorldCheck()
    T_slam_world = make_T(Rotation.from_euler("xyz", (1, 2, 3)).as_matrix(), np.array([5, -7, 2.0]))
    slam = [T_slam_world @ frame.T_world_camera for frame in frames]
    T_level_slam = T_world_camera @ np.linalg.inv(slam[0])
    for frame, T in zip(frames, slam, strict=True):
        assert check(replace(frame, T_world_camera=T_level_slam @ T)) is None


def test_an_image_without_a_level_plane_has_no_such_world(frames: list[Frame]) -> None:
    camera = frames[0].camera
    for depth in (0.0, 2.0):  # nothing, a wall
        blank = np.full_like(frames[0].depth_m, depth)
        assert level_camera(blank, camera) is None


def test_some_odd_frames_are_no_reason(frames: list[Frame]) -> None:
    check = WorldCheck()
    for frame in 4 * frames:
        assert check(frame) is None
        assert check(frame) is None
        assert check(raised(frame, -1.5)) is None


@pytest.mark.parametrize(("width", "cx"), [(3, 1.0), (40, 1.0), (40, 39.0)])
def test_odd_cameras_are_no_trouble(width: int, cx: float) -> None:
    camera = Camera(np.array([[30.0, 0, cx], [0, 30, 1], [0, 0, 1]]), width, 3)
    frame = Frame(0, np.ones((3, width), np.float32), camera, np.eye(4))
    assert WorldCheck()(frame) is None


def test_a_frame_without_depth_says_nothing(frames: list[Frame]) -> None:
    check, empty = WorldCheck(), replace(frames[0], depth_m=0 * frames[0].depth_m)
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
