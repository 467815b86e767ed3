"""Similarity fit in closed form (Umeyama 1991), differentiable and safe where degenerate.

Paper section 4.3; the corrections of its printed formulae: scale = tr(D S) / (N var_n).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class SimilarityFit:
    """Batch of fits p_target = scale * R @ p_source + t.

    scale: (B,). R: (B, D, D). t: (B, D). observable: (B,) bool, False where the points do not
    fix the transform; the fit is then R = identity, scale = 1, t = difference of the means,
    with zero gradient through R and scale.
    """

    scale: Tensor
    R: Tensor
    t: Tensor
    observable: Tensor


class _NearestRotation(torch.autograd.Function):
    """argmax over SO(D) of trace(R^T H).

    With H = U diag(d) V^T, signed so that R = U V^T is a rotation, the differential is
    dR = U W V^T with W_ij = (A_ij - A_ji) / (d_i + d_j) and A = U^T dH V: sums, never
    differences, of singular values, so repeated ones are harmless.
    """

    @staticmethod
    def forward(ctx, H: Tensor, valid: Tensor) -> Tensor:
        U, d, Vh = torch.linalg.svd(H)
        sign = torch.ones_like(d)
        sign[:, -1] = torch.where(torch.det(U @ Vh) < 0, -1.0, 1.0)
        U = U * sign[:, None, :]
        ctx.save_for_backward(U, d * sign, Vh, valid)
        return U @ Vh

    @staticmethod
    def backward(ctx, grad: Tensor):  # type: ignore[override]
        U, d, Vh, valid = ctx.saved_tensors
        B = U.transpose(1, 2) @ grad @ Vh.transpose(1, 2)
        sums = d[:, :, None] + d[:, None, :]
        safe = torch.where(sums.abs() > 1e-12, sums, torch.ones_like(sums))
        W = torch.where(valid[:, None, None], (B - B.transpose(1, 2)) / safe, torch.zeros_like(B))
        return U @ W @ Vh, None


def fit_similarity(
    source: Tensor,
    target: Tensor,
    weights: Tensor | None = None,
    relative_tolerance: float = 1e-4,
    upright: bool = False,
) -> SimilarityFit:
    """Weighted least-squares similarity from source to target points; upright: the best of those
    that turn about z alone (D = 3).

    source, target: (B, N, D), D = 2 or 3. weights: (B, N) >= 0, default ones. Observable when
    at least D points have weight, the source has spread, and the second-smallest signed
    singular sum is above relative_tolerance of the largest singular value: planar sets are
    fine, collinear ones are not; upright, when what lies on a vertical line is not all there is,
    nor is most of it upside down.
    """
    if weights is None:
        weights = torch.ones_like(source[..., 0])
    total = weights.sum(dim=1)
    share = weights / total.clamp_min(1e-12)[:, None]
    mean_s = (share[..., None] * source).sum(dim=1)
    mean_t = (share[..., None] * target).sum(dim=1)
    centered_s = source - mean_s[:, None]
    centered_t = target - mean_t[:, None]
    H = (share[..., None] * centered_t).transpose(1, 2) @ centered_s
    variance = (share * centered_s.square().sum(dim=-1)).sum(dim=1)
    fixed = _turn_is_fixed if upright else _rotation_is_fixed
    finite = torch.isfinite(H.detach()).all(dim=(1, 2))
    known = torch.where(finite[:, None, None], H.detach(), torch.zeros_like(H))
    observable = finite & fixed(known, relative_tolerance)
    observable &= _spread(known, variance.detach(), weights)
    eye = torch.eye(H.shape[-1], dtype=H.dtype, device=H.device).expand_as(H)
    H = torch.where(observable[:, None, None], H, eye)
    R = _turn_about_z(H) if upright else _NearestRotation.apply(H, observable)
    # tr(D S) = max over R of tr(R^T H): its gradient in H is R, so R is held fixed here.
    gain = (R.detach() * H).sum(dim=(1, 2)) / torch.where(
        observable, variance, torch.ones_like(variance)
    )
    observable = observable & (gain.detach() > 0)  # upright, what hangs upside down has none
    scale = torch.where(observable, gain, torch.ones_like(gain))
    R = torch.where(observable[:, None, None], R, eye)
    t = mean_t - scale[:, None] * (R @ mean_s[..., None])[..., 0]
    return SimilarityFit(scale, R, t, observable)


def _spread(H: Tensor, variance: Tensor, weights: Tensor) -> Tensor:
    enough = (weights > 0).sum(dim=1) >= H.shape[-1]
    return enough & (variance > 1e-10) & (H.abs().amax(dim=(1, 2)) > 1e-12)


def _rotation_is_fixed(H: Tensor, tolerance: float) -> Tensor:
    U, d, Vh = torch.linalg.svd(H)
    signed = d.clone()
    signed[:, -1] = torch.where(torch.det(U @ Vh) < 0, -d[:, -1], d[:, -1])
    smallest_sum = signed[:, -1] + signed[:, -2]  # zero: the rotation is not unique
    return smallest_sum > tolerance * d[:, 0]


def _turn_is_fixed(H: Tensor, tolerance: float) -> Tensor:
    return torch.hypot(*_horizontal(H)) > tolerance * H.norm(dim=(1, 2))


def _horizontal(H: Tensor) -> tuple[Tensor, Tensor]:
    """trace(R^T H) of a turn R by an angle a about z is cos(a) along + sin(a) across + H_zz."""
    return H[:, 0, 0] + H[:, 1, 1], H[:, 1, 0] - H[:, 0, 1]


def _turn_about_z(H: Tensor) -> Tensor:
    """argmax over the turns R about z of trace(R^T H)."""
    along, across = _horizontal(H)
    angle = torch.atan2(across, along)
    c, s, zero, one = angle.cos(), angle.sin(), torch.zeros_like(angle), torch.ones_like(angle)
    return torch.stack([c, -s, zero, s, c, zero, zero, zero, one], dim=1).view(-1, 3, 3)
