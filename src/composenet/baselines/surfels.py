"""A surfel map of one rigid body: rendered, fused with frames, and cleaned.

After Keller et al. 2013 ("Real-time 3D reconstruction in dynamic scenes using point-based fusion")
and Whelan et al. 2015 (ElasticFusion); the numbers are those of MaskFusion's public code, pixel
counts halved for images half as wide.
"""

from __future__ import annotations

from functools import cache
from typing import Self

import numba
import numpy as np
from numpy.typing import NDArray

from composenet.baselines.frame_maps import Maps, pinhole
from composenet.baselines.surfel_images import (
    COLOR,
    CONFIDENCE,
    N_VALUES,
    NORMAL,
    POINT,
    RADIUS,
    centres,
    drawn,
    moved,
    pixel_of,
    splatted,
)
from composenet.geometry.transform import inverse_T
from composenet.records import Camera, FloatArray

MERGE_M = 0.05
"""a point farther along its ray from a surfel is another surface"""
MERGE_RAD = 0.5
"""and so is one whose normal differs by more"""
_MERGE_COSINE = float(np.cos(MERGE_RAD))
COARSER = 1.5
"""a measurement with so many times the radius of a surfel confirms it, but moves it not"""
FREE_SPACE_M = 0.01
"""a surfel this far before what was just seen does not exist"""
UNSTABLE_FRAMES = 20
"""a surfel that has not become stable in this time is removed"""
OTHERS_M = 0.05
"""a surfel this near to a pixel of another body may belong to that one"""
_GAUSS_PX, _TWO_SIGMA_SQUARED = 200.0, 0.72  # confidence falls off from the image's centre
_CLEAR_PIXELS = 3  # of 3x3, that must show the surface behind
_BORN, _SEEN = 0, 1  # columns of times


class SurfelMap:
    """N discs in the body's axes. positions, normals: (N, 3) float32 metres. colors: (N, 3)
    float32 in 0..1, NaN where unknown. radii: (N,) metres. confidences: (N,). born, seen: (N,)
    int32 frame numbers. All are views of two tables, one row a disc."""

    def __init__(self) -> None:
        self._values = np.zeros((0, N_VALUES), np.float32)
        self._times = np.zeros((0, 2), np.int32)

    def __len__(self) -> int:
        return len(self._values)

    @property
    def positions(self) -> NDArray[np.float32]:
        return self._values[:, POINT : POINT + 3]

    @property
    def normals(self) -> NDArray[np.float32]:
        return self._values[:, NORMAL : NORMAL + 3]

    @property
    def colors(self) -> NDArray[np.float32]:
        return self._values[:, COLOR : COLOR + 3]

    @property
    def radii(self) -> NDArray[np.float32]:
        return self._values[:, RADIUS]

    @property
    def confidences(self) -> NDArray[np.float32]:
        return self._values[:, CONFIDENCE]

    @property
    def born(self) -> NDArray[np.int32]:
        return self._times[:, _BORN]

    @property
    def seen(self) -> NDArray[np.int32]:
        return self._times[:, _SEEN]

    def render(
        self, T_camera_body: FloatArray, camera: Camera, min_confidence: float = 0.0
    ) -> Maps:
        """What a camera would see of the stable surfels, as opaque discs."""
        lens = pinhole(camera)
        index, depth = splatted(self._values, min_confidence, T_camera_body, *lens)
        points, normals, light = drawn(self._values, index, depth, T_camera_body, *lens[2:])
        return Maps(points, normals, light, camera)

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
        height, width, _, _, *centre = lens
        confidence = _centredness(height, width, *centre)
        new = _merged(
            self._values, self._times, centres(self._values, T_camera_body, *lens),
            maps.points, maps.normals, colors, mask & maps.valid, confidence, weight,
            inverse_T(T_camera_body), lens[2], lens[3], time,
        )  # fmt: skip
        self._values = np.concatenate([self._values, new])
        times = np.full((len(new), 2), time, np.int32)
        self._times = np.concatenate([self._times, times])
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
        lens = pinhole(camera)
        index = centres(self._values, T_camera_body, *lens)
        kept = _judged(
            self._values, self._times, index, depth.astype(np.float32), others,
            T_camera_body, *lens[2:], time, min_confidence,
        )  # fmt: skip
        if len(kept) < len(self):
            self._values, self._times = self._values.take(kept, 0), self._times.take(kept, 0)
        return self


@cache
def _centredness(height: int, width: int, cx: float, cy: float) -> NDArray[np.float32]:
    """(H, W) confidence of a measurement: lenses are best in the middle."""
    v, u = np.mgrid[:height, :width]
    square = (u - cx) ** 2 + (v - cy) ** 2
    reach = _GAUSS_PX * width / 320
    return np.exp(-square / reach**2 / _TWO_SIGMA_SQUARED).astype(np.float32)


@numba.njit(cache=True, nogil=True)
def _disc_radius(z, slant, focal):
    """Such that discs of neighbouring pixels leave no gap. slant: the normal's z."""
    return np.sqrt(2) * z / focal / max(abs(slant), 0.5)


@numba.njit(cache=True, nogil=True)
def _found(v, u, index, values, eye, ray, normal, length):
    """The surfel nearest to the pixel's ray among those that may be the same surface, or -1.
    eye, ray (unit), normal: (3,) in the body's axes; length: metres along the ray."""
    height, width = index.shape
    best, nearest = -1, np.inf
    for y in range(max(0, v - 1), min(height, v + 2)):
        for x in range(max(0, u - 1), min(width, u + 2)):
            i = index[y, x]
            if i < 0:
                continue
            along, square, cosine = 0.0, 0.0, 0.0
            for k in range(3):
                p = values[i, POINT + k] - eye[k]
                along += p * ray[k]
                square += p * p
                cosine += values[i, NORMAL + k] * normal[k]
            if abs(along - length) < MERGE_M and cosine > _MERGE_COSINE:
                aside = square - along * along
                if aside < nearest:
                    best, nearest = i, aside
    return best


@numba.njit(cache=True, nogil=True)
def _merged(
    values, times, index, points, normals, colors, usable, centredness, weight, T, fx, fy, time
):
    """Update the surfels in place; (P, 11) rows of pixels that found none. T: T_body_camera."""
    height, width = index.shape
    new = np.zeros((usable.sum(), N_VALUES), np.float32)
    count, focal = 0, (fx + fy) / 2
    eye, point, normal, ray = T[:3, 3].copy(), np.empty(3), np.empty(3), np.empty(3)
    for v in range(height):
        for u in range(width):
            if not usable[v, u]:
                continue
            x, y, z = points[v, u]
            a, b, c = normals[v, u]
            length = np.sqrt(x**2 + y**2 + z**2)
            for k in range(3):
                away = T[k, 0] * x + T[k, 1] * y + T[k, 2] * z
                point[k], ray[k] = eye[k] + away, away / length
                normal[k] = T[k, 0] * a + T[k, 1] * b + T[k, 2] * c
            gain, radius = weight * centredness[v, u], _disc_radius(z, c, focal)
            i = _found(v, u, index, values, eye, ray, normal, length)
            if i < 0:
                _blend(new[count], point, normal, colors[v, u], radius, 1.0)
                new[count, CONFIDENCE] = gain
                count += 1
                continue
            share = gain / (values[i, CONFIDENCE] + gain)
            values[i, CONFIDENCE] += gain
            times[i, _SEEN] = time
            if radius < COARSER * values[i, RADIUS]:
                _blend(values[i], point, normal, colors[v, u], radius, share)
    return new[:count]


@numba.njit(cache=True, nogil=True)
def _blend(row, point, normal, color, radius, share):
    """Move a surfel's row towards a measurement; share 1 replaces it."""
    square = 0.0
    for k in range(3):
        row[POINT + k] += share * (point[k] - row[POINT + k])
        row[NORMAL + k] += share * (normal[k] - row[NORMAL + k])
        row[COLOR + k] += share * (color[k] - row[COLOR + k])
        square += row[NORMAL + k] ** 2
    for k in range(3):
        row[NORMAL + k] /= np.sqrt(square)
    row[RADIUS] += share * (radius - row[RADIUS])


@numba.njit(cache=True, nogil=True)
def _judged(values, times, index, depth, others, T, fx, fy, cx, cy, time, min_confidence):
    """Which surfels to keep, their numbers; confidences of those in others' pixels fall."""
    height, width = depth.shape
    kept, count = np.empty(len(values), np.int64), 0
    for i in range(len(values)):
        if values[i, CONFIDENCE] < min_confidence and time - times[i, _BORN] > UNSTABLE_FRAMES:
            continue
        kept[count] = i
        u, v, pz = pixel_of(T, values, i, fx, fy, cx, cy)
        behind = 0
        if pz >= 0.1 and 0 <= u < width and 0 <= v < height:
            if abs(depth[v, u] - pz) < OTHERS_M:
                values[i, CONFIDENCE] *= others[v, u]
            if times[i, _SEEN] != time:
                behind = _seen_behind(v, u, pz, values, times, index, T, time, min_confidence)
        count += behind < _CLEAR_PIXELS
    return kept[:count]


@numba.njit(cache=True, nogil=True)
def _seen_behind(v, u, z, values, times, index, T, time, min_confidence):
    """Of 3x3 pixels, those that show a stable surfel of this frame well behind a depth."""
    height, width = index.shape
    count = 0
    for y in range(max(0, v - 1), min(height, v + 2)):
        for x in range(max(0, u - 1), min(width, u + 2)):
            i = index[y, x]
            if i >= 0 and times[i, _SEEN] == time and values[i, CONFIDENCE] > min_confidence:
                count += moved(T, values, i, POINT, 1.0)[2] - z > FREE_SPACE_M
    return count
