"""Proposals -> posed, completed objects (paper sections 4.2 and 4.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from composenet.config import Config
from composenet.detection import Proposals
from composenet.geometry.affine import apply_affine
from composenet.geometry.procrustes import SimilarityFit, fit_similarity
from composenet.geometry.resampling import resampled
from composenet.network.batch import CropBatch, VolumeBatch
from composenet.network.detection_head import VoxelFields
from composenet.network.model import ComposeNet
from composenet.network.object_net import ObjectFields, fit_weights, stretched
from composenet.records import Box, ObjectEstimate, Similarity
from composenet.volume.voxels import Volume

CANONICAL_CELLS = 64


@dataclass(frozen=True)
class _Completed:
    """Every proposal of a frame, completed and posed, as tensors in the grid frame.

    shown: (M, C, C, C) occupancy in 0..1, 0.5 being the decision. score: (M,). center: (M, 3) of
    the boxes, metres. canonical: (M, 64, 64, 64).
    """

    proposals: Proposals
    crops: CropBatch
    shown: Tensor
    score: Tensor
    fit: SimilarityFit
    center: Tensor
    canonical: Tensor


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

    The box is as large as the detector says and stands midway between where the detector says and
    where the completed cells reach in that pose, which errs less than either. Along the object's
    own axes it is as long and wide as the completed cells' centres reach and half a cell (least
    biased on validation), and as high as the detector says: of legs few cells are sure.
    With config.tracking.use_completion False only observed cells carry geometry and
    correspondences (the paper's "no compl.").
    """
    if len(proposals.center) == 0:
        return ()
    found = _complete(network, fields, batch, volume, proposals, config)
    filled = (found.shown >= 0.5).flatten(1).any(dim=1)
    order = torch.argsort(found.score, descending=True, stable=True)
    return tuple(_estimate(i, found, volume, config) for i in order.tolist() if filled[i])


def _complete(
    network: ComposeNet,
    fields: VoxelFields,
    batch: VolumeBatch,
    volume: Volume,
    proposals: Proposals,
    config: Config,
) -> _Completed:
    center = proposals.center
    frame = torch.zeros(len(center), dtype=torch.long, device=center.device)
    boxes = CropBatch.around(frame, center, proposals.extents, config.network.crop_margin)
    probabilities = proposals.class_probabilities
    objects = network.object_fields(fields, batch, boxes, probabilities)
    crops = objects.crops
    score = proposals.score * probabilities.amax(dim=1).sqrt()
    shown = _shown_occupancy(objects, config)
    points = crops.points(config.network.crop_cells // 2)
    correspondences = objects.nocs.flatten(2).transpose(1, 2)
    fit = fit_similarity(correspondences, points, fit_weights(shown), upright=True)
    fit = _with_boxes(fit, proposals, volume)
    posed = fit.t + _offset(fit, shown, crops) if config.tracking.use_completion else fit.t
    # linear interpolation would wear away a surface that is one cell thick
    canonical = _canonical(shown, crops, fit, nearest=not config.tracking.use_completion)
    center = (posed + proposals.center) / 2
    return _Completed(proposals, crops, shown, score, fit, center, canonical)


def _offset(fit: SimilarityFit, shown: Tensor, crops: CropBatch) -> Tensor:
    """(M, 3) metres, level: from the centre of an object's own box to that of the axis-aligned box
    around it, by its filled cells. They differ for what is no rectangle from above, as a corner
    sofa, and does not stand along the axes."""
    filled = (shown >= 0.5).flatten(1)[..., None]
    points = crops.points(shown.shape[-1])
    turned = apply_affine(fit.R.transpose(1, 2), torch.zeros_like(fit.t), points)

    def middle(places: Tensor) -> Tensor:
        low = torch.where(filled, places, torch.inf).amin(dim=1)
        return (low + torch.where(filled, places, -torch.inf).amax(dim=1)) / 2

    offset = middle(points) - (fit.R @ middle(turned)[..., None])[..., 0]
    offset[:, 2] = 0
    return torch.where(filled.any(dim=1), offset, torch.zeros_like(offset))


def _shown_occupancy(objects: ObjectFields, config: Config) -> Tensor:
    """(M, C, C, C) probability, stretched so that 0.5 is the decision threshold."""
    shown = stretched(objects.occupancy.sigmoid(), config.network.occupancy_threshold)
    if not config.tracking.use_completion:
        shown = shown * objects.surface.to(shown.dtype)
    return shown


def _with_boxes(fit: SimilarityFit, proposals: Proposals, volume: Volume) -> SimilarityFit:
    """Where the pose is not observable: turned as the world, with the box's centre and diagonal."""
    known = fit.observable
    R_grid_world = torch.from_numpy(volume.T_world_grid[:3, :3].T).to(fit.R)
    return SimilarityFit(
        torch.where(known, fit.scale, proposals.extents.norm(dim=1)),
        torch.where(known[:, None, None], fit.R, R_grid_world),
        torch.where(known[:, None], fit.t, proposals.center),
        known,
    )


def _canonical(shown: Tensor, crops: CropBatch, fit: SimilarityFit, nearest: bool) -> Tensor:
    """(M, 64, 64, 64) occupancy resampled in canonical space through the fitted similarity."""
    to_share = crops.R_grid_crop.transpose(1, 2) / crops.size[:, :, None]
    A = to_share @ (fit.scale[:, None, None] * fit.R)
    b = 0.5 + (to_share @ (fit.t - crops.center)[:, :, None])[..., 0]
    return resampled(shown, A, b, CANONICAL_CELLS, nearest)


def _estimate(i: int, found: _Completed, volume: Volume, config: Config) -> ObjectEstimate:
    """Proposal i in the world."""
    R_world_grid, low = volume.T_world_grid[:3, :3], volume.T_world_grid[:3, 3]
    cells = config.network.crop_cells
    crop = found.crops[i : i + 1]
    cell_m = _numpy(crop.size[0]) / cells
    filled = found.shown[i].flatten() >= 0.5
    points_grid = _numpy(crop.points(cells)[0, filled])
    similarity = Similarity(
        scale_m=float(found.fit.scale[i]),
        R=R_world_grid @ _numpy(found.fit.R[i]),
        t=R_world_grid @ _numpy(found.fit.t[i]) + low,
    )
    box = Box(
        R_world_grid @ _numpy(found.center[i]) + low,
        np.abs(R_world_grid) @ _numpy(found.proposals.extents[i]),
    )
    points_world = points_grid @ R_world_grid.T + low
    local = (points_world - similarity.t) @ similarity.R
    return ObjectEstimate(
        class_probabilities=_numpy(found.proposals.class_probabilities[i]),
        score=float(found.score[i]),
        box=box,
        S_world_canonical=similarity,
        pose_observable=bool(found.fit.observable[i]),
        extents_m=np.append(np.ptp(local[:, :2], axis=0) + cell_m.mean() / 2, box.extents[2]),
        points_world=points_world.astype(np.float32),
        canonical=found.canonical[i].cpu().numpy(),
    )


def _numpy(values: Tensor) -> NDArray[np.float64]:
    return values.cpu().numpy().astype(np.float64)
