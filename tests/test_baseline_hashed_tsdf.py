"""The field of signed distances in blocks: against a dense one, and against known surfaces."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from baseline_scenes import REST, SMALL
from composenet.baselines.hashed_tsdf import MAX_WEIGHT, HashedTsdf
from composenet.baselines.tsdf_raycast import LIGHT, OWN, TSDF, WEIGHT
from composenet.baselines.voxel_blocks import (
    SIDE,
    allocate_along_rays,
    block_at,
    block_key,
    empty_table,
    fill_table,
)
from composenet.geometry.camera import back_project, pixel_rays
from composenet.geometry.transform import inverse_T, make_T, rotation_z

VOXEL_M, TRUNCATION_M = 0.02, 0.08
GREY = np.full((60, 80), 0.5, np.float32)
ALL = np.ones((60, 80), np.float32)
TURNED = make_T(rotation_z(0.4), (0.3, -0.2, 1.0))  # the body's axes: any


def plane_depth(normal: tuple[float, float, float], z: float) -> np.ndarray:
    """(60, 80) depth of a plane through (0, 0, z)."""
    n = np.array(normal)
    return (n[2] * z / (pixel_rays(SMALL) @ n)).astype(np.float32)


def sphere_depth(z: float, radius: float) -> np.ndarray:
    """(60, 80) depth of a sphere about (0, 0, z), 0 beside it."""
    rays = pixel_rays(SMALL)
    a, b = (rays * rays).sum(axis=-1), rays[..., 2] * z
    inside = b * b - a * (z * z - radius * radius)
    depth = np.where(inside > 0, (b - np.sqrt(np.maximum(inside, 0))) / a, 0)
    return np.asarray(depth, np.float32)


def field(depth: np.ndarray, own: np.ndarray = ALL, T: np.ndarray = REST) -> HashedTsdf:
    return HashedTsdf(VOXEL_M, TRUNCATION_M).integrate(depth, GREY, own, T, SMALL)


def test_a_plane_is_rendered_where_it_was_measured() -> None:
    normal = np.array([0.3, -0.2, -1.0])
    depth = plane_depth((0.3, -0.2, -1.0), 1.0)
    view = field(depth, T=TURNED).raycast(TURNED, SMALL)
    middle = np.s_[2:-2, 2:-2]
    assert view.valid[middle].all()
    off = (view.points - np.array([0, 0, 1.0])) @ normal / np.linalg.norm(normal)
    assert np.abs(off[middle]).max() < 0.2 * VOXEL_M
    cosines = view.normals[middle] @ (normal / np.linalg.norm(normal))
    assert cosines.min() > 0.98 and np.percentile(cosines, 5) > 0.998  # 11 and 3.6 degrees
    np.testing.assert_allclose(view.intensity[middle], 0.5, atol=1e-5)
    rays = pixel_rays(SMALL)[view.valid]
    points = view.points[view.valid]
    np.testing.assert_allclose(points / points[:, 2:], rays, atol=1e-5)


def test_a_sphere_seen_from_two_sides_is_rendered_round() -> None:
    """From the side, where no camera was: half of what is seen comes from each."""
    depth, aside = sphere_depth(1.2, 0.3), []
    body = HashedTsdf(VOXEL_M, TRUNCATION_M)
    for angle in (-0.5, 0.5, 0.0):
        c, s = np.cos(angle), np.sin(angle)
        T = make_T([[c, 0, s], [0, 1, 0], [-s, 0, c]], (0, 0, 1.2))  # camera from body: about y
        if angle:
            body.integrate(depth, GREY, ALL, T, SMALL)
        else:
            aside.append(body.raycast(T, SMALL))
    view = aside[0]
    points = view.points[view.valid] - np.array([0, 0, 1.2])
    radius = np.linalg.norm(points, axis=1)
    assert view.valid.sum() > 0.9 * (depth > 0).sum()
    assert np.abs(radius - 0.3).mean() < 0.15 * VOXEL_M
    assert np.percentile(np.abs(radius - 0.3), 95) < 0.5 * VOXEL_M
    cosines = (view.normals[view.valid] * points).sum(axis=1) / radius
    assert np.percentile(cosines, 5) > 0.97


def test_the_back_of_a_surface_is_not_seen() -> None:
    body = field(plane_depth((0, 0, -1), 1.0))
    behind = make_T(np.diag([-1.0, 1, -1]), (0, 0, 2.0))
    assert not body.raycast(behind, SMALL).valid.any()
    assert not HashedTsdf(VOXEL_M, TRUNCATION_M).raycast(REST, SMALL).valid.any()


def test_voxels_are_those_of_a_dense_field() -> None:
    """Every voxel against the definition, frame by frame."""
    body = HashedTsdf(VOXEL_M, TRUNCATION_M)
    depths = [plane_depth((0.1, 0.2, -1.0), 0.9), plane_depth((0.1, 0.2, -1.0), 0.93)]
    own = np.where(np.arange(80) < 40, 1, 0) * ALL
    own[:, 70:] = -1
    for depth in depths:
        body.integrate(depth, depth / 2, own, TURNED, SMALL)
    grid = np.stack(np.unravel_index(np.arange(SIDE**3), (SIDE,) * 3), axis=-1)
    centres = (body.coords[:, None] * SIDE + grid + 0.5) * VOXEL_M
    points = centres @ TURNED[:3, :3].T + TURNED[:3, 3]
    u = np.floor(80 * points[..., 0] / points[..., 2] + 40.0).astype(int)
    v = np.floor(80 * points[..., 1] / points[..., 2] + 30.0).astype(int)
    inside = (u >= 0) & (u < 80) & (v >= 0) & (v < 60) & (points[..., 2] > 0.1)
    u, v = np.where(inside, u, 0), np.where(inside, v, 0)
    length = np.linalg.norm(points / points[..., 2:], axis=-1)
    total, weight, light, share = (np.zeros(u.shape) for _ in range(4))
    for depth in depths:
        distance = (depth[v, u] - points[..., 2]) * length
        fused = inside & (own[v, u] >= 0) & (distance > -TRUNCATION_M)
        total += np.where(fused, np.minimum(distance / TRUNCATION_M, 1), 0)
        light += np.where(fused, depth[v, u] / 2, 0)
        share += np.where(fused, own[v, u], 0)
        weight += fused
    voxels, seen = body.voxels, weight > 0
    np.testing.assert_array_equal(voxels[..., WEIGHT], weight)
    for channel, expected in ((TSDF, total), (LIGHT, light), (OWN, share)):
        np.testing.assert_allclose(
            voxels[seen][:, channel], expected[seen] / weight[seen], atol=1e-4
        )


def test_blocks_are_those_that_the_rays_pass_near_the_surface() -> None:
    depth = plane_depth((0.3, -0.2, -1.0), 1.0)
    depth[:, :10] = 0
    body = field(depth, T=TURNED)
    T = inverse_T(TURNED)
    points = back_project(depth, SMALL)[depth > 0].astype(np.float64)
    length = np.linalg.norm(points, axis=1, keepdims=True)
    expected = set()
    for s in np.linspace(-TRUNCATION_M, TRUNCATION_M, 9):
        places = (points * (1 + s / length)) @ T[:3, :3].T + T[:3, 3]
        expected |= set(map(tuple, np.floor(places / (SIDE * VOXEL_M)).astype(int).tolist()))
    found = list(map(tuple, body.coords.tolist()))
    assert len(found) == len(set(found)) and len(found) > 100
    # A sample on the wall of two blocks may fall to either.
    assert len(set(found) ^ expected) <= 2


def test_what_lies_beside_the_mask_is_in_the_field_but_not_shown() -> None:
    depth = plane_depth((0, 0, -1), 1.0)
    mask = np.zeros((60, 80), bool)
    mask[20:40, 20:50] = True
    body = field(depth, np.where(mask, 1, 0))
    shown = body.raycast(REST, SMALL).valid
    assert (shown == mask).mean() > 0.96 and shown[22:38, 22:48].all()
    surface = body.surface()
    assert np.abs(surface[:, 2] - 1).max() < VOXEL_M
    assert surface[:, 0].min() > -0.27 and surface[:, 0].max() < 0.15  # columns 20 to 49
    for _ in range(2):  # told twice that it is not its own: a third is no more than half
        body.integrate(depth, GREY, np.zeros((60, 80)), REST, SMALL)
    assert not body.raycast(REST, SMALL).valid.any() and len(body.surface()) == 0


def test_free_space_clears_what_stood_there() -> None:
    body = field(plane_depth((0, 0, -1), 1.0))
    for _ in range(2):
        body.integrate(plane_depth((0, 0, -1), 1.5), GREY, ALL, REST, SMALL)
    view = body.raycast(REST, SMALL)
    middle = view.points[10:50, 10:70, 2]
    assert np.abs(middle - 1.5).max() < 0.2 * VOXEL_M


def test_the_past_weighs_at_most_so_much() -> None:
    body = HashedTsdf(0.1, 0.2)
    for _ in range(int(MAX_WEIGHT) + 5):
        body.integrate(plane_depth((0, 0, -1), 1.0), GREY, ALL, REST, SMALL)
    assert body.voxels[..., WEIGHT].max() == MAX_WEIGHT


def test_frames_without_colour_have_no_brightness() -> None:
    body = HashedTsdf(VOXEL_M, TRUNCATION_M)
    body.integrate(plane_depth((0, 0, -1), 1.0), np.full((60, 80), np.nan), ALL, REST, SMALL)
    view = body.raycast(REST, SMALL)
    assert view.valid[5:-5, 5:-5].all() and np.isnan(view.intensity).all()


places = st.tuples(*[st.integers(-(2**20), 2**20 - 1)] * 3)


@settings(max_examples=50)
@given(st.lists(places, min_size=1, max_size=60, unique=True), places)
def test_the_table_finds_what_was_entered(entered: list[tuple[int, int, int]], other) -> None:
    keys, slots = empty_table(128)
    fill_table(keys, slots, np.array(entered, np.int32))
    assert len({block_key(*place) for place in entered}) == len(entered)
    assert [block_at(keys, slots, *place) for place in entered] == list(range(len(entered)))
    if other not in entered:
        assert block_at(keys, slots, *other) == -1


def test_a_full_table_says_so() -> None:
    keys, slots = empty_table(1024)
    coords = np.zeros((5, 3), np.int32)
    points = back_project(plane_depth((0, 0, -1), 1.0), SMALL)
    count, done = allocate_along_rays(keys, slots, coords, 0, points, REST, VOXEL_M, TRUNCATION_M)
    assert count == 5 and not done
    assert len(field(plane_depth((0, 0, -1), 3.0))) > 256  # it grew
