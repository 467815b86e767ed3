"""Truncated signed distance field of a frame by back-projection (Curless and Levoy 1996).

One frame's field is a function of the depth image, so it is evaluated where it is needed:
on the cells of every crop, or on a whole dense grid. On the nodes both are the same numbers.
"""

from __future__ import annotations

import torch
from torch import Tensor

from composenet.geometry.affine import apply_affine


def projective_tsdf(
    points: Tensor, depth_m: Tensor, K: Tensor, T_camera_points: Tensor, truncation_m: float
) -> tuple[Tensor, Tensor]:
    """Signed distance along the optical axis at given points, one frame a row.

    points: (B, P, 3) metres. depth_m: (B, H, W). K: (B, 3, 3). T_camera_points: (B, 4, 4).
    Returns tsdf (B, P) in [-1, 1], positive in front of the surface, 0 where unknown; and
    observed (B, P) bool: inside the image, before the camera, on a measured pixel. Far behind
    the surface tsdf is -1: occluded, not known to be solid.
    """
    local = apply_affine(T_camera_points[:, :3, :3], T_camera_points[:, :3, 3], points)
    z = local[..., 2]
    ahead = z > 1e-3
    safe_z = torch.where(ahead, z, torch.ones_like(z))
    u = (local[..., 0] / safe_z * K[:, None, 0, 0] + K[:, None, 0, 2]).round().long()
    v = (local[..., 1] / safe_z * K[:, None, 1, 1] + K[:, None, 1, 2]).round().long()
    height, width = depth_m.shape[1:]
    inside = ahead & (u >= 0) & (u < width) & (v >= 0) & (v < height)
    flat = (v.clamp(0, height - 1) * width + u.clamp(0, width - 1)).flatten(1)
    measured = depth_m.flatten(1).gather(1, flat).view_as(z)
    observed = inside & (measured > 0)
    tsdf = ((measured - z) / truncation_m).clamp(-1, 1)
    return torch.where(observed, tsdf, torch.zeros_like(tsdf)), observed


def dense_tsdf(
    depth_m: Tensor,
    K: Tensor,
    T_camera_grid: Tensor,
    shape: tuple[int, int, int],
    voxel_size_m: float,
    truncation_m: float,
) -> tuple[Tensor, Tensor]:
    """The field on every voxel centre of one frame's grid: tsdf and observed, both `shape`."""
    axes = [torch.arange(n, device=depth_m.device, dtype=depth_m.dtype) for n in shape]
    points = torch.stack(torch.meshgrid(*axes, indexing="ij"), dim=-1) * voxel_size_m
    tsdf, observed = projective_tsdf(
        points.reshape(1, -1, 3), depth_m[None], K[None], T_camera_grid[None], truncation_m
    )
    return tsdf.view(shape), observed.view(shape)
