"""Volumes of several frames as tensors, and boxes to crop from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from composenet.geometry.affine import apply_affine
from composenet.volume.voxels import Volume


@dataclass(frozen=True)
class VolumeBatch:
    """B frames. Grid frame of each, metres.

    coords: (N, 4) int64 rows of (frame, x, y, z). features: (N, C). remembered: (N,) bool, voxels
    that only earlier frames saw. free: (B, X, Y, Z) bool cells of edge FREE_CELL_M seen to be
    empty, now or earlier. free_low: (B, 3) corners of the first ones, metres. depth_m: (B, H, W).
    K: (B, 3, 3). T_camera_grid: (B, 4, 4). floor_z: (B,) z of the world's floor plane (z = 0) in
    the grid frame.
    """

    coords: Tensor
    features: Tensor
    remembered: Tensor
    free: Tensor
    free_low: Tensor
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
    """M boxes to look into, grid frame. frame: (M,) int64. center, size: (M, 3) metres; size
    already includes the margin. yaw: (M,) radians by which the box is turned about z."""

    frame: Tensor
    center: Tensor
    size: Tensor
    yaw: Tensor

    @staticmethod
    def around(frame: Tensor, center: Tensor, extents: Tensor, margin: float) -> CropBatch:
        """Boxes around axis-aligned ones, square from above so that they can be turned."""
        side = extents[:, :2].amax(dim=1, keepdim=True)
        size = margin * torch.cat([side, side, extents[:, 2:]], dim=1)
        return CropBatch(frame, center, size, torch.zeros_like(center[:, 0]))

    def turned(self, yaw: Tensor) -> CropBatch:
        """The same boxes at other yaws, (M,) radians."""
        return CropBatch(self.frame, self.center, self.size, yaw)

    def __getitem__(self, rows: Tensor | slice) -> CropBatch:
        """Some of the boxes."""
        return CropBatch(self.frame[rows], self.center[rows], self.size[rows], self.yaw[rows])

    @property
    def R_grid_crop(self) -> Tensor:
        """(M, 3, 3) rotations by the yaws."""
        c, s = self.yaw.cos(), self.yaw.sin()
        o, i = torch.zeros_like(c), torch.ones_like(c)
        return torch.stack([c, -s, o, s, c, o, o, o, i], dim=1).view(-1, 3, 3)

    def local_points(self, cells: int) -> Tensor:
        """(M, cells^3, 3) cell centres in the box's own axes, from its centre, x slowest."""
        steps = (torch.arange(cells, device=self.center.device) + 0.5) / cells - 0.5
        unit = torch.stack(torch.meshgrid(steps, steps, steps, indexing="ij"), -1).view(-1, 3)
        return unit * self.size[:, None]

    def points(self, cells: int) -> Tensor:
        """(M, cells^3, 3) cell centres, grid frame."""
        return apply_affine(self.R_grid_crop, self.center, self.local_points(cells))

    def shares(self, points: Tensor) -> Tensor:
        """(M, P, 3) or (P, 3) grid points -> (M, P, 3) places in the box, 0..1 along its own
        axes."""
        A = self.R_grid_crop.transpose(1, 2) / self.size[:, :, None]
        return apply_affine(A, 0.5 - (A @ self.center[:, :, None])[..., 0], points)


def collate(volumes: Sequence[Volume]) -> VolumeBatch:
    """Stack volumes; all need the same image size and voxel size."""
    rows = [
        np.concatenate([np.full((len(v.coords), 1), i), v.coords], axis=1)
        for i, v in enumerate(volumes)
    ]
    spaces = [v.free.cells for v in volumes]
    free = np.zeros((len(spaces), *np.max([space.shape for space in spaces], axis=0)), np.bool_)
    for row, space in zip(free, spaces, strict=True):
        row[tuple(map(slice, space.shape))] = space
    return VolumeBatch(
        coords=torch.from_numpy(np.concatenate(rows).astype(np.int64)),
        features=torch.from_numpy(np.concatenate([v.features for v in volumes])),
        remembered=torch.from_numpy(
            np.concatenate([np.arange(len(v.coords)) >= v.n_seen for v in volumes])
        ),
        free=torch.from_numpy(free),
        free_low=torch.from_numpy(np.stack([v.free.low for v in volumes]).astype(np.float32)),
        depth_m=torch.from_numpy(np.stack([v.depth_m for v in volumes])),
        K=torch.from_numpy(np.stack([v.K for v in volumes]).astype(np.float32)),
        T_camera_grid=torch.from_numpy(
            np.stack([v.T_camera_grid for v in volumes]).astype(np.float32)
        ),
        floor_z=torch.tensor([-v.T_world_grid[2, 3] for v in volumes], dtype=torch.float32),
        voxel_size_m=volumes[0].voxel_size_m,
    )
