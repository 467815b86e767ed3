"""Dense network of one object: completion and canonical correspondences (paper sections 4.2, 4.3).

Each box is sampled onto one fixed grid, so that boxes of all sizes batch (RoI-align in 3D).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

import torch
from torch import Tensor, nn

from composenet.network.batch import CropBatch, VolumeBatch
from composenet.network.detection_head import HEADING_BINS, VoxelFields
from composenet.volume.tsdf import projective_tsdf

Teacher = Callable[[Tensor], Tensor]
"""(M, HEADING_BINS) logits -> (M,) heading in radians to build the correspondences on."""


@dataclass(frozen=True)
class ObjectFields:
    """Predictions of M crops of C cells a side.

    occupancy: (M, C, C, C) logits. nocs: (M, 3, C/2, C/2, C/2) canonical coordinates. surface:
    (M, C, C, C) bool, cells on the observed surface. quality: (M,) logits of how well the crop
    holds an object. class_logits: (M, n_classes). heading_logits: (M, HEADING_BINS) of the yaw of
    the object's front in the grid frame; bin k is centred at k * 360 / HEADING_BINS degrees.
    """

    occupancy: Tensor
    nocs: Tensor
    surface: Tensor
    quality: Tensor
    class_logits: Tensor
    heading_logits: Tensor


def voxels_inside(batch: VolumeBatch, crops: CropBatch) -> tuple[Tensor, Tensor]:
    """(M, N, 3) places of the voxels in every crop, 0..1 along its sides, and (M, N) bool which
    voxels lie in it."""
    centers = batch.coords[:, 1:].to(crops.center.dtype) * batch.voxel_size_m
    low = crops.center - crops.size / 2
    relative = (centers[None] - low[:, None]) / crops.size[:, None]
    inside = (relative >= 0).all(-1) & (relative < 1).all(-1)
    return relative, inside & (batch.coords[None, :, 0] == crops.frame[:, None])


def scatter_features(features: Tensor, relative: Tensor, inside: Tensor, cells: int) -> Tensor:
    """Mean feature of the voxels in every crop cell, zero where there are none.

    features: (N, F) -> (M, F, cells, cells, cells). Sparse-to-dense mapping of the paper.
    relative, inside: of voxels_inside.
    """
    box, row = torch.nonzero(inside, as_tuple=True)
    cell = (relative[box, row] * cells).long().clamp_(0, cells - 1)
    slot = ((box * cells + cell[:, 0]) * cells + cell[:, 1]) * cells + cell[:, 2]
    n_slots = len(inside) * cells**3
    sums = features.new_zeros(n_slots, features.shape[1]).index_add(0, slot, features[row])
    ones = features.new_ones(len(slot), 1)
    count = features.new_zeros(n_slots, 1).index_add(0, slot, ones)
    mean = sums / count.clamp_min(1)
    return mean.view(-1, cells, cells, cells, features.shape[1]).permute(0, 4, 1, 2, 3)


def voted_headings(fields: VoxelFields, inside: Tensor) -> Tensor:
    """(M, HEADING_BINS) log of the mean heading probability of a crop's object voxels."""
    weight = inside * fields.objectness.sigmoid()
    total = weight.sum(dim=1, keepdim=True)
    votes = weight @ fields.heading_logits.softmax(dim=1)
    return ((votes + 1e-3) / (total + 1e-3 * HEADING_BINS)).log()


def crop_inputs(
    batch: VolumeBatch, crops: CropBatch, cells: int, truncation_m: float
) -> tuple[Tensor, Tensor]:
    """Field samples (M, 2, cells^3 as a cube): tsdf and observed; and the surface mask."""
    points = crops.points(cells)
    tsdf, observed = projective_tsdf(
        points,
        batch.depth_m[crops.frame],
        batch.K[crops.frame],
        batch.T_camera_grid[crops.frame],
        truncation_m,
    )
    reach = crops.size.amax(dim=1, keepdim=True) / cells / truncation_m
    surface = observed & (tsdf.abs() < reach.clamp(max=0.99))
    cube = (-1, 1, cells, cells, cells)
    samples = torch.cat([tsdf.view(cube), observed.to(tsdf.dtype).view(cube)], dim=1)
    return samples, surface.view(-1, cells, cells, cells)


def _position_channels(batch: VolumeBatch, crops: CropBatch, cells: int) -> Tensor:
    """(M, 4, ...) metric position of the cells: from the crop's centre, and above the floor."""
    points = crops.points(cells)
    local = points - crops.center[:, None]
    height = points[..., 2:] - batch.floor_z[crops.frame][:, None, None]
    return torch.cat([local, height], -1).transpose(1, 2).reshape(-1, 4, cells, cells, cells)


def likeliest_heading(logits: Tensor) -> Tensor:
    """(M,) radians: the centre of the strongest bin."""
    return logits.argmax(dim=1).to(logits.dtype) * (2 * math.pi / HEADING_BINS)


def _anchor(position: Tensor, crops: CropBatch, heading: Tensor, margin: float) -> Tensor:
    """(M, 3, ...) canonical coordinates the cells would have, were the object centred in the
    crop, turned by its heading and as large as the crop without its margin."""
    diagonal = crops.size.norm(dim=1) / margin
    x, y, z = position[:, 0], position[:, 1], position[:, 2]
    shape = (-1, 1, 1, 1)
    c, s, d = heading.cos().view(shape), heading.sin().view(shape), diagonal.view(shape)
    return torch.stack([(c * x + s * y) / d, (c * y - s * x) / d, z / d], dim=1)


def _conv(c_in: int, c_out: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv3d(c_in, c_out, 3, padding=1, bias=False), nn.BatchNorm3d(c_out), nn.ReLU()
    )


def _down(c_in: int, c_out: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv3d(c_in, c_out, 2, stride=2, bias=False), nn.BatchNorm3d(c_out), nn.ReLU()
    )


def _up(c_in: int, c_out: int) -> nn.Sequential:
    return nn.Sequential(
        nn.ConvTranspose3d(c_in, c_out, 2, stride=2, bias=False), nn.BatchNorm3d(c_out), nn.ReLU()
    )


class ObjectNet(nn.Module):
    """Encoder-decoder over the fused crop, then the heads."""

    def __init__(
        self, c_features: int, channels: tuple[int, ...], n_classes: int, cells: int
    ) -> None:
        super().__init__()
        c1, c2, c3 = channels
        self.embed_features = nn.Linear(c_features, c1)
        self.embed_tsdf = nn.Conv3d(2, c1, 2, stride=2)
        self.embed_position = nn.Conv3d(4, c1, 1)
        self.encode1 = _conv(c1, c1)
        self.encode2 = nn.Sequential(_down(c1, c2), _conv(c2, c2), _conv(c2, c2))
        self.encode3 = nn.Sequential(_down(c2, c3), _conv(c3, c3), _conv(c3, c3))
        self.up2, self.decode2 = _up(c3, c2), nn.Sequential(_conv(2 * c2, c2), _conv(c2, c2))
        self.up1, self.decode1 = _up(c2, c1), _conv(2 * c1, c1)
        fill = nn.ConvTranspose3d(c1, 1, 2, stride=2)
        nn.init.constant_(cast(Tensor, fill.bias), -2.0)  # most cells are empty
        self.completion = nn.Sequential(_conv(c1, c1), fill)
        self.correspondence = nn.Sequential(_conv(c1 + 4, c1), nn.Conv3d(c1, 3, 1))
        self.classify = nn.Sequential(
            nn.Linear(2 * c3, c3), nn.ReLU(), nn.Linear(c3, n_classes + 1)
        )
        self.heading = nn.Sequential(  # where things are tells the heading: no pooling
            nn.Flatten(),
            nn.Linear(c3 * (cells // 8) ** 3, c3),
            nn.ReLU(),
            nn.Linear(c3, HEADING_BINS),
        )

    def forward(
        self,
        fields: VoxelFields,
        batch: VolumeBatch,
        crops: CropBatch,
        cells: int,
        truncation_m: float,
        margin: float,
        teacher: Teacher = likeliest_heading,
    ) -> ObjectFields:
        """Fields of every crop. The correspondences are a dense correction of an anchor turned by
        the heading: front and back are a choice between bins, not a mean of both."""
        samples, surface = crop_inputs(batch, crops, cells, truncation_m)
        position = _position_channels(batch, crops, cells // 2)
        relative, inside = voxels_inside(batch, crops)
        embedded = self.embed_features(fields.features)
        sparse = scatter_features(embedded, relative, inside, cells // 2)
        x = sparse + self.embed_tsdf(samples) + self.embed_position(position)
        x1 = self.encode1(torch.relu(x))
        x2 = self.encode2(x1)
        x3 = self.encode3(x2)
        y2 = self.decode2(torch.cat([x2, self.up2(x3)], dim=1))
        y1 = self.decode1(torch.cat([x1, self.up1(y2)], dim=1))
        pooled = torch.cat([x3.mean(dim=(2, 3, 4)), x3.amax(dim=(2, 3, 4))], dim=1)
        summary = self.classify(pooled)
        headings = self.heading(x3) + voted_headings(fields, inside)
        anchor = _anchor(position, crops, teacher(headings.detach()), margin)
        given = torch.cat([y1, anchor, position[:, 3:]], dim=1)
        return ObjectFields(
            occupancy=self.completion(y1)[:, 0],
            nocs=anchor + self.correspondence(given),
            surface=surface,
            quality=summary[:, 0],
            class_logits=summary[:, 1:],
            heading_logits=headings,
        )
