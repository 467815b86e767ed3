"""A camera that looks straight along the grid, at walls."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from composenet.network.batch import NO_COLOR, VolumeBatch
from composenet.volume.voxels import FEATURE_NAMES

EYE = torch.tensor([0.2, 1.5, 1.0])


def looking_along_x(depth_m: np.ndarray) -> VolumeBatch:
    """Frames (B, H, W) of a camera at EYE that looks along the grid's x, 60 degrees wide."""
    depth = torch.as_tensor(depth_m, dtype=torch.float32)
    count, height, width = depth.shape
    focal = width / 2 / np.tan(np.radians(30))
    K = torch.tensor([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1.0]])
    T = torch.eye(4)
    T[:3, :3] = torch.tensor([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
    T[:3, 3] = -T[:3, :3] @ EYE
    return VolumeBatch(
        coords=torch.zeros(1, 4, dtype=torch.long),
        features=torch.zeros(1, len(FEATURE_NAMES)),
        remembered=torch.zeros(1, dtype=torch.bool),
        free=torch.zeros(count, 1, 1, 1, dtype=torch.bool),
        free_low=torch.zeros(count, 3),
        depth_m=depth,
        color=torch.full((*depth.shape, 3), NO_COLOR, dtype=torch.uint8),
        K=K.float().expand(count, 3, 3),
        T_camera_grid=T.expand(count, 4, 4),
        floor_z=torch.zeros(count),
        voxel_size_m=0.05,
    )


def wall(distance_m: float = 2.0, width: int = 320) -> np.ndarray:
    """(1, H, W) depth of a wall the camera faces."""
    return np.full((1, width * 3 // 4, width), distance_m, np.float32)


def painted(batch: VolumeBatch, seed: int = 0) -> VolumeBatch:
    """The batch with any colours, smooth over eight columns."""
    g = torch.Generator().manual_seed(seed)
    count, height, width = batch.depth_m.shape
    columns = torch.randint(0, 256, (count, 1, width // 8, 3), generator=g).byte()
    return replace(batch, color=columns.repeat_interleave(8, dim=2).expand(count, height, width, 3))
