"""IoU of axis-aligned boxes as tensors; differentiable."""

from __future__ import annotations

import torch
from torch import Tensor


def paired_iou(center_a: Tensor, extents_a: Tensor, center_b: Tensor, extents_b: Tensor) -> Tensor:
    """IoU of boxes (..., 3) with boxes (..., 3), which broadcast: (...)."""
    low = torch.maximum(center_a - extents_a / 2, center_b - extents_b / 2)
    high = torch.minimum(center_a + extents_a / 2, center_b + extents_b / 2)
    shared = (high - low).clamp_min(0).prod(dim=-1)
    union = extents_a.prod(dim=-1) + extents_b.prod(dim=-1) - shared
    return shared / union.clamp_min(1e-9)


def pairwise_iou(
    center_a: Tensor, extents_a: Tensor, center_b: Tensor, extents_b: Tensor
) -> Tensor:
    """(A, B) IoU of boxes (A, 3) with boxes (B, 3)."""
    return paired_iou(center_a[:, None], extents_a[:, None], center_b[None], extents_b[None])
