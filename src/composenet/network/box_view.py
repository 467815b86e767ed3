"""What the depth image shows where a box is: relief too fine for the voxels.

Doors, drawers and handles stand out by a centimetre or two. The surface voxels smear that; the
depth image has it, so each box is also looked at as the camera sees it (a region of the image as in
R-CNN, Girshick et al. 2014; the paper has nothing like it).
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from composenet.geometry.affine import apply_affine
from composenet.network.batch import VolumeBatch

VIEW_PIXELS = 32
"""Pixels a side of what is seen of a box."""
N_VIEW_CHANNELS = 7
_MARGIN = 1.3  # the view shows the box grown by this factor
_IMAGE_WIDTH = 160  # images are averaged down to about this many columns
_NEAREST_M = 0.2  # of a box that reaches behind the camera
_MIN_RECTANGLE = 8.0  # pixels
_RELIEF_PIXELS = 7  # relief is depth against its mean in a square of so many pixels
_RELIEF_M = 0.05  # and counts in units of this


def view_inputs(batch: VolumeBatch, frame: Tensor, center: Tensor, extents: Tensor) -> Tensor:
    """(M, N_VIEW_CHANNELS, VIEW_PIXELS, VIEW_PIXELS) of M boxes: place of what each pixel sees in
    the box (-1..1 along its sides, 3 channels), whether that is inside, whether depth is known,
    relief, and depth / 4 m. The view is the rectangle of the image around the box, stretched.

    center, extents: (M, 3) metres, grid frame. frame: (M,) int64.
    """
    R, t = batch.T_camera_grid[frame, :3, :3], batch.T_camera_grid[frame, :3, 3]
    K = batch.K[frame]
    u, v = _pixels(batch, R, t, K, center, extents)
    seen, depth = _depth_at(batch.depth_m, frame, u, v)
    x = (u - K[:, 0, 2, None, None]) / K[:, 0, 0, None, None] * depth
    y = (v - K[:, 1, 2, None, None]) / K[:, 1, 1, None, None] * depth
    in_camera = torch.stack([x, y, depth], dim=-1).flatten(1, 2)
    back = R.transpose(1, 2)
    points = apply_affine(back, -(back @ t[:, :, None])[..., 0], in_camera)
    place = (points - center[:, None]) / (extents[:, None] / 2)
    place = place.transpose(1, 2).view(-1, 3, VIEW_PIXELS, VIEW_PIXELS)
    inside = (place.abs() <= 1.1).all(dim=1) & (seen > 0)
    known = seen[:, None]
    square = (_RELIEF_PIXELS, 1, _RELIEF_PIXELS // 2)
    around = F.avg_pool2d(depth[:, None] * known, *square)
    around = around / F.avg_pool2d(known, *square).clamp_min(1e-6)
    relief = ((depth[:, None] - around) / _RELIEF_M).clamp(-1, 1)
    channels = [place.clamp(-2, 2) * known, inside[:, None].to(depth.dtype), known]
    return torch.cat([*channels, relief * known, depth[:, None] / 4], dim=1)


def _pixels(
    batch: VolumeBatch, R: Tensor, t: Tensor, K: Tensor, center: Tensor, extents: Tensor
) -> tuple[Tensor, Tensor]:
    """(M, VIEW_PIXELS, VIEW_PIXELS) columns and rows, pixels of the whole image, of the views."""
    signs = torch.cartesian_prod(*[center.new_tensor([-0.5, 0.5])] * 3)
    corners = center[:, None] + _MARGIN * signs * extents[:, None]
    x, y, z = apply_affine(R, t, corners).unbind(dim=-1)
    z = z.clamp_min(_NEAREST_M)
    steps = (torch.arange(VIEW_PIXELS, device=center.device) + 0.5) / VIEW_PIXELS
    height, width = batch.depth_m.shape[1:]
    sides = []
    for axis, across, last in ((0, x, width - 1), (1, y, height - 1)):
        place = K[:, axis, axis, None] * across / z + K[:, axis, 2, None]
        low, high = place.amin(dim=1).clamp(0, last), place.amax(dim=1).clamp(0, last)
        short = (_MIN_RECTANGLE - (high - low)).clamp_min(0) / 2
        low, high = low - short, high + short
        sides.append(low[:, None] + (high - low)[:, None] * steps)
    u, v = sides
    shape = (len(center), VIEW_PIXELS, VIEW_PIXELS)
    return u[:, None, :].expand(shape), v[:, :, None].expand(shape)


def _depth_at(depth_m: Tensor, frame: Tensor, u: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
    """Whether depth is known there (0 or 1) and mean depth, metres, of images averaged down."""
    step = max(1, depth_m.shape[2] // _IMAGE_WIDTH)
    known = (depth_m > 0).to(depth_m.dtype)[:, None]
    share = F.avg_pool2d(known, step)
    mean = F.avg_pool2d(depth_m[:, None] * known, step) / share.clamp_min(1e-6)
    rows, columns = mean.shape[2:]
    # pixels are centred at whole numbers; cell i is the mean of pixels i * step and those after
    i = ((v + 0.5) / step).long().clamp(0, rows - 1)
    j = ((u + 0.5) / step).long().clamp(0, columns - 1)
    where = (frame[:, None, None], i, j)
    return (share[:, 0][where] > 0).to(depth_m.dtype), mean[:, 0][where]


class BoxView(nn.Module):
    """Views of boxes -> (M, c_out) features."""

    def __init__(self, c_out: int) -> None:
        super().__init__()

        def convolution(c_in: int, c: int, stride: int) -> list[nn.Module]:
            return [nn.Conv2d(c_in, c, 3, stride, 1), nn.GroupNorm(4, c), nn.ReLU()]

        self.layers = nn.Sequential(
            *convolution(N_VIEW_CHANNELS, 16, 1),
            *convolution(16, 32, 2),
            *convolution(32, 32, 2),
            *convolution(32, 48, 2),
            nn.Flatten(),
            nn.Linear(48 * (VIEW_PIXELS // 8) ** 2, c_out),
            nn.LayerNorm(c_out),  # a ReLU here fell silent for nearly all boxes, and stayed so
        )

    def forward(self, batch: VolumeBatch, frame: Tensor, center: Tensor, extents: Tensor) -> Tensor:
        """center, extents: (M, 3) metres, grid frame. frame: (M,) int64."""
        features: Tensor = self.layers(view_inputs(batch, frame, center, extents))
        return features
