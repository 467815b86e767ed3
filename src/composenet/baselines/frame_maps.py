"""What one camera sees of a surface, pixel by pixel: measured by a sensor or rendered from a map.

Depth is smoothed by a bilateral filter before normals are taken from it, as ElasticFusion does
(Whelan et al. 2015), which MaskFusion builds on; here it reaches farther in depth where noise does.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numba
import numpy as np
from numpy.typing import NDArray

from composenet.geometry.camera import back_project, subsample_camera
from composenet.geometry.photometric import brightness, halved
from composenet.records import Camera, FloatArray, Frame

FAR_M = 6.0
"""depth beyond this is dropped"""
_RADIUS_PX, _SIGMA_PX = 3, 2.25  # of the filter; ElasticFusion's at 640x480: 6, 4.5
_SIGMA_M, _SIGMA_PER_M2 = 0.01, 0.003  # the second times depth squared, as noise grows
_STEP = 0.05  # of the depth: neighbours farther apart are not of one surface


@dataclass(frozen=True)
class Maps:
    """A surface by pixel. points: (H, W, 3) float32 metres, camera axes, 0 where there is none.
    normals: (H, W, 3) float32, unit, towards the camera, 0 where there is none. intensity:
    (H, W) float32 in 0..1, NaN where there is none."""

    points: NDArray[np.float32]
    normals: NDArray[np.float32]
    intensity: NDArray[np.float32]
    camera: Camera

    @cached_property
    def valid(self) -> NDArray[np.bool_]:
        """(H, W) bool: a point with a normal."""
        x, y, z = self.normals[..., 0], self.normals[..., 1], self.normals[..., 2]
        return np.asarray((self.points[..., 2] > 0) & ((z != 0) | (x != 0) | (y != 0)))

    def chosen(
        self, mask: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
        """Points (P, 3), normals (P, 3) and brightness (P,) of the mask's pixels (H, W)."""
        pixels = np.flatnonzero(mask)
        points, normals = self.points.reshape(-1, 3), self.normals.reshape(-1, 3)
        return points.take(pixels, 0), normals.take(pixels, 0), self.intensity.take(pixels)


def measured_maps(frame: Frame) -> Maps:
    """Of a frame; points and normals are those of the smoothed depth."""
    depth = np.where((frame.depth_m > 0) & (frame.depth_m < FAR_M), frame.depth_m, 0)
    points = back_project(smoothed(depth.astype(np.float32)), frame.camera)
    return Maps(points, normals_of(points), intensity_of(frame), frame.camera)


def intensity_of(frame: Frame) -> NDArray[np.float32]:
    """(H, W) brightness in 0..1; NaN for a frame without colour."""
    if frame.color is None:
        return np.full(frame.depth_m.shape, np.nan, np.float32)
    return brightness(frame.color)


def pyramid(maps: Maps, levels: int) -> list[Maps]:
    """The maps, finest first, each half as wide as the one before."""
    result = [maps]
    for _ in range(levels - 1):
        maps = result[-1]
        result.append(
            Maps(
                np.ascontiguousarray(maps.points[::2, ::2]),
                np.ascontiguousarray(maps.normals[::2, ::2]),
                halved(maps.intensity),
                subsample_camera(maps.camera, 2),
            )
        )
    return result


def pinhole(camera: Camera) -> tuple[int, int, float, float, float, float]:
    """Height, width, fx, fy, cx, cy: a camera for compiled code."""
    K = camera.K
    return camera.height, camera.width, K[0, 0], K[1, 1], K[0, 2], K[1, 2]


@numba.njit(cache=True, nogil=True)
def smoothed(depth: FloatArray) -> NDArray[np.float32]:
    """Bilateral filter of depth (H, W) float32; 0 stays 0."""
    height, width = depth.shape
    out = np.zeros_like(depth)
    narrowness, reach = np.empty(width, np.float32), np.empty(width, np.float32)
    total, weights = np.empty(width, np.float32), np.empty(width, np.float32)
    for v in range(height):
        for u in range(width):
            z = depth[v, u]
            sigma = _SIGMA_M + _SIGMA_PER_M2 * z * z
            narrowness[u] = 1 / (2 * sigma**2)
            reach[u] = 3 * sigma if z > 0 else -1
        total[:], weights[:] = 0, 0
        for y in range(max(0, v - _RADIUS_PX), min(height, v + _RADIUS_PX + 1)):
            for shift in range(-_RADIUS_PX, _RADIUS_PX + 1):
                square = (y - v) ** 2 + shift**2
                near = np.float32(np.exp(-square / (2 * _SIGMA_PX**2)))
                first, last = max(0, -shift), min(width, width - shift)
                _gathered(
                    depth[y, first + shift : last + shift], depth[v, first:last],
                    narrowness[first:last], reach[first:last], near,
                    total[first:last], weights[first:last],
                )  # fmt: skip
        for u in range(width):
            if depth[v, u] > 0:
                out[v, u] = depth[v, u] + total[u] / weights[u]
    return out


@numba.njit(cache=True, nogil=True)
def _gathered(others, centres, narrowness, reach, near, total, weights):
    """One neighbour of every pixel of a row into its sums, without branches or library calls, so
    that it runs on vectors: exp(-t) is the 16th power of a series, to 1e-6 of the weight."""
    one = np.float32(1)
    for i in range(len(centres)):
        away = others[i] - centres[i]
        s = away * away * narrowness[i] * np.float32(1 / 16)
        power = one - s * np.float32(1 / 5)
        power = one - s * np.float32(1 / 4) * power
        power = one - s * np.float32(1 / 3) * power
        power = one - s * np.float32(1 / 2) * power
        power = one - s * power
        power *= power
        power *= power
        power *= power
        power *= power
        weight = near * power if others[i] > 0 and abs(away) <= reach[i] else np.float32(0)
        total[i] += weight * away
        weights[i] += weight


@numba.njit(cache=True, nogil=True)
def normals_of(points: FloatArray) -> NDArray[np.float32]:
    """(H, W, 3) unit normals towards the camera of points (H, W, 3) in camera axes, from
    neighbours of the same surface; 0 where there are too few."""
    height, width = points.shape[:2]
    normals = np.zeros_like(points)
    a, b = np.empty(3, points.dtype), np.empty(3, points.dtype)
    for v in range(height):
        for u in range(width):
            z = points[v, u, 2]
            if z <= 0:
                continue
            left, right, above, below = u, u, v, v
            if u > 0 and abs(points[v, u - 1, 2] - z) < _STEP * z:
                left = u - 1
            if u + 1 < width and abs(points[v, u + 1, 2] - z) < _STEP * z:
                right = u + 1
            if v > 0 and abs(points[v - 1, u, 2] - z) < _STEP * z:
                above = v - 1
            if v + 1 < height and abs(points[v + 1, u, 2] - z) < _STEP * z:
                below = v + 1
            if left == right or above == below:
                continue
            for k in range(3):
                a[k] = points[v, right, k] - points[v, left, k]
                b[k] = points[below, u, k] - points[above, u, k]
            x = b[1] * a[2] - b[2] * a[1]
            y = b[2] * a[0] - b[0] * a[2]
            n = b[0] * a[1] - b[1] * a[0]
            length = np.sqrt(x * x + y * y + n * n)
            if length > 1e-12:
                normals[v, u, 0] = x / length
                normals[v, u, 1] = y / length
                normals[v, u, 2] = n / length
    return normals
