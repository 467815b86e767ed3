"""What is known of the space in a box: free, surface, hidden or out of view."""

from __future__ import annotations

import torch
from torch import Tensor

from composenet.network.batch import CropBatch, VolumeBatch
from composenet.volume.memory import FREE_CELL_M
from composenet.volume.tsdf import projective_tsdf

N_CHANNELS = 4


def crop_inputs(
    batch: VolumeBatch, crops: CropBatch, cells: int, truncation_m: float
) -> tuple[Tensor, Tensor]:
    """Field samples (M, N_CHANNELS, cells^3 as a cube): tsdf, observed, surface that earlier frames
    saw, and what any frame saw to be empty; and the mask of all surface, seen or remembered."""
    points = crops.points(cells)
    tsdf, observed = projective_tsdf(
        points,
        batch.depth_m[crops.frame],
        batch.K[crops.frame],
        batch.T_camera_grid[crops.frame],
        truncation_m,
    )
    reach = crops.size.amax(dim=1, keepdim=True) / cells / truncation_m
    remembered = _remembered_at(batch, crops.frame, points)
    surface = (observed & (tsdf.abs() < reach.clamp(max=0.99))) | remembered
    cube = (-1, 1, cells, cells, cells)
    fields = (tsdf, observed, remembered, _empty_at(batch, crops.frame, points))
    channels = [field.to(tsdf.dtype).view(cube) for field in fields]
    return torch.cat(channels, dim=1), surface.view(-1, cells, cells, cells)


def _remembered_at(batch: VolumeBatch, frame: Tensor, points: Tensor) -> Tensor:
    """(M, P) bool: the point lies in a remembered voxel. points: (M, P, 3), grid frame."""
    rows = batch.coords[batch.remembered]
    if not len(rows):
        return torch.zeros(points.shape[:2], dtype=torch.bool, device=points.device)
    sides = rows[:, 1:].amax(dim=0) + 1
    x, y, z = sides.tolist()
    filled = torch.zeros(batch.size * x * y * z, dtype=torch.bool, device=points.device)
    filled[((rows[:, 0] * x + rows[:, 1]) * y + rows[:, 2]) * z + rows[:, 3]] = True
    cell = (points / batch.voxel_size_m).round().long()
    inside = ((cell >= 0) & (cell < sides)).all(dim=-1)
    cell = torch.where(inside[..., None], cell, torch.zeros_like(cell))
    slot = ((frame[:, None] * x + cell[..., 0]) * y + cell[..., 1]) * z + cell[..., 2]
    return filled[slot] & inside


def _empty_at(batch: VolumeBatch, frame: Tensor, points: Tensor) -> Tensor:
    """(M, P) bool: the point lies in a cell seen to be empty. points: (M, P, 3), grid frame."""
    sides = torch.tensor(batch.free.shape[1:], device=points.device)
    cell = ((points - batch.free_low[frame][:, None]) / FREE_CELL_M).floor().long()
    inside = ((cell >= 0) & (cell < sides)).all(dim=-1)
    x, y, z = torch.where(inside[..., None], cell, torch.zeros_like(cell)).unbind(dim=-1)
    return batch.free[frame[:, None], x, y, z] & inside if batch.free.numel() else inside
