"""Point-to-plane ICP between two clouds, from several first guesses, with outlier rejection.

Besl and McKay 1992, Rusinkiewicz and Levoy 2001; the inner loop is that of small_gicp (an
optional extra). Correspondences farther apart than a radius are rejected, and the radius shrinks
from pass to pass.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from composenet.errors import ConfigError
from composenet.geometry.transform import apply_T
from composenet.records import FloatArray

REJECTION_RADII_M = (0.3, 0.1, 0.05)
"""correspondences farther apart than this are outliers, pass by pass"""
INLIER_M = 0.05
"""a point this near to the other cloud agrees with it"""
MIN_INLIER_SHARE = 0.3
"""an alignment that fewer points agree with has failed"""
MIN_POINTS = 30
"""smaller clouds are not aligned"""
_SAME_FIT_M = 0.001  # fits this close are equal: then the earlier guess is taken
_ITERATIONS = 15
_NEIGHBOURS = 12


class Cloud:
    """Points of one surface, thinned to one a voxel. points: (N, 3) float64, metres."""

    def __init__(self, points: FloatArray, voxel_size_m: float = 0.02) -> None:
        self._origin = points.mean(axis=0) if len(points) else np.zeros(3)
        local = np.asarray(points - self._origin, dtype=np.float64)
        sampled = _small_gicp().voxelgrid_sampling(local, voxel_size_m) if len(points) else None
        self.points = sampled.points()[:, :3] + self._origin if sampled else np.zeros((0, 3))

    def __len__(self) -> int:
        return len(self.points)

    @property
    def origin(self) -> NDArray[np.float64]:
        """(3,) mean of the points it was made of."""
        return np.asarray(self._origin)

    @cached_property
    def tree(self) -> cKDTree:
        return cKDTree(self.points)

    def local(self, origin: FloatArray) -> Any:
        """small_gicp's cloud with normals, about `origin`."""
        library = _small_gicp()
        cloud = library.PointCloud(self.points - origin)
        library.estimate_normals(cloud, num_neighbors=_NEIGHBOURS)
        return cloud


@dataclass(frozen=True)
class Alignment:
    """`p_target = T_target_source @ p_source`. inlier_share: of the source's points, those
    within INLIER_M of the target. misfit_m: mean distance to the target, at most INLIER_M."""

    T_target_source: FloatArray
    inlier_share: float
    misfit_m: float


def align(
    target: Cloud,
    source: Cloud,
    guesses: Sequence[FloatArray],
    radii_m: Sequence[float] = REJECTION_RADII_M,
) -> Alignment | None:
    """The alignment of least misfit over all first guesses `T_target_source` (4, 4), the earlier
    one where two fit alike; None where the clouds are too small or too few points agree."""
    if min(len(target), len(source)) < MIN_POINTS:
        return None
    origin = target.origin
    clouds = target.local(origin), _small_gicp().PointCloud(source.points - origin)
    to_local, to_input = np.eye(4), np.eye(4)
    to_local[:3, 3], to_input[:3, 3] = -origin, origin
    best: Alignment | None = None
    for guess in guesses:
        refined = _refined(*clouds, to_local @ guess @ to_input, radii_m)
        found = _measured(target, source, to_input @ refined @ to_local)
        if best is None or found.misfit_m < best.misfit_m - _SAME_FIT_M:
            best = found
    return best if best is not None and best.inlier_share >= MIN_INLIER_SHARE else None


def _refined(
    target: Any, source: Any, T_target_source: FloatArray, radii_m: Sequence[float]
) -> FloatArray:
    library = _small_gicp()
    tree = library.KdTree(target)
    for radius_m in radii_m:
        result = library.align(
            target,
            source,
            tree,
            init_T_target_source=T_target_source,
            registration_type="PLANE_ICP",
            max_correspondence_distance=radius_m,
            max_iterations=_ITERATIONS,
        )
        if np.isfinite(result.T_target_source).all():
            T_target_source = result.T_target_source
    return T_target_source


def _measured(target: Cloud, source: Cloud, T_target_source: FloatArray) -> Alignment:
    distances, _ = target.tree.query(apply_T(T_target_source, source.points))
    return Alignment(
        T_target_source=T_target_source,
        inlier_share=float((distances < INLIER_M).mean()),
        misfit_m=float(np.minimum(distances, INLIER_M).mean()),
    )


def _small_gicp() -> ModuleType:
    """The library. Raises ConfigError where it is not installed."""
    try:
        import small_gicp
    except ImportError:
        raise ConfigError(
            "this needs small_gicp: install it with `pip install composenet[baselines]`"
        ) from None
    return small_gicp
