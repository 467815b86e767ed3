"""Training targets and losses: occupancy look-ups, perfect predictions, symmetry."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np
import pytest
import torch

from composenet.geometry.symmetry import ORDER, turns
from composenet.geometry.transform import apply_T, rotation_z
from composenet.network.batch import CropBatch, VolumeBatch
from composenet.network.detection_head import VoxelFields
from composenet.network.object_net import HEADING_BINS, HeadingNet, ObjectFields
from composenet.records import Box, Symmetry
from composenet.training.losses import (
    OBJECT_LOSSES,
    detection_losses,
    heading_bins,
    heading_teacher,
    object_losses,
    valid_headings,
)
from composenet.training.targets import (
    OTHER_VOXELS,
    TrainingBatch,
    collate_samples,
    make_sample,
    occupancy_in_crops,
    soften,
)
from training_cases import EXTENTS, SIZE_M, bumpy_block, no_object, one_object, volume_of

CELLS = 16
ROTATION_PARTS = ("correspondence", "rotation")


ROW = torch.zeros(1, dtype=torch.long)
"""The one object's row, for its one crop."""


def crops_of(batch: TrainingBatch, grow: float = 1.25) -> CropBatch:
    still = torch.zeros(len(batch.frame))
    return CropBatch(batch.frame, batch.center, batch.extents * grow, still)


def true_fields(
    batch: TrainingBatch, crops: CropBatch, turn: np.ndarray, cells: int = CELLS
) -> ObjectFields:
    """Perfect predictions for the object as seen after a turn about its own up axis."""
    m, side = len(batch.frame), cells // 2
    target = occupancy_in_crops(batch, crops, ROW, cells)
    R = batch.R_grid_object @ torch.from_numpy(turn).float()
    local = (crops.points(side) - batch.t[:, None]) @ R
    nocs = local / batch.scale_m[:, None, None]
    bins = heading_bins(torch.atan2(R[:, 1, 0], R[:, 0, 0]))
    return ObjectFields(
        crops=crops,
        occupancy=torch.where(target > 0.5, 20.0, -20.0),
        nocs=nocs.transpose(1, 2).reshape(m, 3, side, side, side).requires_grad_(True),
        surface=torch.zeros(m, cells, cells, cells, dtype=torch.bool),
        heading_logits=40.0 * torch.nn.functional.one_hot(bins, HEADING_BINS),
    )


@pytest.mark.parametrize("yaw", [0.0, 0.4])
def test_occupancy_in_crops_against_a_slow_look_up(yaw: float) -> None:
    batch = one_object(yaw=yaw)
    crops = crops_of(batch)
    ours = occupancy_in_crops(batch, crops, ROW, CELLS)[0].numpy()
    points = crops.points(CELLS)[0].numpy()
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
    share = ours.mean() * float(crops.size[0].prod())
    assert share == pytest.approx(bumpy_block().mean() * EXTENTS.prod(), rel=0.1)


def test_soften_counts_filled_subcells() -> None:
    filled = np.zeros((64, 64, 64), bool)
    filled[0, 0, 0] = filled[2:4, 2:4, 2:4] = True
    soft = soften(filled)
    assert (soft[0, 0, 0], soft[1, 1, 1], soft.sum()) == (1, 8, 9)


def test_soften_against_a_sum_over_blocks() -> None:
    filled = np.random.default_rng(0).random((64, 64, 64)) < np.linspace(0, 1, 64)
    slow = filled.reshape(32, 2, 32, 2, 32, 2).sum(axis=(1, 3, 5))
    soft = soften(filled)
    assert soft.dtype == np.uint8 and soft.max() == 8
    np.testing.assert_array_equal(soft, slow)


def test_targets_are_in_the_grid() -> None:
    batch, volume = one_object(), volume_of()
    assert batch.frame.tolist() == [1]
    assert batch.voxel_object.tolist() == [-1] * 40 + [0] * 30 + [-1] * 10
    R, low = volume.T_world_grid[:3, :3], volume.T_world_grid[:3, 3]
    np.testing.assert_allclose(R @ batch.t[0].numpy() + low, [1.6, 1.7, 0.5], atol=1e-6)
    np.testing.assert_allclose(R @ batch.R_grid_object[0].numpy(), rotation_z(0.4), atol=1e-6)
    assert float(batch.scale_m[0]) == pytest.approx(np.linalg.norm(EXTENTS), rel=1e-6)


def test_other_things_are_kept_where_the_frame_shows_them() -> None:
    """Their boxes are in the grid; voxels of objects and remembered ones do not count."""
    whole = volume_of(label=0)  # 40 voxels of no object, in 16 x 16 x 16 cells
    T = whole.T_world_grid
    middle = apply_T(T, np.full((1, 3), 7.5 * SIZE_M))[0]
    around = Box(middle, np.abs(T[:3, :3]) @ np.array([0.9, 1.0, 1.1]))
    beside = Box(middle + np.array([3.0, 0, 0]), around.extents)
    sample = make_sample(whole, [], [], [beside, around])
    expected = [*[7.5 * SIZE_M] * 3, 0.9, 1.0, 1.1]
    np.testing.assert_allclose(sample.other_boxes, [expected], atol=1e-6)
    for few in (replace(whole, n_seen=OTHER_VOXELS - 1), volume_of(label=3)):
        assert make_sample(few, [], [], [beside, around]).other_boxes.shape == (0, 6)
    batch = collate_samples([make_sample(volume_of(), [], []), sample, sample])
    assert batch.other_frame.tolist() == [1, 2] and batch.other_boxes.shape == (2, 6)


@pytest.mark.parametrize("symmetry", list(Symmetry))
def test_perfect_predictions_cost_nothing(symmetry: Symmetry) -> None:
    batch = one_object(symmetry)
    crops = crops_of(batch)
    losses, errors = object_losses(true_fields(batch, crops, np.eye(3)), batch, ROW)
    for name, value in losses.items():
        soft = name in ("completion", "overlap")  # their target is soft on the surface
        assert -1e-6 <= value.item() < (0.35 if soft else 1e-4), name
    assert float(errors.rotation_deg) < 0.1 and float(errors.translation_m) < 1e-3
    assert float(errors.completion_iou) == 1


def test_what_is_occupied_is_told_by_the_threshold() -> None:
    batch = one_object(Symmetry.NONE)
    fields = true_fields(batch, crops_of(batch), np.eye(3))
    unsure = torch.where(fields.occupancy > 0, torch.tensor(0.45).logit(), fields.occupancy)
    for threshold, iou in ((0.4, 1), (0.5, 0)):
        _, errors = object_losses(replace(fields, occupancy=unsure), batch, ROW, threshold)
        assert float(errors.completion_iou) == iou


@pytest.mark.parametrize("symmetry", list(Symmetry))
@pytest.mark.parametrize("turned_deg", [0, 10, 90, 180])
def test_only_turns_of_the_symmetry_are_free(symmetry: Symmetry, turned_deg: int) -> None:
    batch = one_object(symmetry)
    crops = crops_of(batch)
    turn = rotation_z(np.radians(turned_deg))
    losses, errors = object_losses(true_fields(batch, crops, turn), batch, ROW)
    free = turned_deg % (360 / ORDER[symmetry]) == 0
    for name in ROTATION_PARTS:
        assert (losses[name].item() < 1e-4) == free, name
    near = turned_deg < 180 / HEADING_BINS
    assert (losses["heading"].item() < 1e-4) == (free or near)
    for name in ("scale", "translation", "fit_place"):
        assert losses[name].item() < 1e-4
    if symmetry is Symmetry.NONE:
        assert float(errors.rotation_deg) == pytest.approx(turned_deg, abs=0.1)


@pytest.mark.parametrize(("gap_m", "cost"), [(0.0, 0.0), (0.25, 1 - np.exp(-1)), (1.0, 1.0)])
def test_the_cost_of_a_fitted_place_by_hand(gap_m: float, cost: float) -> None:
    """Correspondences all shifted by as much as moves the object by gap_m."""
    batch = one_object()
    fields = true_fields(batch, crops_of(batch), np.eye(3))
    shift = gap_m / float(batch.scale_m[0])
    moved = replace(fields, nocs=fields.nocs + torch.tensor([0, 0, shift]).view(1, 3, 1, 1, 1))
    losses, errors = object_losses(moved, batch, ROW)
    assert float(errors.translation_m) == pytest.approx(gap_m, abs=1e-3)
    assert losses["fit_place"].item() == pytest.approx(cost, abs=3e-3)
    assert losses["translation"].item() == pytest.approx(gap_m**2, abs=3e-3)


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
    yaws, valid = valid_headings(batch, ROW)
    assert valid.sum() == min(ORDER[symmetry], 4)
    alike = batch.R_grid_object @ torch.from_numpy(turns(symmetry)).float()
    generator = torch.Generator().manual_seed(0)
    for angle in yaws[valid]:
        direction = torch.stack([angle.cos(), angle.sin(), torch.zeros(())])
        assert (alike[:, :, 0] @ direction).max() > 1 - 1e-5
        logits = torch.nn.functional.one_hot(heading_bins(angle[None]), HEADING_BINS).float()
        many = ROW.repeat(2000)
        taught = heading_teacher(batch, many, generator)(logits.expand(2000, -1)) - angle
        off = torch.atan2(taught.sin(), taught.cos())
        assert off.mean().abs() < np.radians(0.7)
        beyond = (off.abs() > np.pi / HEADING_BINS).double().mean()
        assert 0.07 < beyond < 0.12  # in tracking 9 %


def test_poses_are_fitted_to_what_the_network_fills_as_in_tracking() -> None:
    """Coordinates of other cells do not count in the fit, those of cells that are filled though
    they should not be do, and are taught."""
    batch = one_object(yaw=0.3)
    crops = crops_of(batch, grow=1.5)
    fields = true_fields(batch, crops, np.eye(3))
    side = CELLS // 2
    filled = fields.occupancy[0].unfold(0, 2, 2).unfold(1, 2, 2).unfold(2, 2, 2) > 0
    empty = ~filled.flatten(3).any(dim=3)
    assert 0 < int(empty.sum()) < side**3
    noise = torch.randn(3, side, side, side, generator=torch.Generator().manual_seed(0))
    nocs = fields.nocs.detach() + 3 * empty * noise
    losses, errors = object_losses(replace(fields, nocs=nocs), batch, ROW)
    assert errors.translation_m.item() < 1e-4 and errors.rotation_deg.item() < 0.1
    everywhere = torch.full_like(fields.occupancy, 2.0)
    more, worse = object_losses(replace(fields, nocs=nocs, occupancy=everywhere), batch, ROW)
    assert worse.rotation_deg.item() > 1
    assert more["correspondence"] > losses["correspondence"] + 0.5
    weak = torch.where(fields.occupancy > 0, 20.0, -1.0)  # a probability of 0.27
    _, same = object_losses(replace(fields, nocs=nocs, occupancy=weak), batch, ROW)
    _, lower = object_losses(replace(fields, nocs=nocs, occupancy=weak), batch, ROW, 0.2)
    assert same.rotation_deg.item() < 0.1 and lower.rotation_deg.item() > 1


def test_gradients_are_finite_and_point_to_the_truth() -> None:
    batch = one_object()
    crops = crops_of(batch)
    fields = true_fields(batch, crops, rotation_z(0.5))
    losses, _ = object_losses(fields, batch, ROW)
    for name in (*ROTATION_PARTS, "scale", "translation", "fit_place"):
        (grad,) = torch.autograd.grad(losses[name], fields.nocs, retain_graph=True)
        assert torch.isfinite(grad).all(), name
    (grad,) = torch.autograd.grad(losses["rotation"], fields.nocs)
    step = replace(fields, nocs=(fields.nocs - 0.05 * grad / grad.abs().max()).detach())
    assert object_losses(step, batch, ROW)[0]["rotation"] < losses["rotation"]


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
    losses = detection_losses(fields, no_object())
    assert losses["objectness"] > 1 and not losses["center"] and not losses["class"]
    sum(losses.values()).backward()


def aligned() -> tuple[TrainingBatch, ObjectFields]:
    """A crop whose cells are those of the stored occupancy, so that none is half filled."""
    batch = one_object(yaw=0.0)
    fields = true_fields(batch, crops_of(batch, grow=1.0), np.eye(3), cells=32)
    target = occupancy_in_crops(batch, fields.crops, ROW, 32)
    torch.testing.assert_close(target, target.round(), atol=1e-4, rtol=0)
    return batch, fields


@pytest.mark.parametrize(
    ("filled", "cost"),
    # The block fills a half and 24 x 20 x 32 of 64^3 cells.
    [("true", 0.0), ("all others", 1.0), ("nothing", 1.0), ("everything", 1 - 0.55859375)],
)
def test_the_overlap_loss(filled: str, cost: float) -> None:
    batch, fields = aligned()
    solid = fields.occupancy > 0
    cells = {
        "true": solid,
        "all others": ~solid,
        "nothing": torch.zeros_like(solid),
        "everything": torch.ones_like(solid),
    }[filled]
    logits = torch.where(cells, 30.0, -30.0).requires_grad_(True)
    losses, _ = object_losses(replace(fields, occupancy=logits), batch, ROW)
    assert losses["overlap"].item() == pytest.approx(cost, abs=1e-4)


def test_the_overlap_loss_pulls_towards_the_truth() -> None:
    batch, fields = aligned()
    solid = fields.occupancy > 0
    logits = torch.zeros_like(fields.occupancy).requires_grad_(True)
    losses, _ = object_losses(replace(fields, occupancy=logits), batch, ROW)
    (grad,) = torch.autograd.grad(losses["overlap"], logits)
    assert (grad[solid] < 0).all() and (grad[~solid] > 0).all()


def test_no_crops_no_cost() -> None:
    batch = no_object()
    cube = torch.zeros(0, CELLS, CELLS, CELLS, requires_grad=True)
    half = torch.zeros(0, 3, CELLS // 2, CELLS // 2, CELLS // 2, requires_grad=True)
    headings = torch.zeros(0, HEADING_BINS, requires_grad=True)
    fields = ObjectFields(crops_of(batch), cube, half, cube > 0, headings)
    losses, errors = object_losses(fields, batch, ROW[:0])
    assert set(losses) == set(OBJECT_LOSSES) and not any(losses.values())
    sum(losses.values()).backward()
    assert cube.grad is not None and len(errors.rotation_deg) == 0
    assert len(heading_teacher(batch, ROW[:0], torch.Generator())(headings)) == 0


@pytest.mark.parametrize("bins", [1, 5, 9])
def test_heading_scores_turn_with_the_object(bins: int) -> None:
    """A turn of the scene about the crop's centre by whole bins shifts the scores by as many."""
    torch.manual_seed(0)
    net = HeadingNet(10).eval()
    with torch.no_grad():
        cast(torch.nn.Linear, net.score[-1]).weight *= 100
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
            torch.zeros(1, dtype=torch.bool),
            torch.zeros(1, 0, 0, 0, dtype=torch.bool),
            torch.zeros(1, 3),
            depth,
            K,
            (look @ torch.linalg.inv(turn))[None],
            torch.zeros(1),
            0.05,
        )
        return net(batch, crops, torch.full((1, 10), 0.1), 0.15)[0]

    still, turned = scores(0.0), scores(2 * np.pi * bins / HEADING_BINS)
    torch.testing.assert_close(turned, still.roll(bins), atol=1e-4, rtol=0)
    assert still.std() > 1e-2
