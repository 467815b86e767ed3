"""Voxel fields -> proposals, by mean shift on the voted centres (paper section 4.1)."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from composenet.config import DetectionConfig
from composenet.geometry.aligned_boxes import pairwise_iou
from composenet.network.batch import VolumeBatch
from composenet.network.detection_head import VoxelFields
from composenet.network.model import ComposeNet
from composenet.network.sparse import unique_rows
from composenet.records import CLASS_NAMES, Box
from composenet.volume.voxels import Volume

BOX_LIMITS_M = (0.15, 5.0)
"""Boxes are taken to be no smaller and no larger than furniture."""
UNDER_TABLE_IOU = 0.5
"""A chair pushed under a table or desk shares up to so much of the bounding box with it."""
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

    def __getitem__(self, rows: Tensor | slice) -> Proposals:
        """Some of them, in the order of rows (int64)."""
        return Proposals(*(value[rows] for value in vars(self).values()))


def mean_shift(
    points: Tensor, frame: Tensor, radius: float, steps: int, bin_size: float = 2.0
) -> tuple[Tensor, Tensor, Tensor]:
    """Flat-kernel mean shift in every frame: modes (K, 3), frame by frame and strongest first, the
    frame of each (K,), and each point's mode (P,). points: (P, 3), at least one; frame: (P,) int64.

    Points are summed in bins of bin_size, which act as weighted points and as seeds. Modes
    closer than the radius to a stronger one are merged into it; a point belongs to the mode
    nearest to where its bin ended. All frames are shifted at once, each padded to the bins of the
    fullest: on a GPU time goes by the number of operations, not by their size.
    """
    bins = torch.div(points, bin_size, rounding_mode="floor").long()
    bins, member = unique_rows(torch.cat([frame[:, None], bins], dim=1))  # frame by frame
    own = bins[:, 0]
    sizes = torch.bincount(own)
    slot = torch.arange(len(bins), device=own.device) - (sizes.cumsum(0) - sizes)[own]
    shape = (len(sizes), int(sizes.max()))
    mass = points.new_zeros(len(bins)).index_add_(0, member, torch.ones_like(points[:, 0]))
    mean = points.new_zeros(len(bins), 3).index_add_(0, member, points) / mass[:, None]
    weight = points.new_full(shape, _NO_MASS).index_put_((own, slot), mass)
    places = points.new_full((*shape, 3), _NOWHERE).index_put_((own, slot), mean)
    seeds, real = places.clone(), weight[..., None] > _NO_MASS
    moving = torch.arange(len(sizes), device=own.device)
    for _ in range(steps):
        at, to = seeds[moving], places[moving]
        pull = (distances(at, to) <= radius) * weight[moving, None]
        moved = torch.where(real[moving], (pull @ to) / pull.sum(dim=2, keepdim=True), at)
        seeds[moving] = moved
        moving = moving[(moved - at).abs().amax(dim=(1, 2)) >= 1e-3 * radius]
        if not len(moving):
            break
    density = ((distances(seeds, places) <= radius) * weight[:, None]).sum(dim=2)
    order = torch.argsort(density, dim=1, descending=True, stable=True)
    ended = seeds[own, slot]
    modes, mode_frame = _separate(seeds.gather(1, order[..., None].expand_as(seeds)), sizes, radius)
    distance = distances(ended, modes)
    distance = torch.where(own[:, None] == mode_frame, distance, torch.inf)
    return modes, mode_frame, distance.argmin(dim=1)[member]


def distances(a: Tensor, b: Tensor) -> Tensor:
    """(..., N, M) between (..., N, 3) and (..., M, 3). On a GPU not by matrix products, which TF32
    (where it is switched on, as for training) rounds to several voxels."""
    exact, quick = "donot_use_mm_for_euclid_dist", "use_mm_for_euclid_dist_if_necessary"
    return torch.cdist(a, b, compute_mode=exact if a.is_cuda else quick)


_NOWHERE = 1e4
"""Where padding lies, in voxels: farther than any vote."""
_NO_MASS = 1e-6
"""What padding weighs: less than any point."""


def _separate(seeds: Tensor, sizes: Tensor, radius: float) -> tuple[Tensor, Tensor]:
    """Of each frame's seeds, best first, those closer than the radius to no better one, and their
    frames. seeds: (F, S, 3), of which the first sizes (F,) count."""
    places = seeds.cpu().numpy()
    chosen: list[NDArray[np.float32]] = []
    frames: list[int] = []
    for index, size in enumerate(sizes.tolist()):
        own = places[index, :size]

        def close(i: int, own: NDArray[np.float32] = own) -> NDArray[np.bool_]:
            return np.square(own - own[i]).sum(axis=1) <= radius**2

        kept = _distinct(size, close)
        chosen.append(own[kept])
        frames += [index] * len(kept)
    return torch.from_numpy(np.concatenate(chosen)).to(seeds.device), sizes.new_tensor(frames)


def _distinct(count: int, alike: Callable[[int], NDArray[np.bool_]]) -> list[int]:
    """Of `count` rows those that are like no earlier one that is kept. alike(i): (count,) which
    rows are like row i."""
    kept: list[int] = []
    left = np.ones(count, dtype=bool)
    while left.any():
        kept.append(int(left.argmax()))
        left &= ~alike(kept[-1])
        left[kept[-1]] = False
    return kept


@torch.no_grad()
def propose(
    fields: VoxelFields, batch: VolumeBatch, config: DetectionConfig
) -> tuple[Proposals, ...]:
    """Proposals of every frame of the batch, strongest first. What the frame shows nothing of is
    none, however well it is remembered."""
    objectness = torch.sigmoid(fields.objectness)
    rows = torch.nonzero(objectness > config.objectness_threshold)[:, 0]
    votes = batch.coords[rows, 1:].to(fields.center_offset.dtype) + fields.center_offset[rows]
    values = torch.cat(
        [
            votes.new_ones(len(votes), 1),
            ~batch.remembered[rows, None],
            objectness[rows, None],
            votes,
            fields.extents[rows],
            fields.class_logits[rows].softmax(dim=1),
        ],
        dim=1,
    )
    frame = batch.coords[rows, 0]
    if len(rows):
        radius = config.mean_shift_radius_voxels
        modes, frame, member = mean_shift(votes, frame, radius, config.mean_shift_steps)
        values = values.new_zeros(len(modes), values.shape[1]).index_add_(0, member, values)
    count, seen = values[:, 0], values[:, 1]
    mean = values[:, 2:] / count.clamp_min(1)[:, None]
    large = (count >= config.min_cluster_voxels) & (seen >= MIN_SEEN_VOXELS)
    keep = torch.nonzero(large & (mean[:, 0] >= config.min_score))[:, 0]
    found = Proposals(
        center=mean[:, 1:4] * batch.voxel_size_m,
        extents=mean[:, 4:7] * batch.voxel_size_m,
        class_probabilities=mean[:, 7:],
        score=mean[:, 0],
        voxels=count,
    )
    return _by_frame(found[keep], frame[keep], batch.size, config.max_proposals)


def _by_frame(
    proposals: Proposals, frame: Tensor, n_frames: int, most: int | None = None
) -> tuple[Proposals, ...]:
    """The proposals of each frame, strongest first, at most so many. frame: (M,) int64."""
    order = torch.argsort(proposals.score, descending=True, stable=True)
    order = order[torch.argsort(frame[order], stable=True)]
    ranked = proposals[order]
    counts = torch.bincount(frame, minlength=n_frames).tolist()
    firsts = np.cumsum([0, *counts]).tolist()
    return tuple(ranked[a : min(b, a + (most or b))] for a, b in pairwise(firsts))


def frames_of(proposals: Sequence[Proposals]) -> Tensor:
    """(M,) int64 frame of each of the proposals of all frames, one after the other; on the CPU."""
    counts = torch.tensor([len(own.center) for own in proposals], dtype=torch.long)
    return torch.repeat_interleave(torch.arange(len(proposals)), counts)


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
    first, last = seen.min(axis=0, initial=np.inf), seen.max(axis=0, initial=-np.inf)
    near = (center - extents / 2 <= last).all(axis=1) & (center + extents / 2 >= first).all(axis=1)
    inside = np.zeros(len(center), np.int64)
    for box in np.flatnonzero(near):  # few of all tracks
        inside[box] = (np.abs(seen - center[box]) <= extents[box] / 2).all(axis=1).sum()
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
    classes: solid furniture cannot share that much space. But chairs stand under tables
    (`UNDER_TABLE_IOU`).
    """
    frame = frames_of(proposals).to(batch.coords.device)
    every = Proposals(
        *(torch.cat(v) for v in zip(*(vars(p).values() for p in proposals), strict=True))
    )
    every = dataclasses.replace(every, extents=every.extents.clamp(*BOX_LIMITS_M))
    first = _no_two_over(every, frame, ALIKE_IOU)
    frame, every = frame[first], every[first]
    boxes = network.box_fields(fields, batch, every.center, every.extents, frame)
    score = boxes.quality.sigmoid()
    good = torch.nonzero(score >= config.min_score)[:, 0]
    good = good[torch.argsort(score[good], descending=True, stable=True)]
    classes = boxes.class_logits.softmax(dim=1)
    looked = Proposals(boxes.center, boxes.extents, classes, score, every.voxels)[good]
    kept = _no_two_over(looked, frame[good], _shared_at_most(looked, config))
    return _by_frame(looked[kept], frame[good][kept], batch.size)


def _shared_at_most(proposals: Proposals, config: DetectionConfig) -> Tensor:
    """(M, M) the largest IoU of which two proposals may be two objects."""
    likeliest = proposals.class_probabilities.argmax(dim=1)
    chair = likeliest == CLASS_NAMES.index("chair")
    table = (likeliest == CLASS_NAMES.index("table")) | (likeliest == CLASS_NAMES.index("desk"))
    beneath = chair[:, None] & table
    limit = proposals.score.new_full(beneath.shape, config.duplicate_iou)
    return limit.masked_fill(beneath | beneath.T, max(config.duplicate_iou, UNDER_TABLE_IOU))


def _no_two_over(proposals: Proposals, frame: Tensor, iou: Tensor | float) -> Tensor:
    """Rows, int64, of the proposals that overlap no earlier one of their frame, that is kept, by
    more than this, for all pairs or each (M, M). frame: (M,) int64."""
    center, extents = proposals.center, proposals.extents
    overlap = pairwise_iou(center, extents, center, extents) > iou
    table = (overlap & (frame[:, None] == frame)).cpu().numpy()
    kept = _distinct(len(table), lambda i: table[i])
    return torch.tensor(kept, dtype=torch.long, device=frame.device)
