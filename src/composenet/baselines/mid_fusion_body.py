"""What MID-Fusion keeps of the background and of every object, and how they look together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, map_coordinates

from composenet.baselines.frame_maps import Maps
from composenet.baselines.hashed_tsdf import HashedTsdf
from composenet.baselines.photometric_icp import MAX_DISTANCE_M
from composenet.baselines.records import surface_track
from composenet.geometry.camera import project
from composenet.geometry.transform import apply_T, inverse_T, make_T
from composenet.records import CLASS_NAMES, Camera, FloatArray, TrackedObject, TrackState

TRUNCATION_M = 0.075
BACKGROUND_VOXEL_M = 0.02
SPACIOUS = 2.5
"""a volume is so many times as wide as what is seen of its object first"""
FINEST_SIDE_M, FINEST_VOXELS = 1.28, 128
"""a volume up to this wide has so many voxels a side, one twice as wide twice as many"""
BEHIND_M = 0.05
"""the background counts as so much farther than it is: objects win where both are near"""
RIM_PIXELS = 2
"""of what lies around a mask, that is told to be no part of the object"""
_RIM = np.ones((3, 3), bool)
_RIM[::2, ::2] = False


@dataclass(frozen=True)
class View:
    """All bodies as one camera sees them. maps: what is nearest at each pixel. shown: (H, W) int32,
    which body that is: the background 0, objects from 1, -1 none."""

    maps: Maps
    shown: NDArray[np.int32]


class Body:
    """The background or one object: its field and its pose (4, 4) `T_world_body`."""

    def __init__(self, volume: HashedTsdf, T_world_body: FloatArray) -> None:
        self.volume = volume
        self.T_world_body = T_world_body

    def fuse(self, maps: Maps, own: FloatArray, T_world_camera: FloatArray) -> None:
        """Take the pixels of a frame; own: (H, W) as in `HashedTsdf.integrate`."""
        T_camera_body = inverse_T(T_world_camera) @ self.T_world_body
        self.volume.integrate(maps.points[..., 2], maps.intensity, own, T_camera_body, maps.camera)

    def view(self, T_world_camera: FloatArray, camera: Camera) -> Maps:
        """What a camera sees of it."""
        return self.volume.raycast(inverse_T(T_world_camera) @ self.T_world_body, camera)


class Model(Body):
    """An object: also who it is and when it was seen. points_world: (P, 3), those that start it."""

    def __init__(self, track_id: int, points_world: FloatArray) -> None:
        size = float(np.ptp(points_world, axis=0).max())
        super().__init__(
            HashedTsdf(voxel_size(size), TRUNCATION_M), make_T(np.eye(3), points_world.mean(axis=0))
        )
        self.track_id = track_id
        self._votes = np.zeros(len(CLASS_NAMES))
        self._seen_at: int | None = None
        self._state, self._score = TrackState.TRACKED, 0.0
        self._extents_m: FloatArray = np.zeros(3)

    def see(self, frame_index: int, class_id: int, score: float) -> None:
        """A mask of this frame is its own."""
        absent = self._seen_at is not None and frame_index - self._seen_at > 1
        self._state = TrackState.RE_FOUND if absent else TrackState.TRACKED
        self._seen_at, self._score = frame_index, score
        self._votes[class_id] += score

    def measure(self) -> None:
        """The box of what was seen so far, less stray voxels."""
        surface = self.volume.surface()
        if len(surface):
            low, high = np.percentile(surface, [5, 95], axis=0)
            self._extents_m = high - low

    def record(self, frame_index: int) -> TrackedObject:
        """Its entry for this frame."""
        return surface_track(
            self.track_id,
            frame_index,
            int(self._votes.argmax()),
            self._state if self._seen_at == frame_index else None,
            self._score,
            self.T_world_body,
            self._extents_m,
        )


def voxel_size(object_size_m: float) -> float:
    """Edge of a voxel, metres, for an object of which so much is seen at first."""
    side = max(SPACIOUS * object_size_m, FINEST_SIDE_M / 2)
    voxels = FINEST_VOXELS * 2 ** max(0, int(np.ceil(np.log2(side / FINEST_SIDE_M))))
    return side / voxels


def composed(views: Sequence[Maps]) -> View:
    """The nearest of what one camera sees of each body, the background first."""
    nearest = Maps(
        np.zeros_like(views[0].points),
        np.zeros_like(views[0].normals),
        np.full_like(views[0].intensity, np.nan),
        views[0].camera,
    )
    shape = nearest.intensity.shape
    shown, depth = np.full(shape, -1, np.int32), np.full(shape, np.inf)
    for number, view in enumerate(views):
        _compose(
            view.points, view.normals, view.intensity, number, 0 if number else BEHIND_M,
            nearest.points, nearest.normals, nearest.intensity, shown, depth,
        )  # fmt: skip
    return View(nearest, shown)


@numba.njit(cache=True, nogil=True)
def _compose(
    points, normals, light, number, behind_m,
    best_points, best_normals, best_light, shown, depth,
):  # fmt: skip
    """Put a body before what is farther away, in place."""
    height, width = depth.shape
    for v in range(height):
        for u in range(width):
            z = points[v, u, 2]
            if z <= 0 or z + behind_m >= depth[v, u]:
                continue
            if normals[v, u, 0] == 0 and normals[v, u, 1] == 0 and normals[v, u, 2] == 0:
                continue
            depth[v, u], shown[v, u], best_light[v, u] = z + behind_m, number, light[v, u]
            for k in range(3):
                best_points[v, u, k] = points[v, u, k]
                best_normals[v, u, k] = normals[v, u, k]


def with_brightness(surface: Maps, frame: Maps, T_frame_surface: FloatArray) -> Maps:
    """The surface with the brightness that another frame measured of it, where it shows it.
    T_frame_surface: (4, 4) between the cameras."""
    points = apply_T(T_frame_surface, surface.points)
    columns, rows = np.moveaxis(project(points, frame.camera), -1, 0)
    inside = (columns >= 0) & (columns <= frame.camera.width - 1)
    inside &= (rows >= 0) & (rows <= frame.camera.height - 1) & surface.valid
    u, v = columns[inside], rows[inside]
    measured = frame.points[np.rint(v).astype(int), np.rint(u).astype(int), 2]
    agrees = np.abs(measured - points[inside, 2]) <= MAX_DISTANCE_M
    light = surface.intensity.copy()
    sampled = map_coordinates(frame.intensity, [v, u], order=1)
    light[inside] = np.where(agrees, sampled, light[inside])
    return Maps(surface.points, surface.normals, light, surface.camera)


def own_pixels(
    mask: NDArray[np.bool_], shown: NDArray[np.bool_], share: float = 1.0
) -> NDArray[np.float32]:
    """(H, W) what a body's field is told: `share` in its mask, 0 around it and where it was shown
    outside it, -1 elsewhere."""
    told = binary_dilation(mask, _RIM, iterations=RIM_PIXELS) | shown
    return np.where(mask, share, np.where(told, 0, -1)).astype(np.float32)
