"""Per-voxel objectness, centre offset, extent, class (paper section 4.1)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import torch
from torch import Tensor, nn

VOXELS_PER_UNIT = 10.0
"""Offsets and extents are predicted in units of ten voxels: heads learn those faster."""
TYPICAL_EXTENT_VOXELS = 20.0


@dataclass(frozen=True)
class VoxelFields:
    """Predictions of N voxels. features: (N, F). objectness: (N,) logits. center_offset: (N, 3)
    voxels, from the voxel's centre. extents: (N, 3) voxels, full. class_logits: (N, n_classes).
    """

    features: Tensor
    objectness: Tensor
    center_offset: Tensor
    extents: Tensor
    class_logits: Tensor

    def detach(self) -> VoxelFields:
        """The same numbers without gradient."""
        return VoxelFields(**{name: value.detach() for name, value in vars(self).items()})


class DetectionHead(nn.Module):
    """Small perceptrons over the backbone's features."""

    def __init__(self, c_in: int, n_classes: int) -> None:
        super().__init__()

        def head(c_out: int) -> nn.Sequential:
            return nn.Sequential(nn.Linear(c_in, 2 * c_in), nn.ReLU(), nn.Linear(2 * c_in, c_out))

        self.objectness, self.offset = head(1), head(3)
        self.extent, self.classes = head(3), head(n_classes)
        nn.init.constant_(
            cast(nn.Linear, self.objectness[2]).bias, -1.0
        )  # most surfaces are walls and floor

    def forward(self, features: Tensor) -> VoxelFields:
        extents = TYPICAL_EXTENT_VOXELS + VOXELS_PER_UNIT * self.extent(features)
        return VoxelFields(
            features=features,
            objectness=self.objectness(features)[:, 0],
            center_offset=VOXELS_PER_UNIT * self.offset(features),
            extents=torch.clamp(extents, min=1.0),
            class_logits=self.classes(features),
        )
