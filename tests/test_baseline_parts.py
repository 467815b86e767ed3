"""ICP, masks, association and the start shift, each by itself."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from baseline_scenes import CAMERA, CHAIR, cabinet, camera_pose, look, without_ids
from composenet.baselines.association import MIN_BIRTH_SCORE, mask_iou, projected_mask
from composenet.baselines.frame_to_frame import FrameToFrame
from composenet.baselines.icp import Cloud, align
from composenet.baselines.mask_fusion import MaskFusion
from composenet.baselines.mid_fusion import MidFusion
from composenet.baselines.records import Cameras, ComparisonSystem
from composenet.baselines.run import shown_poses
from composenet.baselines.start_shift import start_at_true_centres
from composenet.baselines.true_masks import TrueMasks
from composenet.errors import ConfigError, DataError
from composenet.geometry.camera import back_project
from composenet.geometry.transform import apply_T, make_T, rotation_z
from composenet.records import (
    Box,
    ObjectFrameTruth,
    ObjectTruth,
    SequenceTruth,
    Similarity,
    Symmetry,
    TrackedObject,
    TrackState,
)
from composenet.sequences import open_sequence
from composenet.synth.sequence_folder import read_truth


def corner() -> np.ndarray:
    """(N, 3) three faces of a 0.6 m cube, 1 cm apart."""
    a, b = (axis.ravel() for axis in np.meshgrid(*[np.arange(0, 0.6, 0.01)] * 2))
    zero = np.zeros_like(a)
    return np.concatenate([np.stack(p, 1) for p in ((a, b, zero), (a, zero, b), (zero, a, b))])


def test_icp_finds_a_known_motion_and_ignores_what_only_one_cloud_shows() -> None:
    points = corner()
    T = make_T(rotation_z(0.15), (0.08, -0.05, 0.03))
    found = align(Cloud(apply_T(T, points)), Cloud(points), [np.eye(4)])
    assert found is not None and found.inlier_share > 0.99 and found.misfit_m < 0.002
    assert np.abs(apply_T(found.T_target_source, points) - apply_T(T, points)).max() < 0.01
    half = points[points[:, 0] < 0.35]
    for target, source, motion in ((half, points, np.eye(4)), (points, half, np.eye(4))):
        found = align(Cloud(target), Cloud(source), [motion])
        assert found is not None
        assert np.abs(found.T_target_source - np.eye(4)).max() < 0.005


def test_icp_takes_the_guess_that_fits_and_the_first_of_equal_ones() -> None:
    points = corner()
    far = make_T(np.eye(3), (1.0, 0.5, 0.0))
    found = align(Cloud(apply_T(far, points)), Cloud(points), [np.eye(4), far])
    assert found is not None and np.abs(found.T_target_source - far).max() < 0.005
    plane = points[points[:, 2] == 0]
    slid = make_T(np.eye(3), (0.02, 0.0, 0.0))
    found = align(Cloud(plane), Cloud(plane), [np.eye(4), slid])
    assert found is not None and np.abs(found.T_target_source - np.eye(4)).max() < 0.005


def test_icp_says_where_it_fails() -> None:
    points = corner()
    assert align(Cloud(points), Cloud(points[:5]), [np.eye(4)]) is None
    assert align(Cloud(np.zeros((0, 3))), Cloud(points), [np.eye(4)]) is None
    assert align(Cloud(points + 5), Cloud(points), [np.eye(4)]) is None
    assert align(Cloud(points), Cloud(points), [make_T(rotation_z(np.pi), (0.6, 0.6, 0))]) is None


def test_without_the_library_one_line_says_what_to_install(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "small_gicp", None)
    with pytest.raises(ConfigError, match=r"composenet\[odometry\]"):
        Cloud(corner())


def test_projected_mask_is_the_mask_seen() -> None:
    seen = look(0, [cabinet(2.5, 0.2, 0.5)])
    mask, T = seen.masks.masks[0], seen.frame.T_world_camera
    points = apply_T(T, back_project(seen.frame.depth_m, CAMERA))[mask]
    assert mask_iou(projected_mask(points, T, CAMERA)[None], mask[None])[0, 0] > 0.99
    nearer = projected_mask(points, camera_pose(x=0.5), CAMERA)
    true = look(0, [cabinet(2.5, 0.2, 0.5)], T_world_camera=camera_pose(x=0.5)).masks.masks
    assert mask_iou(nearer[None], true)[0, 0] > 0.9
    assert not projected_mask(points, camera_pose(np.pi), CAMERA).any()


def test_mask_iou_by_hand() -> None:
    a = np.zeros((2, 2, 4), bool)
    a[0, 0, :3] = True
    b = np.zeros((1, 2, 4), bool)
    b[0, 0, 2:] = True
    np.testing.assert_allclose(mask_iou(a, b), [[1 / 4], [0]])
    assert mask_iou(a[:0], b).shape == (0, 1) and mask_iou(a, b[:0]).shape == (2, 0)


def test_true_masks_are_the_instance_images(recordings: Path, tmp_path: Path) -> None:
    folder = recordings / "val_00000"
    frame = next(iter(open_sequence(folder)))
    masks, truth = TrueMasks(folder)(frame), read_truth(folder)
    assert masks.gt_ids is not None
    pixels = dict(zip(masks.gt_ids.tolist(), masks.masks.sum(axis=(1, 2)), strict=True))
    assert pixels == {o.gt_id: o.visible_pixels for o in truth.frames[0] if o.visible_pixels}
    classes = {item.gt_id: item.class_id for item in truth.objects}
    assert masks.class_ids.tolist() == [classes[i] for i in masks.gt_ids.tolist()]
    with pytest.raises(DataError, match="no readable instance image"):
        TrueMasks(folder)(replace(frame, name="none"))


def test_true_masks_follow_the_reader_that_thins_wide_images(tmp_path: Path, recordings) -> None:
    source = TrueMasks(recordings / "val_00000")
    source._folder = tmp_path
    frame = look(0, []).frame  # 320 wide; ids at 640, as the reader halves those
    (tmp_path / "instance").mkdir()
    ids = np.zeros((480, 640), np.uint16)
    ids[100:, 200:] = next(iter(source._class_ids))
    Image.fromarray(ids).save(tmp_path / "instance" / "0.png")
    np.testing.assert_array_equal(source(frame).masks[0], ids[::2, ::2] > 0)
    Image.fromarray(ids[:300]).save(tmp_path / "instance" / "0.png")
    with pytest.raises(DataError, match="320x150"):
        source(frame)


def test_an_estimated_camera_is_told_the_first_pose_only() -> None:
    frames = [look(i, [], T_world_camera=camera_pose(0.1 * i)).frame for i in range(3)]
    shown = list(shown_poses(frames, Cameras.ESTIMATED))
    assert all((f.T_world_camera == frames[0].T_world_camera).all() for f in shown)
    given = shown_poses(frames, Cameras.GIVEN)
    assert all(
        (a.T_world_camera == b.T_world_camera).all() for a, b in zip(given, frames, strict=True)
    )


def truth_of(centers: dict[int, list[tuple[float, float, float]]]) -> SequenceTruth:
    """Chairs of 1 m at these centres, frame by frame."""
    empty = np.zeros((0, 3), np.float32)
    none = np.zeros((64, 64, 64), bool)
    objects = tuple(ObjectTruth(i, CHAIR, Symmetry.NONE, np.ones(3), none, empty) for i in centers)
    frames = zip(*centers.values(), strict=True)
    return SequenceTruth(
        objects,
        tuple(
            tuple(
                ObjectFrameTruth(i, make_T(np.eye(3), c), Box(np.array(c), np.ones(3)), 900, 1.0)
                for i, c in zip(centers, frame, strict=True)
            )
            for frame in frames
        ),
    )


def entry(track_id: int, index: int, at: tuple[float, float, float], **changes) -> TrackedObject:
    R, t = changes.pop("R", np.eye(3)), np.array(at)
    made = TrackedObject(
        track_id, index, CHAIR, TrackState.TRACKED, 1.0, Box(t, np.ones(3)),
        Similarity(1.0, R, t), np.ones(3), True,
    )  # fmt: skip
    return replace(made, **changes)


def test_a_track_starts_at_the_true_centre_and_its_own_motion_carries_it_on() -> None:
    truth = truth_of({1: [(2.0, 0.0, 0.5)] * 3})
    turned = rotation_z(np.pi / 2)
    tracked = [
        (entry(0, 0, (1.6, 0.0, 0.6)),),
        (entry(0, 1, (1.7, 0.0, 0.6)),),
        (entry(0, 2, (1.7, 0.0, 0.6), R=turned),),
    ]
    shifted = start_at_true_centres(truth, tracked)
    places = [frame[0].box.center for frame in shifted]
    # The reference lay 0.4 m before the centre: a quarter turn swings the centre to its side.
    np.testing.assert_allclose(places, [(2, 0, 0.5), (2.1, 0, 0.5), (1.7, 0.4, 0.5)], atol=1e-9)
    assert all((f[0].S_world_canonical.t == f[0].box.center).all() for f in shifted)


def test_the_start_shift_is_given_once_and_only_on_an_object_of_the_class() -> None:
    truth = truth_of({1: [(2.0, 0.0, 0.5)] * 2, 2: [(2.0, 1.2, 0.5)] * 2})
    tracked = [
        (
            entry(0, 0, (1.7, 0.5, 0.5)),  # 0.58 m from the first chair, 0.76 from the second
            entry(1, 0, (1.7, 0.9, 0.5)),
            entry(2, 0, (5.0, 0.0, 0.5)),  # nothing there
            entry(3, 0, (1.9, 0.0, 0.5), class_id=0),
            entry(4, 0, (2.0, 0.1, 0.5), state=TrackState.OCCLUDED),
        ),
        (entry(0, 1, (3.7, 0.5, 0.5)), entry(4, 1, (2.1, 0.1, 0.5))),
    ]
    first, second = start_at_true_centres(truth, tracked)
    expected = [(2, 0, 0.5), (2, 1.2, 0.5), (5, 0, 0.5), (1.9, 0, 0.5), (2, 0.1, 0.5)]
    np.testing.assert_allclose([e.box.center for e in first], expected, atol=1e-9)
    # The first went astray and stays so; the last is seen only now.
    np.testing.assert_allclose(
        [e.box.center for e in second], [(4, 0, 0.5), (2, 0, 0.5)], atol=1e-9
    )
    assert start_at_true_centres(truth_of({}), []) == []


@pytest.mark.parametrize("make", [FrameToFrame, MaskFusion, MidFusion])
def test_an_unsure_mask_continues_a_track_but_starts_none(
    make: Callable[[Cameras], ComparisonSystem],
) -> None:
    system, box = make(Cameras.GIVEN), cabinet(2.5, 0.0)
    seen_in = []
    for i, score in enumerate([0.5, MIN_BIRTH_SCORE - 0.01, MIN_BIRTH_SCORE, 0.5]):
        scene = without_ids(look(i, [box]))
        masks = replace(scene.masks, scores=np.array([score], np.float32))
        entries = system(scene.frame, masks)
        seen_in.append(sum(entry.observed for entry in entries))
    assert seen_in == [0, 0, 1, 1]
