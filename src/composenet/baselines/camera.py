"""Camera poses from frame to frame, for systems that are not given them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from composenet.geometry.transform import inverse_T
from composenet.records import FloatArray, Frame
from composenet.sequences.odometry import Odometry


class OdometryCamera:
    """`T_world_camera` of one recording, in the world that the first frame's pose fixes."""

    def __init__(self) -> None:
        """Raises ConfigError where small_gicp is not installed."""
        self._odometry = Odometry()
        self._T_world_own: FloatArray | None = None  # of the odometry's own world
        self._T_world_camera: FloatArray = np.eye(4)

    def __call__(self, frame: Frame, movable: NDArray[np.bool_]) -> FloatArray:
        """(4, 4) pose of the next frame; the last one where odometry loses the camera. movable:
        (H, W) bool, pixels not to be trusted."""
        depth_m = np.where(movable, 0, frame.depth_m)
        found = self._odometry(depth_m, frame.camera, frame.color)
        if self._T_world_own is None:
            self._T_world_camera = frame.T_world_camera
        if found is not None:
            if self._T_world_own is None:
                self._T_world_own = frame.T_world_camera @ inverse_T(found)
            self._T_world_camera = self._T_world_own @ found
        return self._T_world_camera
