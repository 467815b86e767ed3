"""Streams with times of their own: pairs against the assignment that tries all, laws of both, and
poses between poses."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation

from composenet.geometry.transform import apply_T, inverse_T, make_T
from composenet.sequences.stamps import MAX_GAP_S, Trajectory, nearest, paired, paired_or_nearest

TIMES = st.lists(st.floats(0, 0.3), max_size=12).map(np.array)


def test_nearest_timestamp_table() -> None:
    at = np.array([0.0, 1.0, 2.0, 3.0])
    stream = np.array([3.019, 0.011, -0.01, 1.021])
    assert nearest(at, stream).tolist() == [2, -1, -1, 0]
    assert nearest(at, np.zeros(0)).tolist() == [-1] * 4


def cost_s(at_s: np.ndarray, stream_s: np.ndarray, places: np.ndarray) -> float:
    """What lies between partners; a missing one counts as twice the gap."""
    pairs = zip(at_s, places, strict=True)
    return sum(abs(stream_s[place] - t) if place >= 0 else 2 * MAX_GAP_S for t, place in pairs)


@given(TIMES, TIMES)
def test_pairs_are_those_of_least_cost(at_s: np.ndarray, stream_s: np.ndarray) -> None:
    places = paired(at_s, stream_s)
    taken = places[places >= 0]
    assert places.shape == at_s.shape and len(set(taken)) == len(taken)
    assert (np.abs(stream_s[taken] - at_s[places >= 0]) <= MAX_GAP_S).all()
    by_time = places[np.argsort(at_s, kind="stable")]
    partners = stream_s[by_time[by_time >= 0]]
    assert (np.diff(partners) >= 0).all()  # nothing runs backwards
    apart_s = np.abs(np.subtract.outer(at_s, stream_s)).reshape(len(at_s), len(stream_s))
    apart_s[apart_s > MAX_GAP_S] = 99.0
    table = np.hstack([apart_s, np.full((len(at_s), len(at_s)), 2 * MAX_GAP_S)])
    least = table[linear_sum_assignment(table)].sum()
    assert cost_s(at_s, stream_s, places) == pytest.approx(least, abs=1e-9)


def test_cameras_that_take_turns_have_every_image_once() -> None:
    """Colour half-way between depth, with a jitter of 2 ms."""
    rng = np.random.default_rng(3)
    depth_s = np.arange(300) / 30
    color_s = rng.permutation(depth_s + 1 / 60 + rng.normal(0, 0.002, 300).clip(-0.003, 0.003))
    assert np.unique(nearest(depth_s, color_s)).size < 260
    places = paired(depth_s, color_s)
    assert (places >= 0).sum() > 295 and np.bincount(places[places >= 0]).max() == 1


@pytest.mark.parametrize("rate", [30, 60, 90])
def test_an_image_that_is_lost_shifts_no_others(rate: int) -> None:
    times_s = np.arange(300) / rate
    depth_s, color_s = np.delete(times_s, 100), np.delete(times_s, 125)
    places = paired(depth_s, color_s)
    assert (color_s[places] == depth_s)[places >= 0].all() and (places < 0).sum() <= 2


def test_of_a_slow_stream_some_are_shared() -> None:
    depth_s, color_s = np.arange(120) / 60, np.arange(60) / 30 + 0.004
    own, shared = paired(depth_s, color_s), paired_or_nearest(depth_s, color_s)
    assert own[::2].tolist() == list(range(60)) and (own[1::2] == -1).all()
    assert shared.tolist() == np.repeat(np.arange(60), 2).tolist()


def test_many_images_are_paired_in_no_time() -> None:
    """An hour of cameras that take turns, and stamps that are all the same."""
    depth_s = np.arange(108_000) / 30
    start = time.perf_counter()
    assert (paired(depth_s, depth_s + 1 / 60) == np.arange(108_000)).all()
    assert (paired(np.ones(2_000), np.ones(1_000)) >= 0).sum() == 1_000
    assert time.perf_counter() - start < 10


def random_poses(rng: np.random.Generator, count: int) -> np.ndarray:
    return np.hstack([rng.normal(size=(count, 3)), Rotation.random(count, rng=rng).as_quat()])


def matrix(pose: np.ndarray) -> np.ndarray:
    return make_T(Rotation.from_quat(pose[3:]).as_matrix(), pose[:3])


@given(st.floats(0, 1), st.integers(0, 2**32 - 1))
def test_between_two_poses_the_way_is_even(share: float, seed: int) -> None:
    """Turned and moved by a fixed motion, the way is turned and moved with it; backwards it is the
    same way."""
    rng = np.random.default_rng(seed)
    poses = random_poses(rng, 2)
    T = Trajectory(np.array([1.0, 2.0]), poses, 1.0, 0.0).at(1 + share)
    back = Trajectory(np.array([1.0, 2.0]), poses[::-1], 1.0, 0.0).at(2 - share)
    assert T is not None and back is not None
    np.testing.assert_allclose(T, back, atol=1e-6)
    moved = matrix(random_poses(rng, 1)[0])
    turned = Rotation.from_matrix([(moved @ matrix(pose))[:3, :3] for pose in poses]).as_quat()
    other = np.hstack([apply_T(moved, poses[:, :3]), turned])
    np.testing.assert_allclose(
        Trajectory(np.array([1.0, 2.0]), other, 1.0, 0.0).at(1 + share), moved @ T, atol=1e-6
    )
    whole, first = (
        Rotation.from_matrix((inverse_T(matrix(poses[0])) @ end)[:3, :3]).magnitude()
        for end in (matrix(poses[1]), T)
    )
    assert first == pytest.approx(share * whole, abs=1e-5)


def test_poses_hold_for_a_moment_where_there_is_a_gap() -> None:
    times_s = np.array([0.0, 0.05, 0.5])
    poses = random_poses(np.random.default_rng(4), 3)
    way = Trajectory(times_s, poses, 0.1, 0.02)
    for time_s, pose in zip(times_s, poses, strict=True):
        assert np.array_equal(way.at(time_s), matrix(pose))
    held = {-0.019: 0, 0.069: 1, 0.481: 2, 0.519: 2}
    for time_s, place in held.items():
        assert np.array_equal(way.at(time_s), matrix(poses[place]))
    assert all(way.at(time_s) is None for time_s in (-0.021, 0.071, 0.3, 0.479, 0.521))
    poses[2] = poses[1] + [0.06, 0, 0, 0, 0, 0, 0]
    steady = Trajectory(times_s, poses, 0.1, 0.02, (0.1, 5.0)).at(0.275)
    assert steady is not None
    np.testing.assert_allclose(steady[:3, 3], poses[1, :3] + [0.03, 0, 0])
    for gap_s, step in ((0.1, (0.05, 5.0)), (0.04, (0.1, 5.0))):  # too far, or for too long
        assert Trajectory(times_s, poses, gap_s, 0.02, step).at(0.275) is None
    poses[2, :3] = poses[1, :3]
    poses[2, 3:] = (Rotation.from_quat(poses[1, 3:]) * Rotation.from_rotvec([0.1, 0, 0])).as_quat()
    for degrees, told in ((6.0, True), (5.0, False)):
        way = Trajectory(times_s, poses, 0.1, 0.02, (0.1, degrees))
        assert (way.at(0.3) is not None) == told
    poses[2] = poses[1]  # what stays the same holds between
    np.testing.assert_allclose(Trajectory(times_s, poses, 0.1, 0.02).at(0.3), matrix(poses[1]))
    poses[2] = np.nan  # lost: nothing is told on the way there
    lost = Trajectory(times_s, poses, 1.0, 0.02)
    assert lost.at(0.3) is None and lost.at(0.5) is None and lost.at(0.06) is not None
    alone = Trajectory(times_s[:1], poses[:1], 0.1, 0.02)
    assert alone.at(0.03) is None and np.array_equal(alone.at(-0.01), matrix(poses[0]))
