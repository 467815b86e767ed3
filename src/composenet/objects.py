"""Proposals -> posed, completed objects (paper sections 4.2 and 4.3)."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from composenet.config import Config
from composenet.detection import Proposals
from composenet.geometry.procrustes import SimilarityFit, fit_similarity
from composenet.network.batch import CropBatch, VolumeBatch
from composenet.network.detection_head import VoxelFields
from composenet.network.model import ComposeNet
from composenet.network.object_net import ObjectFields
from composenet.records import Box, ObjectEstimate, Similarity
from composenet.volume.voxels import Volume

CANONICAL_CELLS = 64


@torch.no_grad()
def estimate_objects(
    network: ComposeNet,
    fields: VoxelFields,
    batch: VolumeBatch,
    volume: Volume,
    proposals: Proposals,
    config: Config,
) -> tuple[ObjectEstimate, ...]:
    """Complete and pose every proposal of one frame (batch of one), strongest first.

    With config.tracking.use_completion False only observed cells carry geometry and
    correspondences (the paper's "no compl."), and the box is the detector's.
    """
    m = len(proposals.center)
    if m == 0:
        return ()
    frame = torch.zeros(m, dtype=torch.long, device=proposals.center.device)
    size = proposals.extents.clamp(0.15, 5.0) * config.network.crop_margin
    crops = CropBatch(frame, proposals.center, size)
    objects = network.object_fields(fields.features, batch, crops)
    probabilities = (proposals.class_probabilities * objects.class_logits.softmax(dim=1)).clamp_min(
        1e-9
    )
    probabilities = probabilities / probabilities.sum(dim=1, keepdim=True)
    score = (proposals.score * objects.quality.sigmoid()).sqrt() * probabilities.amax(dim=1)
    shown = _shown_occupancy(objects, config)
    coarse = F.max_pool3d(shown[:, None], 2)[:, 0].flatten(1)
    weights = coarse * (coarse >= 0.5)
    points = crops.points(config.network.crop_cells // 2)
    fit = fit_similarity(objects.nocs.flatten(2).transpose(1, 2), points, weights)
    canonical = _canonical(shown, crops, fit)
    return tuple(
        _estimate(i, crops, proposals, probabilities, score, shown, fit, canonical, volume, config)
        for i in torch.argsort(score, descending=True, stable=True).tolist()
        if bool((weights[i] > 0).any())
    )


def _shown_occupancy(objects: ObjectFields, config: Config) -> Tensor:
    """(M, C, C, C) probability, rescaled so that 0.5 is the decision threshold."""
    probability = objects.occupancy.sigmoid()
    threshold = config.network.occupancy_threshold
    low = 0.5 * probability / threshold
    high = 0.5 + 0.5 * (probability - threshold) / (1 - threshold)
    shown = torch.where(probability < threshold, low, high)
    if not config.tracking.use_completion:
        shown = shown * objects.surface.to(shown.dtype)
    return shown


def _canonical(shown: Tensor, crops: CropBatch, fit: SimilarityFit) -> Tensor:
    """(M, 64, 64, 64) occupancy resampled in canonical space through the fitted similarity."""
    steps = (torch.arange(CANONICAL_CELLS, device=shown.device) + 0.5) / CANONICAL_CELLS - 0.5
    cells = torch.stack(torch.meshgrid(steps, steps, steps, indexing="ij"), -1).view(1, -1, 3)
    world = fit.scale[:, None, None] * (cells @ fit.R.transpose(1, 2)) + fit.t[:, None]
    unit = 2 * (world - crops.center[:, None]) / crops.size[:, None]
    n = CANONICAL_CELLS
    grid = unit.flip(-1).view(-1, n, n, n, 3)
    return F.grid_sample(shown[:, None], grid, padding_mode="zeros", align_corners=False)[:, 0]


def _estimate(
    i: int,
    crops: CropBatch,
    proposals: Proposals,
    probabilities: Tensor,
    score: Tensor,
    shown: Tensor,
    fit: SimilarityFit,
    canonical: Tensor,
    volume: Volume,
    config: Config,
) -> ObjectEstimate:
    R_world_grid, low = volume.T_world_grid[:3, :3], volume.T_world_grid[:3, 3]
    cells = config.network.crop_cells
    solid = shown[i].flatten() >= 0.5
    cell_size = (crops.size[i] / cells).cpu().numpy().astype(np.float64)
    points_grid = _points(crops, i, cells)[solid].cpu().numpy().astype(np.float64)
    if len(points_grid) == 0:  # a cell passes only after pooling: keep the strongest one
        strongest = int(shown[i].flatten().argmax())
        points_grid = _points(crops, i, cells)[strongest][None].cpu().numpy().astype(np.float64)
    if config.tracking.use_completion:
        box = _box(points_grid, cell_size, R_world_grid, low)
    else:
        center, extents = (
            x[i].cpu().numpy().astype(np.float64) for x in (proposals.center, proposals.extents)
        )
        box = Box(R_world_grid @ center + low, np.abs(R_world_grid) @ extents)
    points_world = points_grid @ R_world_grid.T + low
    observable = bool(fit.observable[i])
    if observable:
        similarity = Similarity(
            float(fit.scale[i]),
            R_world_grid @ fit.R[i].cpu().numpy().astype(np.float64),
            R_world_grid @ fit.t[i].cpu().numpy().astype(np.float64) + low,
        )
    else:
        similarity = Similarity(float(np.linalg.norm(box.extents)), np.eye(3), box.center)
    local = (points_world - similarity.t) @ similarity.R
    return ObjectEstimate(
        class_id=int(probabilities[i].argmax()),
        score=float(score[i]),
        box=box,
        S_world_canonical=similarity,
        pose_observable=observable,
        extents_m=2 * np.abs(local).max(axis=0) + cell_size.mean(),
        points_world=points_world.astype(np.float32),
        points_canonical=(local / similarity.scale_m).astype(np.float32),
        canonical=canonical[i].cpu().numpy(),
    )


def _points(crops: CropBatch, i: int, cells: int) -> Tensor:
    one = CropBatch(crops.frame[i : i + 1], crops.center[i : i + 1], crops.size[i : i + 1])
    return one.points(cells)[0]


def _box(points_grid, cell_size, R_world_grid, low) -> Box:
    """Tight world box of the filled cells."""
    lo, hi = points_grid.min(axis=0) - cell_size / 2, points_grid.max(axis=0) + cell_size / 2
    return Box(R_world_grid @ ((lo + hi) / 2) + low, np.abs(R_world_grid) @ (hi - lo))
