"""The second look at boxes: pooling against a slow loop, and what must not matter to it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from composenet.geometry.transform import rotation_z
from composenet.network.batch import CropBatch, VolumeBatch
from composenet.network.box_head import (
    CONTEXT,
    MAX_GROWTH,
    BoxFields,
    BoxHead,
    pool_by_box,
    voxels_inside,
)
from composenet.network.detection_head import VoxelFields

F, N_CLASSES, SIZE_M = 6, 4, 0.1
CENTER = torch.tensor([[1.02, 1.03, 0.54], [1.53, 1.04, 1.01], [0.51, 1.55, 0.77], [9, 9, 9]])
EXTENTS = torch.tensor([[0.61, 0.82, 1.03], [0.94, 0.55, 0.76], [0.47, 0.68, 1.19], [1, 1, 1]])
FRAME = torch.tensor([0, 1, 0, 1])
"""Three boxes among voxels and one that holds none."""


def scene(seed: int = 0, voxels: int = 400) -> tuple[VoxelFields, VolumeBatch]:
    """Two frames of voxels scattered over 2 x 2 x 1.6 m, in double precision."""
    g = torch.Generator().manual_seed(seed)
    sites = torch.rand(voxels, 4, generator=g) * torch.tensor([2, 20, 20, 16])
    coords = torch.unique(sites.long(), dim=0)
    n = len(coords)

    def noise(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=g, dtype=torch.float64)

    fields = VoxelFields(noise(n, F), noise(n), 3 * noise(n, 3), noise(n, 3), noise(n, N_CLASSES))
    eye = torch.eye(4).double().expand(2, 4, 4)
    floor_z = torch.tensor([-0.1, 0.2]).double()
    depth = torch.zeros(2, 4, 4).double()
    seen = torch.zeros(n, dtype=torch.bool)
    free = torch.rand(2, 8, 8, 8, generator=g) < 0.5
    K = eye[:, :3, :3]
    return fields, VolumeBatch(
        coords, fields.features, seen, free, 0.2 * noise(2, 3), depth, K, eye, floor_z, SIZE_M
    )


def head(stirred: bool = True, size: float = 0.1) -> BoxHead:
    """An untrained head; stirred: with a last layer that does something."""
    torch.manual_seed(0)
    net = BoxHead(F, N_CLASSES)
    if stirred:
        torch.nn.init.normal_(net.box[2].weight, std=size)  # type: ignore[arg-type]
    return net.double()


def look(
    net: BoxHead,
    fields: VoxelFields,
    batch: VolumeBatch,
    center: Tensor = CENTER,
    frame: Tensor = FRAME,
    extents: Tensor = EXTENTS,
) -> BoxFields:
    return net(fields, batch, center.double(), extents.double(), frame, 0.15)


def total(found: BoxFields) -> Tensor:
    """Some number that depends on everything."""
    weights = torch.linspace(0.5, 1.5, found.class_logits.shape[1]).double()
    parts = (found.center.sum(), found.extents.sum(), found.quality.sum())
    return sum(parts) + (found.class_logits * weights).sum()


def assert_equal(a: BoxFields, b: BoxFields) -> None:
    for name, value in vars(a).items():
        torch.testing.assert_close(getattr(b, name), value)


def around(center: Tensor = CENTER, yaw: float = 0.0) -> CropBatch:
    return CropBatch(
        FRAME, center.double(), CONTEXT * EXTENTS.double(), torch.full((4,), yaw).double()
    )


@pytest.mark.parametrize("yaw", [0.0, 0.7])
def test_voxels_inside_against_a_slow_loop(yaw: float) -> None:
    _, batch = scene()
    shares, inside = voxels_inside(batch, around(yaw=yaw))
    for m, (frame, center, extents) in enumerate(zip(FRAME, CENTER, EXTENTS, strict=True)):
        for n, (of, *site) in enumerate(batch.coords.tolist()):
            local = rotation_z(yaw).T @ (np.array(site) * SIZE_M - center.numpy())
            place = local / (CONTEXT * extents.numpy()) + 0.5
            np.testing.assert_allclose(shares[m, n], place, atol=1e-6)
            assert inside[m, n] == (of == frame and (place >= 0).all() and (place < 1).all())
    assert (inside.sum(dim=1) > 10).tolist() == [True, True, True, False]


def pooled_slowly(values: Tensor, box: Tensor, weight: Tensor, n_boxes: int) -> Tensor:
    rows = []
    for index in range(n_boxes):
        own, w = values[box == index], weight[box == index]
        if len(own):
            rows.append(torch.cat([own.amax(dim=0), (w * own).sum(dim=0) / w.sum()]))
        else:
            rows.append(values.new_zeros(2 * values.shape[1]))
    return torch.stack(rows)


@pytest.mark.parametrize("seed", range(3))
def test_pooling_against_a_slow_loop(seed: int) -> None:
    g = torch.Generator().manual_seed(seed)
    values, weight = (torch.rand(30, c, generator=g, dtype=torch.float64) for c in (5, 1))
    values, box = values * (values > 0.3), torch.randint(0, 8, (30,), generator=g)
    box = torch.where(box == 3, 2, box).sort().values  # one is empty
    ours = pool_by_box(values, box, weight, 8)
    torch.testing.assert_close(ours, pooled_slowly(values, box, weight, 8))
    assert not ours[3].any()


def test_gradients_of_pooling() -> None:
    g = torch.Generator().manual_seed(0)
    values, weight = (
        (0.1 + torch.rand(9, c, generator=g, dtype=torch.float64)).requires_grad_(True)
        for c in (3, 1)
    )
    box = torch.tensor([0, 0, 0, 2, 2, 2, 3, 3, 3])
    assert torch.autograd.gradcheck(lambda v, w: pool_by_box(v, box, w, 4), (values, weight))


def test_an_untouched_head_leaves_the_box_nearly_as_it_is() -> None:
    fields, batch = scene()
    found = look(head(stirred=False), fields, batch)
    moved = (found.center - CENTER) / EXTENTS
    grown = (found.extents / EXTENTS).log()
    assert moved.abs().max() < 0.1 and grown.abs().max() < 0.1
    for same in (moved, grown, found.quality, found.class_logits):  # whatever it looked at
        torch.testing.assert_close(same, same[:1].expand_as(same))
    assert found.quality.shape == (4,) and found.class_logits.shape == (4, N_CLASSES)


def test_sides_change_within_limits() -> None:
    found = look(head(size=100.0), *scene())
    grown = (found.extents / EXTENTS).log()
    assert grown.max().item() == pytest.approx(MAX_GROWTH)
    assert grown.min().item() == pytest.approx(-MAX_GROWTH)


def test_the_order_of_voxels_does_not_matter() -> None:
    fields, batch = scene()
    order = torch.randperm(len(batch.coords), generator=torch.Generator().manual_seed(0))
    shuffled = VoxelFields(**{name: value[order] for name, value in vars(fields).items()})
    found = look(head(), fields, batch)
    assert_equal(found, look(head(), shuffled, replace(batch, coords=batch.coords[order])))


def test_boxes_do_not_see_each_other() -> None:
    fields, batch = scene()
    found = look(head(), fields, batch)
    rows = torch.tensor([2, 3, 0])
    some = look(head(), fields, batch, CENTER[rows], FRAME[rows], EXTENTS[rows])
    assert_equal(BoxFields(*(value[rows] for value in vars(found).values())), some)


def test_boxes_of_one_frame_do_not_see_voxels_of_another() -> None:
    fields, batch = scene()
    found = look(head(), fields, batch)
    own = batch.coords[:, 0] == 1
    alone = VoxelFields(*(value[own] for value in vars(fields).values()))
    only = replace(batch, coords=batch.coords[own], remembered=batch.remembered[own])
    second = FRAME == 1
    some = look(head(), alone, only, CENTER[second], FRAME[second], EXTENTS[second])
    assert_equal(BoxFields(*(value[second] for value in vars(found).values())), some)


def test_a_shift_by_whole_voxels_shifts_the_box() -> None:
    fields, batch = scene()
    step = torch.tensor([3, 7, 2])
    shifted = replace(
        batch,
        coords=batch.coords + torch.cat([step.new_zeros(1), step]),
        floor_z=batch.floor_z + step[2] * SIZE_M,
        free_low=batch.free_low + step * SIZE_M,
    )
    center = CENTER.double() + step * SIZE_M
    before, after = look(head(), fields, batch), look(head(), fields, shifted, center)
    assert_equal(replace(before, center=before.center + step * SIZE_M), after)
    higher = look(head(), fields, replace(shifted, floor_z=batch.floor_z), center)
    assert (higher.quality - after.quality).abs().min() > 1e-5  # it sees where the floor is


@pytest.mark.parametrize("boxes", [slice(3, 4), slice(0, 0)])
def test_nothing_to_look_at(boxes: slice) -> None:
    """A box without voxels, and no box at all."""
    fields, batch = scene()
    net = head()
    features = fields.features.requires_grad_(True)
    found = look(net, fields, batch, CENTER[boxes], FRAME[boxes], EXTENTS[boxes])
    for value in vars(found).values():
        assert torch.isfinite(value).all() and len(value) == len(FRAME[boxes])
    total(found).backward()
    assert not features.grad.any()
    assert all(torch.isfinite(p.grad).all() for p in net.parameters() if p.grad is not None)


def test_gradients_reach_the_voxels_in_and_around_the_boxes_only() -> None:
    fields, batch = scene()
    for value in vars(fields).values():
        value.requires_grad_(True)
    total(look(head(), fields, batch)).backward()
    seen = voxels_inside(batch, around())[1].any(dim=0)
    assert 0.1 < seen.double().mean() < 0.9
    for name in ("features", "objectness", "center_offset", "class_logits"):
        grad = getattr(fields, name).grad
        touched = grad.reshape(len(grad), -1).any(dim=1)
        assert torch.equal(touched, seen), name
        assert torch.isfinite(grad).all()


def test_gradients_against_finite_differences() -> None:
    fields, batch = scene(voxels=60)
    net = head()

    def numbers(features: Tensor, objectness: Tensor, logits: Tensor) -> tuple[Tensor, ...]:
        given = replace(fields, features=features, objectness=objectness, class_logits=logits)
        return tuple(vars(look(net, given, batch)).values())

    inputs = (fields.features, fields.objectness, fields.class_logits)
    assert torch.autograd.gradcheck(numbers, tuple(v.requires_grad_(True) for v in inputs))


def test_a_view_into_the_box_and_one_that_ends_before_it_are_told_apart() -> None:
    """Cameras that look along x with a focal length of 2 pixels: free, hidden, or out of view."""
    fields, batch = scene()
    T_camera_grid = torch.zeros(2, 4, 4).double()
    for row, column, sign in ((0, 1, -1.0), (1, 2, -1.0), (2, 0, 1.0), (3, 3, 1.0)):
        T_camera_grid[:, row, column] = sign
    T_camera_grid[:, 0, 3], T_camera_grid[:, 1, 3] = 1.0, 1.0
    K = torch.tensor([[2.0, 0, 1.5], [0, 2.0, 1.5], [0, 0, 1]]).double().expand(2, 3, 3)
    found = [
        look(head(), fields, replace(batch, K=K, T_camera_grid=T_camera_grid, depth_m=depth))
        for depth in (torch.full((2, 4, 4), z).double() for z in (9.0, 0.2, 0.0))
    ]
    for one, other in ((0, 1), (1, 2), (0, 2)):
        gap = (found[one].quality - found[other].quality)[:3].abs()
        assert gap.min() > 1e-4
