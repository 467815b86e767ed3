"""What brightness says of a camera's motion: direct alignment of two RGB-D images, coarse to fine
(Steinbruecker, Sturm and Cremers, 2011; Kerl, Sturm and Cremers, ICRA 2013).

Images are taken to be registered: the colour of a pixel is that of its depth, black where it is not
known.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter
from scipy.spatial.transform import Rotation

from composenet.geometry.camera import back_project, subsample_camera, subsampled
from composenet.geometry.photometric import (
    add_row,
    brightness,
    halved,
    mirrored,
    move_into,
    photometric_row,
)
from composenet.geometry.transform import make_T, rigid_T
from composenet.records import Camera, FloatArray

LEVELS = 3
"""of an image, the finest first, each half as wide as the one before"""
_WIDEST = 200  # pixels of the finest level; steps of hands are too long for finer ones
_JUDGE = 1  # level by which misfits are told
_GUESSED_TO = 1  # finest level of a first guess
_ITERATIONS = 10
_DONE = 0.001  # a step of fewer metres and radians is the last one
_MIN_SLOPE = 0.01  # of brightness a pixel; what is plainer says nothing
_MIN_PIXELS, _MIN_SHARE = 50, 0.3  # in common, for a misfit
_HUBER = 0.05
_KNOWN = 0.9  # of a pixel and of those beside it
_REACH_M, _FIRST_REACH_M = 0.1, 0.3  # a surface that far from the other image's is another one
_REST = (0.006, 0.006, 0.006, 0.002, 0.002, 0.002)  # of a first guess, a pixel and rad^2 or m^2


@dataclass(frozen=True)
class _Level:
    """light: (H, W) float32 in 0..1. depth_m: (H, W) float32, 0 where unknown. points, values:
    (P, 3) in camera axes and (P,), of the pixels with depth where brightness changes."""

    light: NDArray[np.float32]
    depth_m: NDArray[np.float32]
    points: NDArray[np.float64]
    values: NDArray[np.float64]
    pinhole: tuple[float, float, float, float]


@dataclass(frozen=True)
class Equations:
    """Of one Gauss-Newton step: rotation vector, then translation, in the axes of the second
    camera. H: (6, 6) J^T W J, b: (6,) J^T W r, for brightness in 0..1; misfit: mean absolute
    difference, large ones cut; pixels: that entered."""

    H: NDArray[np.float64]
    b: NDArray[np.float64]
    misfit: float
    pixels: int

    def __add__(self, other: Equations) -> Equations:
        """What the pixels of both say."""
        pixels = self.pixels + other.pixels
        misfits = self.misfit * self.pixels + other.misfit * other.pixels
        return Equations(self.H + other.H, self.b + other.b, misfits / max(pixels, 1), pixels)

    def weighed(self, weight: float) -> Equations:
        """Every pixel counts so often."""
        return replace(self, H=weight * self.H, b=weight * self.b)


class LitView:
    """An RGB-D image to be aligned with others. depth_m: (H, W) metres, 0 where unknown. color:
    (H, W, 3) uint8, RGB, black where unknown."""

    def __init__(
        self, depth_m: NDArray[np.float32], color: NDArray[np.uint8], camera: Camera
    ) -> None:
        known = np.asarray(color.any(axis=-1), np.float32)
        image = _Image(brightness(color), known, depth_m, camera)
        while image.camera.width > _WIDEST:
            image = image.halved()
        self.levels = [_level(image)]
        while len(self.levels) < LEVELS:
            image = image.halved()
            self.levels.append(_level(image))


@dataclass(frozen=True)
class _Image:
    """light: (H, W) float32 in 0..1. known: (H, W) float32, what share of it is known. depth_m:
    (H, W) float32, 0 where unknown."""

    light: NDArray[np.float32]
    known: NDArray[np.float32]
    depth_m: NDArray[np.float32]
    camera: Camera

    def halved(self) -> _Image:
        """Half as wide and high."""
        depth_m = np.ascontiguousarray(subsampled(self.depth_m, 2))
        camera = subsample_camera(self.camera, 2)
        return _Image(halved(self.light), halved(self.known), depth_m, camera)


def _level(image: _Image) -> _Level:
    light, camera = image.light, image.camera
    depth_m = np.where(minimum_filter(image.known, 3) > _KNOWN, image.depth_m, 0)
    across, down = np.zeros_like(light), np.zeros_like(light)
    across[:, 1:-1] = (light[:, 2:] - light[:, :-2]) / 2
    down[1:-1] = (light[2:] - light[:-2]) / 2
    telling = (depth_m > 0) & (np.hypot(across, down) > _MIN_SLOPE)
    points = back_project(depth_m, camera)[telling].astype(np.float64)
    K = camera.K
    pinhole = (K[0, 0], K[1, 1], K[0, 2], K[1, 2])
    return _Level(light, depth_m, points, light[telling].astype(np.float64), pinhole)


@dataclass(frozen=True)
class LitPair:
    """Two images one after the other. A pose of the two, T_before_now, is (4, 4), the second camera
    in the axes of the first."""

    before: LitView
    now: LitView

    def equations(
        self, T_before_now: FloatArray, level: int, reach_m: float = _REACH_M
    ) -> Equations:
        """What brightness says of a pose. A difference that is the same everywhere, as by another
        exposure, moves nothing."""
        seen, own = self.before.levels[level], self.now.levels[level]
        H, b, total, pixels = _equations(
            own.points, own.values, seen.light, seen.depth_m, T_before_now, *seen.pinhole, reach_m
        )
        return Equations(H, b, total / max(pixels, 1), pixels)

    def misfit(self, T_before_now: FloatArray) -> float:
        """Mean difference of brightness, 0..1, infinite where the images have too little in
        common."""
        found = self.equations(T_before_now, _JUDGE)
        needed = max(_MIN_PIXELS, _MIN_SHARE * len(self.now.levels[_JUDGE].points))
        return found.misfit if found.pixels > needed else np.inf

    def guessed(self, T_guess: NDArray[np.float64]) -> NDArray[np.float64]:
        """T_before_now by brightness alone, from a guess, on small images; the guess where they
        have nothing in common."""
        T = T_guess
        for level in reversed(range(_GUESSED_TO, LEVELS)):
            for _ in range(_ITERATIONS):
                found = self.equations(T, level, _FIRST_REACH_M)
                if found.pixels < _MIN_PIXELS:
                    return T_guess
                step = np.linalg.solve(found.H + found.pixels * np.diag(_REST), -found.b)
                T = moved(T, step)
                if np.abs(step).max() < _DONE:
                    break
        return T


def moved(T: FloatArray, step: FloatArray) -> NDArray[np.float64]:
    """The pose (4, 4) after a step (6,), rotation vector and translation in its own axes; a rigid
    motion: errors of rounding would double from frame to frame."""
    return rigid_T(T @ make_T(Rotation.from_rotvec(step[:3]).as_matrix(), step[3:]))


@numba.njit(cache=True, nogil=True)
def _equations(points, values, light, depth, T, fx, fy, cx, cy, reach_m):  # type: ignore[no-untyped-def]
    """J^T W J and J^T W r, free of the mean difference, the sum of cut differences, and pixels."""
    height, width = light.shape
    A, b = np.zeros((6, 6)), np.zeros(6)
    point, slope, row = np.empty(3), np.empty(6), np.empty(6)
    rows, weights, differences, total, pixels = np.zeros(6), 0.0, 0.0, 0.0, 0
    for i in range(len(points)):
        own = points[i]
        move_into(T, own, 1.0, point)
        if point[2] < 0.1:
            continue
        u = int(np.round(fx * point[0] / point[2] + cx))
        v = int(np.round(fy * point[1] / point[2] + cy))
        if not (0 <= u < width and 0 <= v < height):
            continue
        z = depth[v, u]
        if z <= 0 or abs(z - point[2]) > reach_m * (1 + 0.5 * z):
            continue
        residual = photometric_row(point, values[i], light, fx, fy, cx, cy, slope)
        if not np.isfinite(residual):
            continue
        for k in range(3):
            row[3 + k] = T[0, k] * slope[0] + T[1, k] * slope[1] + T[2, k] * slope[2]
        row[0] = own[1] * row[5] - own[2] * row[4]
        row[1] = own[2] * row[3] - own[0] * row[5]
        row[2] = own[0] * row[4] - own[1] * row[3]
        weight = min(1.0, _HUBER / max(abs(residual), 1e-12))
        add_row(A, b, row, residual, weight)
        rows += weight * row
        weights += weight
        differences += weight * residual
        total += min(abs(residual), 3 * _HUBER)
        pixels += 1
    A = mirrored(A)
    if weights > 0:
        A -= np.outer(rows, rows) / weights
        b -= rows * (differences / weights)
    return A, b, total, pixels
