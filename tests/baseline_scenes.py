"""Scenes of turned boxes over a floor and walls, by exact ray casting, with their true masks.

World: z up. The camera stands 1.2 m high at the origin of x and y and looks along +x, tilted down.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from composenet.baselines.records import InstanceMasks
from composenet.geometry.box import OrientedBox
from composenet.geometry.camera import pixel_rays
from composenet.geometry.transform import angle_between_deg, make_T, rotation_z
from composenet.records import CLASS_NAMES, Camera, Frame, TrackedObject

CABINET, CHAIR = CLASS_NAMES.index("cabinet"), CLASS_NAMES.index("chair")
CAMERA = Camera(
    K=np.array([[280.0, 0, 159.5], [0, 280.0, 119.5], [0, 0, 1]]), width=320, height=240
)
SMALL = Camera(K=np.array([[80.0, 0, 39.5], [0, 80.0, 29.5], [0, 0, 1]]), width=80, height=60)
REST = np.eye(4)
ROOM = OrientedBox(np.array([1.0, 0, 1.4]), rotation_z(0.1), np.array([8.0, 7.0, 2.8]))
_C, _S = np.cos(0.25), np.sin(0.25)
AHEAD = np.array([[0.0, -_S, _C], [-1, 0, 0], [0, -_C, -_S]])


@dataclass(frozen=True)
class Seen:
    """A frame and the masks of the furniture in it."""

    frame: Frame
    masks: InstanceMasks


def cabinet(x: float, y: float, yaw: float = 0.0) -> OrientedBox:
    """0.5 x 0.7 x 0.9 m, on the floor."""
    return OrientedBox(np.array([x, y, 0.45]), rotation_z(yaw), np.array([0.5, 0.7, 0.9]))


def screen(x: float, y: float, width: float = 0.6) -> OrientedBox:
    """Hides what stands behind it."""
    return OrientedBox(np.array([x, y, 1.0]), np.eye(3), np.array([0.05, width, 2.0]))


def pillar(x: float, y: float) -> OrientedBox:
    """Something for a camera to hold on to."""
    return OrientedBox(np.array([x, y, 0.8]), rotation_z(x), np.array([0.3, 0.4, 1.6]))


def camera_pose(yaw: float = 0.0, x: float = 0.0, y: float = 0.0) -> np.ndarray:
    """`T_world_camera`, turned to the left by yaw."""
    return make_T(rotation_z(yaw) @ AHEAD, (x, y, 1.2))


def look(
    index: int,
    furniture: Sequence[OrientedBox],
    others: Sequence[OrientedBox] = (),
    T_world_camera: np.ndarray | None = None,
    class_id: int = CABINET,
) -> Seen:
    """The frame of a room with these boxes; gt_id is the place in `furniture`, from 1. Depth is
    exact but for millimetres, as a 16-bit image has it."""
    T = camera_pose() if T_world_camera is None else T_world_camera
    rays = pixel_rays(CAMERA) @ T[:3, :3].T
    depth = _through(rays, T[:3, 3], ROOM)[1]
    ids = np.zeros(depth.shape, dtype=np.int64)
    for number, box in enumerate([*furniture, *others], start=1):
        enter, leave = _through(rays, T[:3, 3], box)
        hit = (enter < leave) & (enter > 0) & (enter < depth)
        depth = np.where(hit, enter, depth)
        ids[hit] = number if number <= len(furniture) else 0
    gt_ids = np.array([i for i in range(1, len(furniture) + 1) if (ids == i).any()], np.int64)
    masks = InstanceMasks(
        masks=ids[None] == gt_ids[:, None, None],
        class_ids=np.full(len(gt_ids), class_id),
        scores=np.ones(len(gt_ids), np.float32),
        gt_ids=gt_ids,
    )
    depth_m = np.round(depth, 3).astype(np.float32)
    return Seen(Frame(index, depth_m, CAMERA, T, name=str(index)), masks)


def _through(rays: np.ndarray, eye: np.ndarray, box: OrientedBox) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) z-depths at which rays enter and leave a box."""
    with np.errstate(divide="ignore"):
        a, b = (
            ((box.center - eye) @ box.R + sign * box.extents / 2) / (rays @ box.R)
            for sign in (-1, 1)
        )
    return np.minimum(a, b).max(axis=-1), np.maximum(a, b).min(axis=-1)


def without_ids(seen: Seen) -> Seen:
    """The same masks, of nobody knows whom."""
    return replace(seen, masks=replace(seen.masks, gt_ids=None))


def motion_errors(
    tracked: list[TrackedObject], truth: list[OrientedBox]
) -> tuple[np.ndarray, np.ndarray]:
    """(N,) metres of the true centre and degrees, both carried from the first frame."""
    first, start = tracked[0].S_world_canonical, truth[0]
    offset = first.R.T @ (start.center - first.t)
    metres, degrees = [], []
    for entry, true in zip(tracked, truth, strict=True):
        S = entry.S_world_canonical
        metres.append(np.linalg.norm(S.R @ offset + S.t - true.center))
        degrees.append(angle_between_deg(S.R @ first.R.T, true.R @ start.R.T))
    return np.array(metres), np.array(degrees)
