"""The camera's way from its depth images alone, for recordings without poses.

Each frame is aligned with a map of the hundred before it: generalised ICP against the Gaussians of
its cells (VGICP, Koide et al., ICRA 2021; the normal equations are small_gicp's, an optional
extra), from coarse cells to fine. It begins from the last motion, from rest and from turns to
either side, for hands turn a camera fast; the guess that leads nearest to the frame before is
taken. What moves is outvoted by what rests, unless it fills the image.

Along a wall or the floor the surfaces say nothing, but the rims of half-filled cells do, and they
lie. So a guess holds its place by a spring: weak against surfaces that face that way, strong
against rims, and nearly none with the finest cells.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from composenet.geometry.camera import back_project
from composenet.geometry.transform import (
    angle_between_deg,
    apply_T,
    inverse_T,
    make_T,
    rigid_T,
    rotation_z,
)
from composenet.gicp import small_gicp
from composenet.records import Camera, FloatArray, usable_depth
from composenet.sequences.leveling import CameraLeveler, surface_of

_CELLS_M = (0.4, 0.2, 0.1)
_SPRINGS = (20.0, 5.0, 0.05)  # by cell size, 1/m^2 a partner; along its normal a surface has 500
_REACH_CELLS = 3.0  # a point this far from a cell's Gaussian has no partner
_ITERATIONS = 10
_DONE = 0.001  # a step of fewer metres and radians is the last one
_SPACING_M = 0.05  # between the points of a frame that are aligned
_NEIGHBOURS = 12
_FAR_M = 6.0  # depth beyond this is too noisy to align
_MIN_POINTS = 100
_TURNS_DEG = (8.0, -8.0, 16.0, -16.0, 24.0, -24.0)  # about the vertical
_NEAR_M = 0.06
_GOOD_SHARE = 0.75  # of a frame's points near the frame before: no other guess is tried
_FAIR_SHARE = 0.6  # likewise where two guesses lead to the same pose
_SAME_M, _SAME_DEG = 0.01, 0.5
_LOST_SHARE = 0.3
_MAX_STEP_M, _MAX_TURN_DEG = 1.0, 45.0  # farther from one frame to the next no hand moves
_BETTER_SHARE = 0.03  # a later guess must lead that much nearer


class Odometry:
    """Camera poses of one recording or live camera, frame by frame, nothing from the future.

    >>> odometry = Odometry()
    >>> T_world_camera = odometry(depth_m, camera)
    """

    def __init__(self) -> None:
        """Raises ConfigError where small_gicp is not installed."""
        self._maps = [small_gicp().GaussianVoxelMap(cell_m) for cell_m in _CELLS_M]
        self._T: NDArray[np.float64] = np.eye(4)
        self._motion: NDArray[np.float64] = np.eye(4)  # of the last frame, T_before_now
        self._before: cKDTree | None = None  # points of the last frame that was placed

    def __call__(self, depth_m: FloatArray, camera: Camera) -> NDArray[np.float64] | None:
        """`T_world_camera` (4, 4) of the next frame; None where too little of it agrees with what
        was seen before. The world is levelled as the first frame shows it: z up, the floor it
        sees at z = 0. depth_m: (H, W) metres, 0 where unknown, or where a moving thing should not
        be trusted. Raises SequenceError where it is not in metres or not the camera's."""
        depth_m = usable_depth("odometry", depth_m, camera)
        points = back_project(depth_m, camera)[(depth_m > 0) & (depth_m < _FAR_M)]
        if len(points) < _MIN_POINTS:
            return None
        cloud, _ = small_gicp().preprocess_points(
            points.astype(np.float64), _SPACING_M, num_neighbors=_NEIGHBOURS
        )
        points = cloud.points()[:, :3]
        if len(points) < _MIN_POINTS:
            return None
        if self._before is None:
            _, self._T = CameraLeveler().level(surface_of(depth_m, camera))
        else:
            T = self._aligned(cloud, points)
            self._motion = np.eye(4) if T is None else inverse_T(self._T) @ T
            if T is None:
                return None
            self._T = T
        for cells in self._maps:
            cells.insert(cloud, self._T)
        self._before = cKDTree(apply_T(self._T, points), balanced_tree=False, compact_nodes=False)
        return self._T.copy()

    def _aligned(self, cloud: Any, points: FloatArray) -> NDArray[np.float64] | None:
        """The best guess's pose, if it is good enough."""
        R, t = self._T[:3, :3], self._T[:3, 3]
        turns = [make_T(rotation_z(angle) @ R, t) for angle in np.radians(_TURNS_DEG)]
        best, share = self._T, _LOST_SHARE - _BETTER_SHARE
        poses: list[NDArray[np.float64]] = []
        moves = not np.array_equal(self._motion, np.eye(4))
        for guess in (*([self._T @ self._motion] if moves else []), self._T, *turns):
            T = self._refined(cloud, guess)
            if not _alike(T, self._T, _MAX_STEP_M, _MAX_TURN_DEG):
                continue
            near = self._near_share(apply_T(T, points))
            if near > share + _BETTER_SHARE:
                best, share = T, near
            again = any(_alike(T, other, _SAME_M, _SAME_DEG) for other in poses)
            if share > _GOOD_SHARE or (share > _FAIR_SHARE and again):
                break
            poses.append(T)
        return best if share >= _LOST_SHARE else None

    def _refined(self, cloud: Any, T_guess: NDArray[np.float64]) -> NDArray[np.float64]:
        """The pose after Gauss-Newton with each map, coarse to fine."""
        T = T_guess
        for cell_m, spring, cells in zip(_CELLS_M, _SPRINGS, self._maps, strict=True):
            for _ in range(_ITERATIONS):
                at_T = small_gicp().align(
                    cells,
                    cloud,
                    init_T_target_source=T,
                    max_correspondence_distance=_REACH_CELLS * cell_m,
                    max_iterations=1,
                )
                if at_T.num_inliers < _MIN_POINTS:
                    break
                step = _step(at_T, T, T_guess, spring)
                # Errors of rounding would double from frame to frame.
                T = rigid_T(T @ make_T(Rotation.from_rotvec(step[:3]).as_matrix(), step[3:]))
                if np.abs(step).max() < _DONE:
                    break
        return T

    def _near_share(self, points: FloatArray) -> float:
        assert self._before is not None
        distance_m, _ = self._before.query(points, distance_upper_bound=_NEAR_M)
        return float(np.isfinite(distance_m).mean())


def _step(at_T: Any, T: FloatArray, T_guess: FloatArray, spring: float) -> NDArray[np.float64]:
    """(6,) rotation vector and translation, in the camera's axes, that best fits the surfaces and
    the spring. at_T: small_gicp's normal equations at the pose T."""
    stiffness = spring * at_T.num_inliers
    H, b = at_T.H.copy(), -at_T.b
    H[3:, 3:] += stiffness * np.eye(3)
    b[3:] += stiffness * T[:3, :3].T @ (T_guess[:3, 3] - T[:3, 3])
    return np.asarray(np.linalg.lstsq(H, b, rcond=None)[0])


def _alike(T: FloatArray, other: FloatArray, metres: float, degrees: float) -> bool:
    """Whether two poses are not farther apart than that."""
    apart_m = np.linalg.norm(T[:3, 3] - other[:3, 3])
    return bool(apart_m <= metres and angle_between_deg(T[:3, :3], other[:3, :3]) <= degrees)
