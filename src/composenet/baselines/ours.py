"""Our own tracker as a row of the table, for cameras that are not given."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from composenet.baselines.camera import OdometryCamera
from composenet.baselines.records import InstanceMasks
from composenet.records import Frame, TrackedObject

if TYPE_CHECKING:
    from composenet.pipeline import ObjectTracker


class OwnCamera:
    """ComPoseNet with camera poses from odometry over all that it sees, as it follows a recording
    without poses."""

    def __init__(self, tracker: ObjectTracker) -> None:
        self._tracker = tracker
        self._camera = OdometryCamera()

    def __call__(self, frame: Frame, masks: InstanceMasks) -> tuple[TrackedObject, ...]:
        """Every living track. The masks are not looked at."""
        pose = self._camera(frame, np.zeros(frame.depth_m.shape, dtype=bool))
        return self._tracker(replace(frame, T_world_camera=pose)).objects


def no_masks(frame: Frame) -> InstanceMasks:
    """For systems that need none."""
    nothing = np.zeros((0, *frame.depth_m.shape), dtype=bool)
    return InstanceMasks(nothing, np.zeros(0, np.int64), np.zeros(0, np.float32))
