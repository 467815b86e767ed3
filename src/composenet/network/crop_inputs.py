"""What is known of the space in a box: free, surface, hidden or out of view."""

from __future__ import annotations

import numba
import numpy as np
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
    saw, and what any frame saw to be empty; and the mask of all surface, seen or remembered. No
    gradient comes back to the boxes."""
    if crops.center.device.type == "cpu":
        return _cell_by_cell(batch, crops, cells, truncation_m)
    return all_at_once(batch, crops, cells, truncation_m)


def _cell_by_cell(
    batch: VolumeBatch, crops: CropBatch, cells: int, truncation_m: float
) -> tuple[Tensor, Tensor]:
    """On the CPU, where one loop takes a fifth of the time of passes over all cells."""
    places = (crops.frame, crops.center, crops.size, crops.R_grid_crop)
    boxes = tuple(each.detach().numpy() for each in places)
    frames = (batch.depth_m, batch.K, batch.T_camera_grid)
    space = (_remembered(batch), batch.free, batch.free_low)
    fields = np.empty((len(boxes[0]), N_CHANNELS, cells, cells, cells), boxes[1].dtype)
    surface = np.empty((len(boxes[0]), cells, cells, cells), np.bool_)
    _look(
        boxes,
        tuple(each.numpy() for each in frames),
        tuple(each.numpy() for each in space),
        batch.voxel_size_m,
        truncation_m,
        _reach(crops, cells, truncation_m).detach().numpy(),
        fields,
        surface,
    )
    return torch.from_numpy(fields), torch.from_numpy(surface)


@torch.no_grad()
def all_at_once(
    batch: VolumeBatch, crops: CropBatch, cells: int, truncation_m: float
) -> tuple[Tensor, Tensor]:
    """`crop_inputs` on any device."""
    points = crops.points(cells)
    tsdf, observed = projective_tsdf(
        points,
        batch.depth_m[crops.frame],
        batch.K[crops.frame],
        batch.T_camera_grid[crops.frame],
        truncation_m,
    )
    cell = (points / batch.voxel_size_m).round().long()
    remembered = _at(_remembered(batch), crops.frame, cell)
    cell = ((points - batch.free_low[crops.frame][:, None]) / FREE_CELL_M).floor().long()
    empty = _at(batch.free, crops.frame, cell)
    reach = _reach(crops, cells, truncation_m)[:, None]
    surface = (observed & (tsdf.abs() < reach)) | remembered
    cube = (-1, 1, cells, cells, cells)
    channels = [f.to(tsdf.dtype).view(cube) for f in (tsdf, observed, remembered, empty)]
    return torch.cat(channels, dim=1), surface.view(-1, cells, cells, cells)


def _reach(crops: CropBatch, cells: int, truncation_m: float) -> Tensor:
    """(M,) |tsdf| below which a cell holds surface: as far as a cell is wide."""
    return (crops.size.amax(dim=1) / cells / truncation_m).clamp(max=0.99)


def _remembered(batch: VolumeBatch) -> Tensor:
    """(B, X, Y, Z) bool: the remembered voxels, as far as there are any."""
    rows = batch.coords[batch.remembered]
    sides = (rows[:, 1:].amax(dim=0) + 1).tolist() if len(rows) else (0, 0, 0)
    filled = torch.zeros(batch.size, *sides, dtype=torch.bool, device=rows.device)
    filled[tuple(rows.T)] = True
    return filled


def _at(filled: Tensor, frame: Tensor, cell: Tensor) -> Tensor:
    """(M, P) bool: the cells (M, P, 3) are filled; those outside are not. filled: (B, X, Y, Z)."""
    sides = torch.tensor(filled.shape[1:], device=cell.device)
    inside = ((cell >= 0) & (cell < sides)).all(dim=-1)
    if not filled.numel():
        return inside
    x, y, z = torch.where(inside[..., None], cell, torch.zeros_like(cell)).unbind(dim=-1)
    return filled[frame[:, None], x, y, z] & inside


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _look(boxes, frames, space, voxel_m, truncation_m, reach, fields, surface):
    """Fill fields and surface."""
    frame_of, center, size, R = boxes
    depth_m, K, T_camera_grid = frames
    remembered, free, free_low = space
    n = surface.shape[1]
    height, width = depth_m.shape[1:]
    steps = (np.arange(n) + 0.5) / n - 0.5
    for m, frame in enumerate(frame_of):
        T, low = T_camera_grid[frame], free_low[frame]
        fx, fy, cx, cy = K[frame, 0, 0], K[frame, 1, 1], K[frame, 0, 2], K[frame, 1, 2]
        z = steps * size[m, 2] + center[m, 2]  # a box is turned about z alone
        over_x, over_y, over_z = T[0, 2] * z, T[1, 2] * z, T[2, 2] * z
        old_z, free_z = z / voxel_m + 0.5, (z - low[2]) / FREE_CELL_M
        for i in range(n):
            for j in range(n):
                a, b = steps[i] * size[m, 0], steps[j] * size[m, 1]
                x = R[m, 0, 0] * a + R[m, 0, 1] * b + center[m, 0]
                y = R[m, 1, 0] * a + R[m, 1, 1] * b + center[m, 1]
                tsdf, observed, old, empty = fields[m, :, i, j]
                _read(remembered[frame], x / voxel_m + 0.5, y / voxel_m + 0.5, old_z, old)
                free_x, free_y = (x - low[0]) / FREE_CELL_M, (y - low[1]) / FREE_CELL_M
                _read(free[frame], free_x, free_y, free_z, empty)
                right = T[0, 0] * x + T[0, 1] * y + T[0, 3]
                down = T[1, 0] * x + T[1, 1] * y + T[1, 3]
                ahead = T[2, 0] * x + T[2, 1] * y + T[2, 3]
                for k in range(n):
                    distance, measured = ahead + over_z[k], np.float32(0)
                    if distance > 1e-3:
                        u = np.rint((right + over_x[k]) / distance * fx + cx)
                        v = np.rint((down + over_y[k]) / distance * fy + cy)
                        if 0 <= u < width and 0 <= v < height:
                            measured = depth_m[frame, int(v), int(u)]
                    if measured > 0:
                        signed = (measured - distance) / truncation_m
                        tsdf[k], observed[k] = min(max(signed, -1.0), 1.0), 1
                    else:
                        tsdf[k], observed[k] = 0, 0
                    close = measured > 0 and abs(tsdf[k]) < reach[m]
                    surface[m, i, j, k] = close or old[k] > 0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _read(cells, x, y, z, found):
    """Of cells (X, Y, Z) the column that holds x, y at the places z, in cells from the corner."""
    found[:] = 0
    if 0 <= x < cells.shape[0] and 0 <= y < cells.shape[1]:
        column = cells[int(x), int(y)]
        for k in range(len(z)):
            if 0 <= z[k] < len(column):
                found[k] = column[int(z[k])]
