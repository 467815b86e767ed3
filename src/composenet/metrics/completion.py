"""Completed geometry: IoU of volumes in the world frame, distances between surfaces.

Both volumes are sampled at the cell centres of one world grid of 2.5 cm whose cell faces lie
at multiples of the cell, so that equal solids give equal cells.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion
from scipy.spatial import cKDTree

from composenet.geometry.box import OrientedBox, corners
from composenet.geometry.camera import project
from composenet.geometry.transform import apply_T, inverse_T
from composenet.metrics.records import IntArray
from composenet.records import Box, FloatArray, Frame, ObjectEstimate, ObjectTruth

VOXEL_M = 0.025
OCCUPIED = 0.5
SEEN_TOLERANCE_M = 2 * VOXEL_M


@dataclass(frozen=True)
class VoxelVolume:
    """Cells of the world grid. first: (3,) int, index of occupied[0, 0, 0]; cell i spans
    i * voxel_m to (i + 1) * voxel_m. occupied: (X, Y, Z) bool, possibly of size 0."""

    first: IntArray
    occupied: NDArray[np.bool_]
    voxel_m: float = VOXEL_M

    def surface(self) -> NDArray[np.float64]:
        """(N, 3) centres, metres, world, of occupied cells with an empty face neighbour."""
        shell = self.occupied & ~binary_erosion(self.occupied)
        return np.asarray((self.first + np.argwhere(shell) + 0.5) * self.voxel_m, dtype=np.float64)

    def between(self, low: IntArray, high: IntArray) -> NDArray[np.bool_]:
        """The occupied array from world cell `low` up to `high`, which lie within the grid."""
        (x0, y0, z0), (x1, y1, z1) = low - self.first, high - self.first
        return self.occupied[x0:x1, y0:y1, z0:z1]

    def touches(self, box: Box) -> bool:
        """Whether the grid's bounds overlap an axis-aligned box, grown by a cell."""
        low = self.first * self.voxel_m
        high = low + np.array(self.occupied.shape) * self.voxel_m
        reach = np.asarray(box.extents) / 2 + self.voxel_m
        return bool(np.all(low < box.center + reach) and np.all(high > box.center - reach))


@dataclass(frozen=True)
class CompletionError:
    """A prediction against its truth; surface distances in centimetres, NaN where a side has
    no surface. chamfer_cm: mean of the two directed means. seen_cm, unseen_cm: from the true
    surface to the predicted one, over the part that the depth image shows and the rest."""

    volume_iou: float
    chamfer_cm: float
    seen_cm: float = float("nan")
    unseen_cm: float = float("nan")


def voxelize_truth(truth: ObjectTruth, T_world_object: FloatArray) -> VoxelVolume:
    """The true solid on the world grid."""
    box = OrientedBox(T_world_object[:3, 3], T_world_object[:3, :3], truth.extents_m)
    return voxelize(truth.occupancy, box)


def voxelize_estimate(estimate: ObjectEstimate) -> VoxelVolume:
    """The predicted solid (canonical reconstruction, at least 0.5) on the world grid."""
    S = estimate.S_world_canonical
    box = OrientedBox(S.t, S.R, np.full(3, S.scale_m, dtype=np.float64))
    return voxelize(estimate.canonical >= OCCUPIED, box)


def voxelize(
    occupied: NDArray[np.bool_], box: OrientedBox, voxel_m: float = VOXEL_M
) -> VoxelVolume:
    """A grid (X, Y, Z) that fills an oriented box, looked up at the centres of world cells."""
    cells = np.argwhere(occupied)
    if len(cells) == 0:
        return VoxelVolume(np.zeros(3, dtype=np.int64), np.zeros((0, 0, 0), dtype=bool), voxel_m)
    shape = np.array(occupied.shape)
    low, high = cells.min(axis=0), cells.max(axis=0) + 1
    block = VoxelVolume(np.zeros(3, dtype=np.int64), occupied).between(low, high)
    R = np.asarray(box.R, dtype=np.float64)
    cell_m = np.asarray(box.extents, dtype=np.float64) / shape
    center = R @ (((low + high) / 2 - shape / 2) * cell_m) + box.center
    reach = corners(OrientedBox(center, R, (high - low) * cell_m)) / voxel_m
    first = np.floor(reach.min(axis=0)).astype(np.int64)
    count = np.ceil(reach.max(axis=0)).astype(np.int64) - first
    x, y, z = np.ix_(
        *(_cell_centres(*axis, voxel_m) for axis in zip(first, count, center, strict=True))
    )
    filled = np.ones(tuple(count), dtype=bool)
    flat = np.zeros(tuple(count), dtype=np.int64)
    for axis, size in enumerate(block.shape):
        along = (R[0, axis] * x + R[1, axis] * y + R[2, axis] * z) / cell_m[axis] + size / 2
        index = np.floor(along).astype(np.int64)
        filled &= (index >= 0) & (index < size)
        flat = flat * size + index
    filled[filled] = block.ravel()[flat[filled]]
    return VoxelVolume(first, filled, voxel_m)


def _cell_centres(first: int, count: int, origin: float, voxel_m: float) -> NDArray[np.float64]:
    return np.asarray((first + np.arange(count) + 0.5) * voxel_m - origin, dtype=np.float64)


def volume_iou(a: VoxelVolume, b: VoxelVolume) -> float:
    """IoU of two solids on the same grid; 0 where both are empty."""
    low = np.maximum(a.first, b.first)
    high = np.minimum(a.first + a.occupied.shape, b.first + b.occupied.shape)
    shared = 0
    if np.all(high > low):
        shared = int(np.count_nonzero(a.between(low, high) & b.between(low, high)))
    union = int(np.count_nonzero(a.occupied) + np.count_nonzero(b.occupied)) - shared
    return shared / union if union else 0.0


def completion_error(
    truth: VoxelVolume, prediction: VoxelVolume, frame: Frame | None = None
) -> CompletionError:
    """Volume IoU and surface distances; with the frame, split into seen and unseen."""
    overlap = volume_iou(truth, prediction)
    true_surface, surface = truth.surface(), prediction.surface()
    if len(true_surface) == 0 or len(surface) == 0:
        return CompletionError(overlap, float("nan"))
    to_prediction = 100 * cKDTree(surface).query(true_surface)[0]
    to_truth = 100 * cKDTree(true_surface).query(surface)[0]
    chamfer = float(to_prediction.mean() + to_truth.mean()) / 2
    if frame is None:
        return CompletionError(overlap, chamfer)
    seen = seen_points(true_surface, frame)
    return CompletionError(
        overlap, chamfer, _mean(to_prediction[seen]), _mean(to_prediction[~seen])
    )


def seen_points(
    points_world: FloatArray, frame: Frame, tolerance_m: float = SEEN_TOLERANCE_M
) -> NDArray[np.bool_]:
    """(N,) whether a point lies on or before the depth that its pixel measured."""
    points = apply_T(inverse_T(frame.T_world_camera), points_world)
    pixels = project(points, frame.camera)
    height, width = frame.depth_m.shape
    u, v = np.round(np.nan_to_num(pixels, nan=-1)).astype(np.int64).T
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    depth = np.where(inside, frame.depth_m[v * inside, u * inside], 0.0)
    return np.asarray((depth > 0) & (points[:, 2] <= depth + tolerance_m))


def _mean(values: NDArray[np.float64]) -> float:
    return float(values.mean()) if len(values) else float("nan")
