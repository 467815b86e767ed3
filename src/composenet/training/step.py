"""One training step: network, proposals, losses. Works under DistributedDataParallel."""

from __future__ import annotations

import dataclasses

import torch
from torch import Tensor, nn

from composenet.detection import Proposals, propose
from composenet.network.model import ComposeNet
from composenet.training.config import TrainingConfig
from composenet.training.losses import (
    PoseErrors,
    detection_losses,
    heading_teacher,
    object_losses,
)
from composenet.training.proposals import training_crops
from composenet.training.targets import TrainingBatch

POSE_LOSSES = ("rotation", "scale", "translation")


class LossModule(nn.Module):
    """The network with its losses, so that one forward serves one process or many."""

    def __init__(self, config: TrainingConfig) -> None:
        super().__init__()
        self.config = config
        self.network = ComposeNet(config.model.network, config.model.volume)

    def forward(
        self, batch: TrainingBatch, joint: bool, generator: torch.Generator
    ) -> tuple[dict[str, Tensor], PoseErrors]:
        """Unweighted losses by name. joint: second stage (gradients reach the backbone through
        the object network, which sees the detector's proposals too)."""
        fields = self.network.voxel_fields(batch.volume)
        losses = detection_losses(fields, batch)
        proposals: tuple[Proposals, ...] = ()
        if joint:
            proposals = propose(fields, batch.volume, self.config.model.detection)
        margin = self.config.model.network.crop_margin
        boxes = training_crops(batch, proposals, margin, self.config.max_boxes, generator)
        given = fields if joint else fields.detach()
        teacher = heading_teacher(batch, boxes, generator)
        objects = self.network.object_fields(given, batch.volume, boxes.crops, teacher)
        more, errors = object_losses(objects, batch, boxes)
        if not joint:  # correspondences must make sense before a pose is fitted to them
            more = {k: v for k, v in more.items() if k not in POSE_LOSSES}
        return losses | more, errors


def weighted_sum(losses: dict[str, Tensor], config: TrainingConfig) -> Tensor:
    """The scalar that is minimised."""
    weights = dataclasses.asdict(config.weights)
    weights["class"] = weights.pop("classes")
    return torch.stack([weights[name] * value for name, value in losses.items()]).sum()
