"""Ground truth of a frame as training targets, in the frame's grid."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from composenet.geometry.symmetry import ORDER
from composenet.geometry.transform import apply_T, inverse_T
from composenet.network.batch import CropBatch, VolumeBatch, collate
from composenet.records import Box, ObjectFrameTruth, ObjectTruth
from composenet.volume.voxels import Volume

UNKNOWN = -1
"""Label of a remembered voxel of an object that is out of view or has moved away unseen."""

OTHER_VOXELS = 20
"""What is no furniture counts as visible from this many voxels on."""

SOFT_CELLS = 32
"""Occupancy travels as the filled share of 32^3 cells over the object's own box."""


@dataclass(frozen=True)
class Sample:
    """One frame for training: its volume, its K visible objects and L visible other things.

    gt_id, class_id, symmetry_order: (K,) int64. center, extents: (K, 3) axis-aligned box, grid
    frame, metres. R_grid_object: (K, 3, 3). t: (K, 3) centre of the object's own box, grid frame.
    object_extents: (K, 3). occupancy: (K, 32, 32, 32) uint8, 0..8 filled subcells.
    visible_pixels: (K,) int64. other_boxes: (L, 6) centre and extents, as those of the objects.
    """

    volume: Volume
    gt_id: NDArray[np.int64]
    class_id: NDArray[np.int64]
    symmetry_order: NDArray[np.int64]
    center: NDArray[np.float32]
    extents: NDArray[np.float32]
    R_grid_object: NDArray[np.float32]
    t: NDArray[np.float32]
    object_extents: NDArray[np.float32]
    occupancy: NDArray[np.uint8]
    visible_pixels: NDArray[np.int64]
    other_boxes: NDArray[np.float32]


@dataclass(frozen=True)
class TrainingBatch:
    """B frames with K objects and L other things in all.

    frame: (K,) frame of each object. other_frame: (L,) that of each other thing. voxel_object: (N,)
    row of the voxel's object, -1 for none, -2 for what nobody can know.
    The rest as in Sample, as tensors.
    """

    volume: VolumeBatch
    frame: Tensor
    other_frame: Tensor
    voxel_object: Tensor
    class_id: Tensor
    symmetry_order: Tensor
    center: Tensor
    extents: Tensor
    R_grid_object: Tensor
    t: Tensor
    object_extents: Tensor
    occupancy: Tensor
    visible_pixels: Tensor
    other_boxes: Tensor

    @property
    def scale_m(self) -> Tensor:
        """(K,) diagonal of the object's box, metres."""
        return self.object_extents.norm(dim=1)

    def to(self, device: torch.device) -> TrainingBatch:
        """The same batch on another device."""
        moved = {name: value.to(device) for name, value in vars(self).items()}
        return TrainingBatch(**moved)


def forget_moved(
    volume: Volume, objects: Mapping[int, tuple[ObjectTruth, ObjectFrameTruth]]
) -> None:
    """Relabel, in place, the remembered voxels that are no surface of an object in this frame.

    objects: by id, those that are targets. A voxel of one of them that lies outside its box now
    becomes background; one of any other becomes UNKNOWN.
    """
    rows = np.arange(volume.n_seen, len(volume.labels))
    world = apply_T(volume.T_world_grid, volume.coords[rows] * volume.voxel_size_m)
    labels = volume.labels[rows]
    for gt_id in np.unique(labels[labels > 0]).tolist():
        mine = labels == gt_id
        if gt_id not in objects:
            volume.labels[rows[mine]] = UNKNOWN
            continue
        truth, now = objects[gt_id]
        local = apply_T(inverse_T(now.T_world_object), world[mine])
        out = (np.abs(local) > truth.extents_m / 2 + volume.voxel_size_m).any(axis=1)
        volume.labels[rows[mine][out]] = 0


def make_sample(
    volume: Volume,
    truths: Sequence[ObjectTruth],
    seen: Sequence[ObjectFrameTruth],
    others: Sequence[Box] = (),
) -> Sample:
    """Targets of the objects seen in a frame. truths, seen: one entry an object, same order.
    others: boxes of what is no furniture; kept are those of which the frame shows something."""
    R_grid_world = volume.T_world_grid[:3, :3].T
    low = volume.T_world_grid[:3, 3]

    def rows(values: list, shape: tuple[int, ...], kind: type) -> NDArray:
        return np.array(values, dtype=kind).reshape(-1, *shape)

    def center(box: Box) -> NDArray[np.float64]:
        return R_grid_world @ (box.center - low)

    def extents(box: Box) -> NDArray[np.float64]:
        return np.abs(R_grid_world) @ box.extents

    other_boxes = rows([[*center(b), *extents(b)] for b in others], (6,), np.float32)
    return Sample(
        volume=volume,
        gt_id=rows([f.gt_id for f in seen], (), np.int64),
        class_id=rows([o.class_id for o in truths], (), np.int64),
        symmetry_order=rows([ORDER[o.symmetry] for o in truths], (), np.int64),
        center=rows([center(f.box) for f in seen], (3,), np.float32),
        extents=rows([extents(f.box) for f in seen], (3,), np.float32),
        R_grid_object=rows(
            [R_grid_world @ f.T_world_object[:3, :3] for f in seen], (3, 3), np.float32
        ),
        t=rows([R_grid_world @ (f.T_world_object[:3, 3] - low) for f in seen], (3,), np.float32),
        object_extents=rows([o.extents_m for o in truths], (3,), np.float32),
        occupancy=rows([soften(o.occupancy) for o in truths], (SOFT_CELLS,) * 3, np.uint8),
        visible_pixels=rows([f.visible_pixels for f in seen], (), np.int64),
        other_boxes=other_boxes[_shown(volume, other_boxes)],
    )


def _shown(volume: Volume, boxes: NDArray[np.float32]) -> NDArray[np.bool_]:
    """(L,) bool: the frame sees OTHER_VOXELS or more in it that are no object's."""
    free = volume.labels[: volume.n_seen] == 0
    points = volume.coords[: volume.n_seen][free] * volume.voxel_size_m
    inside = np.ones((len(boxes), len(points)), np.bool_)
    for axis in range(3):
        away = np.abs(points[:, axis] - boxes[:, axis, None])
        inside &= away <= boxes[:, 3 + axis, None] / 2
    return np.count_nonzero(inside, axis=1) >= OTHER_VOXELS


def soften(occupancy: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """(64,)*3 bool -> (32,)*3 count of filled subcells, 0..8."""
    count = occupancy.view(np.uint8)
    count = count[::2] + count[1::2]  # a sum over all axes at once takes fifty times as long
    count = count[:, ::2] + count[:, 1::2]
    return count[..., ::2] + count[..., 1::2]


def collate_samples(samples: Sequence[Sample]) -> TrainingBatch:
    """Stack samples into one batch."""

    def join(name: str) -> Tensor:
        return torch.from_numpy(np.concatenate([getattr(s, name) for s in samples]))

    offsets = np.cumsum([0, *[len(s.gt_id) for s in samples]])
    frames = np.arange(len(samples))
    frame = np.repeat(frames, [len(s.gt_id) for s in samples])
    other_frame = np.repeat(frames, [len(s.other_boxes) for s in samples])
    voxel_object = []
    for sample, offset in zip(samples, offsets, strict=False):
        row = np.full(max(int(sample.volume.labels.max(initial=0)), *sample.gt_id, 0) + 1, -1)
        row[sample.gt_id] = np.arange(len(sample.gt_id)) + offset
        labels = sample.volume.labels
        voxel_object.append(np.where(labels == UNKNOWN, -2, row[labels.clip(min=0)]))
    return TrainingBatch(
        volume=collate([s.volume for s in samples]),
        frame=torch.from_numpy(frame),
        other_frame=torch.from_numpy(other_frame),
        voxel_object=torch.from_numpy(np.concatenate(voxel_object)),
        **{
            name: join(name)
            for name in (
                "class_id",
                "symmetry_order",
                "center",
                "extents",
                "R_grid_object",
                "t",
                "object_extents",
                "occupancy",
                "visible_pixels",
                "other_boxes",
            )
        },
    )


def occupancy_in_crops(batch: TrainingBatch, crops: CropBatch, rows: Tensor, cells: int) -> Tensor:
    """(M, cells^3 as a cube) filled share 0..1 of crop cells by object rows[m] of the batch."""
    points = crops.points(cells) - batch.t[rows][:, None]
    local = points @ batch.R_grid_object[rows]
    unit = 2 * local / batch.object_extents[rows][:, None]  # -1..1 over the object's box
    grid = unit.flip(-1).view(-1, cells, cells, cells, 3)
    filled = batch.occupancy[rows][:, None].to(grid.dtype) / 8
    return F.grid_sample(filled, grid, padding_mode="zeros", align_corners=False)[:, 0]
