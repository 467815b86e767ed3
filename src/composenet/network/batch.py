"""Volumes of several frames as tensors, and boxes to crop from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from composenet.volume.voxels import Volume


@dataclass(frozen=True)
class VolumeBatch:
    """B frames. Grid frame of each, metres.

    coords: (N, 4) int64 rows of (frame, x, y, z). features: (N, C). depth_m: (B, H, W).
    K: (B, 3, 3). T_camera_grid: (B, 4, 4). floor_z: (B,) z of the world's floor plane (z = 0)
    in the grid frame.
    """

    coords: Tensor
    features: Tensor
    depth_m: Tensor
    K: Tensor
    T_camera_grid: Tensor
    floor_z: Tensor
    voxel_size_m: float

    @property
    def size(self) -> int:
        """Number of frames."""
        return len(self.depth_m)

    def to(self, device: torch.device) -> VolumeBatch:
        """The same batch on another device."""
        moved: dict[str, Any] = {
            name: value.to(device, non_blocking=True) if isinstance(value, Tensor) else value
            for name, value in vars(self).items()
        }
        return VolumeBatch(**moved)


@dataclass(frozen=True)
class CropBatch:
    """M boxes to look into. frame: (M,) int64. center, size: (M, 3) metres, grid frame; size
    already includes the margin."""

    frame: Tensor
    center: Tensor
    size: Tensor

    def points(self, cells: int) -> Tensor:
        """(M, cells^3, 3) cell centres, grid frame, x slowest."""
        steps = (torch.arange(cells, device=self.center.device) + 0.5) / cells - 0.5
        unit = torch.stack(torch.meshgrid(steps, steps, steps, indexing="ij"), -1).view(-1, 3)
        return self.center[:, None] + unit * self.size[:, None]

    def points_of(self, i: int, cells: int) -> Tensor:
        """(cells^3, 3) cell centres of one box."""
        one = slice(i, i + 1)
        return CropBatch(self.frame[one], self.center[one], self.size[one]).points(cells)[0]


def collate(volumes: Sequence[Volume]) -> VolumeBatch:
    """Stack volumes; all need the same image size and voxel size."""
    rows = [
        np.concatenate([np.full((len(v.coords), 1), i), v.coords], axis=1)
        for i, v in enumerate(volumes)
    ]
    return VolumeBatch(
        coords=torch.from_numpy(np.concatenate(rows).astype(np.int64)),
        features=torch.from_numpy(np.concatenate([v.features for v in volumes])),
        depth_m=torch.from_numpy(np.stack([v.depth_m for v in volumes])),
        K=torch.from_numpy(np.stack([v.K for v in volumes]).astype(np.float32)),
        T_camera_grid=torch.from_numpy(
            np.stack([v.T_camera_grid for v in volumes]).astype(np.float32)
        ),
        floor_z=torch.tensor([-v.T_world_grid[2, 3] for v in volumes], dtype=torch.float32),
        voxel_size_m=volumes[0].voxel_size_m,
    )
