"""A surfel map of one rigid body: rendered, fused with frames, and cleaned.

After Keller et al. 2013 ("Real-time 3D reconstruction in dynamic scenes using point-based fusion")
and Whelan et al. 2015 (ElasticFusion); the numbers are those of MaskFusion's public code, pixel
counts halved for images half as wide.
"""

from __future__ import annotations

from typing import Self

import numba
import numpy as np
from numpy.typing import NDArray

from composenet.baselines.frame_maps import LUMA, Maps, pinhole
from composenet.geometry.camera import back_project
from composenet.geometry.transform import inverse_T
from composenet.records import Camera, FloatArray

MERGE_M = 0.05
"""a point farther along its ray from a surfel is another surface"""
MERGE_RAD = 0.5
"""and so is one whose normal differs by more"""
COARSER = 1.5
"""a measurement with so many times the radius of a surfel confirms it, but moves it not"""
FREE_SPACE_M = 0.01
"""a surfel this far before what was just seen does not exist"""
UNSTABLE_FRAMES = 20
"""a surfel that has not become stable in this time is removed"""
OTHERS_M = 0.05
"""a surfel this near to a pixel of another body may belong to that one"""
_FACING = 0.1  # cosine: discs seen flatter than this are not drawn
_GAUSS_PX, _TWO_SIGMA_SQUARED = 200.0, 0.72  # confidence falls off from the image's centre
_CLEAR_PIXELS = 3  # of 3x3, that must show the surface behind


class SurfelMap:
    """N discs in the body's axes. positions, normals: (N, 3) float32 metres. colors: (N, 3)
    float32 in 0..1, NaN where unknown. radii: (N,) metres. confidences: (N,). born, seen: (N,)
    int32 frame numbers."""

    def __init__(self) -> None:
        self.positions = np.zeros((0, 3), np.float32)
        self.normals = np.zeros((0, 3), np.float32)
        self.colors = np.zeros((0, 3), np.float32)
        self.radii = np.zeros(0, np.float32)
        self.confidences = np.zeros(0, np.float32)
        self.born = np.zeros(0, np.int32)
        self.seen = np.zeros(0, np.int32)

    def __len__(self) -> int:
        return len(self.positions)

    def render(
        self, T_camera_body: FloatArray, camera: Camera, min_confidence: float = 0.0
    ) -> Maps:
        """What a camera would see of the stable surfels, as opaque discs."""
        usable = self.confidences >= min_confidence
        index, depth = _splatted(
            self.positions, self.normals, self.radii, usable, T_camera_body, *pinhole(camera)
        )
        drawn = index >= 0
        normals = np.zeros((*index.shape, 3), np.float32)
        intensity = np.full(index.shape, np.nan, np.float32)
        normals[drawn] = self.normals[index[drawn]] @ T_camera_body[:3, :3].T.astype(np.float32)
        intensity[drawn] = self.colors[index[drawn]] @ LUMA
        return Maps(back_project(depth, camera), normals, intensity, camera)

    def fuse(
        self,
        maps: Maps,
        colors: NDArray[np.float32],
        mask: NDArray[np.bool_],
        T_camera_body: FloatArray,
        time: int,
        weight: float = 1.0,
    ) -> Self:
        """Average the pixels of the mask into the surfels they show, weighted by confidence;
        the others become new surfels. maps: measured. colors: (H, W, 3) float32 in 0..1."""
        lens = pinhole(maps.camera)
        index = _centres(self.positions, T_camera_body, *lens)
        usable = mask & maps.valid
        gain = weight * _centredness(maps.camera)
        T_body_camera = inverse_T(T_camera_body)
        new = _merged(
            self.positions, self.normals, self.colors, self.radii, self.confidences, self.seen,
            index, maps.points, maps.normals, colors, usable, gain,
            T_camera_body, T_body_camera, *lens[2:], time,
        )  # fmt: skip
        self._append(maps, colors, new, gain, T_body_camera, time)
        return self

    def clean(
        self,
        depth: FloatArray,
        others: FloatArray,
        T_camera_body: FloatArray,
        camera: Camera,
        time: int,
        min_confidence: float,
    ) -> Self:
        """Remove what stayed unstable and what stands before a stable surface seen in this very
        frame; doubt what lies in another body's part of the image. depth: (H, W) measured.
        others: (H, W) float32 factor on the confidence of surfels there, 1 in this body's own."""
        index = _centres(self.positions, T_camera_body, *pinhole(camera))
        kept = _judged(
            self.positions, self.confidences, self.born, self.seen, index,
            depth.astype(np.float32), others, T_camera_body, *pinhole(camera)[2:],
            time, min_confidence,
        )  # fmt: skip
        if not kept.all():
            for name in ("positions", "normals", "colors", "radii", "confidences", "born", "seen"):
                setattr(self, name, getattr(self, name)[kept])
        return self

    def _append(
        self,
        maps: Maps,
        colors: NDArray[np.float32],
        new: NDArray[np.bool_],
        gain: NDArray[np.float32],
        T_body_camera: FloatArray,
        time: int,
    ) -> None:
        R, t = T_body_camera[:3, :3].astype(np.float32), T_body_camera[:3, 3].astype(np.float32)
        points, normals = maps.points[new], maps.normals[new]
        self.positions = np.concatenate([self.positions, points @ R.T + t])
        self.normals = np.concatenate([self.normals, normals @ R.T])
        self.colors = np.concatenate([self.colors, colors[new]])
        self.radii = np.concatenate([self.radii, _disc_radii(points, normals, maps.camera)])
        self.confidences = np.concatenate([self.confidences, gain[new]])
        stamp = np.full(len(points), time, np.int32)
        self.born = np.concatenate([self.born, stamp])
        self.seen = np.concatenate([self.seen, stamp])


def _centredness(camera: Camera) -> NDArray[np.float32]:
    """(H, W) confidence of a measurement: lenses are best in the middle."""
    v, u = np.mgrid[: camera.height, : camera.width]
    square = (u - camera.K[0, 2]) ** 2 + (v - camera.K[1, 2]) ** 2
    reach = _GAUSS_PX * camera.width / 320
    return np.exp(-square / reach**2 / _TWO_SIGMA_SQUARED).astype(np.float32)


def _disc_radii(points: FloatArray, normals: FloatArray, camera: Camera) -> NDArray[np.float32]:
    """(P,) such that discs of neighbouring pixels leave no gap."""
    focal = (camera.K[0, 0] + camera.K[1, 1]) / 2
    facing = np.maximum(np.abs(normals[:, 2]), 0.5)
    return (np.sqrt(2) * points[:, 2] / focal / facing).astype(np.float32)


@numba.njit(cache=True, nogil=True)
def _splatted(positions, normals, radii, usable, T, height, width, fx, fy, cx, cy):
    """(H, W) the nearest disc at every pixel, -1 for none, and its z-depth there. Of discs in one
    plane the one counts as nearest whose centre is."""
    index = np.full((height, width), -1, np.int32)
    depth = np.zeros((height, width), np.float32)
    nearest = np.full((height, width), np.inf)
    p, n = np.empty(3), np.empty(3)
    for i in range(len(positions)):
        if not usable[i]:
            continue
        for k in range(3):
            p[k] = T[k, 3]
            n[k] = 0.0
            for j in range(3):
                p[k] += T[k, j] * positions[i, j]
                n[k] += T[k, j] * normals[i, j]
        if p[2] < 0.1:
            continue
        plane = n[0] * p[0] + n[1] * p[1] + n[2] * p[2]
        if plane > -_FACING * np.sqrt(p[0] ** 2 + p[1] ** 2 + p[2] ** 2):
            continue
        u, v, reach = fx * p[0] / p[2] + cx, fy * p[1] / p[2] + cy, fx * radii[i] / p[2]
        for y in range(max(0, int(np.ceil(v - reach))), min(height - 1, int(v + reach)) + 1):
            for x in range(max(0, int(np.ceil(u - reach))), min(width - 1, int(u + reach)) + 1):
                a, b = (x - cx) / fx, (y - cy) / fy
                slope = n[0] * a + n[1] * b + n[2]
                if slope > -1e-3:
                    continue
                z = plane / slope
                away = (a * z - p[0]) ** 2 + (b * z - p[1]) ** 2 + (z - p[2]) ** 2
                if away <= radii[i] ** 2 and z + np.sqrt(away) < nearest[y, x]:
                    nearest[y, x] = z + np.sqrt(away)
                    index[y, x] = i
                    depth[y, x] = z
    return index, depth


@numba.njit(cache=True, nogil=True)
def _pixel(T, position, fx, fy, cx, cy):
    """Pixel and depth of a point; pixel (0, 0) if it is not well before the camera."""
    x, y, z = position
    pz = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
    if pz < 0.1:
        return 0, 0, pz
    px = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]
    py = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
    return int(np.round(fx * px / pz + cx)), int(np.round(fy * py / pz + cy)), pz


@numba.njit(cache=True, nogil=True)
def _centres(positions, T, height, width, fx, fy, cx, cy):
    """(H, W) the nearest surfel whose centre falls on the pixel, -1 for none."""
    index = np.full((height, width), -1, np.int32)
    depth = np.zeros((height, width), np.float32)
    for i in range(len(positions)):
        u, v, pz = _pixel(T, positions[i], fx, fy, cx, cy)
        if pz < 0.1:
            continue
        if 0 <= u < width and 0 <= v < height and (index[v, u] < 0 or pz < depth[v, u]):
            index[v, u] = i
            depth[v, u] = pz
    return index


@numba.njit(cache=True, nogil=True)
def _found(v, u, index, positions, normals, point, normal, T):
    """The surfel nearest to the pixel's ray among those that may be the same surface, or -1."""
    height, width = index.shape
    length = np.sqrt(point[0] ** 2 + point[1] ** 2 + point[2] ** 2)
    best, nearest = -1, np.inf
    for y in range(max(0, v - 1), min(height, v + 2)):
        for x in range(max(0, u - 1), min(width, u + 2)):
            i = index[y, x]
            if i < 0:
                continue
            along, square, cosine = 0.0, 0.0, 0.0
            for k in range(3):
                p, n = T[k, 3], 0.0
                for j in range(3):
                    p += T[k, j] * positions[i, j]
                    n += T[k, j] * normals[i, j]
                along += p * point[k] / length
                square += p * p
                cosine += n * normal[k]
            if abs(along - length) < MERGE_M and cosine > np.cos(MERGE_RAD):
                aside = square - along * along
                if aside < nearest:
                    best, nearest = i, aside
    return best


@numba.njit(cache=True, nogil=True)
def _merged(
    positions, normals, colors, radii, confidences, seen,
    index, points, point_normals, point_colors, usable, gain,
    T, T_back, fx, fy, cx, cy, time,
):  # fmt: skip
    """Update the surfels in place; (H, W) the pixels that found none."""
    height, width = index.shape
    new = np.zeros((height, width), np.bool_)
    focal = (fx + fy) / 2
    for v in range(height):
        for u in range(width):
            if not usable[v, u]:
                continue
            point, normal = points[v, u], point_normals[v, u]
            i = _found(v, u, index, positions, normals, point, normal, T)
            if i < 0:
                new[v, u] = True
                continue
            old, add = confidences[i], gain[v, u]
            share = add / (old + add)
            radius = np.sqrt(2) * point[2] / focal / max(abs(normal[2]), 0.5)
            confidences[i] = old + add
            seen[i] = time
            if radius >= COARSER * radii[i]:
                continue
            radii[i] += share * (radius - radii[i])
            square = 0.0
            for k in range(3):
                p, n = T_back[k, 3], 0.0
                for j in range(3):
                    p += T_back[k, j] * point[j]
                    n += T_back[k, j] * normal[j]
                positions[i, k] += share * (p - positions[i, k])
                normals[i, k] += share * (n - normals[i, k])
                colors[i, k] += share * (point_colors[v, u, k] - colors[i, k])
                square += normals[i, k] ** 2
            for k in range(3):
                normals[i, k] /= np.sqrt(square)
    return new


@numba.njit(cache=True, nogil=True)
def _judged(
    positions, confidences, born, seen, index, depth, others,
    T, fx, fy, cx, cy, time, min_confidence,
):  # fmt: skip
    """(N,) which surfels to keep; confidences of those in others' pixels fall."""
    height, width = depth.shape
    kept = np.ones(len(positions), np.bool_)
    for i in range(len(positions)):
        if confidences[i] < min_confidence and time - born[i] > UNSTABLE_FRAMES:
            kept[i] = False
            continue
        u, v, pz = _pixel(T, positions[i], fx, fy, cx, cy)
        if pz < 0.1:
            continue
        if not (0 <= u < width and 0 <= v < height):
            continue
        if abs(depth[v, u] - pz) < OTHERS_M:
            confidences[i] *= others[v, u]
        if seen[i] == time:
            continue
        behind = 0
        for b in range(max(0, v - 1), min(height, v + 2)):
            for a in range(max(0, u - 1), min(width, u + 2)):
                j = index[b, a]
                if j >= 0 and seen[j] == time and confidences[j] > min_confidence:
                    far = T[2, 0] * positions[j, 0] + T[2, 1] * positions[j, 1]
                    far += T[2, 2] * positions[j, 2] + T[2, 3]
                    behind += far - pz > FREE_SPACE_M
        kept[i] = behind < _CLEAR_PIXELS
    return kept
