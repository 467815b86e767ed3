"""Boxes that training looks at: jittered true boxes, of furniture and of what is none, random ones,
the detector's own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from composenet.detection import BOX_LIMITS_M, Proposals, frames_of
from composenet.geometry.aligned_boxes import pairwise_iou
from composenet.network.batch import CropBatch
from composenet.training.targets import TrainingBatch

POSITIVE_IOU = 0.1
"""From this box IoU on, a box is taught the object's box: many objects have no better to begin
with."""
CROP_IOU = 0.25
"""From this box IoU on, geometry and pose are taught."""
JITTERED = 1
"""Jittered copies of every true box, and of every box of what is no furniture."""
RANDOM = 1
"""Random boxes a frame, on average."""


@dataclass(frozen=True)
class TrainingBoxes:
    """M boxes, grid frame. frame: (M,). center, extents: (M, 3) metres. rows: (M,) object of the
    batch that overlaps most. iou: (M,) with that one's box, 0 where there is none."""

    frame: Tensor
    center: Tensor
    extents: Tensor
    rows: Tensor
    iou: Tensor

    @staticmethod
    def matched(
        batch: TrainingBatch, frame: Tensor, center: Tensor, extents: Tensor
    ) -> TrainingBoxes:
        """Boxes with the objects they show."""
        if len(batch.frame) == 0:
            zeros = torch.zeros_like(frame)
            return TrainingBoxes(frame, center, extents, zeros, zeros.to(center.dtype))
        iou = pairwise_iou(center, extents, batch.center, batch.extents)
        iou = torch.where(frame[:, None] == batch.frame[None], iou, torch.zeros_like(iou))
        best, rows = iou.max(dim=1)
        return TrainingBoxes(frame, center, extents, rows, best)

    @property
    def positive(self) -> Tensor:
        """(M,) bool: shows its object."""
        return self.iou >= POSITIVE_IOU

    def __getitem__(self, rows: Tensor) -> TrainingBoxes:
        """Some of the boxes."""
        return TrainingBoxes(*(value[rows] for value in vars(self).values()))

    def crops(self, margin: float) -> CropBatch:
        """What the object network looks into."""
        return CropBatch.around(self.frame, self.center, self.extents, margin)


def training_boxes(
    batch: TrainingBatch, proposals: Sequence[Proposals], generator: torch.Generator
) -> TrainingBoxes:
    """Jittered boxes of every object and of every other thing, random boxes, and the proposals of
    every frame."""
    device = batch.center.device

    def noise(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator).to(device)

    true_center = torch.cat([batch.center, batch.other_boxes[:, :3]]).repeat(JITTERED, 1)
    true_extents = torch.cat([batch.extents, batch.other_boxes[:, 3:]]).repeat(JITTERED, 1)
    frames = [torch.cat([batch.frame, batch.other_frame]).repeat(JITTERED)]
    spread = 0.2 * torch.rand(len(true_center), 1, generator=generator).to(device)
    centers = [true_center + spread * true_extents * noise(len(true_center), 3)]
    extents = [true_extents * torch.exp(1.5 * spread * noise(len(true_center), 3))]
    sites = batch.volume.coords
    pick = torch.randint(len(sites), (RANDOM * batch.volume.size,), generator=generator).to(device)
    frames.append(sites[pick, 0])
    centers.append(sites[pick, 1:] * batch.volume.voxel_size_m + 0.2 * noise(len(pick), 3))
    extents.append(0.9 * torch.exp(0.5 * noise(len(pick), 3)))
    frames.append(frames_of(proposals).to(device))
    centers += [own.center for own in proposals]
    extents += [own.extents for own in proposals]
    return TrainingBoxes.matched(
        batch, torch.cat(frames), torch.cat(centers), torch.cat(extents).clamp(*BOX_LIMITS_M)
    )


def chosen_objects(boxes: TrainingBoxes, max_crops: int, generator: torch.Generator) -> Tensor:
    """Rows of at most max_crops boxes a frame that show an object well enough to complete it, no
    object twice; int64."""
    kept: list[int] = []
    taken: set[int] = set()
    room: dict[int, int] = {}
    order = torch.randperm(len(boxes.frame), generator=generator)
    shown, frame, rows = (boxes.iou >= CROP_IOU).tolist(), boxes.frame.tolist(), boxes.rows.tolist()
    for i in order.tolist():
        left = room.setdefault(frame[i], max_crops)
        if shown[i] and rows[i] not in taken and left:
            kept.append(i)
            taken.add(rows[i])
            room[frame[i]] -= 1
    return torch.tensor(kept, dtype=torch.long, device=boxes.frame.device)
