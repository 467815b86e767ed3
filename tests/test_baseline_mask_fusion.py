"""MaskFusion: its parts against laws and finite differences, the whole on known motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import correlate1d

from baseline_scenes import (
    CABINET,
    CHAIR,
    REST,
    SMALL,
    Seen,
    cabinet,
    camera_pose,
    look,
    motion_errors,
    pillar,
    screen,
    without_ids,
)
from composenet.baselines import frame_maps
from composenet.baselines.anonymous_masks import AnonymousMasks
from composenet.baselines.frame_maps import Maps, measured_maps, normals_of, pyramid, smoothed
from composenet.baselines.geometric_segmentation import masks_of_pieces, overlap_counts, pieces
from composenet.baselines.mask_fusion import END_AFTER_FRAMES, MIN_NEW_PIXELS, MaskFusion
from composenet.baselines.photometric_icp import (
    LEVELS,
    MIN_PAIRS,
    align,
    geometric_row,
    increment,
    turned,
)
from composenet.baselines.records import Cameras
from composenet.baselines.run import shown_poses
from composenet.baselines.surfels import UNSTABLE_FRAMES, SurfelMap
from composenet.baselines.true_masks import TrueMasks
from composenet.geometry.box import OrientedBox
from composenet.geometry.camera import back_project, pixel_rays
from composenet.geometry.photometric import photometric_row
from composenet.geometry.transform import angle_between_deg, apply_T, inverse_T, make_T, rotation_z
from composenet.records import TrackedObject, TrackState
from composenet.sequences import open_sequence

NO_ONE = np.ones((60, 80), np.float32)  # no pixel is another body's


def plane(
    normal: tuple[float, float, float] = (0.3, -0.2, -1.0), z: float = 2.0, T: np.ndarray = REST
) -> Maps:
    """A textured plane through (0, 0, z), as SMALL sees it after the motion T."""
    n = T[:3, :3] @ np.array(normal) / np.linalg.norm(normal)
    depth = n @ apply_T(T, np.array([0, 0, z])) / (pixel_rays(SMALL) @ n)
    points = back_project(depth.astype(np.float32), SMALL)
    light = texture(apply_T(inverse_T(T), points))
    return Maps(points, np.full(points.shape, n, np.float32), light, SMALL)


def texture(points: np.ndarray) -> np.ndarray:
    x, y = points[..., 0], points[..., 1]
    return (0.5 + 0.2 * np.sin(9 * x + 2 * y) + 0.2 * np.cos(7 * y - 3 * x)).astype(np.float32)


def grey(maps: Maps) -> np.ndarray:
    return np.repeat(maps.intensity[..., None], 3, axis=-1)


def fused(maps: Maps, times: int = 1) -> SurfelMap:
    surfels = SurfelMap()
    for time in range(times):
        surfels.fuse(maps, grey(maps), np.ones((60, 80), bool), REST, time)
    return surfels


# What a camera sees


def test_depth_is_smoothed_within_a_surface_and_not_across_a_step() -> None:
    depth = np.full((40, 60), 1.5, np.float32)
    depth[:, 30:] = 2.5
    noisy = depth + np.random.default_rng(0).normal(0, 0.004, depth.shape).astype(np.float32)
    noisy[5, 5] = 0
    smooth = smoothed(noisy)
    assert smooth[5, 5] == 0  # unknown stays unknown
    kept = np.ones(depth.shape, bool)
    kept[5, 5] = False
    assert np.abs(smooth - depth)[kept].std() < 0.5 * 0.004
    assert np.abs(smooth - depth)[kept].max() < 0.01


def test_smoothing_is_a_bilateral_filter() -> None:
    """Against the sums as they are written in a book, holes and borders included."""
    draw = np.random.default_rng(3)
    depth = draw.uniform(1.5, 1.6, (17, 23)).astype(np.float32)
    depth[:, 12:] += 0.3
    depth[draw.random(depth.shape) < 0.2] = 0
    reach = frame_maps._RADIUS_PX
    expected = np.zeros_like(depth)
    for v, u in np.argwhere(depth > 0):
        z = depth[v, u]
        sigma = frame_maps._SIGMA_M + frame_maps._SIGMA_PER_M2 * z**2
        rows, columns = np.mgrid[v - reach : v + reach + 1, u - reach : u + reach + 1]
        seen = (rows >= 0) & (rows < 17) & (columns >= 0) & (columns < 23)
        rows, columns = rows[seen], columns[seen]
        others = depth[rows, columns]
        used = (others > 0) & (abs(others - z) <= 3 * sigma)
        far = ((rows - v) ** 2 + (columns - u) ** 2) / (2 * frame_maps._SIGMA_PX**2)
        weights = used * np.exp(-far - (others - z) ** 2 / (2 * sigma**2))
        expected[v, u] = (weights * others).sum() / weights.sum()
    np.testing.assert_allclose(smoothed(depth), expected, atol=2e-6)


def test_normals_are_those_of_the_plane_and_look_at_the_camera() -> None:
    maps = plane()
    found = normals_of(maps.points)
    assert (found * maps.normals).sum(axis=-1).min() > 0.9999
    assert ((found * maps.points).sum(axis=-1) < 0).all()
    points = maps.points.copy()
    points[20, 20] = 0
    assert not normals_of(points)[20, 20].any() and normals_of(points)[20, 21].any()


def test_coarse_maps_keep_the_rays_of_their_pixels() -> None:
    for level in pyramid(plane(), 3):
        rays = pixel_rays(level.camera)
        np.testing.assert_allclose(level.points / level.points[..., 2:], rays, atol=1e-5)


@pytest.mark.parametrize("shape", [(40, 60), (33, 47)])
def test_coarse_brightness_is_smoothed_before_it_is_halved(shape: tuple[int, int]) -> None:
    light = np.random.default_rng(4).random(shape).astype(np.float32)
    kernel = np.array([1, 2, 1]) / 4
    smooth = correlate1d(correlate1d(light, kernel, 0, mode="nearest"), kernel, 1, mode="nearest")
    maps = replace(plane(), intensity=light)
    np.testing.assert_allclose(pyramid(maps, 2)[1].intensity, smooth[::2, ::2], atol=1e-6)


# Surfels


def test_a_fused_plane_is_rendered_where_it_was_seen() -> None:
    maps = plane()
    T = make_T(rotation_z(0.4), (0.3, -0.2, 1.0))  # the body's axes: any
    surfels = SurfelMap().fuse(maps, grey(maps), maps.valid, T, 0)
    view = surfels.render(T, SMALL)
    assert view.valid.all()
    np.testing.assert_allclose(view.points[..., 2], maps.points[..., 2], atol=2e-3)
    np.testing.assert_allclose(view.normals, maps.normals, atol=1e-5)
    np.testing.assert_allclose(view.intensity, maps.intensity, atol=0.03)
    behind = surfels.render(make_T(np.diag([-1.0, 1, -1]), (0, 0, 4)) @ T, SMALL)
    assert not behind.valid.any()  # its back is not seen


def test_the_nearer_surface_is_rendered() -> None:
    near, far = plane((0, 0, -1), 1.0), plane((0, 0, -1), 2.0)
    half = np.zeros((60, 80), bool)
    half[:, :40] = True
    surfels = fused(far).fuse(near, grey(near), half, REST, 1)
    depth = surfels.render(REST, SMALL).points[..., 2]
    np.testing.assert_allclose(depth[:, :38], 1, atol=1e-5)
    np.testing.assert_allclose(depth[:, 42:], 2, atol=1e-5)


def test_fusing_a_frame_again_raises_confidence_and_moves_nothing() -> None:
    once, twice = fused(plane()), fused(plane(), 2)
    assert len(once) == len(twice) == 60 * 80
    np.testing.assert_allclose(twice.positions, once.positions, atol=1e-6)
    np.testing.assert_allclose(twice.normals, once.normals, atol=1e-6)
    np.testing.assert_allclose(twice.radii, once.radii, rtol=1e-5)
    np.testing.assert_allclose(twice.confidences, 2 * once.confidences, rtol=1e-6)
    assert (twice.seen == 1).all() and (twice.born == 0).all()


def test_fusion_averages_by_confidence_and_keeps_surfaces_apart() -> None:
    near, far = plane((0, 0, -1), 2.0), plane((0, 0, -1), 2.02)
    everywhere = np.ones((60, 80), bool)
    surfels = fused(near)
    surfels.fuse(far, grey(far), everywhere, REST, 1, weight=3.0)
    middle = np.linalg.norm(surfels.positions[:, :2], axis=1) < 0.3
    np.testing.assert_allclose(surfels.positions[middle, 2], 2.015, atol=1e-4)
    other = plane((0, 0, -1), 2.2)
    surfels.fuse(other, grey(other), everywhere, REST, 2)
    assert len(surfels) == 2 * 60 * 80
    steep = plane((0.9, 0, -1), 2.0)  # 42 degrees: no surface seen before
    count = len(fused(near).fuse(steep, grey(steep), everywhere, REST, 1))
    assert count == 2 * 60 * 80


def test_what_stays_unstable_or_stands_before_a_seen_surface_is_removed() -> None:
    near, far = plane((0, 0, -1), 1.9), plane((0, 0, -1), 2.0)
    patch = np.zeros((60, 80), bool)
    patch[25:35, 35:45] = True
    surfels = SurfelMap().fuse(near, grey(near), patch, REST, 0)
    depth = far.points[..., 2]
    surfels.clean(depth, NO_ONE, REST, SMALL, UNSTABLE_FRAMES, min_confidence=2.0)
    assert len(surfels) == 100
    late = SurfelMap().fuse(near, grey(near), patch, REST, 0)
    late.clean(depth, NO_ONE, REST, SMALL, UNSTABLE_FRAMES + 1, min_confidence=2.0)
    assert len(late) == 0
    # A ghost 10 cm before a wall, at the places of its own pixels but two: the wall is seen there.
    wall = fused(far, 3)
    wall.positions[patch.ravel().nonzero()[0][::2]] *= 0.95
    wall.seen[:] = 3
    wall.seen[wall.positions[:, 2] < 1.95] = 2
    wall.clean(depth, NO_ONE, REST, SMALL, 3, min_confidence=0.5)
    assert len(wall) == 60 * 80 - 50 and wall.positions[:, 2].min() > 1.99


def test_surfels_in_anothers_pixels_are_doubted() -> None:
    maps = plane((0, 0, -1), 2.0)
    surfels = fused(maps)
    before = surfels.confidences.copy()
    others = NO_ONE.copy()
    others[:, :40] = 0.5
    surfels.clean(maps.points[..., 2], others, REST, SMALL, 0, 0.0)
    left = surfels.positions[:, 0] < 0
    np.testing.assert_allclose(surfels.confidences[left], before[left] / 2)
    np.testing.assert_allclose(surfels.confidences[~left], before[~left])
    surfels.clean(maps.points[..., 2] + 0.2, others, REST, SMALL, 0, 0.0)
    np.testing.assert_allclose(surfels.confidences[left], before[left] / 2)  # not the same surface


# ICP


def differences(residual, size: float = 1e-6) -> np.ndarray:
    """(6,) central differences of a residual by the steps of `increment`."""
    steps = np.eye(6) * size
    return np.array(
        [(residual(increment(s)) - residual(increment(-s))) / (2 * size) for s in steps]
    )


def test_the_geometric_term_has_the_derivative_of_finite_differences() -> None:
    rng = np.random.default_rng(1)
    point, measured = rng.normal(size=(2, 3)) + np.array([0, 0, 3])
    normal = rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    row, unused = np.empty(6), np.empty(6)

    def residual(T: np.ndarray) -> float:
        return geometric_row(apply_T(T, point), T[:3, :3] @ normal, measured, unused)

    assert geometric_row(point, normal, measured, row) == pytest.approx(normal @ (point - measured))
    np.testing.assert_allclose(row, differences(residual), atol=1e-7)


def test_the_photometric_term_has_the_derivative_of_finite_differences() -> None:
    image = np.random.default_rng(2).random((60, 80)).astype(np.float64)
    K = (80.0, 82.0, 39.5, 29.5)
    point, row, unused = np.array([0.2, -0.15, 1.7]), np.empty(6), np.empty(6)

    def residual(T: np.ndarray) -> float:
        return photometric_row(apply_T(T, point), 0.4, image, *K, unused)

    u, v = 80 * 0.2 / 1.7 + 39.5, 82 * -0.15 / 1.7 + 29.5
    a, b = u - int(u), v - int(v)
    corners = image[int(v) : int(v) + 2, int(u) : int(u) + 2]
    seen = np.array([1 - b, b]) @ corners @ np.array([1 - a, a])
    assert photometric_row(point, 0.4, image, *K, row) == pytest.approx(seen - 0.4)
    np.testing.assert_allclose(row, differences(residual), atol=1e-6)
    assert np.isnan(photometric_row(np.array([9.0, 0, 1.7]), 0.4, image, *K, row))


def test_icp_needs_brightness_to_see_a_plane_slide() -> None:
    """Geometry fixes three of six motions of a plane; its texture the others."""
    maps = view = plane((0.1, 0.0, -1.0))
    T = make_T(rotation_z(0.02), (0.02, 0.015, 0.01))
    now = plane((0.1, 0.0, -1.0), T=T)
    found, pairs = align(view, pyramid(now, LEVELS))
    assert pairs > 3000
    np.testing.assert_allclose(found[:3, 3], T[:3, 3], atol=2e-3)
    assert angle_between_deg(found[:3, :3], T[:3, :3]) < 0.2
    blind = replace(now, intensity=np.full_like(now.intensity, np.nan))
    slid, _ = align(view, pyramid(blind, LEVELS))
    off = apply_T(slid, maps.points[30, 40]) - apply_T(T, maps.points[30, 40])
    assert abs(off @ now.normals[30, 40]) < 1e-3 and np.linalg.norm(off) > 0.01


def test_icp_does_nothing_where_nothing_agrees() -> None:
    near, far = plane(z=1.5), plane(z=2.0)
    T, pairs = align(near, pyramid(far, LEVELS))
    assert pairs < MIN_PAIRS and (T == REST).all()
    empty = SurfelMap().render(REST, SMALL)
    T, pairs = align(empty, pyramid(far, LEVELS))
    assert pairs == 0 and (T == REST).all()


@pytest.mark.parametrize("turn_deg", [1, 3, 6])
def test_a_turn_of_the_camera_is_seen_by_brightness_alone(turn_deg: float) -> None:
    axis = np.array([0.3, 1.0, 0.1]) / np.linalg.norm([0.3, 1.0, 0.1])
    T = increment(np.concatenate([np.zeros(3), np.radians(turn_deg) * axis]))
    before, now = plane((0, 0, -1)), plane((0, 0, -1), T=T)
    found = turned(before, now)
    assert angle_between_deg(found[:3, :3], T[:3, :3]) < 0.5 and (found[:3, 3] == 0).all()
    dark = replace(now, intensity=np.full_like(now.intensity, np.nan))
    assert (turned(before, dark) == REST).all()


def test_fine_patterns_do_not_hide_a_larger_turn() -> None:
    """They repeat within the turn; what is coarse does not."""

    def seen(T_now_before: np.ndarray) -> Maps:
        maps = plane((0, 0, -1))
        rays = pixel_rays(maps.camera) @ T_now_before[:3, :3]  # in the first camera's axes
        x, y = rays[..., 0] / rays[..., 2], rays[..., 1] / rays[..., 2]
        coarse, fine = np.sin(4 * x + 1) + np.sin(5 * y), np.sin(100 * x) + np.sin(90 * y)
        return replace(maps, intensity=(0.5 + 0.12 * coarse + 0.12 * fine).astype(np.float32))

    T = increment(np.array([0, 0, 0, 0.01, np.radians(6), 0]))
    found = turned(seen(np.eye(4)), seen(T))
    assert angle_between_deg(found[:3, :3], T[:3, :3]) < 1


# Segmentation


def test_two_boxes_that_touch_are_split_at_the_concave_edge() -> None:
    """A tall box beside a low deep one: the faces meet in a fold, with no step in depth."""
    tall = OrientedBox(np.array([2.6, 0.35, 0.6]), np.eye(3), np.array([0.6, 0.7, 1.2]))
    deep = OrientedBox(np.array([2.2, -0.35, 0.6]), np.eye(3), np.array([1.4, 0.7, 1.2]))
    seen = look(0, [tall, deep])
    numbers = pieces(measured_maps(seen.frame))
    refined, owned = masks_of_pieces(numbers, seen.masks.masks)
    for number, mask in enumerate(seen.masks.masks, start=1):
        found = refined == number
        assert (found & mask).sum() / (found | mask).sum() > 0.8
    assert not owned[0]
    shared = np.intersect1d(numbers[seen.masks.masks[0]], numbers[seen.masks.masks[1]])
    sizes = [min((numbers[m] == n).sum() for m in seen.masks.masks) for n in shared if n]
    assert max(sizes, default=0) < 100  # no piece lies on both


def test_masks_are_mended_by_pieces_and_pieces_need_most_of_a_mask() -> None:
    numbers = np.zeros((30, 40), np.int32)
    numbers[2:20, 2:20], numbers[2:20, 20:38], numbers[22:26, 2:6] = 1, 2, 3
    masks = np.zeros((2, 30, 40), bool)
    masks[0, 2:20, 2:16] = True  # 14 of 18 columns of the first piece
    masks[1, 2:20, 20:30] = True  # 10 of 18 of the second: too few
    masks[1, 22:26, 2:6] = True  # all of the third, which is tiny
    refined, owned = masks_of_pieces(numbers, masks)
    np.testing.assert_array_equal(refined == 1, numbers == 1)
    assert not (refined == 2).any() and owned.tolist() == [False, True, False, False]
    both = np.stack([numbers == 1, numbers == 1])
    assert (masks_of_pieces(numbers, both)[0][numbers == 1] == 2).all()  # the surest comes last
    none, owned = masks_of_pieces(numbers, masks[:0])
    assert not none.any() and not owned.any()
    np.testing.assert_array_equal(overlap_counts(numbers, numbers, 4), np.diag([536, 324, 324, 16]))


# The whole


def follow(scenes: list[Seen], cameras: Cameras = Cameras.GIVEN) -> list[tuple[TrackedObject, ...]]:
    system = MaskFusion(cameras)
    frames = shown_poses([seen.frame for seen in scenes], cameras)
    return [system(f, without_ids(s).masks) for f, s in zip(frames, scenes, strict=True)]


def test_a_box_slides_at_known_speed() -> None:
    truth = [cabinet(2.5 + 0.025 * i, -0.4 + 0.05 * i, yaw=0.5) for i in range(8)]
    tracked = follow([look(i, [box]) for i, box in enumerate(truth)])
    assert {entry.track_id for frame in tracked for entry in frame} == {0}
    entries = [frame[0] for frame in tracked]
    metres, degrees = motion_errors(entries, truth)
    assert metres.max() < 0.01 and degrees.max() < 0.5
    assert all(e.class_id == CABINET and e.state is TrackState.TRACKED for e in entries)
    assert all((e.box.center == e.S_world_canonical.t).all() for e in entries)


def test_a_box_turns_about_itself() -> None:
    truth = [cabinet(2.5, 0.1, yaw=0.3 + np.radians(5) * i) for i in range(8)]
    tracked = follow([look(i, [box]) for i, box in enumerate(truth)])
    metres, degrees = motion_errors([frame[0] for frame in tracked], truth)
    assert metres.max() < 0.01 and degrees.max() < 0.5


def test_a_box_waits_behind_an_occluder_and_is_found_again() -> None:
    """The camera steps behind a screen and back; a model out of view rests in the world."""
    poses = [camera_pose(y=y) for y in (-0.7, -0.5, -0.3, -0.1, -0.1, -0.3, -0.5)]
    box = cabinet(3.0, 0.0, yaw=0.5)
    scenes = [look(i, [box], [screen(1.6, 0.0)], T) for i, T in enumerate(poses)]
    assert [len(s.masks.masks) for s in scenes] == [1, 1, 1, 0, 0, 1, 1]
    entries = [frame[0] for frame in follow(scenes)]
    tracked, occluded = TrackState.TRACKED, TrackState.OCCLUDED
    states = [tracked] * 3 + [occluded] * 2 + [TrackState.RE_FOUND, tracked]
    assert [e.state for e in entries] == states and {e.track_id for e in entries} == {0}
    assert motion_errors(entries, [box] * 7)[0].max() < 0.03


def test_a_box_that_jumps_farther_than_pairs_may_be_apart_is_lost() -> None:
    """The original's weakness: correspondences beyond 10 cm are dropped."""
    truth = [cabinet(2.5, 0.0), cabinet(2.5, 0.9), cabinet(2.5, 0.9)]
    tracked = follow([look(i, [box]) for i, box in enumerate(truth)])
    assert tracked[1][0].state is TrackState.OCCLUDED
    metres, _ = motion_errors([frame[0] for frame in tracked], truth)
    assert metres[1] > 0.8
    assert [e.track_id for e in tracked[2] if e.observed] == [1]


def test_a_model_takes_no_mask_of_another_class() -> None:
    box = cabinet(2.5, 0.0)
    scenes = [look(0, [box]), look(1, [box], class_id=CHAIR), look(2, [box])]
    tracked = follow(scenes)
    assert [[e.observed for e in frame] for frame in tracked] == [[True], [False], [True]]
    assert tracked[2][0].state is TrackState.RE_FOUND and tracked[2][0].class_id == CABINET


def test_small_and_weak_masks_start_nothing() -> None:
    seen = without_ids(look(0, [cabinet(2.5, 0.0)]))
    weak = replace(seen.masks, scores=np.array([0.4], np.float32))
    assert MaskFusion()(seen.frame, weak) == ()
    few = np.zeros_like(seen.masks.masks)
    rows, columns = np.nonzero(seen.masks.masks[0])
    few[0, rows[:MIN_NEW_PIXELS], columns[:MIN_NEW_PIXELS]] = True
    assert MaskFusion()(seen.frame, replace(seen.masks, masks=few)) == ()
    blank = replace(seen.frame, depth_m=np.zeros_like(seen.frame.depth_m))
    assert MaskFusion()(blank, seen.masks) == ()


def test_an_estimated_camera_follows_the_background() -> None:
    """Only the first pose is told."""
    poses = [camera_pose(yaw, x=0.04 * i) for i, yaw in enumerate([0.0, 0.04, 0.1, 0.14])]
    box, things = cabinet(2.6, 0.7, 0.7), [pillar(3.2, -0.2), pillar(2.4, 1.6), pillar(2.2, -0.8)]
    scenes = [look(i, [box], things, T) for i, T in enumerate(poses)]
    tracked = follow(scenes, Cameras.ESTIMATED)
    metres, degrees = motion_errors([frame[0] for frame in tracked], [box] * len(poses))
    assert metres.max() < 0.03 and degrees.max() < 1


def test_only_small_models_end_when_long_unseen() -> None:
    small = OrientedBox(np.array([3.6, -0.6, 0.25]), np.eye(3), np.array([0.25, 0.25, 0.5]))
    scenes = [look(0, [cabinet(2.5, 0.7), small])]
    scenes += [look(i, []) for i in range(1, END_AFTER_FRAMES + 2)]
    tracked = follow(scenes)
    assert [len(frame) for frame in tracked] == [2] * (END_AFTER_FRAMES + 1) + [1]
    assert tracked[-1][0].track_id == 0 and tracked[-1][0].state is TrackState.OCCLUDED


def test_anonymous_masks_tell_no_identity(recordings) -> None:
    folder = recordings / "val_00000"
    frame = next(iter(open_sequence(folder)))
    told, shown = TrueMasks(folder)(frame), AnonymousMasks(folder)(frame)
    assert told.gt_ids is not None and shown.gt_ids is None
    np.testing.assert_array_equal(shown.masks, told.masks)
    np.testing.assert_array_equal(shown.class_ids, told.class_ids)
