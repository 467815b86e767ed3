"""Places seen before: which frame is like which, how a way is bent, how a camera finds back."""

from __future__ import annotations

from dataclasses import replace

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
    way.bend(2, drifted[10], true[10] @ np.linalg.matrix_power(drift, 2))
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
    poses = [odometry(seen_from(0.06 * i).depth_m, CAMERA) for i in range(5)]
    assert poses[0] is None  # one frame alone says too little
    for i, T in enumerate(poses[1:], start=1):
        assert error_m(T, first @ inverse_T(camera_pose()) @ camera_pose(0.06 * i)) < 0.03
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


def at_once(odometry: Odometry, yaws: np.ndarray, first: np.ndarray | None = None) -> list[float]:
    """Errors in metres of a camera that turns on the spot, before they are corrected."""
    errors = []
    for yaw in yaws:
        T = odometry(seen_from(yaw).depth_m, CAMERA)
        first = T if first is None else first
        errors.append(error_m(T, from_first(first, yaw)))
    return errors


def from_first(first: np.ndarray, yaw: float) -> np.ndarray:
    return first @ inverse_T(camera_pose()) @ camera_pose(yaw)


def slipped(odometry: Odometry, yaw: float, y: float) -> None:
    """The camera is taken to be so many metres aside, and all it saw is forgotten but keyframes."""
    first = odometry.way()[0]
    shot, _ = shot_of(seen_from(yaw))
    odometry._here = module.Surroundings(False)
    odometry._here.add(shot, make_T(np.eye(3), [0.0, y, 0.0]) @ from_first(first, yaw))


SWEEP = np.arange(0.0, 1.21, 0.05)


def test_what_slipped_is_corrected_where_the_way_was_before() -> None:
    """The camera goes on 20 cm aside until it sees what it saw before; the frames until then are
    bent, the more the later."""
    odometry = Odometry()
    before = at_once(odometry, SWEEP)
    slipped(odometry, SWEEP[-1], 0.2)
    first = odometry.way()[0]
    after = at_once(odometry, SWEEP[::-1], first)
    assert max(before) < 0.03 and after[0] > 0.15 and max(after[-5:]) < 0.03
    yaws = np.concatenate([SWEEP, SWEEP[::-1]])
    way = [error_m(T, from_first(first, yaw)) for T, yaw in zip(odometry.way(), yaws, strict=True)]
    corrected = len(SWEEP) + next(i for i, error in enumerate(after) if error < 0.03)
    assert way[corrected - 1] < 0.05 < 0.15 < after[corrected - 1 - len(SWEEP)]
    assert max(way[:5]) < 0.03 and max(way[corrected:]) < 0.03


def test_what_was_corrected_is_not_torn_open_again() -> None:
    """Keyframes from while it was wrong are left where they are, and move no later frame."""
    odometry = Odometry()
    at_once(odometry, SWEEP[:7])
    slipped(odometry, SWEEP[7], 0.2)
    first = odometry.way()[0]
    errors = at_once(odometry, [*SWEEP[7:], *SWEEP[::-1], *SWEEP, *SWEEP[::-1]], first)
    right = next(i for i, error in enumerate(errors) if i > 3 and error < 0.03)
    assert right < 50 and max(errors[right:]) < 0.05


def test_a_row_of_the_same_does_not_carry_it_away() -> None:
    """A camera that goes along pillars 1.2 m apart sees every 40 frames what it saw before."""
    odometry, first = Odometry(), None
    row = [pillar(3.0, 1.2 * k) for k in range(-3, 7)]
    row = [replace(one, R=row[0].R) for one in row]
    for i in range(60):
        T_true = camera_pose(y=0.03 * i)
        T = odometry(look(i, [], row, T_true).frame.depth_m, CAMERA)
        first = T if first is None else first
        assert error_m(T, first @ inverse_T(camera_pose()) @ T_true) < 0.1, i


def test_a_place_that_changed_is_not_asked_again_and_again(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    around = Way.around
    monkeypatch.setattr(Way, "around", lambda way, key: asked.append(1) or around(way, key))
    odometry = Odometry()
    for i in range(40):  # what stands before the camera goes from left to right
        things = [pillar(2.0, 0.9 - 0.045 * i), *THINGS]
        assert odometry(look(i, [], things, camera_pose()).frame.depth_m, CAMERA) is not None
    assert len(asked) <= 4


def test_the_length_of_a_way() -> None:
    shot, small = shot_of(seen_from(0.0))
    way = Way(False)
    for i in range(6):
        way.lose() if i == 3 else way.add(shot, small, camera_pose(0.1 * i, x=0.5 * i))
    metres, degrees = way.length(1)
    assert metres == pytest.approx(2.0) and degrees == pytest.approx(np.degrees(0.4))
    assert way.length(5) == (0.0, 0.0)
