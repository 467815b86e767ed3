"""torchvision's detection models where its compiled operators do not load.

A torchvision made for another build of torch (CUDA beside a CPU one) cannot even be imported: its
`nms` is missing. Then `nms` and `roi_align` are defined here before it is imported again: the
first compiled by numba, the second in terms of `grid_sample`, with gradient. Where torchvision's
own operators load, they are used. Others (deformable convolution, ...) stay missing.
"""

from __future__ import annotations

import importlib.util
import sys
from types import ModuleType

import numba
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import grid_sample

from composenet.errors import WeightsError

INSTALL = (
    "install it with `pip install 'composenet[baselines]'`, or, to keep your torch as it is, "
    "`pip install --no-deps torchvision`"
)
_SCHEMAS = (
    "nms(Tensor dets, Tensor scores, float iou_threshold) -> Tensor",
    "qnms(Tensor dets, Tensor scores, float iou_threshold) -> Tensor",
    "roi_align(Tensor input, Tensor rois, float spatial_scale, int pooled_height, "
    "int pooled_width, int sampling_ratio, bool aligned) -> Tensor",
)
_libraries: list[torch.library.Library] = []  # operators live as long as these


def import_torchvision() -> ModuleType:
    """torchvision, usable for detection. Raises WeightsError where it is not installed."""
    if importlib.util.find_spec("torchvision") is None:
        raise WeightsError(f"Mask R-CNN needs torchvision: {INSTALL}")
    try:
        return importlib.import_module("torchvision")
    except RuntimeError as error:
        if "torchvision::nms" not in str(error):
            raise
    _define_operators()
    torchvision = importlib.import_module("torchvision")
    # It asks these two whether operators have been loaded.
    for name in ("torchvision.extension", "torchvision.ops.roi_align"):
        sys.modules[name]._has_ops = lambda: True  # type: ignore[attr-defined]
    return torchvision


def _define_operators() -> None:
    library = torch.library.Library("torchvision", "FRAGMENT")
    for schema in _SCHEMAS:  # qnms only has to exist
        library.define(schema)
    library.impl("nms", nms, "CompositeExplicitAutograd")
    library.impl("roi_align", roi_align, "CompositeImplicitAutograd")
    _libraries.append(library)


def nms(boxes: Tensor, scores: Tensor, iou_threshold: float) -> Tensor:
    """(K,) int64 indices of the boxes that overlap no kept box of higher score by more than the
    threshold, highest score first. boxes: (N, 4) x0, y0, x1, y1. scores: (N,)."""
    order = scores.detach().argsort(descending=True, stable=True)
    sorted_boxes = boxes.detach()[order].double().cpu().numpy()
    kept = torch.from_numpy(_kept(np.ascontiguousarray(sorted_boxes), iou_threshold))
    return order[kept.to(order.device)]


@numba.njit(cache=True, nogil=True)
def _kept(boxes: NDArray[np.float64], threshold: float) -> NDArray[np.bool_]:
    """(N,) which boxes stay, the strongest standing first."""
    n = len(boxes)
    kept = np.ones(n, np.bool_)
    areas = (boxes[:, 2] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 1])
    for i in range(n):
        if not kept[i]:
            continue
        for j in range(i + 1, n):
            w = min(boxes[i, 2], boxes[j, 2]) - max(boxes[i, 0], boxes[j, 0])
            h = min(boxes[i, 3], boxes[j, 3]) - max(boxes[i, 1], boxes[j, 1])
            shared = max(w, 0.0) * max(h, 0.0)
            if shared > threshold * (areas[i] + areas[j] - shared):
                kept[j] = False
    return kept


def roi_align(
    features: Tensor,
    rois: Tensor,
    spatial_scale: float,
    pooled_height: int,
    pooled_width: int,
    sampling_ratio: int,
    aligned: bool,
) -> Tensor:
    """(K, C, pooled_height, pooled_width): means of bilinear samples, spread evenly over each bin.

    features: (N, C, H, W). rois: (K, 5) index into N, then x0, y0, x1, y1 in units of
    1 / spatial_scale. sampling_ratio: samples a bin and axis; 0 or less: one for every feature cell
    that a bin covers. aligned: cell centres are at .5. Samples farther than a cell outside are 0.
    Differentiable in the features.
    """
    bins = (pooled_height, pooled_width)
    boxes = rois[:, 1:].detach() * spatial_scale - (0.5 if aligned else 0.0)
    starts = boxes[:, [1, 0]]  # y, x
    sizes = boxes[:, [3, 2]] - starts
    if not aligned:
        sizes = sizes.clamp(min=1.0)
    if sampling_ratio > 0:
        samples = torch.full_like(sizes, sampling_ratio)
    else:
        samples = (sizes / sizes.new_tensor(bins)).ceil().clamp(min=1)
    groups, member = torch.cat([rois[:, :1].detach(), samples], dim=1).unique(
        dim=0, return_inverse=True
    )
    out = features.new_zeros(len(rois), features.shape[1], *bins)
    for number, (image, per_y, per_x) in enumerate(groups.long().tolist()):
        chosen = (member == number).nonzero()[:, 0]
        y = _sample_places(starts[chosen, 0], sizes[chosen, 0], bins[0], per_y)
        x = _sample_places(starts[chosen, 1], sizes[chosen, 1], bins[1], per_x)
        values = _bilinear(features[image], y, x).unflatten(3, (-1, per_x))
        out = out.index_copy(0, chosen, values.unflatten(2, (-1, per_y)).mean((3, 5)))
    return out


def _sample_places(start: Tensor, size: Tensor, bins: int, per_bin: int) -> Tensor:
    """(K, bins * per_bin) coordinates along one axis, in feature cells."""
    n = bins * per_bin
    steps = (torch.arange(n, dtype=start.dtype, device=start.device) + 0.5) / n
    return start[:, None] + size[:, None] * steps


def _bilinear(features: Tensor, y: Tensor, x: Tensor) -> Tensor:
    """(K, C, Y, X) of features (C, H, W) at rows y (K, Y) and columns x (K, X)."""
    n_channels, height, width = features.shape
    inside = ((y >= -1) & (y <= height))[:, :, None] & ((x >= -1) & (x <= width))[:, None]
    rows = (2 * y / max(height - 1, 1) - 1)[:, :, None].expand(inside.shape)
    columns = (2 * x / max(width - 1, 1) - 1)[:, None].expand(inside.shape)
    grid = torch.stack([columns, rows], dim=-1).flatten(0, 1)[None].to(features.dtype)
    values = grid_sample(features[None], grid, "bilinear", "border", align_corners=True)[0]
    values = values.view(n_channels, *inside.shape).transpose(0, 1)
    return values * inside[:, None].to(features.dtype)
