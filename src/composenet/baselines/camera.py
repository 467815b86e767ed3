"""Camera poses from frame to frame, for systems that are not given them.

Point-to-plane ICP of everything that is no furniture against the frame before, begun from the
last motion, from rest and from turns to either side (hands turn a camera fast).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from composenet.baselines.icp import Cloud, align
from composenet.geometry.camera import back_project
from composenet.geometry.transform import make_T, rotation_z
from composenet.records import FloatArray, Frame

VOXEL_M = 0.05
FAR_M = 6.0
"""depth beyond this is too noisy to align"""
RADII_M = (0.5, 0.2, 0.1, 0.05)
TURNS_DEG = (10.0, -10.0, 20.0, -20.0)
"""first guesses, about the vertical; 10 degrees move a wall 4 m away by 0.7 m"""


class FrameToFrameCamera:
    """`T_world_camera` of one recording, in the world that the first frame's pose fixes."""

    def __init__(self) -> None:
        self._cloud = Cloud(np.zeros((0, 3)))
        self._T_world_camera: FloatArray | None = None
        self._T_before_now: FloatArray = np.eye(4)  # the last motion

    def __call__(self, frame: Frame, movable: NDArray[np.bool_]) -> FloatArray:
        """(4, 4) pose of the next frame. movable: (H, W) bool, pixels not to be trusted. Where
        too little agrees with the frame before, the camera goes on as it last moved."""
        still = ~movable & (frame.depth_m > 0) & (frame.depth_m < FAR_M)
        cloud = Cloud(back_project(frame.depth_m, frame.camera)[still], VOXEL_M)
        if self._T_world_camera is None:
            self._T_world_camera = frame.T_world_camera
        else:
            up = self._T_world_camera[:3, :3]
            turns = [make_T(up.T @ rotation_z(a) @ up, np.zeros(3)) for a in np.radians(TURNS_DEG)]
            guesses = [self._T_before_now, np.eye(4), *turns]
            found = align(self._cloud, cloud, guesses, RADII_M)
            if found is not None:
                self._T_before_now = found.T_target_source
            self._T_world_camera = self._T_world_camera @ self._T_before_now
        self._cloud = cloud
        return self._T_world_camera
