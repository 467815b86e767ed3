"""Small hand-made rooms for the tests of tracking: boxes, a camera, their depth image.

World: z up; the camera stands at the origin, 1.2 m high, and looks along +x,
tilted down by 0.2 rad.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from composenet.geometry.box import aabb_of_points
from composenet.geometry.camera import pixel_rays
from composenet.geometry.transform import make_T, rotation_z
from composenet.records import CLASS_NAMES, Box, Camera, Frame, ObjectEstimate, Similarity

CHAIR, DESK, TABLE = 4, 5, 8
WALL_M = 6.0
CAMERA = Camera(K=np.array([[140.0, 0, 79.3], [0, 140.0, 59.3], [0, 0, 1]]), width=160, height=120)
_C, _S = np.cos(0.2), np.sin(0.2)
LOOK_ALONG_X = np.array([[0.0, -_S, _C], [-1, 0, 0], [0, -_C, -_S]])
SIZE = np.array([0.6, 0.6, 0.9])


def block(extents_m: Sequence[float] = tuple(SIZE), hollow: bool = False) -> np.ndarray:
    """(64, 64, 64) canonical reconstruction of a block; hollow: only its lower fifth."""
    half = np.asarray(extents_m) / np.linalg.norm(extents_m) / 2
    cells = (np.arange(64) + 0.5) / 64 - 0.5
    inside = [np.abs(cells) <= side for side in half]
    if hollow:
        inside[2] &= cells < -0.6 * half[2]
    return np.einsum("i,j,k->ijk", *(axis.astype(np.float32) for axis in inside))


def thing(
    x: float,
    y: float,
    *,
    class_id: int = CHAIR,
    score: float = 0.9,
    size: Sequence[float] = tuple(SIZE),
    yaw: float = 0.0,
    canonical: np.ndarray | None = None,
    observable: bool = True,
) -> ObjectEstimate:
    """A block standing on the floor at (x, y)."""
    extents, R = np.asarray(size, dtype=float), rotation_z(yaw)
    center = np.array([x, y, extents[2] / 2])
    corners = np.stack(np.meshgrid(*[(-0.5, 0.5)] * 3), -1).reshape(-1, 3) * extents
    return ObjectEstimate(
        class_probabilities=np.eye(len(CLASS_NAMES))[class_id],
        score=score,
        box=aabb_of_points(corners @ R.T + center),
        S_world_canonical=Similarity(float(np.linalg.norm(extents)), R, center),
        pose_observable=observable,
        extents_m=extents,
        points_world=np.zeros((0, 3), np.float32),
        canonical=block(size) if canonical is None else canonical,
    )


def frame(index: int, shown: Sequence[Box] = (), yaw: float = 0.0) -> Frame:
    """What the camera, turned by yaw, measures of boxes before a round wall at 6 m."""
    R = rotation_z(yaw) @ LOOK_ALONG_X
    eye = np.array([0.0, 0.0, 1.2])
    rays = pixel_rays(CAMERA) @ R.T
    depth = np.full(rays.shape[:2], WALL_M)
    for box in shown:
        with np.errstate(divide="ignore"):
            a = (box.center - box.extents / 2 - eye) / rays
            b = (box.center + box.extents / 2 - eye) / rays
        enter, leave = np.minimum(a, b).max(-1), np.maximum(a, b).min(-1)
        hit = (enter < leave) & (enter > 0)
        depth = np.where(hit, np.minimum(depth, enter), depth)
    return Frame(index, depth.astype(np.float32), CAMERA, make_T(R, eye))


def screen(x: float, y: float) -> Box:
    """A wide board that hides what stands behind it."""
    return Box(np.array([x, y, 1.0]), np.array([0.05, 1.4, 2.0]))
