"""The paper's losses (sections 4.1 to 4.3), with the symmetry minimum."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from composenet.geometry.aligned_boxes import paired_iou
from composenet.geometry.procrustes import SimilarityFit, fit_similarity
from composenet.metrics.records import MATCH_GATE_M
from composenet.network.box_head import BoxFields
from composenet.network.detection_head import VoxelFields
from composenet.network.object_net import (
    HEADING_BINS,
    ObjectFields,
    Teacher,
    fit_weights,
    stretched,
)
from composenet.training.proposals import TrainingBoxes
from composenet.training.targets import TrainingBatch, occupancy_in_crops


@dataclass(frozen=True)
class PoseErrors:
    """Of the positive crops, M' of them. rotation_deg, translation_m, completion_iou: (M',)."""

    rotation_deg: Tensor
    translation_m: Tensor
    completion_iou: Tensor

    @staticmethod
    def none(like: Tensor) -> PoseErrors:
        """Of no crop at all."""
        empty = like.new_zeros(0)
        return PoseErrors(empty, empty, empty)


def detection_losses(fields: VoxelFields, batch: TrainingBatch) -> dict[str, Tensor]:
    """Objectness, centre, extent (both in voxels) and class. Every object weighs by the root of
    its voxel count, so that large ones do not drown small ones."""
    on_object = batch.voxel_object >= 0
    known = batch.voxel_object > -2
    losses = {
        "objectness": F.binary_cross_entropy_with_logits(
            fields.objectness[known], on_object[known].to(fields.objectness.dtype)
        )
    }
    zero = fields.objectness.sum() * 0
    if not on_object.any():
        touched = fields.center_offset.sum() + fields.extents.sum() + fields.class_logits.sum()
        return losses | {"center": zero + 0 * touched, "extent": zero, "class": zero}
    rows = batch.voxel_object[on_object]
    weight = torch.bincount(rows, minlength=len(batch.frame)).to(zero.dtype).rsqrt()[rows]
    weight = weight / weight.sum()
    size = batch.volume.voxel_size_m
    coords = batch.volume.coords[on_object, 1:].to(zero.dtype)
    offset = batch.center[rows] / size - coords
    center = F.smooth_l1_loss(fields.center_offset[on_object], offset, reduction="none")
    extent = F.smooth_l1_loss(
        fields.extents[on_object], batch.extents[rows] / size, reduction="none"
    )
    classes = F.cross_entropy(
        fields.class_logits[on_object], batch.class_id[rows], reduction="none"
    )
    return losses | {
        "center": (weight * center.sum(dim=1)).sum(),
        "extent": (weight * extent.sum(dim=1)).sum(),
        "class": (weight * classes).sum(),
    }


NEAR_M = 0.6
"""Large furniture must be placed as well as what is this large."""


def box_losses(fields: BoxFields, batch: TrainingBatch, boxes: TrainingBoxes) -> dict[str, Tensor]:
    """Box (places as shares of the true sides, of NEAR_M where those are longer, sizes as shares of
    the true ones, and IoU), place, quality and class.

    The quality that is taught is half overlap, half place: the one rises from 0 to 1 as the
    corrected box's IoU does from 0.1 to 0.6, the other is 1 where the centre can match
    (MATCH_GATE_M).
    """
    keep = boxes.positive
    rows = boxes.rows[keep]
    quality = torch.zeros_like(boxes.iou)
    touching = boxes.iou > 0
    if touching.any():
        own = boxes.rows[touching]
        center, extents = fields.center[touching].detach(), fields.extents[touching].detach()
        overlap = paired_iou(center, extents, batch.center[own], batch.extents[own])
        right = (center - batch.center[own]).norm(dim=1) < MATCH_GATE_M
        quality[touching] = (((overlap - 0.1) / 0.5).clamp(0, 1) + right) / 2
    losses = {name: 0 * fields.class_logits.sum() for name in ("box", "place", "box_class")}
    if keep.any():
        center, extents = fields.center[keep], fields.extents[keep]
        true_center, true_extents = batch.center[rows], batch.extents[rows]
        iou = paired_iou(center, extents, true_center, true_extents)
        away = (center - true_center).abs() / true_extents.clamp(max=NEAR_M)
        grown = (extents / true_extents).log().abs()
        losses["box"] = ((away + grown).sum(dim=1) + 1 - iou).mean()
        losses["place"] = _place_cost(center - true_center).mean()
        losses["box_class"] = F.cross_entropy(fields.class_logits[keep], batch.class_id[rows])
    losses["quality"] = F.binary_cross_entropy_with_logits(fields.quality, quality)
    return losses


def _place_cost(gap_m: Tensor) -> Tensor:
    """(M, 3) gaps between centres -> (M,) nearly 0 well within the distance at which centres match
    (MATCH_GATE_M), nearly 1 from twice that on: one likely place is asked for where several are
    possible, and what one view cannot show does not pull."""
    return -torch.expm1(-gap_m.square().sum(dim=1) / MATCH_GATE_M**2)


OBJECT_LOSSES = (
    "heading",
    "completion",
    "overlap",
    "correspondence",
    "rotation",
    "scale",
    "translation",
    "fit_place",
)


def object_losses(
    fields: ObjectFields, batch: TrainingBatch, rows: Tensor, threshold: float = 0.5
) -> tuple[dict[str, Tensor], PoseErrors]:
    """Heading, completion, correspondence, rotation, scale, translation and place of crops that
    show the objects `rows` (M,) of the batch. threshold: probability from which on a cell is
    occupied. Poses are fitted as in tracking: upright, to the cells that the network fills."""
    cells = fields.occupancy.shape[-1]
    if not len(rows):
        touched = 0 * (fields.occupancy.sum() + fields.nocs.sum() + fields.heading_logits.sum())
        return dict.fromkeys(OBJECT_LOSSES, touched), PoseErrors.none(touched)
    crops = fields.crops
    target = occupancy_in_crops(batch, crops, rows, cells)
    logits = fields.occupancy
    losses = {
        "heading": _heading_loss(fields.heading_logits, batch, rows),
        "completion": F.binary_cross_entropy_with_logits(logits, target),
        "overlap": _overlap_loss(logits, target),
    }
    solid = F.avg_pool3d(target[:, None], 2)[:, 0].flatten(1) > 0.1
    solid[:, 0] |= ~solid.any(dim=1)
    points = crops.points(cells // 2)
    predicted = fields.nocs.flatten(2).transpose(1, 2)
    weights = fit_weights(stretched(logits.detach().sigmoid(), threshold))
    taught = solid | (weights > 0)
    losses["correspondence"] = _correspondence_loss(predicted, points, taught, batch, rows)
    fit = fit_similarity(predicted, points, weights, upright=True)
    squared = rotation_square_error(fit.R, batch, rows)
    seen = fit.observable.to(squared.dtype)
    losses["rotation"] = (seen * squared).mean()
    losses["scale"] = (seen * (fit.scale - batch.scale_m[rows]).abs()).mean()
    gap = fit.t - batch.t[rows]
    losses["translation"] = (seen * gap.square().sum(dim=1)).mean()
    losses["fit_place"] = (seen * _place_cost(gap)).mean()
    return losses, _errors(fit, squared, gap, logits.sigmoid() >= threshold, target)


def _overlap_loss(logits: Tensor, target: Tensor) -> Tensor:
    """1 - IoU of soft occupancies: cross-entropy alone is timid where most cells are empty."""
    filled, true = logits.sigmoid().flatten(1), target.flatten(1)
    shared = (filled * true).sum(dim=1)
    return (1 - shared / (filled.sum(dim=1) + true.sum(dim=1) - shared).clamp_min(1e-6)).mean()


def _errors(
    fit: SimilarityFit, squared: Tensor, gap: Tensor, full: Tensor, target: Tensor
) -> PoseErrors:
    # |R - R'|_F^2 = 6 - 2 tr(R^T R') = 8 sin^2(angle / 2)
    sine = (squared.detach() / 8).clamp(0, 1).sqrt()
    true = target > 0.5
    overlap = (full & true).flatten(1).sum(dim=1) / (full | true).flatten(1).sum(dim=1).clamp_min(1)
    return PoseErrors(
        torch.rad2deg(2 * torch.asin(sine)), gap.detach().norm(dim=1), overlap.to(squared.dtype)
    )


def _turns(order: int, like: Tensor) -> Tensor:
    """(order, 3, 3) turns about z."""
    angle = torch.arange(order, device=like.device, dtype=like.dtype) * (2 * np.pi / order)
    c, s, o, i = angle.cos(), angle.sin(), torch.zeros_like(angle), torch.ones_like(angle)
    return torch.stack([c, -s, o, s, c, o, o, o, i], dim=1).view(-1, 3, 3)


def valid_headings(batch: TrainingBatch, rows: Tensor) -> tuple[Tensor, Tensor]:
    """(M, 4) yaws of the object's front that look alike, radians, and (M, 4) bool which of them
    are distinct. For infinite symmetry the first is as good as any other."""
    R = batch.R_grid_object[rows]
    yaw = torch.atan2(R[:, 1, 0], R[:, 0, 0])
    order = batch.symmetry_order[rows].clamp(max=4)[:, None]
    k = torch.arange(4, device=yaw.device)[None]
    return yaw[:, None] + 2 * np.pi * k / order, k < order


def heading_bins(yaw: Tensor) -> Tensor:
    """Bin of each yaw, int64."""
    return (yaw * (HEADING_BINS / (2 * np.pi))).round().long() % HEADING_BINS


def _heading_loss(logits: Tensor, batch: TrainingBatch, rows: Tensor) -> Tensor:
    """Cross-entropy where any valid bin is right; objects round about z are left out."""
    yaws, valid = valid_headings(batch, rows)
    log_p = logits.log_softmax(dim=1).gather(1, heading_bins(yaws))
    log_p = torch.where(valid, log_p, torch.full_like(log_p, -torch.inf))
    directed = (batch.symmetry_order[rows] <= 4).to(logits.dtype)
    return -(directed * log_p.logsumexp(dim=1)).sum() / directed.sum().clamp_min(1)


WRONG_HEADING_DEG = 9.0
"""Standard deviation: as many headings are off by more than half a bin as in tracking."""


def heading_teacher(batch: TrainingBatch, rows: Tensor, generator: torch.Generator) -> Teacher:
    """Gives crops of the objects `rows` the valid heading the network finds likeliest, off by
    WRONG_HEADING_DEG as at test time."""

    def teach(logits: Tensor) -> Tensor:
        yaws, valid = valid_headings(batch, rows)
        liked = logits.gather(1, heading_bins(yaws)).masked_fill(~valid, -torch.inf).argmax(dim=1)
        noise = torch.randn(len(rows), generator=generator).to(logits)
        return yaws.gather(1, liked[:, None])[:, 0] + np.radians(WRONG_HEADING_DEG) * noise

    return teach


def _correspondence_loss(
    predicted: Tensor, points: Tensor, solid: Tensor, batch: TrainingBatch, rows: Tensor
) -> Tensor:
    """l1 where geometry is or is thought to be, for the turn of the object that fits best."""
    count = solid.sum(dim=1)
    cells = solid.byte().argsort(dim=1, descending=True)[:, : int(count.max())]  # solid ones first
    weight = solid.gather(1, cells) / count[:, None]
    cells = cells[..., None].expand(-1, -1, 3)
    predicted, points = predicted.gather(1, cells), points.gather(1, cells)
    true = (points - batch.t[rows][:, None]) @ batch.R_grid_object[rows]
    true = true / batch.scale_m[rows][:, None, None]

    def smallest(own: Tensor, turns: Tensor) -> Tensor:
        gaps = (true[own][:, None] @ turns - predicted[own][:, None]).abs().sum(dim=-1)
        return (weight[own][:, None] * gaps).sum(dim=-1).amin(dim=1)

    return _of_each(batch, rows, smallest, predicted).mean()


def rotation_square_error(R: Tensor, batch: TrainingBatch, rows: Tensor) -> Tensor:
    """(M,) squared Frobenius distance to the nearest valid rotation."""

    def smallest(own: Tensor, turns: Tensor) -> Tensor:
        valid = batch.R_grid_object[rows[own]][:, None] @ turns
        return (valid - R[own][:, None]).square().sum(dim=(2, 3)).amin(dim=1)

    return _of_each(batch, rows, smallest, R)


def _of_each(
    batch: TrainingBatch, rows: Tensor, of_some: Callable[[Tensor, Tensor], Tensor], like: Tensor
) -> Tensor:
    """(M,) values of the objects `rows`, for all those with as many turns at once: of_some(own,
    turns) gives those of rows[own], turns being (order, 3, 3)."""
    orders = batch.symmetry_order[rows]
    kinds = sorted(set(orders.tolist()))
    groups = [torch.nonzero(orders == order)[:, 0] for order in kinds]
    pairs = zip(kinds, groups, strict=True)
    values = torch.cat([of_some(own, _turns(order, like)) for order, own in pairs])
    return values[torch.argsort(torch.cat(groups))]
