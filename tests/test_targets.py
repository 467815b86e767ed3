"""Training targets and losses: occupancy look-ups, perfect predictions, symmetry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from composenet.geometry.box import pairwise_iou
from composenet.geometry.symmetry import ORDER, turns
from composenet.geometry.transform import make_T, rotation_z
from composenet.network.batch import CropBatch, VolumeBatch
from composenet.network.detection_head import VoxelFields
from composenet.network.object_net import HEADING_BINS, HeadingNet, ObjectFields, likeliest_heading
from composenet.records import Box, ObjectFrameTruth, ObjectTruth, Symmetry
from composenet.training.losses import (
    detection_losses,
    heading_bins,
    heading_teacher,
    object_losses,
    valid_headings,
)
from composenet.training.proposals import TrainingCrops, box_iou, training_crops
from composenet.training.targets import (
    TrainingBatch,
    collate_samples,
    make_sample,
    occupancy_in_crops,
    soften,
)
from composenet.volume.voxels import FEATURE_NAMES, Volume

CELLS, SIZE_M = 16, 0.05
EXTENTS = np.array([0.6, 0.9, 1.2])
ROTATION_PARTS = ("correspondence", "rotation")


def bumpy_block() -> np.ndarray:
    """(64, 64, 64) occupancy without any symmetry."""
    filled = np.zeros((64, 64, 64), bool)
    filled[:, :, :32] = True
    filled[40:, :20, :] = True
    return filled


def volume_of(label: int = 3, quarter: float = 1.0) -> Volume:
    """A grid turned by quarters and shifted; 40 voxels, the first 30 on object `label`."""
    rng = np.random.default_rng(0)
    return Volume(
        coords=rng.permutation(np.indices((16, 16, 16)).reshape(3, -1).T)[:40].astype(np.int32),
        features=np.zeros((40, len(FEATURE_NAMES)), np.float32),
        labels=np.where(np.arange(40) < 30, label, 0).astype(np.int32),
        shape=(32, 32, 32),
        voxel_size_m=SIZE_M,
        T_world_grid=make_T(np.round(rotation_z(quarter * np.pi / 2)), np.array([2.0, 1.0, -0.2])),
        depth_m=np.zeros((4, 4), np.float32),
        K=np.eye(3),
        T_camera_grid=np.eye(4),
    )


def one_object(symmetry: Symmetry = Symmetry.NONE, yaw: float = 0.4) -> TrainingBatch:
    """Two frames, the object in the second one; the first holds nothing."""
    T = make_T(rotation_z(yaw), np.array([1.6, 1.7, 0.5]))
    box = Box(T[:3, 3], np.abs(T[:3, :3]) @ EXTENTS)
    truth = ObjectTruth(3, 4, symmetry, EXTENTS, bumpy_block(), np.zeros((0, 3), np.float32))
    seen = ObjectFrameTruth(3, T, box, 500, 0.7)
    return collate_samples(
        [make_sample(volume_of(), [], []), make_sample(volume_of(), [truth], [seen])]
    )


def crops_of(batch: TrainingBatch, grow: float = 1.25) -> TrainingCrops:
    still = torch.zeros(len(batch.frame))
    crops = CropBatch(batch.frame, batch.center, batch.extents * grow, still)
    ones = torch.ones(len(batch.frame))
    return TrainingCrops(crops, torch.arange(len(batch.frame)), ones, ones.bool())


def true_fields(batch: TrainingBatch, boxes: TrainingCrops, turn: np.ndarray) -> ObjectFields:
    """Perfect predictions for the object as seen after a turn about its own up axis."""
    m = len(batch.frame)
    target = occupancy_in_crops(batch, boxes.crops, boxes.rows, CELLS)
    R = batch.R_grid_object @ torch.from_numpy(turn).float()
    local = (boxes.crops.points(CELLS // 2) - batch.t[:, None]) @ R
    nocs = local / batch.scale_m[:, None, None]
    side = CELLS // 2
    bins = heading_bins(torch.atan2(R[:, 1, 0], R[:, 0, 0]))
    return ObjectFields(
        crops=boxes.crops,
        occupancy=torch.where(target > 0.5, 20.0, -20.0),
        nocs=nocs.transpose(1, 2).reshape(m, 3, side, side, side).requires_grad_(True),
        surface=torch.zeros(m, CELLS, CELLS, CELLS, dtype=torch.bool),
        quality=torch.full((m,), 20.0),
        class_logits=40.0 * torch.nn.functional.one_hot(batch.class_id, 10),
        heading_logits=40.0 * torch.nn.functional.one_hot(bins, HEADING_BINS),
    )


@pytest.mark.parametrize("yaw", [0.0, 0.4])
def test_occupancy_in_crops_against_a_slow_look_up(yaw: float) -> None:
    batch = one_object(yaw=yaw)
    boxes = crops_of(batch)
    ours = occupancy_in_crops(batch, boxes.crops, boxes.rows, CELLS)[0].numpy()
    points = boxes.crops.points(CELLS)[0].numpy()
    R, t = batch.R_grid_object[0].numpy(), batch.t[0].numpy()
    slow = np.zeros(len(points), bool)
    clear = np.zeros(len(points), bool)  # farther than a soft cell from a boundary
    filled = np.pad(bumpy_block(), 4)
    for n, point in enumerate(points):
        i, j, k = np.floor((R.T @ (point - t) / EXTENTS + 0.5) * 64).astype(int) + 4
        if min(i, j, k) < 2 or max(i, j, k) > 69:
            clear[n] = min(i, j, k) < -4 or max(i, j, k) > 76
            continue
        around = filled[i - 2 : i + 3, j - 2 : j + 3, k - 2 : k + 3]
        slow[n], clear[n] = filled[i, j, k], around.all() or not around.any()
    np.testing.assert_allclose(ours.ravel()[clear], slow[clear], atol=1e-5)
    assert clear.mean() > 0.3 and slow[clear].any() and not slow[clear].all()
    assert np.mean((ours.ravel() > 0.5) == slow) > 0.97
    share = ours.mean() * float(boxes.crops.size[0].prod())
    assert share == pytest.approx(bumpy_block().mean() * EXTENTS.prod(), rel=0.1)


def test_soften_counts_filled_subcells() -> None:
    filled = np.zeros((64, 64, 64), bool)
    filled[0, 0, 0] = filled[2:4, 2:4, 2:4] = True
    soft = soften(filled)
    assert (soft[0, 0, 0], soft[1, 1, 1], soft.sum()) == (1, 8, 9)


def test_targets_are_in_the_grid() -> None:
    batch, volume = one_object(), volume_of()
    assert batch.frame.tolist() == [1]
    assert batch.voxel_object.tolist() == [-1] * 40 + [0] * 30 + [-1] * 10
    R, low = volume.T_world_grid[:3, :3], volume.T_world_grid[:3, 3]
    np.testing.assert_allclose(R @ batch.t[0].numpy() + low, [1.6, 1.7, 0.5], atol=1e-6)
    np.testing.assert_allclose(R @ batch.R_grid_object[0].numpy(), rotation_z(0.4), atol=1e-6)
    assert float(batch.scale_m[0]) == pytest.approx(np.linalg.norm(EXTENTS), rel=1e-6)


@pytest.mark.parametrize("symmetry", list(Symmetry))
def test_perfect_predictions_cost_nothing(symmetry: Symmetry) -> None:
    batch = one_object(symmetry)
    boxes = crops_of(batch)
    losses, errors = object_losses(true_fields(batch, boxes, np.eye(3)), batch, boxes)
    for name, value in losses.items():
        limit = 0.35 if name == "completion" else 1e-4  # its target is soft on the surface
        assert 0 <= value.item() < limit, name
    assert float(errors.rotation_deg) < 0.1 and float(errors.translation_m) < 1e-3
    assert float(errors.completion_iou) == 1


@pytest.mark.parametrize("symmetry", list(Symmetry))
@pytest.mark.parametrize("turned_deg", [0, 10, 90, 180])
def test_only_turns_of_the_symmetry_are_free(symmetry: Symmetry, turned_deg: int) -> None:
    batch = one_object(symmetry)
    boxes = crops_of(batch)
    turn = rotation_z(np.radians(turned_deg))
    losses, errors = object_losses(true_fields(batch, boxes, turn), batch, boxes)
    free = turned_deg % (360 / ORDER[symmetry]) == 0
    for name in ROTATION_PARTS:
        assert (losses[name].item() < 1e-4) == free, name
    near = turned_deg < 180 / HEADING_BINS
    assert (losses["heading"].item() < 1e-4) == (free or near)
    for name in ("scale", "translation"):
        assert losses[name].item() < 1e-4
    if symmetry is Symmetry.NONE:
        assert float(errors.rotation_deg) == pytest.approx(turned_deg, abs=0.1)


@pytest.mark.parametrize("symmetry", list(Symmetry))
def test_turns_form_the_group(symmetry: Symmetry) -> None:
    group = turns(symmetry)
    assert len(group) == ORDER[symmetry]
    np.testing.assert_allclose(group[0], np.eye(3))
    for a in group[:4]:
        products = a @ group
        gaps = np.abs(products[:, None] - group[None]).max(axis=(2, 3))
        assert (gaps.min(axis=1) < 1e-9).all() and len(set(gaps.argmin(axis=1))) == len(group)
        np.testing.assert_allclose(a @ [0, 0, 1], [0, 0, 1])


@pytest.mark.parametrize("yaw", [0.0, 0.4, -3.0])
@pytest.mark.parametrize("symmetry", list(Symmetry))
def test_the_teacher_gives_the_valid_heading_that_the_network_likes(
    symmetry: Symmetry, yaw: float
) -> None:
    batch = one_object(symmetry, yaw)
    boxes = crops_of(batch)
    yaws, valid = valid_headings(batch, boxes.rows)
    assert valid.sum() == min(ORDER[symmetry], 4)
    alike = batch.R_grid_object @ torch.from_numpy(turns(symmetry)).float()
    generator = torch.Generator().manual_seed(0)
    for angle in yaws[valid]:
        direction = torch.stack([angle.cos(), angle.sin(), torch.zeros(())])
        assert (alike[:, :, 0] @ direction).max() > 1 - 1e-5
        logits = torch.nn.functional.one_hot(heading_bins(angle[None]), HEADING_BINS).float()
        (taught,) = heading_teacher(batch, boxes, generator)(logits)
        assert torch.cos(taught - angle) > np.cos(np.pi / HEADING_BINS) - 1e-6
        negative = replace(boxes, positive=torch.zeros(1, dtype=torch.bool))
        assert heading_teacher(batch, negative, generator)(logits) == likeliest_heading(logits)


def test_gradients_are_finite_and_point_to_the_truth() -> None:
    batch = one_object()
    boxes = crops_of(batch)
    fields = true_fields(batch, boxes, rotation_z(0.5))
    losses, _ = object_losses(fields, batch, boxes)
    for name in (*ROTATION_PARTS, "scale", "translation"):
        (grad,) = torch.autograd.grad(losses[name], fields.nocs, retain_graph=True)
        assert torch.isfinite(grad).all(), name
    (grad,) = torch.autograd.grad(losses["rotation"], fields.nocs)
    step = replace(fields, nocs=(fields.nocs - 0.05 * grad / grad.abs().max()).detach())
    assert object_losses(step, batch, boxes)[0]["rotation"] < losses["rotation"]


def test_perfect_voxels_cost_nothing_and_frames_without_objects_are_fine() -> None:
    batch = one_object()
    on = batch.voxel_object >= 0
    coords = batch.volume.coords[:, 1:].float()
    fields = VoxelFields(
        features=torch.zeros(80, 1),
        objectness=torch.where(on, 20.0, -20.0).requires_grad_(True),
        center_offset=batch.center / SIZE_M - coords,
        extents=(batch.extents / SIZE_M).expand(80, 3),
        class_logits=40.0 * torch.nn.functional.one_hot(batch.class_id, 10).expand(80, 10),
    )
    for name, value in detection_losses(fields, batch).items():
        assert value.item() < 1e-5, name
    empty = collate_samples([make_sample(volume_of(), [], [])] * 2)
    losses = detection_losses(fields, empty)
    assert losses["objectness"] > 1 and not losses["center"] and not losses["class"]
    sum(losses.values()).backward()
    boxes = training_crops(empty, (), 1.25, 7, torch.Generator().manual_seed(0))
    assert not boxes.positive.any() and len(boxes.rows) == 2  # a random box a frame


def test_training_crops_hold_the_objects_of_their_own_frame() -> None:
    batch = one_object()
    boxes = training_crops(batch, (), 1.25, 7, torch.Generator().manual_seed(0))
    assert boxes.crops.frame.tolist() == [0, 1, 1]
    assert not boxes.positive[0] and boxes.iou[0] == 0  # the same place, another frame
    assert boxes.positive[1] and boxes.iou[1] > 0.3


boxes_strategy = st.lists(
    st.tuples(*[st.floats(-1, 1)] * 3, *[st.floats(0.1, 2)] * 3), min_size=1, max_size=4
)


@settings(max_examples=50, deadline=None)
@given(boxes_strategy, boxes_strategy)
def test_box_iou_equals_the_reference(a: list[tuple], b: list[tuple]) -> None:
    A, B = np.array(a), np.array(b)
    tensors = [torch.from_numpy(x) for x in (A[:, :3], A[:, 3:], B[:, :3], B[:, 3:])]
    reference = pairwise_iou(
        [Box(row[:3], row[3:]) for row in A], [Box(row[:3], row[3:]) for row in B]
    )
    np.testing.assert_allclose(box_iou(*tensors), reference, atol=1e-9)


@pytest.mark.parametrize("bins", [1, 5, 9])
def test_heading_scores_turn_with_the_object(bins: int) -> None:
    """A turn of the scene about the crop's centre by whole bins shifts the scores by as many."""
    torch.manual_seed(0)
    net = HeadingNet(10).eval()
    depth = torch.zeros(1, 240, 320)
    depth[0, 60:180, 80:240] = 2.0 + 0.3 * torch.rand(120, 160)
    K = torch.tensor([[[280.0, 0, 160], [0, 280, 120], [0, 0, 1]]])
    look = torch.tensor([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    center = torch.tensor([[2.0, 0.1, 0.0]])
    crops = CropBatch.around(torch.zeros(1).long(), center, torch.full((1, 3), 1.2), 1.0)

    def scores(turn_rad: float) -> torch.Tensor:
        turn = torch.eye(4)
        turn[:2, :2] = torch.from_numpy(rotation_z(turn_rad)[:2, :2]).float()
        turn[:3, 3] = center[0] - turn[:3, :3] @ center[0]
        batch = VolumeBatch(
            torch.zeros(1, 4).long(),
            torch.zeros(1, 1),
            depth,
            K,
            (look @ torch.linalg.inv(turn))[None],
            torch.zeros(1),
            0.05,
        )
        return net(batch, crops, torch.full((1, 10), 0.1), 0.15)[0]

    still, turned = scores(0.0), scores(2 * np.pi * bins / HEADING_BINS)
    torch.testing.assert_close(turned, still.roll(bins), atol=2e-3, rtol=0)
    assert still.std() > 1e-3
