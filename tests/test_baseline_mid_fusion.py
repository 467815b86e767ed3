"""MID-Fusion: its parts against laws, the whole on known motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

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
from composenet.baselines.frame_maps import Maps, pyramid
from composenet.baselines.mid_fusion import AT_REST, MidFusion, grown_masks, shared_of_smaller
from composenet.baselines.mid_fusion_body import FINEST_SIDE_M, own_pixels, voxel_size
from composenet.baselines.photometric_icp import LEVELS
from composenet.baselines.records import Cameras
from composenet.baselines.run import shown_poses
from composenet.baselines.weighted_icp import align_weighted, share_at_rest
from composenet.geometry.box import OrientedBox
from composenet.geometry.camera import back_project, pixel_rays
from composenet.geometry.transform import angle_between_deg, apply_T, inverse_T, make_T, rotation_z
from composenet.records import TrackedObject, TrackState

EVERYWHERE = np.ones((60, 80), bool)


def folded(T: np.ndarray = REST) -> Maps:
    """Three textured planes that meet in a corner, as SMALL sees them after the motion T."""
    rays = pixel_rays(SMALL)
    depth, normals = np.full((60, 80), np.inf), np.zeros((60, 80, 3))
    for normal in ((1.0, 0.2, -1.0), (-1.0, 0.3, -1.0), (0.0, -1.0, -0.8)):
        n = T[:3, :3] @ np.array(normal) / np.linalg.norm(normal)
        z = n @ apply_T(T, np.array([0, 0, 2.0])) / (rays @ n)
        nearer = (z > 0) & (z < depth)
        depth[nearer], normals[nearer] = z[nearer], n
    points = back_project(depth.astype(np.float32), SMALL)
    x, y, z = np.moveaxis(apply_T(inverse_T(T), points), -1, 0)
    light = 0.5 + 0.2 * np.sin(9 * x + 2 * y) + 0.2 * np.cos(7 * z - 3 * x)
    return Maps(points, normals.astype(np.float32), light.astype(np.float32), SMALL)


# Alignment


def test_a_corner_is_aligned_by_shape_alone_and_with_brightness() -> None:
    T = make_T(rotation_z(0.02), (0.02, 0.015, 0.01))
    before, now = folded(), folded(T)
    found, pairs = align_weighted(pyramid(before, LEVELS), EVERYWHERE, pyramid(now, LEVELS), REST)
    assert pairs > 3000
    np.testing.assert_allclose(found[:3, 3], T[:3, 3], atol=3e-3)
    assert angle_between_deg(found[:3, :3], T[:3, :3]) < 0.3
    blind = replace(now, intensity=np.full_like(now.intensity, np.nan))
    found, _ = align_weighted(pyramid(before, LEVELS), EVERYWHERE, pyramid(blind, LEVELS), REST)
    off = apply_T(found, before.points) - apply_T(T, before.points)
    assert np.linalg.norm(off, axis=-1).mean() < 5e-3


def test_only_the_kept_pixels_are_aligned() -> None:
    """One half of the image moves, the other rests."""
    T = make_T(np.eye(3), (0.0, 0.0, 0.05))
    before, moved = folded(), folded(T)
    left = np.arange(80)[None] < 36
    now = replace(
        before,
        points=np.where(left[..., None], moved.points, before.points),
        normals=np.where(left[..., None], moved.normals, before.normals),
        intensity=np.where(left, moved.intensity, before.intensity),
    )
    levels, views = pyramid(now, LEVELS), pyramid(before, LEVELS)
    right, _ = align_weighted(views, EVERYWHERE & ~left, levels, REST)
    assert np.abs(right - REST).max() < 5e-3
    assert share_at_rest(before, EVERYWHERE & ~left, now, REST) > 0.97


def test_nothing_to_align_leaves_the_guess() -> None:
    guess = make_T(np.eye(3), (0, 0, 1.0))
    levels = pyramid(folded(), LEVELS)
    found, pairs = align_weighted(levels, ~EVERYWHERE, levels, guess)
    assert pairs == 0 and (found == guess).all()


def test_what_moved_speaks_against_rest_and_what_is_unseen_does_not() -> None:
    before = folded()
    assert share_at_rest(before, EVERYWHERE, before, REST) == 1
    far = folded(make_T(np.eye(3), (0, 0, 0.3)))
    assert share_at_rest(before, EVERYWHERE, far, REST) < 0.2
    slid = replace(before, intensity=np.roll(before.intensity, 12, axis=1))
    assert share_at_rest(before, EVERYWHERE, slid, REST) < AT_REST  # brightness alone
    hole = replace(before, points=np.zeros_like(before.points))
    assert share_at_rest(before, EVERYWHERE, hole, REST) > 0.9
    assert share_at_rest(before, EVERYWHERE, before, make_T(np.eye(3), (9, 0, 0))) == 1


# Masks


def test_masks_take_the_rest_of_pieces_that_they_nearly_cover() -> None:
    numbers = np.zeros((20, 40), np.int32)
    numbers[2:18, 2:12], numbers[2:18, 12:38] = 1, 2
    mask = np.zeros((1, 20, 40), bool)
    mask[0, 2:18, 3:14] = True  # nine tenths of the first piece, a little of the second
    grown = grown_masks(mask, numbers)
    np.testing.assert_array_equal(grown[0], (numbers == 1) | mask[0])
    assert grown_masks(mask[:0], numbers).shape == (0, 20, 40)


def test_overlap_is_of_the_smaller() -> None:
    a = np.zeros((2, 4, 10), bool)
    a[0, :, :4] = True
    a[1, 0, 0] = True
    b = np.zeros((1, 4, 10), bool)
    b[0, :, 2:10] = True
    np.testing.assert_allclose(shared_of_smaller(a, b), [[0.5], [0]])
    np.testing.assert_allclose(shared_of_smaller(a, a), [[1, 1], [1, 1]])
    assert shared_of_smaller(a, b[:0]).shape == (2, 0)


def test_a_field_is_told_of_the_mask_and_of_what_lies_around_it() -> None:
    mask, shown = np.zeros((2, 12, 12), bool)
    mask[5:7, 5:7], shown[6:10, 6] = True, True
    own = own_pixels(mask, shown, 0.5)
    assert (own[mask] == 0.5).all() and own[5, 3] == own[9, 6] == 0
    assert own[5, 2] == own[0, 0] == -1


def test_voxels_grow_with_the_object() -> None:
    sizes = np.array([0.1, 0.3, 0.5, 0.6, 1.0, 1.5, 3.0])
    voxels = np.array([voxel_size(size) for size in sizes])
    assert (voxels >= 0.005).all() and (voxels <= FINEST_SIDE_M / 128 + 1e-9).all()
    assert voxel_size(0.512) == 0.01 and voxel_size(0.513) < 0.0051


# The whole


def follow(scenes: list[Seen], cameras: Cameras = Cameras.GIVEN) -> list[tuple[TrackedObject, ...]]:
    system = MidFusion(cameras)
    frames = shown_poses([seen.frame for seen in scenes], cameras)
    return [system(f, without_ids(s).masks) for f, s in zip(frames, scenes, strict=True)]


def test_a_box_slides_at_known_speed() -> None:
    truth = [cabinet(2.5 + 0.025 * i, -0.4 + 0.05 * i, yaw=0.5) for i in range(6)]
    tracked = follow([look(i, [box]) for i, box in enumerate(truth)])
    assert {entry.track_id for frame in tracked for entry in frame} == {0}
    entries = [frame[0] for frame in tracked]
    metres, degrees = motion_errors(entries, truth)
    assert metres.max() < 0.015 and degrees.max() < 1
    assert all(e.class_id == CABINET and e.state is TrackState.TRACKED for e in entries)
    assert all((e.box.center == e.S_world_canonical.t).all() for e in entries)
    assert abs(entries[-1].extents_m[2] - 0.9) < 0.1


def test_a_box_turns_about_itself() -> None:
    truth = [cabinet(2.5, 0.1, yaw=0.3 + np.radians(5) * i) for i in range(6)]
    tracked = follow([look(i, [box]) for i, box in enumerate(truth)])
    metres, degrees = motion_errors([frame[0] for frame in tracked], truth)
    assert metres.max() < 0.015 and degrees.max() < 1.5


def test_a_box_waits_behind_an_occluder_and_is_found_again() -> None:
    """The camera steps behind a screen and back; a model out of view rests in the world."""
    poses = [camera_pose(y=y) for y in (-0.7, -0.5, -0.3, -0.1, -0.3, -0.5)]
    box = cabinet(3.0, 0.0, yaw=0.5)
    scenes = [look(i, [box], [screen(1.6, 0.0)], T) for i, T in enumerate(poses)]
    assert [len(s.masks.masks) for s in scenes] == [1, 1, 1, 0, 1, 1]
    entries = [frame[0] for frame in follow(scenes)]
    tracked, occluded = TrackState.TRACKED, TrackState.OCCLUDED
    states = [tracked] * 3 + [occluded, TrackState.RE_FOUND, tracked]
    assert [e.state for e in entries] == states and {e.track_id for e in entries} == {0}
    assert motion_errors(entries, [box] * 6)[0].max() < 0.03


def test_what_rests_stays_exactly_where_it_was_while_another_moves() -> None:
    still = cabinet(2.6, 0.7, 0.2)
    truth = [cabinet(2.5, -0.9 + 0.07 * i, yaw=0.6) for i in range(4)]
    poses = [camera_pose(0.01 * i, y=0.03 * i) for i in range(4)]
    scenes = [
        look(i, [still, box], (), T) for i, (box, T) in enumerate(zip(truth, poses, strict=True))
    ]
    tracked = follow(scenes)
    assert motion_errors([frame[0] for frame in tracked], [still] * 4)[0].max() == 0
    metres, _ = motion_errors([frame[1] for frame in tracked], truth)
    assert metres.max() < 0.03


def test_a_box_that_jumps_farther_than_pairs_may_be_apart_is_lost() -> None:
    """The original's weakness: correspondences beyond 10 cm are dropped."""
    truth = [cabinet(2.5, -0.4), cabinet(2.5, 0.9), cabinet(2.5, 0.9)]
    tracked = follow([look(i, [box]) for i, box in enumerate(truth)])
    assert tracked[1][0].state is TrackState.OCCLUDED
    assert motion_errors([frame[0] for frame in tracked], truth)[0][1] > 0.8
    assert [e.track_id for e in tracked[2] if e.observed] == [1]


def test_the_class_is_that_of_most_masks() -> None:
    box = cabinet(2.5, 0.0)
    scenes = [look(i, [box], class_id=c) for i, c in enumerate([CABINET, CHAIR, CHAIR])]
    tracked = follow(scenes)
    assert [frame[0].class_id for frame in tracked] == [CABINET, CABINET, CHAIR]
    assert {e.track_id for frame in tracked for e in frame} == {0}


def test_a_model_without_masks_fades() -> None:
    """It is told little of its own place being its own, and is shown no more; then a mask there
    starts another."""
    small = OrientedBox(np.array([3.0, 0.0, 0.25]), np.eye(3), np.array([0.25, 0.25, 0.5]))
    scenes = [look(0, [small])]
    scenes += [look(i, [], [small]) for i in (1, 2)] + [look(3, [small])]
    tracked = follow(scenes)
    assert [[e.track_id for e in frame if e.observed] for frame in tracked] == [[0], [], [], [1]]


def test_tiny_masks_and_empty_frames_start_nothing() -> None:
    seen = without_ids(look(0, [cabinet(2.5, 0.0)]))
    few = np.zeros_like(seen.masks.masks)
    few[0, 100, 100:140] = True
    assert MidFusion()(seen.frame, replace(seen.masks, masks=few)) == ()
    blank = replace(seen.frame, depth_m=np.zeros_like(seen.frame.depth_m))
    assert MidFusion()(blank, seen.masks) == ()


def test_an_estimated_camera_follows_what_rests() -> None:
    """Only the first pose is told; a box moves across the view."""
    poses = [camera_pose(yaw, x=0.04 * i) for i, yaw in enumerate([0.0, 0.03, 0.07, 0.1])]
    truth = [cabinet(2.6, 0.5 + 0.05 * i, 0.7) for i in range(4)]
    things = [pillar(3.2, -0.2), pillar(2.4, 1.9), pillar(2.2, -0.8)]
    scenes = [
        look(i, [box], things, T) for i, (box, T) in enumerate(zip(truth, poses, strict=True))
    ]
    tracked = follow(scenes, Cameras.ESTIMATED)
    metres, degrees = motion_errors([frame[0] for frame in tracked], truth)
    assert metres.max() < 0.04 and degrees.max() < 2
