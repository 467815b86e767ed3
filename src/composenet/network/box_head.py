"""Second look at a box: its class, its quality and a better box.

A small PointNet (Qi et al. 2017) over the surface voxels in and around the box, a small dense
network over the space there, which tells where an object ends from where its view ends, and another
over what the depth image shows of it (`BoxView`). The paper stops at the clusters' means; a look at
all voxels of a box at once corrects boxes that hug the visible part.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import cast

import torch
from torch import Tensor, nn

from composenet.network.batch import CropBatch, VolumeBatch
from composenet.network.box_view import BoxView
from composenet.network.crop_inputs import N_CHANNELS, crop_inputs
from composenet.network.detection_head import VoxelFields

CONTEXT = 1.5
"""The head looks at the voxels of the box grown by this factor."""
SPACE_CELLS = 8
"""Cells a side of the space that is looked at."""
MAX_GROWTH = 1.1
"""Sides change at most by exp of this, up and down."""


@dataclass(frozen=True)
class BoxFields:
    """Predictions for M boxes, grid frame. center, extents: (M, 3) metres, axis-aligned, of the
    whole object. quality: (M,) logits that the box is right. class_logits: (M, n_classes)."""

    center: Tensor
    extents: Tensor
    quality: Tensor
    class_logits: Tensor


def voxels_inside(batch: VolumeBatch, crops: CropBatch) -> tuple[Tensor, Tensor]:
    """(M, N, 3) places of the voxels in every crop, 0..1 along its sides, and (M, N) bool which
    voxels lie in it."""
    centers = batch.coords[:, 1:].to(crops.center.dtype) * batch.voxel_size_m
    shares = crops.shares(centers)
    inside = (shares >= 0).all(-1) & (shares < 1).all(-1)
    return shares, inside & (batch.coords[None, :, 0] == crops.frame[:, None])


def pool_by_box(values: Tensor, box: Tensor, weight: Tensor, n_boxes: int) -> Tensor:
    """(P, F) values of voxels of boxes -> (n_boxes, 2F): largest and weighted mean, zero where a
    box is empty. box: (P,) int64, ascending; weight: (P, 1) >= 0."""
    largest = values.new_zeros(n_boxes, values.shape[1])
    if values.device.type == "cpu":  # a scatter's backward pass takes twice as long
        filled, counts = torch.unique_consecutive(box, return_counts=True)
        if len(filled):
            parts = torch.stack([part.amax(dim=0) for part in values.split(counts.tolist())])
            largest = largest.index_copy(0, filled, parts)
    else:  # and here it is one kernel for some hundreds
        index = box[:, None].expand_as(values)
        largest = largest.scatter_reduce(0, index, values, "amax", include_self=False)
    total = values.new_zeros(n_boxes, 1).index_add(0, box, weight)
    mean = values.new_zeros(n_boxes, values.shape[1]).index_add(0, box, weight * values)
    return torch.cat([largest, mean / total.clamp_min(1e-6)], dim=1)


class BoxHead(nn.Module):
    """Voxel fields and boxes -> BoxFields."""

    def __init__(self, c_features: int, n_classes: int) -> None:
        super().__init__()
        unit = partial(nn.LeakyReLU, 0.01)  # units that are off have a gradient still
        self.voxel = nn.Linear(c_features, 64)  # once a voxel, however many boxes it is in
        self.place = nn.Linear(11, 64)
        self.point = nn.Sequential(
            nn.LayerNorm(64), unit(), nn.Linear(64, 128), nn.LayerNorm(128), unit()
        )
        self.space = nn.Sequential(
            nn.Conv3d(N_CHANNELS, 16, 3, padding=1),
            unit(),
            nn.Conv3d(16, 32, 3, stride=2, padding=1),
            unit(),
            nn.Flatten(),
            nn.Linear(32 * (SPACE_CELLS // 2) ** 3, 64),
            unit(),
        )
        self.view = BoxView(64)
        self.box = nn.Sequential(
            nn.Linear(2 * 128 + 5 + n_classes + 64 + 64, 128),
            unit(),
            nn.Linear(128, 7 + n_classes),
        )
        nn.init.zeros_(cast(nn.Linear, self.box[2]).weight)  # at first the box as it is

    def forward(
        self,
        fields: VoxelFields,
        batch: VolumeBatch,
        center: Tensor,
        extents: Tensor,
        frame: Tensor,
        truncation_m: float,
    ) -> BoxFields:
        """center, extents: (M, 3) metres, grid frame. frame: (M,) int64. truncation_m: of the
        signed distance field (see `crop_inputs`)."""
        around = CropBatch(frame, center, CONTEXT * extents, torch.zeros_like(center[:, 0]))
        box, row = torch.nonzero(voxels_inside(batch, around)[1], as_tuple=True)
        place = batch.coords[row, 1:].to(center.dtype) * batch.voxel_size_m
        offset = place - center[box]
        vote = offset + fields.center_offset[row] * batch.voxel_size_m
        objectness = fields.objectness[row, None].sigmoid()
        height = place[:, 2:] - batch.floor_z[frame][box, None]
        known = [offset, offset / extents[box], vote / extents[box], height, objectness]
        voxels = self.voxel(fields.features).index_select(0, row)
        points = self.point(voxels + self.place(torch.cat(known, dim=1)))
        pooled = pool_by_box(points, box, objectness, len(frame))
        votes = pool_by_box(fields.class_logits[row].softmax(dim=1), box, objectness, len(frame))
        above = center[:, 2:] - batch.floor_z[frame][:, None]
        count = torch.bincount(box, minlength=len(frame)).to(center.dtype)[:, None]
        n_classes = fields.class_logits.shape[1]
        space = self.space(crop_inputs(batch, around, SPACE_CELLS, truncation_m)[0])
        view = self.view(batch, frame, center, extents)
        sizes = [extents.log(), above, (1 + count).log() / 5]
        summary = [pooled, votes[:, n_classes:], *sizes, space, view]
        out = self.box(torch.cat(summary, dim=1))
        return BoxFields(
            center=center + extents * out[:, :3],
            extents=extents * out[:, 3:6].clamp(-MAX_GROWTH, MAX_GROWTH).exp(),
            quality=out[:, 6],
            class_logits=out[:, 7:],
        )
