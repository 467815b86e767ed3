"""Point-to-plane ICP between two clouds, from several first guesses, with outlier rejection.

Besl and McKay 1992, Rusinkiewicz and Levoy 2001; the inner loop is that of small_gicp (an
optional extra). Correspondences farther apart than a radius are rejected, and the radius shrinks
from pass to pass.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from composenet.geometry.transform import angle_between_deg, apply_T, inverse_T, make_T
from composenet.gicp import small_gicp
from composenet.records import FloatArray

REJECTION_RADII_M = (0.3, 0.1, 0.05)
"""correspondences farther apart than this are outliers, pass by pass"""
INLIER_M = 0.05
"""a point this near to the other cloud agrees with it"""
SAMPLING_M = 0.02
"""distances between thinned clouds that say nothing"""
MAX_TURN_DEG = 45.0
"""an alignment that turns an object farther from one frame to the next has failed"""
MIN_INLIER_SHARE = 0.3
"""an alignment that fewer points agree with has failed"""
MIN_POINTS = 30
"""smaller clouds are not aligned"""
_GOOD_FIT_M = 0.0005  # one point in sixty at fault: no other guess can fit much better
_BETTER_FIT = 0.8  # a later guess must fit that much better: partial views fit in many places
_RECIPROCAL_M = 0.05
_ITERATIONS = 15
_NEIGHBOURS = 12


class Cloud:
    """Points of one surface, thinned to one a voxel. points: (N, 3) float64, metres."""

    def __init__(self, points: FloatArray, voxel_size_m: float = 0.03) -> None:
        points = np.asarray(points, dtype=np.float64)
        # The grid is that of the frame: one that went with the cloud would hide its motion.
        sampled = small_gicp().voxelgrid_sampling(points, voxel_size_m) if len(points) else None
        self.points = sampled.points()[:, :3] if sampled else np.zeros((0, 3))

    def __len__(self) -> int:
        return len(self.points)

    @cached_property
    def origin(self) -> NDArray[np.float64]:
        """(3,) mean of the points."""
        return self.points.mean(axis=0) if len(self) else np.zeros(3)

    @cached_property
    def tree(self) -> cKDTree:
        return cKDTree(self.points, balanced_tree=False, compact_nodes=False)

    @cached_property
    def local(self) -> Any:
        """small_gicp's cloud with normals, about `origin`."""
        library = small_gicp()
        cloud = library.PointCloud(self.points - self.origin)
        library.estimate_normals(cloud, num_neighbors=_NEIGHBOURS)
        return cloud

    @cached_property
    def local_tree(self) -> Any:
        return small_gicp().KdTree(self.local)


@dataclass(frozen=True)
class Alignment:
    """`p_target = T_target_source @ p_source`. inlier_share: of the points of the cloud
    that agrees better, those within INLIER_M of the other. misfit_m: their mean distance beyond
    SAMPLING_M, each counted up to INLIER_M."""

    T_target_source: FloatArray
    inlier_share: float
    misfit_m: float


def align(
    target: Cloud,
    source: Cloud,
    guesses: Sequence[FloatArray],
    reach_m: float = np.inf,
) -> Alignment | None:
    """The alignment of least misfit over all first guesses `T_target_source` (4, 4), the earlier
    one where two fit alike; None where the clouds are too small, too few points agree, the turn
    is too large or the source's middle moves farther than reach_m."""
    if min(len(target), len(source)) < MIN_POINTS:
        return None
    best: Alignment | None = None
    for guess in guesses:
        found = _measured(target, source, _refined(target, source, guess))
        if not _plausible(found.T_target_source, source.origin, reach_m):
            continue
        if best is None or found.misfit_m < _BETTER_FIT * best.misfit_m:
            best = found
        if best.misfit_m < _GOOD_FIT_M:
            break
    return best if best is not None and best.inlier_share >= MIN_INLIER_SHARE else None


def _plausible(T: FloatArray, middle: FloatArray, reach_m: float) -> bool:
    step_m = np.linalg.norm(apply_T(T, middle) - middle)
    return bool(step_m <= reach_m and angle_between_deg(T[:3, :3], np.eye(3)) <= MAX_TURN_DEG)


def _refined(target: Cloud, source: Cloud, T_target_source: FloatArray) -> FloatArray:
    """One pass for each radius, of the source's points that have a partner within it."""
    library = small_gicp()
    for radius_m in REJECTION_RADII_M:
        paired = _reciprocal(target, source, T_target_source, radius_m)
        if paired.sum() < MIN_POINTS:
            continue
        kept = apply_T(T_target_source, source.points[paired])
        result = library.align(
            target.local,
            library.PointCloud(kept - target.origin),
            target.local_tree,
            registration_type="PLANE_ICP",
            max_correspondence_distance=radius_m,
            max_iterations=_ITERATIONS,
        )
        if np.isfinite(result.T_target_source).all():
            T_target_source = _about(result.T_target_source, target.origin) @ T_target_source
    return T_target_source


def _about(T: FloatArray, origin: FloatArray) -> FloatArray:
    """The motion T, told about `origin`, in the frame of `origin`."""
    return make_T(T[:3, :3], T[:3, 3] + origin - T[:3, :3] @ origin)


def _reciprocal(
    target: Cloud, source: Cloud, T_target_source: FloatArray, radius_m: float
) -> NDArray[np.bool_]:
    """(N,) whether a source point's nearest in the target is within the radius and has its own
    nearest near that point. Surface that only one of the clouds shows, cut off by the image's
    border or by what stands before it, ends at the rim of the other and would pull it over."""
    moved = apply_T(T_target_source, source.points)
    distance, partner = target.tree.query(moved, distance_upper_bound=radius_m)
    found = np.flatnonzero(np.isfinite(distance))  # the others' partner is no index
    partners = apply_T(inverse_T(T_target_source), target.points[partner[found]])
    _, back = source.tree.query(partners)
    apart = np.linalg.norm(source.points[back] - source.points[found], axis=1)
    kept = np.zeros(len(source), dtype=bool)
    kept[found[apart < _RECIPROCAL_M]] = True
    return kept


def _measured(target: Cloud, source: Cloud, T_target_source: FloatArray) -> Alignment:
    """How well the cloud that shows less lies on the other."""
    moved = apply_T(T_target_source, source.points)
    moved_back = apply_T(inverse_T(T_target_source), target.points)
    distances = [
        tree.query(points, distance_upper_bound=INLIER_M)[0].clip(SAMPLING_M, INLIER_M)
        for tree, points in ((target.tree, moved), (source.tree, moved_back))
    ]
    return Alignment(
        T_target_source=T_target_source,
        inlier_share=max(float((d < INLIER_M).mean()) for d in distances),
        misfit_m=min(float((d - SAMPLING_M).mean()) for d in distances),
    )
