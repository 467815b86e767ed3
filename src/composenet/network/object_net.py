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
from torch.nn import functional as F

from composenet.network.batch import CropBatch, VolumeBatch
from composenet.network.box_head import voxels_inside
from composenet.network.crop_inputs import N_CHANNELS, crop_inputs
from composenet.network.detection_head import VoxelFields

HEADING_BINS = 12
"""Yaw of an object's front in the grid frame; bin k is centred at k * 30 degrees. Divisible by 2
and 4, so that symmetric turns map bins onto bins."""

Teacher = Callable[[Tensor], Tensor]
"""(M, HEADING_BINS) logits -> (M,) heading in radians to build the correspondences on."""


@dataclass(frozen=True)
class ObjectFields:
    """Predictions of M crops of C cells a side.

    crops: the boxes, turned by the heading that was taken. occupancy: (M, C, C, C) logits. nocs:
    (M, 3, C/2, C/2, C/2) canonical coordinates. surface: (M, C, C, C) bool, cells on the observed
    surface. heading_logits: (M, HEADING_BINS) of the yaw of the object's front in the grid.
    """

    crops: CropBatch
    occupancy: Tensor
    nocs: Tensor
    surface: Tensor
    heading_logits: Tensor


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


def _position_channels(batch: VolumeBatch, crops: CropBatch, cells: int) -> Tensor:
    """(M, 4, ...) metric position of the cells: from the crop's centre in its own axes, and
    above the floor."""
    local = crops.local_points(cells)
    above = crops.center[:, 2] - batch.floor_z[crops.frame]
    height = local[..., 2:] + above[:, None, None]
    return torch.cat([local, height], -1).transpose(1, 2).reshape(-1, 4, cells, cells, cells)


def likeliest_heading(logits: Tensor) -> Tensor:
    """(M,) radians: within the strongest bin the top of the parabola through it and the bins
    beside it."""
    top = logits.argmax(dim=1, keepdim=True)
    before, at, after = (logits.gather(1, (top + k) % HEADING_BINS)[:, 0] for k in (-1, 0, 1))
    bend = (2 * at - before - after).clamp_min(1e-6)
    share = ((after - before) / (2 * bend)).clamp(-0.5, 0.5)
    return (top[:, 0] + share) * (2 * math.pi / HEADING_BINS)


def stretched(probability: Tensor, threshold: float) -> Tensor:
    """Probabilities 0..1 of any shape, so that the threshold lies at 0.5 and 0 and 1 stay."""
    low = 0.5 * probability / threshold
    high = 0.5 + 0.5 * (probability - threshold) / (1 - threshold)
    return torch.where(probability < threshold, low, high)


def fit_weights(shown: Tensor) -> Tensor:
    """(M, C, C, C) occupancy, 0.5 being the decision -> (M, (C/2)^3) weights of the correspondences
    in the fit of the pose: the largest occupancy within, from 0.5 on."""
    coarse = F.max_pool3d(shown[:, None], 2)[:, 0].flatten(1)
    return coarse * (coarse >= 0.5)


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


class HeadingNet(nn.Module):
    """Scores how well the object in a crop faces the crop's +x. Applied to the crop turned to
    every bin with the same weights, so that a turn of the object shifts the scores: what is
    learned from one heading holds for all."""

    CELLS = 16

    def __init__(self, n_classes: int) -> None:
        super().__init__()
        self.encode = nn.Sequential(
            nn.Conv3d(N_CHANNELS, 16, 3, stride=2, padding=1, bias=False),
            nn.BatchNorm3d(16),
            nn.ReLU(),
            nn.Conv3d(16, 32, 3, stride=2, padding=1, bias=False),
            nn.BatchNorm3d(32),
            nn.ReLU(),
            _conv(32, 32),
            nn.Flatten(),
            nn.Linear(32 * (self.CELLS // 4) ** 3, 64),
        )
        self.score = nn.Sequential(
            nn.ReLU(), nn.Linear(64 + n_classes + 3, 64), nn.ReLU(), nn.Linear(64, 1)
        )

    def forward(
        self, batch: VolumeBatch, crops: CropBatch, classes: Tensor, truncation_m: float
    ) -> Tensor:
        """(M, HEADING_BINS) logits. classes: (M, n_classes) probabilities."""
        m = len(crops.frame)
        every = torch.arange(m, device=classes.device).repeat_interleave(HEADING_BINS)
        yaw = torch.arange(HEADING_BINS, device=classes.device).repeat(m)
        turned = crops[every].turned(yaw.to(classes.dtype) * (2 * math.pi / HEADING_BINS))
        samples, _ = crop_inputs(batch, turned, self.CELLS, truncation_m)
        known = torch.cat([classes, crops.size], dim=1)[every]
        scores = self.score(torch.cat([self.encode(samples), known], dim=1))
        return scores.view(m, HEADING_BINS)


class ObjectNet(nn.Module):
    """Encoder-decoder over the fused crop, then the heads."""

    def __init__(self, c_features: int, channels: tuple[int, ...], n_classes: int) -> None:
        super().__init__()
        c1, c2, c3 = channels
        self.embed_features = nn.Linear(c_features, c1)
        self.embed_tsdf = nn.Conv3d(N_CHANNELS, c1, 2, stride=2)
        self.embed_position = nn.Conv3d(4, c1, 1)
        self.encode1 = _conv(c1, c1)
        self.encode2 = nn.Sequential(_down(c1, c2), _conv(c2, c2), _conv(c2, c2))
        self.encode3 = nn.Sequential(_down(c2, c3), _conv(c3, c3), _conv(c3, c3))
        self.up2, self.decode2 = _up(c3, c2), nn.Sequential(_conv(2 * c2, c2), _conv(c2, c2))
        self.up1, self.decode1 = _up(c2, c1), _conv(2 * c1, c1)
        fill = nn.ConvTranspose3d(2 * c1, 1, 2, stride=2)
        nn.init.constant_(cast(Tensor, fill.bias), -2.0)  # most cells are empty
        self.completion = nn.Sequential(nn.Conv3d(c1, 2 * c1, 1), nn.ReLU(), fill)
        self.correspondence = nn.Sequential(
            nn.Conv3d(c1 + 4, 2 * c1, 1), nn.ReLU(), nn.Conv3d(2 * c1, 3, 1)
        )
        self.heading = HeadingNet(n_classes)
        self.to(memory_format=torch.channels_last_3d)  # type: ignore[call-overload]

    def forward(
        self,
        fields: VoxelFields,
        batch: VolumeBatch,
        crops: CropBatch,
        classes: Tensor,
        cells: int,
        truncation_m: float,
        margin: float,
        teacher: Teacher = likeliest_heading,
    ) -> ObjectFields:
        """Fields of every crop, which is turned to the heading first: completion happens in
        nearly canonical axes, and the correspondences are a dense correction of the crop's own
        coordinates over its diagonal. Front and back are a choice between bins, not a mean.
        classes: (M, n_classes) probabilities."""
        headings = self.heading(batch, crops, classes, truncation_m)
        crops = crops.turned(teacher(headings.detach()))
        samples, surface = crop_inputs(batch, crops, cells, truncation_m)
        position = _position_channels(batch, crops, cells // 2)
        embedded = self.embed_features(fields.features)
        sparse = scatter_features(embedded, *voxels_inside(batch, crops), cells // 2)
        x = sparse + self.embed_tsdf(samples) + self.embed_position(position)
        x1 = self.encode1(torch.relu(x).contiguous(memory_format=torch.channels_last_3d))
        x2 = self.encode2(x1)
        x3 = self.encode3(x2)
        y2 = self.decode2(torch.cat([x2, self.up2(x3)], dim=1))
        y1 = self.decode1(torch.cat([x1, self.up1(y2)], dim=1))
        anchor = position[:, :3] * (margin / crops.size.norm(dim=1)).view(-1, 1, 1, 1, 1)
        correction = self.correspondence(torch.cat([y1, position], dim=1))
        return ObjectFields(
            crops=crops,
            occupancy=self.completion(y1)[:, 0],
            nocs=anchor + correction,
            surface=surface,
            heading_logits=headings,
        )
