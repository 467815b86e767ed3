"""Images tell how the camera moved: derivatives, recovered motions, exposure, nothing to tell."""

from __future__ import annotations

import numpy as np
import pytest

from composenet.geometry.camera import back_project, pixel_rays
from composenet.geometry.photometric import brightness
from composenet.geometry.transform import angle_between_deg, apply_T, make_T
from composenet.records import Camera
from composenet.sequences.brightness import LEVELS, LitPair, LitView, moved

CAMERA = Camera(np.array([[150.0, 0, 79.5], [0, 150, 59.5], [0, 0, 1]]), 160, 120)
WALL_M = 2.0
STEP = np.array([0.01, -0.02, 0.015, 0.03, -0.02, 0.02])


def wall(T_wall_camera: np.ndarray, offset: float = 0.0) -> LitView:
    """A painted wall, the plane z = WALL_M of `T_wall_camera`'s world."""
    rays = pixel_rays(CAMERA) @ T_wall_camera[:3, :3].T
    depth_m = (WALL_M - T_wall_camera[2, 3]) / rays[..., 2]
    x, y, _ = np.moveaxis(T_wall_camera[:3, 3] + depth_m[..., None] * rays, -1, 0)
    paint = 0.5 + 0.15 * np.sin(3 * x + 1) * np.cos(4 * y) + 0.1 * np.sin(9 * x - 5 * y)
    grey = np.round(255 * np.clip(paint + offset, 0, 1)).astype(np.uint8)
    return LitView(depth_m.astype(np.float32), np.repeat(grey[..., None], 3, axis=2), CAMERA)


TRUE = moved(np.eye(4), STEP)
PAIR = LitPair(wall(np.eye(4)), wall(TRUE))


@pytest.mark.parametrize("level", range(LEVELS))
def test_the_gradient_is_that_of_the_misfit(level: int) -> None:
    """H is J^T J and b J^T r: for small residuals the halved sum of squares changes by b, and b
    itself by H."""
    T = moved(TRUE, 0.1 * STEP)
    at = PAIR.equations(T, level)
    for k in range(6):
        step = np.zeros(6)
        step[k] = 1e-3
        ahead, behind = (PAIR.equations(moved(T, sign * step), level) for sign in (1, -1))
        change = (ahead.b[k] - behind.b[k]) / 2e-3
        assert change == pytest.approx(at.H[k, k], rel=0.35)
    downhill = moved(T, -np.linalg.solve(at.H + 1e-3 * np.trace(at.H) * np.eye(6), at.b))
    assert PAIR.equations(downhill, level).misfit < at.misfit


@pytest.mark.parametrize(
    "step",
    [STEP, -STEP, np.array([0, 0.06, 0, 0, 0, 0]), np.array([0, 0, 0, 0.1, 0, 0.1])],
)
def test_a_camera_before_a_bare_wall_is_found_by_its_paint(step: np.ndarray) -> None:
    true = moved(np.eye(4), step)
    found = LitPair(wall(np.eye(4)), wall(true)).guessed(np.eye(4))
    assert np.linalg.norm(found[:3, 3] - true[:3, 3]) < 0.02
    assert angle_between_deg(found[:3, :3], true[:3, :3]) < 0.5


def test_another_exposure_moves_nothing() -> None:
    dimmer = LitPair(wall(np.eye(4)), wall(TRUE, offset=-0.08))
    np.testing.assert_allclose(dimmer.guessed(np.eye(4)), PAIR.guessed(np.eye(4)), atol=0.01)


def test_the_true_pose_looks_most_alike() -> None:
    true = PAIR.misfit(TRUE)
    assert true < 0.01
    for k in range(6):
        for sign in (-1, 1):
            step = np.zeros(6)
            step[k] = 0.05 * sign
            assert PAIR.misfit(moved(TRUE, step)) > 2 * true


def test_what_is_hidden_or_elsewhere_is_not_compared() -> None:
    behind = make_T(np.eye(3), [0.0, 0, 0.5])  # in view, but the wall of the first hides it
    assert PAIR.equations(behind, 0).pixels == 0 and PAIR.misfit(behind) == np.inf
    aside = make_T(np.eye(3), [30.0, 0, 0])
    assert PAIR.equations(aside, 0).pixels == 0 and PAIR.misfit(aside) == np.inf
    np.testing.assert_array_equal(PAIR.guessed(aside), aside)


def test_plain_or_unmeasured_images_tell_nothing() -> None:
    grey = np.full((CAMERA.height, CAMERA.width, 3), 90, np.uint8)
    depth = np.full(grey.shape[:2], WALL_M, np.float32)
    noise = np.random.default_rng(0).integers(0, 255, grey.shape).astype(np.uint8)
    for view in (LitView(depth, grey, CAMERA), LitView(0 * depth, noise, CAMERA)):
        pair = LitPair(view, view)
        assert pair.misfit(np.eye(4)) == np.inf
        np.testing.assert_array_equal(pair.guessed(TRUE), TRUE)


def test_images_of_few_pixels_tell_nothing() -> None:
    K = np.array([[5.0, 0, 2], [0, 5, 1], [0, 0, 1]])
    color = np.random.default_rng(2).integers(0, 255, (3, 5, 3)).astype(np.uint8)
    view = LitView(np.ones((3, 5), np.float32), color, Camera(K, 5, 3))
    assert len(view.levels) == LEVELS and LitPair(view, view).misfit(np.eye(4)) == np.inf


def test_wide_images_are_halved_first() -> None:
    depth = np.full((480, 640), WALL_M, np.float32)
    color = np.random.default_rng(1).integers(0, 255, (480, 640, 3)).astype(np.uint8)
    K = np.array([[500.0, 0, 319.5], [0, 500, 239.5], [0, 0, 1]])
    levels = LitView(depth, color, Camera(K, 640, 480)).levels
    assert [level.light.shape for level in levels] == [(120, 160), (60, 80), (30, 40)]
    fx, fy, cx, cy = levels[0].pinhole
    assert (fx, fy) == (125, 125) and (cx, cy) == pytest.approx((319.5 / 4, 239.5 / 4))
    assert abs(levels[0].light.mean() - brightness(color).mean()) < 0.01


def test_points_are_those_of_their_pixels() -> None:
    """A slow reference: every point projects onto a pixel whose brightness is its value."""
    level = wall(TRUE).levels[0]
    fx, fy, cx, cy = level.pinhole
    u = np.round(fx * level.points[:, 0] / level.points[:, 2] + cx).astype(int)
    v = np.round(fy * level.points[:, 1] / level.points[:, 2] + cy).astype(int)
    np.testing.assert_allclose(level.light[v, u], level.values, atol=1e-6)
    np.testing.assert_allclose(
        back_project(level.depth_m, CAMERA)[v, u], level.points, rtol=1e-5, atol=1e-6
    )
    wall_z = apply_T(TRUE, level.points)[:, 2]
    np.testing.assert_allclose(wall_z, WALL_M, atol=1e-4)


def test_what_two_images_say_is_what_all_their_pixels_say() -> None:
    """Weighed by pixels, not by images; twice the same says the same."""
    one, other = PAIR.equations(TRUE, 0), PAIR.equations(np.eye(4), 2)
    both = one + other
    assert both.pixels == one.pixels + other.pixels
    np.testing.assert_allclose(both.H, one.H + other.H)
    np.testing.assert_allclose(both.b, one.b + other.b)
    total = one.misfit * one.pixels + other.misfit * other.pixels
    assert both.misfit == pytest.approx(total / both.pixels)
    assert (one + one).misfit == pytest.approx(one.misfit)
