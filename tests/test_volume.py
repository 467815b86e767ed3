"""Frame -> voxels and signed distances: frames, places, labels, laws."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from composenet.config import VolumeConfig
from composenet.geometry.transform import apply_T, inverse_T, make_T, rotation_z
from composenet.records import Box, Frame
from composenet.volume.tsdf import dense_tsdf, projective_tsdf
from composenet.volume.voxels import Volume, quarter_turn, smooth_depth, voxelize
from tracking_scenes import frame

CONFIG = VolumeConfig(min_pixels=1, max_depth_m=7.0)  # the wall is 6 m away
BOX = Box(np.array([2.5, 0.3, 0.45]), np.array([0.6, 0.8, 0.9]))


def voxels(view: Frame, ids: np.ndarray | None = None, config: VolumeConfig = CONFIG) -> Volume:
    volume = voxelize(view, config, ids)
    assert volume is not None
    return volume


def world_centers(volume: Volume) -> np.ndarray:
    return apply_T(volume.T_world_grid, volume.coords * volume.voxel_size_m)


def back_projected(view: Frame, max_depth_m: float) -> np.ndarray:
    """World points of the smoothed depth, pixel by pixel."""
    depth = smooth_depth(view.depth_m)
    v, u = np.nonzero((depth > 0.1) & (depth <= max_depth_m))
    z, K = depth[v, u].astype(float), view.camera.K
    local = np.stack([(u - K[0, 2]) / K[0, 0] * z, (v - K[1, 2]) / K[1, 1] * z, z], axis=-1)
    return apply_T(view.T_world_camera, local)


@given(st.integers(0, 2**32 - 1), st.integers(1, 9), st.integers(1, 9))
def test_depth_is_smoothed_as_the_docstring_says(seed: int, height: int, width: int) -> None:
    rng = np.random.default_rng(seed)
    depth = (1.0 + 0.02 * rng.standard_normal((height, width))).astype(np.float32)
    depth[rng.random(depth.shape) < 0.3] += 1
    holes = rng.random(depth.shape) < 0.2
    depth[holes] = rng.choice([0, -1, np.nan, np.inf], holes.sum())
    expected = np.zeros_like(depth)
    for v, u in zip(*np.nonzero((depth > 0) & (depth < np.inf)), strict=True):
        around = depth[max(0, v - 2) : v + 3, max(0, u - 2) : u + 3].astype(float)
        limit = 0.015 + 0.006 * float(depth[v, u]) ** 2
        expected[v, u] = around[np.abs(around - depth[v, u]) < limit].mean()
    np.testing.assert_allclose(smooth_depth(depth), expected, rtol=1e-6)


@given(st.floats(-10, 10), st.floats(-1.4, 1.4))
def test_quarter_turn_faces_the_camera_along_x(yaw: float, pitch: float) -> None:
    c, s = np.cos(pitch), np.sin(pitch)
    down = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    T = make_T(
        rotation_z(yaw) @ down @ np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), np.zeros(3)
    )
    R = quarter_turn(T)
    forward = R.T @ T[:3, 2]
    assert forward[0] >= abs(forward[1]) - 1e-9
    np.testing.assert_array_equal(np.abs(R).sum(axis=0), 1)  # a signed permutation: boxes stay
    np.testing.assert_array_equal(R @ R.T, np.eye(3))
    assert np.linalg.det(R) == pytest.approx(1) and R[2, 2] == 1


def test_quarter_turn_of_a_camera_that_looks_straight_down() -> None:
    T = np.eye(4)
    T[:3, :3] = np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])  # image's up is world +y
    np.testing.assert_allclose(quarter_turn(T).T @ np.array([0, 1, 0]), [1, 0, 0])


@pytest.mark.parametrize("yaw", [0.0, 2.0])
def test_voxels_are_those_of_the_points(yaw: float) -> None:
    view = frame(0, [BOX], yaw)
    volume = voxels(view)
    points = back_projected(view, CONFIG.max_depth_m)
    in_grid = apply_T(inverse_T(volume.T_world_grid), points) / volume.voxel_size_m
    cells = np.floor(in_grid + 0.5).astype(int)
    inside = (cells[:, 2] >= 0) & (cells[:, 2] < volume.shape[2])  # -1 m to 3.2 m of height
    assert inside.mean() > 0.5
    cells, ours = {tuple(c) for c in cells[inside]}, {tuple(c) for c in volume.coords}
    assert len(ours) == len(volume.coords)
    assert len(cells ^ ours) <= 0.002 * len(ours)  # single precision on the faces between cells
    assert np.all(volume.coords >= 0) and np.all(volume.coords < volume.shape)
    assert all(side % 16 == 0 for side in volume.shape)


def test_offsets_lead_to_the_mean_point() -> None:
    volume = voxels(frame(0, [BOX]))
    offsets = volume.features[:, :3]
    assert np.abs(offsets).max() <= 0.5 + 1e-4
    means = apply_T(volume.T_world_grid, (volume.coords + offsets) * volume.voxel_size_m)
    front = BOX.center[0] - BOX.extents[0] / 2
    on_front = (np.abs(means[:, 1] - 0.3) < 0.3) & (np.abs(means[:, 2] - 0.5) < 0.3)
    on_front &= means[:, 0] < 3
    assert on_front.sum() > 30
    np.testing.assert_allclose(means[on_front, 0], front, atol=0.01)
    normals = (volume.features[:, 3:6] @ volume.T_world_grid[:3, :3].T)[on_front]
    np.testing.assert_allclose(np.median(normals, axis=0), [-1, 0, 0], atol=0.02)
    np.testing.assert_allclose(2 * volume.features[:, 6], world_centers(volume)[:, 2], atol=1e-5)


def test_features_of_the_view_against_a_slow_look_up() -> None:
    """Voxel by voxel, by the words of FEATURE_NAMES."""
    view = frame(0, [BOX], 0.7)
    volume = voxels(view)
    eye, points = np.asarray(view.T_world_camera)[:3, 3], back_projected(view, CONFIG.max_depth_m)
    R, centers = volume.T_world_grid[:3, :3], world_centers(volume)
    for n in range(0, len(centers), 37):
        ray = R.T @ (centers[n] - eye)
        x, y = ray[:2]
        count = (np.abs(points - centers[n]) < volume.voxel_size_m / 2).all(axis=1).sum()
        expected = [np.linalg.norm(ray) / 4, x / np.hypot(x, y), y / np.hypot(x, y)]
        np.testing.assert_allclose(volume.features[n, 7:10], expected, atol=1e-5)
        assert np.exp(4 * volume.features[n, 10]) == pytest.approx(count, abs=1.5)
        assert volume.features[n, 11] == 0
        length = np.linalg.norm(volume.features[n, 3:6])
        assert length == 0 or length == pytest.approx(1, abs=1e-5)


def test_labels_are_the_majority_of_the_pixels() -> None:
    view = frame(0, [BOX])
    ids = np.where(view.depth_m < 3.2, 7, 0).astype(np.uint16)
    ids[:, ::5] = np.where(ids[:, ::5] == 7, 3, 0)  # every fifth column speaks for another one
    volume = voxels(view, ids)
    solid = np.exp(4 * volume.features[:, 10]) > 12
    near = world_centers(volume)[:, 0] < 2.3
    assert set(volume.labels[solid & near]) == {7}
    assert set(volume.labels[world_centers(volume)[:, 0] > 4]) == {0}
    assert not voxels(view).labels.any()


@pytest.mark.parametrize("depth", [0.0, np.nan, np.inf, 50.0, -1.0])
def test_no_usable_depth_is_no_volume(depth: float) -> None:
    view = frame(0)
    assert voxelize(replace(view, depth_m=np.full_like(view.depth_m, depth)), CONFIG) is None


def test_a_lone_pixel_is_noise() -> None:
    view = frame(0, [BOX])
    depth = view.depth_m.copy()
    depth[60, 80] = 1.0
    strict, loose = replace(CONFIG, min_pixels=2), CONFIG
    spiked = replace(view, depth_m=depth)
    near = [(world_centers(voxels(spiked, None, c))[:, 0] < 1.5).sum() for c in (strict, loose)]
    assert near == [0, 1]


@settings(max_examples=4)
@given(st.integers(1, 3), st.floats(-np.pi, np.pi))
def test_a_quarter_turn_of_the_world_changes_nothing(quarters: int, yaw: float) -> None:
    view = frame(0, [BOX], yaw)
    c, s = ((0, 1), (-1, 0), (0, -1))[quarters - 1]
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]], dtype=float)
    turned = replace(view, T_world_camera=make_T(R, np.zeros(3)) @ view.T_world_camera)
    a, b = voxels(view), voxels(turned)
    assert a.shape == b.shape
    np.testing.assert_array_equal(a.coords, b.coords)
    np.testing.assert_allclose(a.features, b.features, atol=1e-5)
    np.testing.assert_allclose(b.T_world_grid, make_T(R, np.zeros(3)) @ a.T_world_grid, atol=1e-9)
    np.testing.assert_allclose(a.T_camera_grid, b.T_camera_grid, atol=1e-9)


def test_the_two_ways_from_camera_to_grid_agree() -> None:
    view = frame(0, [BOX], 1.0)
    volume = voxels(view)
    np.testing.assert_allclose(
        view.T_world_camera @ volume.T_camera_grid, volume.T_world_grid, atol=1e-12
    )


def wall(distance_m: float, n: int = 40) -> tuple[torch.Tensor, torch.Tensor]:
    K = torch.tensor([[30.0, 0, n / 2 - 0.5], [0, 30.0, n / 2 - 0.5], [0, 0, 1]])
    return torch.full((n, n), distance_m), K


def test_signed_distance_to_a_plane() -> None:
    depth, K = wall(2.0)
    z = torch.tensor([0.5, 1.9, 2.0, 2.05, 2.1, 4.0])
    points = torch.stack([0.1 * z, -0.2 * z, z], dim=-1)[None]
    tsdf, observed = projective_tsdf(points, depth[None], K[None], torch.eye(4)[None], 0.1)
    torch.testing.assert_close(tsdf[0], torch.tensor([1, 1, 0, -0.5, -1, -1.0]))
    assert observed.all()


def test_unknown_outside_the_view_behind_the_camera_and_where_nothing_was_measured() -> None:
    depth, K = wall(2.0)
    depth[20, 20] = 0
    center = torch.tensor([0.5 / 30, 0.5 / 30, 1.0])  # falls on the pixel (20, 20)
    points = torch.stack(
        [torch.tensor([5.0, 0, 2]), torch.tensor([0.0, 0, -2]), torch.zeros(3), center, 2 * center]
    )
    tsdf, observed = projective_tsdf(points[None], depth[None], K[None], torch.eye(4)[None], 0.1)
    assert not observed.any() and not tsdf.any()


def test_dense_grid_equals_single_points_and_frames_do_not_mix() -> None:
    volumes = [voxels(frame(0, [BOX])), voxels(frame(1, yaw=2.0))]
    shape = (16, 12, 10)
    axes = [torch.arange(n, dtype=torch.float32) * 0.2 for n in shape]
    points = torch.stack(torch.meshgrid(*axes, indexing="ij"), dim=-1).view(1, -1, 3)
    depth = torch.from_numpy(np.stack([v.depth_m for v in volumes]))
    K = torch.from_numpy(np.stack([v.K for v in volumes])).float()
    T = torch.from_numpy(np.stack([v.T_camera_grid for v in volumes])).float()
    both, seen = projective_tsdf(points.expand(2, -1, -1), depth, K, T, 0.15)
    assert 0 < seen.sum() < seen.numel()
    for i in range(2):
        tsdf, observed = dense_tsdf(depth[i], K[i], T[i], shape, 0.2, 0.15)
        assert torch.equal(tsdf.flatten(), both[i]) and torch.equal(observed.flatten(), seen[i])


def test_the_field_vanishes_on_the_surface_voxels() -> None:
    volume = voxels(frame(0, [BOX]))
    points = (volume.coords + volume.features[:, :3]) * volume.voxel_size_m
    tsdf, observed = projective_tsdf(
        torch.from_numpy(points).float()[None],
        torch.from_numpy(volume.depth_m)[None],
        torch.from_numpy(volume.K).float()[None],
        torch.from_numpy(volume.T_camera_grid).float()[None],
        0.15,
    )
    assert (observed & (tsdf.abs() < 0.3)).float().mean() > 0.9
