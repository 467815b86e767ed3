"""Laws of the pinhole camera and its pixel convention."""

import numpy as np
import pytest

from composenet.geometry.camera import (
    back_project,
    pixel_rays,
    project,
    resize_camera,
    subsample_camera,
    subsample_offset,
)
from composenet.records import Camera


@pytest.fixture
def camera() -> Camera:
    K = np.array([[50.0, 0, 15.3], [0, 55.0, 11.1], [0, 0, 1]])
    return Camera(K=K, width=32, height=24)


def test_projecting_back_projected_pixels_gives_their_centres(camera):
    depth = np.random.default_rng(0).uniform(0.5, 5, (24, 32)).astype(np.float32)
    pixels = project(back_project(depth, camera), camera)
    v, u = np.mgrid[:24, :32]
    np.testing.assert_allclose(pixels, np.stack([u, v], axis=-1), atol=1e-4)


def test_back_projection_is_depth_times_ray(camera):
    depth = np.random.default_rng(1).uniform(0.5, 5, (24, 32)).astype(np.float32)
    np.testing.assert_allclose(
        back_project(depth, camera), depth[..., None] * pixel_rays(camera), rtol=1e-5, atol=1e-6
    )


def test_first_pixel_centre_is_zero(camera):
    ray = pixel_rays(camera)[0, 0]
    np.testing.assert_allclose(ray, [-15.3 / 50, -11.1 / 55, 1])


def test_no_measurement_stays_zero(camera):
    assert not back_project(np.zeros((24, 32), np.float32), camera).any()


def test_points_behind_the_camera_have_no_pixel(camera):
    pixels = project(np.array([[0.0, 0, 1], [0, 0, 0], [0, 0, -1]]), camera)
    np.testing.assert_array_equal(np.isnan(pixels[:, 0]), [False, True, True])


def test_resize_keeps_the_image_borders(camera):
    """Half a pixel outside the first and the last centre are the borders of both images."""
    small = resize_camera(camera, 16, 6)
    for old, new in (((-0.5, -0.5), (-0.5, -0.5)), ((31.5, 23.5), (15.5, 5.5))):
        ray = np.linalg.solve(camera.K, [*old, 1.0])
        np.testing.assert_allclose(project(ray, small), new, atol=1e-12)


def test_resize_there_and_back_is_the_same_camera(camera):
    back = resize_camera(resize_camera(camera, 80, 12), 32, 24)
    np.testing.assert_allclose(back.K, camera.K, atol=1e-12)


@pytest.mark.parametrize("factor", [1, 2, 3, 4, 5])
def test_subsampled_pixels_see_the_same_rays(camera, factor):
    o = subsample_offset(factor)
    small = subsample_camera(camera, factor)
    kept = pixel_rays(camera)[o::factor, o::factor]
    assert kept.shape[:2] == (small.height, small.width)
    np.testing.assert_allclose(pixel_rays(small), kept, atol=1e-12)


def test_odd_subsampling_is_a_resize():
    camera = Camera(K=np.array([[50.0, 0, 15.3], [0, 55, 11.1], [0, 0, 1]]), width=30, height=24)
    np.testing.assert_allclose(
        subsample_camera(camera, 3).K, resize_camera(camera, 10, 8).K, atol=1e-12
    )


def test_cameras_of_equal_numbers_are_equal() -> None:
    K = np.array([[150.0, 0, 79.5], [0, 150.0, 59.5], [0, 0, 1]])
    camera, same = Camera(K, 160, 120), Camera(K.copy(), 160, 120)
    assert camera == same and hash(camera) == hash(same) and len({camera, same}) == 1
    for other in (Camera(K + np.diag([0.1, 0, 0]), 160, 120), Camera(K, 161, 120), None):
        assert camera != other
