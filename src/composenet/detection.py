"""Voxel fields -> proposals, by mean shift on the voted centres (paper section 4.1)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from composenet.config import DetectionConfig
from composenet.geometry.aligned_boxes import pairwise_iou
from composenet.network.batch import VolumeBatch
from composenet.network.detection_head import VoxelFields
from composenet.network.model import ComposeNet
from composenet.network.sparse import unique_rows
from composenet.records import Box
from composenet.volume.voxels import Volume

BOX_LIMITS_M = (0.15, 5.0)
"""Boxes are taken to be no smaller and no larger than furniture."""
ALIKE_IOU = 0.9
"""Of proposals that overlap more than this only the first is looked at."""
MIN_SEEN_VOXELS = 5
"""So many voxels of a cluster are what the frame sees itself; the others may be remembered."""


@dataclass(frozen=True)
class Proposals:
    """Boxes found in one frame, grid frame.

    center, extents: (M, 3) metres. class_probabilities: (M, n_classes). score: (M,) of `propose`
    the mean objectness of the cluster, of `second_look` the quality. voxels: (M,) how
    many voxels voted.
    """

    center: Tensor
    extents: Tensor
    class_probabilities: Tensor
    score: Tensor
    voxels: Tensor

    def __add__(self, other: Proposals) -> Proposals:
        """Both, one after the other."""
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return Proposals(*(torch.cat(pair) for pair in pairs))

    def __getitem__(self, rows: Tensor) -> Proposals:
        """Some of them, in the order of rows (int64)."""
        return Proposals(*(value[rows] for value in vars(self).values()))


def mean_shift(
    points: Tensor, radius: float, steps: int, bin_size: float = 2.0
) -> tuple[Tensor, Tensor]:
    """Flat-kernel mean shift: modes (K, 3), strongest first, and each point's mode (P,).

    Points are summed in bins of bin_size, which act as weighted points and as seeds. Modes
    closer than the radius to a stronger one are merged into it; a point belongs to the mode
    nearest to where its bin ended.
    """
    bins, member = unique_rows(torch.div(points, bin_size, rounding_mode="floor").long())
    weight = points.new_zeros(len(bins)).index_add_(0, member, torch.ones_like(points[:, 0]))
    mean = points.new_zeros(len(bins), 3).index_add_(0, member, points) / weight[:, None]
    seeds = mean.clone()
    near = torch.cdist(seeds, mean) <= radius
    for _ in range(steps):
        mass = near * weight
        moved = (mass @ mean) / mass.sum(dim=1, keepdim=True)
        shift = (moved - seeds).abs().amax()
        seeds = moved
        near = torch.cdist(seeds, mean) <= radius
        if shift < 1e-3 * radius:
            break
    density = (near * weight).sum(dim=1)
    order = torch.argsort(density, descending=True, stable=True)
    ordered = seeds[order]
    modes = ordered[_distinct(torch.cdist(ordered, ordered) <= radius).to(seeds.device)]
    return modes, torch.cdist(seeds, modes).argmin(dim=1)[member]


def _distinct(clash: Tensor) -> Tensor:
    """Rows, int64, that clash with no earlier row that is kept. clash: (M, M) bool."""
    table = clash.cpu().numpy()
    alive = np.ones(len(table), dtype=bool)
    for i in range(len(table)):
        if alive[i]:
            alive[i + 1 :] &= ~table[i, i + 1 :]
    return torch.from_numpy(np.flatnonzero(alive))


@torch.no_grad()
def propose(
    fields: VoxelFields, batch: VolumeBatch, config: DetectionConfig
) -> tuple[Proposals, ...]:
    """Proposals of every frame of the batch, strongest first. What the frame shows nothing of is
    none, however well it is remembered."""
    votes = batch.coords[:, 1:].to(fields.center_offset.dtype) + fields.center_offset
    objectness = torch.sigmoid(fields.objectness)
    out = []
    for frame in range(batch.size):
        rows = (batch.coords[:, 0] == frame) & (objectness > config.objectness_threshold)
        out.append(_propose_frame(rows, votes, objectness, fields, batch, config))
    return tuple(out)


def _propose_frame(
    rows: Tensor,
    votes: Tensor,
    objectness: Tensor,
    fields: VoxelFields,
    batch: VolumeBatch,
    config: DetectionConfig,
) -> Proposals:
    n_classes = fields.class_logits.shape[1]
    votes, weight = votes[rows], objectness[rows]
    if len(votes) < config.min_cluster_voxels:
        empty = votes.new_zeros
        return Proposals(empty(0, 3), empty(0, 3), empty(0, n_classes), empty(0), empty(0))
    values = torch.cat(
        [
            votes.new_ones(len(votes), 1),
            ~batch.remembered[rows, None],
            weight[:, None],
            votes,
            fields.extents[rows],
            fields.class_logits[rows].softmax(dim=1),
        ],
        dim=1,
    )
    modes, member = mean_shift(votes, config.mean_shift_radius_voxels, config.mean_shift_steps)
    sums = values.new_zeros(len(modes), values.shape[1]).index_add_(0, member, values)
    count, seen = sums[:, 0], sums[:, 1]
    mean = sums[:, 2:] / count.clamp_min(1)[:, None]
    large = (count >= config.min_cluster_voxels) & (seen >= MIN_SEEN_VOXELS)
    keep = torch.nonzero(large & (mean[:, 0] >= config.min_score))[:, 0]
    order = keep[torch.argsort(mean[keep, 0], descending=True, stable=True)]
    order = order[: config.max_proposals]
    return Proposals(
        center=mean[order, 1:4] * batch.voxel_size_m,
        extents=mean[order, 4:7] * batch.voxel_size_m,
        class_probabilities=mean[order, 7:],
        score=mean[order, 0],
        voxels=count[order],
    )


def remembered(
    boxes: Sequence[Box], volume: Volume, like: Proposals, config: DetectionConfig
) -> Proposals:
    """Where tracks were last, as further proposals of the frame `volume` is of: a second look at
    them finds objects that too few votes gather for. Boxes with less than
    config.min_cluster_voxels of what the frame sees in them are left out.

    boxes: world frame. like: proposals of the same network and device; class and score of the new
    ones are zero.
    """
    low, R = volume.T_world_grid[:3, 3], volume.T_world_grid[:3, :3]
    center = np.reshape([box.center for box in boxes], (-1, 3)) - low
    extents = np.reshape([box.extents for box in boxes], (-1, 3))
    center, extents = center @ R, extents @ np.abs(R)  # R is a quarter turn
    seen = volume.coords[: volume.n_seen] * volume.voxel_size_m
    inside = (np.abs(seen - center[:, None]) <= extents[:, None] / 2).all(axis=2).sum(axis=1)
    keep = inside >= config.min_cluster_voxels
    new = like.center.new_tensor
    zeros = like.class_probabilities.new_zeros(int(keep.sum()), like.class_probabilities.shape[1])
    return Proposals(new(center[keep]), new(extents[keep]), zeros, zeros[:, 0], new(inside[keep]))


@torch.no_grad()
def second_look(
    network: ComposeNet,
    fields: VoxelFields,
    batch: VolumeBatch,
    proposals: tuple[Proposals, ...],
    config: DetectionConfig,
) -> tuple[Proposals, ...]:
    """Proposals with corrected boxes and classes, strongest first.

    Of proposals nearly alike (`ALIKE_IOU`) the first is looked at. score becomes the quality; of
    two boxes that overlap by more than config.duplicate_iou the weaker is dropped, whatever their
    classes: solid furniture cannot share that much space.
    """
    seeds = [_looked_at(p) for p in proposals]
    frame = torch.repeat_interleave(
        torch.arange(len(seeds), device=batch.coords.device),
        torch.tensor([len(seed.center) for seed in seeds], device=batch.coords.device),
    )
    center = torch.cat([seed.center for seed in seeds])
    extents = torch.cat([seed.extents for seed in seeds])
    boxes = network.box_fields(fields, batch, center, extents, frame)
    classes = boxes.class_logits.softmax(dim=1)
    seen_again, first = [], 0
    for seed in seeds:
        own = slice(first, first := first + len(seed.center))
        seen_again.append(
            _best(
                Proposals(
                    boxes.center[own],
                    boxes.extents[own],
                    classes[own],
                    boxes.quality[own].sigmoid(),
                    seed.voxels,
                ),
                config,
            )
        )
    return tuple(seen_again)


def _looked_at(proposals: Proposals) -> Proposals:
    """Of proposals nearly alike the first, none smaller or larger than furniture."""
    center, extents = proposals.center, proposals.extents.clamp(*BOX_LIMITS_M)
    first = _distinct(pairwise_iou(center, extents, center, extents) > ALIKE_IOU)
    return dataclasses.replace(proposals, extents=extents)[first.to(extents.device)]


def _best(proposals: Proposals, config: DetectionConfig) -> Proposals:
    """Those that are good enough, strongest first, none over a stronger one."""
    order = torch.argsort(proposals.score, descending=True, stable=True)
    ranked = proposals[order[proposals.score[order] >= config.min_score]]
    overlap = pairwise_iou(ranked.center, ranked.extents, ranked.center, ranked.extents)
    return ranked[_distinct(overlap > config.duplicate_iou).to(overlap.device)]
