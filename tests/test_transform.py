"""Laws of rigid transforms and rotations."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from composenet.geometry.transform import (
    angle_between_deg,
    apply_T,
    inverse_T,
    make_T,
    quaternion_from_rotation,
    rotation_error_deg,
    rotation_from_quaternion,
    rotation_onto,
    rotation_z,
)
from composenet.records import Symmetry

seeds = st.integers(0, 2**32 - 1)


def random_T(rng: np.random.Generator) -> np.ndarray:
    return make_T(Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3) * 3)


@given(seeds)
def test_inverse_undoes_on_both_sides(seed):
    T = random_T(np.random.default_rng(seed))
    np.testing.assert_allclose(inverse_T(T) @ T, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(inverse_T(T), np.linalg.inv(T), atol=1e-12)


@given(seeds)
def test_apply_is_a_group_action(seed):
    rng = np.random.default_rng(seed)
    T_a_b, T_b_c, points_c = random_T(rng), random_T(rng), rng.normal(size=(2, 5, 3))
    composed = apply_T(T_a_b @ T_b_c, points_c)
    np.testing.assert_allclose(composed, apply_T(T_a_b, apply_T(T_b_c, points_c)), atol=1e-12)
    np.testing.assert_array_equal(apply_T(np.eye(4), points_c), points_c)


def test_rotation_z_turns_x_to_y():
    np.testing.assert_allclose(rotation_z(np.pi / 2) @ [1, 0, 0], [0, 1, 0], atol=1e-15)


@given(seeds)
def test_rotation_onto_is_the_smallest_turn(seed):
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(2, 3))
    R = rotation_onto(a, b)
    np.testing.assert_allclose(R @ a / np.linalg.norm(a), b / np.linalg.norm(b), atol=1e-9)
    between = np.degrees(np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b)))
    assert angle_between_deg(np.eye(3), R) == pytest.approx(between, abs=1e-5)


@pytest.mark.parametrize("axis", np.eye(3))
def test_rotation_onto_the_same_and_the_opposite(axis):
    np.testing.assert_array_equal(rotation_onto(axis, axis), np.eye(3))
    half_turn = rotation_onto(axis, -axis)
    np.testing.assert_allclose(half_turn @ axis, -axis, atol=1e-12)
    assert np.linalg.det(half_turn) == pytest.approx(1)


def test_rotation_onto_refuses_no_direction():
    with pytest.raises(ValueError, match="length zero"):
        rotation_onto([0, 0, 0], [0, 0, 1])


@pytest.mark.parametrize("degrees", [0.0, 1e-6, 1.0, 90.0, 179.9999, 180.0])
def test_angle_between_is_exact_near_both_ends(degrees):
    assert angle_between_deg(np.eye(3), rotation_z(np.radians(degrees))) == pytest.approx(
        degrees, abs=1e-7
    )


@pytest.mark.parametrize(
    ("symmetry", "turn_deg", "error_deg"),
    [
        (Symmetry.NONE, 180, 180),
        (Symmetry.TWO, 180, 0),
        (Symmetry.TWO, 90, 90),
        (Symmetry.FOUR, 90, 0),
        (Symmetry.FOUR, 60, 30),
        (Symmetry.INF, 70, 0),
        (Symmetry.INF, 123, 3),
    ],
)
def test_symmetric_rotation_error(symmetry, turn_deg, error_deg):
    R = Rotation.random(random_state=3).as_matrix()
    turned = R @ rotation_z(np.radians(turn_deg))
    assert rotation_error_deg(turned, R, symmetry) == pytest.approx(error_deg, abs=1e-6)
    assert rotation_error_deg(R, turned, symmetry) == pytest.approx(error_deg, abs=1e-6)


def test_symmetry_is_about_the_objects_axis_not_the_worlds():
    tipped = Rotation.from_euler("x", 90, degrees=True).as_matrix()
    world_turn = rotation_z(np.pi) @ tipped
    assert rotation_error_deg(world_turn, tipped, Symmetry.INF) == pytest.approx(180)


@given(seeds)
def test_quaternion_round_trip(seed):
    R = Rotation.random(random_state=seed).as_matrix()
    q = quaternion_from_rotation(R)
    assert q[0] >= 0
    np.testing.assert_allclose(rotation_from_quaternion(q), R, atol=1e-12)
    np.testing.assert_allclose(rotation_from_quaternion(-3 * q), R, atol=1e-12)


def test_quaternion_order_is_wxyz():
    half = np.sqrt(0.5)
    np.testing.assert_allclose(
        quaternion_from_rotation(rotation_z(np.pi / 2)), [half, 0, 0, half], atol=1e-15
    )
