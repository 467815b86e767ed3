"""A signed distance field of one rigid body, in blocks of 8^3 voxels found by a hash table.

Curless and Levoy 1996 for the running average; blocks where something was measured as in Niessner
et al. 2013 ("Real-time 3D reconstruction at scale using voxel hashing"). Beside distance and weight
a voxel keeps brightness and the share of its frames in which it was the body's own, so that what
stands beside a mask's rim goes into the field without becoming part of the body (McCormac et al.
2018, Fusion++).
"""

from __future__ import annotations

from typing import Self

import numba
import numpy as np
from numpy.typing import NDArray

from composenet.baselines.frame_maps import Maps, pinhole
from composenet.baselines.tsdf_raycast import (
    LIGHT,
    MIN_OWN,
    OWN,
    TSDF,
    WEIGHT,
    cast_rays,
    depth_ranges,
    farthest,
    tiles_of,
)
from composenet.baselines.voxel_blocks import SIDE, allocate_along_rays, empty_table, fill_table
from composenet.geometry.camera import back_project
from composenet.geometry.transform import inverse_T
from composenet.records import Camera, FloatArray

MAX_WEIGHT = 100.0
"""frames that the past weighs at most"""
_SHOWN_VOXELS = 3  # rays may meet a surface within so many voxels of one that is told of it
_SURFACE = 0.5  # of the truncation: voxels this near the surface have their place measured


class HashedTsdf:
    """The field, in the body's axes. coords: (N, 3) int32, the blocks. voxels: (N, 512, 4) float32:
    tsdf, weight in frames, brightness, share of frames in which it was the body's own."""

    def __init__(self, voxel_size_m: float, truncation_m: float) -> None:
        self.voxel_size_m, self.truncation_m = voxel_size_m, truncation_m
        self._keys, self._slots = empty_table(1024)
        self._coords = np.zeros((256, 3), np.int32)
        self._voxels = np.zeros((256, SIDE**3, 4), np.float32)
        self._shown = np.zeros(256, np.bool_)  # blocks with the body's own voxels at its surface
        self._count = 0

    def __len__(self) -> int:
        return self._count

    @property
    def coords(self) -> NDArray[np.int32]:
        return self._coords[: self._count]

    @property
    def voxels(self) -> NDArray[np.float32]:
        return self._voxels[: self._count]

    def integrate(
        self,
        depth_m: FloatArray,
        intensity: FloatArray,
        own: FloatArray,
        T_camera_body: FloatArray,
        camera: Camera,
    ) -> Self:
        """Average a frame into it. depth_m, intensity, own: (H, W) float32; own: 1 where a pixel
        is the body's, 0 where it is not, negative where nothing is to be fused."""
        depth = np.where(own >= 0, depth_m, 0).astype(np.float32)
        points = back_project(depth, camera)
        while not self._allocated(points, inverse_T(T_camera_body)):
            self._grow()
        _integrated(
            self.coords, self.voxels, self._shown, self.voxel_size_m, self.truncation_m, depth,
            intensity.astype(np.float32), own.astype(np.float32), T_camera_body, *pinhole(camera),
        )  # fmt: skip
        return self

    def raycast(self, T_camera_body: FloatArray, camera: Camera) -> Maps:
        """What a camera would see of the body: its surface, from outside."""
        block_m = SIDE * self.voxel_size_m
        near, far = depth_ranges(self.coords, self._shown, block_m, T_camera_body, *pinhole(camera))
        points, normals, light = cast_rays(
            self._keys, self._slots, self._voxels, self.voxel_size_m, self.truncation_m,
            near, far, inverse_T(T_camera_body), *pinhole(camera),
        )  # fmt: skip
        return Maps(points, normals, light, camera)

    def surface(self) -> NDArray[np.float64]:
        """(P, 3) centres of the body's own voxels near its surface, metres, body axes."""
        near = min(_SURFACE, self.voxel_size_m / self.truncation_m)
        return _near_surface(self.coords, self.voxels, self._shown, near) * self.voxel_size_m

    def _allocated(self, points: NDArray[np.float32], T_body_camera: FloatArray) -> bool:
        """Make blocks along the rays through the points; False where the table filled up."""
        self._count, done = allocate_along_rays(
            self._keys, self._slots, self._coords, self._count, points,
            T_body_camera, self.voxel_size_m, self.truncation_m,
        )  # fmt: skip
        return bool(done)

    def _grow(self) -> None:
        """A quarter more blocks, in place: no one else holds the arrays. The table keeps free
        what it needs to be fast."""
        size = 5 * len(self._coords) // 4
        self._coords.resize((size, 3), refcheck=False)
        self._shown.resize(size, refcheck=False)
        self._voxels.resize((size, SIDE**3, 4), refcheck=False)
        if len(self._keys) < 2 * size:
            self._keys, self._slots = empty_table(2 * len(self._keys))
            fill_table(self._keys, self._slots, self.coords)


@numba.njit(cache=True, nogil=True)
def _near_surface(coords, voxels, shown, near):
    """(P, 3) centres, in voxels, of those that `HashedTsdf.surface` tells of."""
    found, count = np.empty((1024, 3)), 0
    for n in range(len(coords)):
        if not shown[n]:
            continue
        for inner in range(SIDE**3):
            voxel = voxels[n, inner]
            if abs(voxel[TSDF]) >= near or voxel[WEIGHT] <= 0 or voxel[OWN] <= MIN_OWN:
                continue
            if count == len(found):
                found = np.concatenate((found, np.empty_like(found)))
            found[count, 0] = coords[n, 0] * SIDE + inner // SIDE**2 + 0.5
            found[count, 1] = coords[n, 1] * SIDE + inner // SIDE % SIDE + 0.5
            found[count, 2] = coords[n, 2] * SIDE + inner % SIDE + 0.5
            count += 1
    return found[:count]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _integrated(
    coords, voxels, shown, voxel_m, truncation_m, depth, light, own, T,
    height, width, fx, fy, cx, cy,
):  # fmt: skip
    """Average the frame into the blocks that it reaches, in place. T: T_camera_body."""
    near = _SHOWN_VOXELS * voxel_m / truncation_m
    steps = (T[:3, :3] * voxel_m).copy()  # from voxel to voxel
    p, far = np.empty(3), farthest(depth)
    for n in range(len(coords)):
        for k in range(3):
            p[k] = T[k, 3]
            for j in range(3):
                p[k] += SIDE * steps[k, j] * (coords[n, j] + 0.5)
        radius = SIDE * voxel_m * np.sqrt(3.0) / 2
        if not _reached(p, radius, truncation_m, far, fx, fy, cx, cy):
            continue
        for inner in range(SIDE**3):
            a, b, c = inner // SIDE**2 - 3.5, inner // SIDE % SIDE - 3.5, inner % SIDE - 3.5
            x = p[0] + steps[0, 0] * a + steps[0, 1] * b + steps[0, 2] * c
            y = p[1] + steps[1, 0] * a + steps[1, 1] * b + steps[1, 2] * c
            z = p[2] + steps[2, 0] * a + steps[2, 1] * b + steps[2, 2] * c
            if z < 0.1:
                continue
            x, y = x / z, y / z
            u, v = int(np.floor(fx * x + cx + 0.5)), int(np.floor(fy * y + cy + 0.5))
            if not (0 <= u < width and 0 <= v < height) or depth[v, u] <= 0:
                continue
            distance = depth[v, u] - z
            if distance < truncation_m:  # else it is so along the ray, too
                distance *= np.sqrt(1 + x * x + y * y)
            if distance <= -truncation_m:
                continue
            voxel = voxels[n, inner]
            share = 1 / (voxel[WEIGHT] + 1)
            voxel[TSDF] += share * (min(1.0, distance / truncation_m) - voxel[TSDF])
            voxel[LIGHT] += share * (light[v, u] - voxel[LIGHT])
            voxel[OWN] += share * (own[v, u] - voxel[OWN])
            voxel[WEIGHT] = min(voxel[WEIGHT] + 1, MAX_WEIGHT)
        shown[n] = False
        for voxel in voxels[n]:
            if voxel[OWN] > MIN_OWN and abs(voxel[TSDF]) < near:
                shown[n] = True
                break


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _reached(p, radius, truncation_m, far, fx, fy, cx, cy):
    """Whether the frame measured something, in view of a block's sphere about p (3,), that is not
    well before it. far: from `farthest`."""
    rows, columns = far.shape
    top, bottom, left, right = tiles_of(p, radius, rows, columns, fx, fy, cx, cy)
    for row in range(top, bottom):
        for column in range(left, right):
            if far[row, column] > max(0.0, p[2] - radius - truncation_m):
                return True
    return False
