"""Boxes the object network is trained on: jittered true boxes, random ones, own proposals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from composenet.detection import Proposals
from composenet.network.batch import CropBatch
from composenet.training.targets import TrainingBatch

POSITIVE_IOU = 0.25
"""From this box IoU on, a crop is taught the object's geometry and pose."""


@dataclass(frozen=True)
class TrainingCrops:
    """M crops. rows: (M,) best overlapping object of the batch. iou: (M,) with its box.
    positive: (M,) bool."""

    crops: CropBatch
    rows: Tensor
    iou: Tensor
    positive: Tensor


def box_iou(center_a: Tensor, extents_a: Tensor, center_b: Tensor, extents_b: Tensor) -> Tensor:
    """(A, B) IoU of axis-aligned boxes."""
    low = torch.maximum((center_a - extents_a / 2)[:, None], (center_b - extents_b / 2)[None])
    high = torch.minimum((center_a + extents_a / 2)[:, None], (center_b + extents_b / 2)[None])
    shared = (high - low).clamp_min(0).prod(dim=-1)
    union = extents_a.prod(dim=-1)[:, None] + extents_b.prod(dim=-1)[None] - shared
    return shared / union.clamp_min(1e-9)


def training_crops(
    batch: TrainingBatch,
    proposals: Sequence[Proposals],
    margin: float,
    max_boxes: int,
    generator: torch.Generator,
) -> TrainingCrops:
    """At most max_boxes a frame: a jittered box for each object, one random box a frame, and
    the detector's own proposals while there is room."""
    device = batch.center.device

    def noise(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator).to(device)

    frames, centers, extents = [], [], []
    for index in range(batch.volume.size):
        rows = torch.nonzero(batch.frame == index)[:, 0]
        rows = rows[torch.randperm(len(rows), generator=generator).to(device)][: max_boxes - 1]
        n = len(rows)
        spread = 0.1 * torch.rand(n, 1, generator=generator).to(device) * 2
        own = batch.extents[rows]
        c = [batch.center[rows] + spread * own * noise(n, 3)]
        e = [own * torch.exp(1.5 * spread * noise(n, 3))]
        sites = torch.nonzero(batch.volume.coords[:, 0] == index)[:, 0]
        pick = sites[torch.randint(len(sites), (1,), generator=generator).to(device)]
        c.append(batch.volume.coords[pick, 1:] * batch.volume.voxel_size_m + 0.2 * noise(1, 3))
        e.append(0.9 * torch.exp(0.5 * noise(1, 3)))
        if proposals:
            c.append(proposals[index].center)
            e.append(proposals[index].extents)
        centers.append(torch.cat(c)[:max_boxes])
        extents.append(torch.cat(e)[:max_boxes])
        frames.append(torch.full((len(centers[-1]),), index, device=device))
    center, extent, frame = torch.cat(centers), torch.cat(extents), torch.cat(frames)
    extent = extent.clamp(0.15, 5.0)
    crops = CropBatch.around(frame, center, extent, margin)
    if len(batch.frame) == 0:
        zeros = torch.zeros(len(frame), device=device)
        return TrainingCrops(crops, zeros.long(), zeros, zeros.bool())
    iou = box_iou(center, extent, batch.center, batch.extents)
    iou = torch.where(frame[:, None] == batch.frame[None], iou, torch.zeros_like(iou))
    best, rows = iou.max(dim=1)
    return TrainingCrops(crops, rows, best, best >= POSITIVE_IOU)
