"""What the images say of every voxel: seams, edges and textures that no surface shows.

A cabinet flush with the wall is a wall to every voxel of it; its colour and its seams tell. A small
encoder-decoder looks at the colour image, and every voxel the frame sees takes what was made of its
pixel (image features lifted to voxels as in 3D-SIS, Hou et al. 2019). It is not shown depth, which
voxels have: what sees both learns nothing of colour for long. The paper sees depth alone.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from composenet.network.batch import VolumeBatch

IMAGE_WIDTH = 320
"""Images are averaged down to about this many columns."""
CELL_PIXELS = 4
"""Pixels a side, of images that wide, for each of which there are features."""
_CHANNELS = (16, 32, 48, 64)  # at 1/2, 1/4, 1/8 and 1/16


def image_inputs(batch: VolumeBatch) -> Tensor:
    """(B, 3, H, W) colour, -1..1, averaged down, and turned round in a mirror image."""
    color = batch.color.permute(0, 3, 1, 2).to(batch.depth_m.dtype)
    images = F.avg_pool2d(color, _step(batch)) / 127.5 - 1
    return torch.where(_mirrored(batch)[:, None, None, None], images.flip(3), images)


def places(batch: VolumeBatch, columns: int) -> Tensor:
    """(N, 2) columns and rows of `image_inputs`, that many columns wide, where the voxels lie."""
    frame, step = batch.coords[:, 0], _step(batch)
    points = batch.coords[:, 1:].to(batch.depth_m.dtype) * batch.voxel_size_m
    T = batch.T_camera_grid[frame]
    in_camera = (T[:, :3, :3] @ points[:, :, None])[..., 0] + T[:, :3, 3]
    K = batch.K[frame]
    pixels = in_camera[:, :2] / in_camera[:, 2:].clamp_min(0.05)
    pixels = pixels * K.diagonal(dim1=1, dim2=2)[:, :2] + K[:, :2, 2]
    u, v = ((pixels + 0.5) / step - 0.5).unbind(dim=1)
    return torch.stack([torch.where(_mirrored(batch)[frame], columns - 1 - u, u), v], dim=1)


def _step(batch: VolumeBatch) -> int:
    """Pixels a side that are averaged to one."""
    return max(1, batch.depth_m.shape[2] // IMAGE_WIDTH)


def _mirrored(batch: VolumeBatch) -> Tensor:
    """(B,) bool."""
    T = batch.T_camera_grid
    across = torch.linalg.cross(T[:, :3, 0], T[:, :3, 1])
    return (across * T[:, :3, 2]).sum(dim=1) < 0


class ImageEncoder(nn.Module):
    """Images of a batch -> (N, c_out) features of its voxels; zero of those only remembered."""

    def __init__(self) -> None:
        super().__init__()

        def unit(c_in: int, c: int, stride: int = 1) -> nn.Sequential:
            return nn.Sequential(
                nn.Conv2d(c_in, c, 3, stride, 1, bias=False), nn.GroupNorm(4, c), nn.ReLU()
            )

        a, b, c, d = _CHANNELS
        self.c_out = b
        self.fine = nn.Sequential(unit(3, a, 2), unit(a, a), unit(a, b, 2), unit(b, b))
        self.middle = nn.Sequential(unit(b, c, 2), unit(c, c))
        self.coarse = nn.Sequential(unit(c, d, 2), unit(d, d), unit(d, d))
        self.middle_up, self.fine_up = unit(d + c, c), unit(c + b, b)

    def forward(self, batch: VolumeBatch) -> Tensor:
        images = image_inputs(batch)
        fine = self.fine(images)
        middle = self.middle(fine)
        middle = self.middle_up(_joined(self.coarse(middle), middle))
        fine = self.fine_up(_joined(middle, fine))
        return self._lifted(fine, batch, images.shape[3])

    def _lifted(self, features: Tensor, batch: VolumeBatch, columns: int) -> Tensor:
        """(B, C, rows, columns) features of cells -> (N, C), bilinear."""
        height, width = features.shape[2:]
        lifted = features.new_zeros(len(batch.coords), features.shape[1])
        at = places(batch, columns) / CELL_PIXELS  # a cell is centred on its first pixel
        at = 2 * at / at.new_tensor([width - 1, height - 1]).clamp_min(1) - 1
        for i in range(batch.size):
            rows = torch.nonzero((batch.coords[:, 0] == i) & ~batch.remembered)[:, 0]
            grid = at[rows][None, :, None]
            values = F.grid_sample(
                features[i : i + 1], grid, padding_mode="border", align_corners=True
            )
            lifted = lifted.index_copy(0, rows, values[0, :, :, 0].T)
        return lifted


def _joined(coarse: Tensor, fine: Tensor) -> Tensor:
    """Coarse features at the places of fine ones, before these."""
    # cells are centred on even ones of the finer grid: corners agree but for the last row
    larger = F.interpolate(coarse, size=fine.shape[2:], mode="bilinear", align_corners=False)
    return torch.cat([larger, fine], dim=1)
