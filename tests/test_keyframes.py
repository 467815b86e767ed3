"""Places seen before: which frame is like which, how a way is bent, how a camera finds back."""

from __future__ import annotations

import numpy as np
import pytest

from baseline_scenes import CAMERA, cabinet, camera_pose, look, pillar
from composenet.geometry.transform import angle_between_deg, inverse_T, make_T, rotation_z
from composenet.records import Frame
from composenet.sequences import Odometry
from composenet.sequences import keyframes as module
from composenet.sequences.keyframes import Way, small_image
from composenet.sequences.surroundings import Shot

THINGS = [pillar(3.2, -0.2), pillar(2.4, 2.0), pillar(3.0, 2.9), pillar(3.6, 1.0)]
RNG = np.random.default_rng(5)


def seen_from(yaw: float, x: float = 0.0) -> Frame:
    return look(0, [cabinet(2.6, 0.9, 0.7)], THINGS, camera_pose(yaw, x=x)).frame


def shot_of(frame: Frame) -> tuple[Shot, np.ndarray]:
    shot = Shot.taken(frame.depth_m, CAMERA, None)
    assert shot is not None
    return shot, small_image(frame.depth_m, None)


def error_m(T: np.ndarray | None, true: np.ndarray) -> float:
    assert T is not None
    assert angle_between_deg(T[:3, :3], true[:3, :3]) < 2
    return float(np.linalg.norm(T[:3, 3] - true[:3, 3]))


def test_small_images_tell_likeness_whatever_the_exposure() -> None:
    depth_m = RNG.uniform(0.5, 4, (60, 80)).astype(np.float32)
    color = RNG.integers(20, 100, (60, 80, 3)).astype(np.uint8)
    small = small_image(depth_m, color)
    assert small.shape == (2, 300)
    np.testing.assert_allclose(small.sum(axis=1), 0, atol=1e-4)
    np.testing.assert_allclose(np.linalg.norm(small, axis=1), 1, atol=1e-4)
    assert small_image(depth_m, 2 * color)[1] @ small[1] > 0.99
    assert small_image(depth_m, color[:, ::-1])[1] @ small[1] < 0.5
    assert not small_image(depth_m, None)[1].any()
    assert not small_image(np.full((60, 80), 2, np.float32), None).any()


def test_the_frame_from_near_by_is_likest() -> None:
    way, yaws = Way(False), [0.0, 0.4, 0.8, 1.2]
    for yaw in yaws:
        way.add(*shot_of(seen_from(yaw)), camera_pose(yaw))
        way.add(*shot_of(seen_from(yaw, 0.02)), camera_pose(yaw, x=0.02))  # too near to be kept
        way.lose()
    for i, yaw in enumerate(yaws):
        best = way.likest(shot_of(seen_from(yaw + 0.05, 0.05))[1], 1)
        assert [key.number for key in best] == [3 * i]
        np.testing.assert_array_equal(way.pose(best[0]), camera_pose(yaw))
        found = way.around(best[0]).find(shot_of(seen_from(yaw + 0.05, 0.05))[0])
        assert error_m(found, camera_pose(yaw + 0.05, x=0.05)) < 0.03


def test_the_one_not_seen_for_longest_is_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_MOST", 3)
    way = Way(False)
    for yaw in (0.0, 0.5, 1.0):
        way.add(*shot_of(seen_from(yaw)), camera_pose(yaw))
    for yaw, number in ((0.0, 0), (0.5, 1)):
        (key,) = way.likest(shot_of(seen_from(yaw))[1], 1)
        assert key.number == number
    way.likest(shot_of(seen_from(0.0))[1], 1)[0].seen = 2
    way.add(*shot_of(seen_from(1.5)), camera_pose(1.5))
    kept = {
        key.number for yaw in (0.0, 1.0, 1.5) for key in way.likest(shot_of(seen_from(yaw))[1], 1)
    }
    assert kept == {0, 2, 3}


def test_a_way_is_bent_the_more_the_later() -> None:
    """As by a camera that goes straight on and errs by the same small motion in every frame."""
    shot, small = shot_of(seen_from(0.0))
    way, true = Way(False), [make_T(np.eye(3), [0.1 * i, 0, 0]) for i in range(11)]
    drift = make_T(rotation_z(0.002), [0.01, 0.02, -0.01])
    drifted = [T @ np.linalg.matrix_power(drift, i) for i, T in enumerate(true)]
    for i, T in enumerate(drifted[:-1]):
        way.lose() if i == 5 else way.add(shot, small, T)
    way.bend(2, 10, drifted[10], true[10] @ np.linalg.matrix_power(drift, 2))
    assert way.poses[5] is None
    for i in (0, 1, 2):
        np.testing.assert_array_equal(way.poses[i], drifted[i])
    for i in (3, 4, 6, 7, 8, 9):
        assert error_m(way.poses[i], true[i] @ np.linalg.matrix_power(drift, 2)) < 0.002
    T = way.poses[9]
    assert T is not None
    np.testing.assert_allclose(T[:3, :3].T @ T[:3, :3], np.eye(3), atol=1e-12)


def test_a_camera_that_was_covered_finds_its_place_again() -> None:
    """It turns away, sees little but a hand, and looks at the first view again, 80 degrees back."""
    odometry = Odometry()
    first = odometry(seen_from(0.0).depth_m, CAMERA)
    assert first is not None
    for yaw in np.arange(0.2, 1.41, 0.2):
        assert odometry(seen_from(yaw).depth_m, CAMERA) is not None
    hand = np.full((CAMERA.height, CAMERA.width), 0.3, np.float32)
    for _ in range(2):
        assert odometry(hand, CAMERA) is None
    poses = [odometry(seen_from(0.02 * i).depth_m, CAMERA) for i in range(5)]
    assert poses[0] is None  # one frame alone says too little
    for i, T in enumerate(poses[1:], start=1):
        assert error_m(T, first @ inverse_T(camera_pose()) @ camera_pose(0.02 * i)) < 0.03
    assert [T is None for T in odometry.way()] == [*[False] * 8, True, True, True, *[False] * 4]


def test_a_glance_away_changes_nothing() -> None:
    """Frames in which the camera is lost, and a keyframe is like the next: it goes on as it was."""
    odometry, hand = Odometry(), np.full((CAMERA.height, CAMERA.width), 0.3, np.float32)
    first = None
    for i in range(12):
        if i % 4 == 3:
            assert odometry(hand, CAMERA) is None
        T, here = odometry(seen_from(0.03 * i).depth_m, CAMERA), odometry._here
        first = T if first is None else first
        assert error_m(T, first @ inverse_T(camera_pose()) @ camera_pose(0.03 * i)) < 0.02
        assert odometry._here is here
    (key,) = odometry._way.likest(shot_of(seen_from(0.0))[1], 1)
    assert key.number == 0


def test_a_place_that_only_looks_alike_is_not_taken_for_it() -> None:
    """What one frame says, the next must say of the same keyframe."""
    odometry = Odometry()
    for yaw in np.arange(0.0, 1.41, 0.2):
        assert odometry(seen_from(yaw).depth_m, CAMERA) is not None
    hand = np.full((CAMERA.height, CAMERA.width), 0.3, np.float32)
    assert odometry(seen_from(0.0).depth_m, CAMERA) is None and odometry._return is not None
    assert odometry(hand, CAMERA) is None and odometry._return is None
    assert odometry(seen_from(0.0).depth_m, CAMERA) is None
    other = look(0, [cabinet(1.6, -0.3)], [pillar(2.0, 0.9)], camera_pose()).frame.depth_m
    assert odometry(other, CAMERA) is None
    assert odometry(seen_from(0.0).depth_m, CAMERA) is None
    assert odometry(seen_from(0.01).depth_m, CAMERA) is not None


def test_what_slipped_is_corrected_where_the_way_was_before() -> None:
    """After 25 frames the camera is taken to be 20 cm aside; it goes on from there until it sees
    what it saw before."""
    odometry, slip = Odometry(), make_T(np.eye(3), [0.0, 0.2, 0.0])
    yaws = [0.05 * i for i in range(25)]
    yaws += yaws[::-1]
    first = None
    for i, yaw in enumerate(yaws):
        depth_m = seen_from(yaw).depth_m
        if i == 25:
            shot, _ = shot_of(seen_from(yaw))
            odometry._here = module.Surroundings(False)
            odometry._here.add(shot, slip @ first @ inverse_T(camera_pose()) @ camera_pose(yaw))
        T = odometry(depth_m, CAMERA)
        first = T if first is None else first
        error = error_m(T, first @ inverse_T(camera_pose()) @ camera_pose(yaw))
        assert error < 0.03 if i < 25 else error < 0.25
    assert error < 0.03
    way = odometry.way()
    for i, T in enumerate(way):
        error = error_m(T, first @ inverse_T(camera_pose()) @ camera_pose(yaws[i]))
        assert error < 0.03 if i < 10 or i > 45 else error < 0.21
