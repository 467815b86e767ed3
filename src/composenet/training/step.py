"""One training step: network, proposals, losses. Works under DistributedDataParallel."""

from __future__ import annotations

import dataclasses

import torch
from torch import Tensor, nn

from composenet.detection import Proposals, propose, second_look
from composenet.network.detection_head import VoxelFields
from composenet.network.model import ComposeNet
from composenet.training.config import TrainingConfig
from composenet.training.losses import (
    PoseErrors,
    box_losses,
    detection_losses,
    heading_teacher,
    object_losses,
)
from composenet.training.proposals import TrainingBoxes, chosen_objects, training_boxes
from composenet.training.targets import TrainingBatch

POSE_LOSSES = ("rotation", "scale", "translation", "fit_place")
OTHER_RADII_VOXELS = (3.0, 8.0)
"""Clusters of these radii are looked at too: pieces of objects, and neighbours taken for one."""
LOWEST_OBJECTNESS = 0.2
"""Clusters of voxels that are this unsure are looked at too: most are no furniture."""


class LossModule(nn.Module):
    """The network with its losses, so that one forward serves one process or many."""

    def __init__(self, config: TrainingConfig) -> None:
        super().__init__()
        self.config = config
        self.network = ComposeNet(config.model.network, config.model.volume)
        self.network.requires_grad_(False)
        for part in _learned(self.network, config):
            part.requires_grad_(True)
        self.train()

    def train(self, mode: bool = True) -> LossModule:
        """Training mode, except for what is held fixed."""
        super().train(mode)
        if self.config.parts in ("boxes", "objects"):
            self.network.backbone.eval()
        return self

    def forward(
        self, batch: TrainingBatch, joint: bool, generator: torch.Generator
    ) -> tuple[dict[str, Tensor], PoseErrors]:
        """Unweighted losses by name. joint: second stage (gradients reach the backbone through
        the object network, and boxes are corrected before it looks into them)."""
        config = self.config
        learns_voxels = config.parts in ("all", "apart", "detector")
        learns_boxes = config.parts != "objects"
        fields = self.network.voxel_fields(batch.volume)
        proposals: tuple[Proposals, ...] = ()
        if learns_boxes:
            proposals = self._proposals(fields, batch, generator)
        boxes = training_boxes(batch, proposals, generator)
        corrected = self.network.box_fields(
            fields, batch.volume, boxes.center, boxes.extents, boxes.frame
        )
        losses: dict[str, Tensor] = {}
        if learns_voxels:
            losses |= detection_losses(fields, batch)
        if learns_boxes:
            losses |= box_losses(corrected, batch, boxes)
        if config.parts in ("detector", "boxes"):
            return losses, PoseErrors.none(fields.objectness)
        if joint:
            boxes = TrainingBoxes.matched(
                batch, boxes.frame, corrected.center.detach(), corrected.extents.detach()
            )
        chosen = chosen_objects(boxes, config.max_crops, generator)
        rows = boxes.rows[chosen]
        objects = self.network.object_fields(
            fields if joint and config.parts != "apart" else fields.detach(),
            batch.volume,
            boxes[chosen].crops(config.model.network.crop_margin),
            corrected.class_logits[chosen].detach().softmax(dim=1),
            heading_teacher(batch, rows, generator),
        )
        more, errors = object_losses(objects, batch, rows, config.model.network.occupancy_threshold)
        if not joint:  # correspondences must make sense before a pose is fitted to them
            more = {k: v for k, v in more.items() if k not in POSE_LOSSES}
        return losses | more, errors

    def _proposals(
        self, fields: VoxelFields, batch: TrainingBatch, generator: torch.Generator
    ) -> tuple[Proposals, ...]:
        """What the detector finds with its own radius or another from a random objectness on, and
        what the second look makes of it: in tracking that is where it looks again (see
        `detection.remembered`)."""
        detection = self.config.model.detection
        radii = (detection.mean_shift_radius_voxels, *OTHER_RADII_VOXELS)
        radius = radii[int(torch.randint(len(radii), (), generator=generator))]
        sure = detection.objectness_threshold
        unsure = min(sure, LOWEST_OBJECTNESS)
        threshold = sure + float(torch.rand((), generator=generator)) * (unsure - sure)
        one = dataclasses.replace(
            detection,
            mean_shift_radius_voxels=radius,
            objectness_threshold=threshold,
            min_score=min(threshold, detection.min_score),
        )
        found = propose(fields, batch.volume, one)
        if not detection.use_tracks:
            return found
        again = second_look(self.network, fields, batch.volume, found, detection)
        return tuple(a + b for a, b in zip(found, again, strict=True))


def _learned(network: ComposeNet, config: TrainingConfig) -> tuple[nn.Module, ...]:
    """What config.parts trains."""
    if config.parts in ("all", "apart"):
        return (network,)
    if config.parts == "detector":
        return network.backbone, network.detection, network.boxes
    return (network.boxes,) if config.parts == "boxes" else (network.objects,)


def weighted_sum(losses: dict[str, Tensor], config: TrainingConfig) -> Tensor:
    """The scalar that is minimised."""
    weights = dataclasses.asdict(config.weights)
    weights["class"] = weights.pop("classes")
    return torch.stack([weights[name] * value for name, value in losses.items()]).sum()
