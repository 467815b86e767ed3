"""Alignment of a rendered surface with a frame as MID-Fusion weighs it, and whether it is needed.

The energy of `photometric_icp` with other weights: every residual is divided by its standard
deviation (that of the measured point along the normal, from the sensor's disparity; that of
brightness), and Cauchy's function bounds what outliers count. A step that raises the mean cost is
taken back.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from composenet.baselines.frame_maps import Maps, pinhole
from composenet.baselines.photometric_icp import (
    ITERATIONS,
    MAX_DISTANCE_M,
    MIN_PAIRS,
    geometric_row,
    increment,
)
from composenet.geometry.photometric import add_row, mirrored, move_into, photometric_row
from composenet.records import FloatArray

MIN_COSINE = 0.8
"""normals that differ by more are of no pair"""
SIGMA_PX, SIGMA_DISPARITY_PX, BASELINE_M = 0.5, 0.0625, 0.075
"""noise of a pixel's place and of its disparity, in pixels of an image 320 wide, and the sensor's
baseline"""
SIGMA_LIGHT = 10 / 255
MAX_SIGMAS = 1.5
"""a residual beyond so many standard deviations speaks against rest"""
_CAUCHY = 2.3849  # standard deviations: 95 % efficient on normal noise
_CONVERGED = 1e-5


def align_weighted(
    views: list[Maps], kept: NDArray[np.bool_], frame: list[Maps], guess: FloatArray
) -> tuple[NDArray[np.float64], int]:
    """The motion (4, 4) from the axes of the camera that `views` were rendered for to the frame's
    camera, and the pairs of points that agreed in the end. views, frame: pyramids. kept: (H, W),
    the pixels of the rendering to use. guess: (4, 4), what is returned where too few agree."""
    T, pairs = np.asarray(guess, np.float64), 0
    scale = frame[0].camera.width / 320
    for halved in reversed(range(len(frame))):
        view, level = views[halved], frame[halved]
        surface = view.chosen(kept[:: 2**halved, :: 2**halved] & view.valid)
        before, least = T, np.inf
        for _ in range(ITERATIONS[halved]):
            A, b, cost, pairs = _weighted_equations(
                *surface, level.points, level.normals, level.intensity, T,
                scale, *pinhole(level.camera)[2:],
            )  # fmt: skip
            if pairs < max(10, MIN_PAIRS // 4**halved):
                break
            if cost > least:
                T = before
                break
            step = np.linalg.lstsq(A, -b, rcond=1e-9)[0]
            before, least = T, cost
            T = increment(step) @ T
            if np.linalg.norm(step) < _CONVERGED:
                break
    return T, pairs


def share_at_rest(view: Maps, kept: NDArray[np.bool_], frame: Maps, T: FloatArray) -> float:
    """Of the rendering's kept pixels, those that nothing in the frame speaks against being where
    the motion T (4, 4) brings them. What is out of view or not measured speaks against nothing."""
    used = kept & view.valid
    if not used.any():
        return 1.0
    against = _outliers(
        *view.chosen(used), frame.points, frame.normals, frame.intensity, T,
        frame.camera.width / 320, *pinhole(frame.camera)[2:],
    )  # fmt: skip
    return 1 - against / int(used.sum())


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _deviation(normal, z, scale, fx):
    """Standard deviation along a normal (3,), metres, of a point measured at depth z."""
    aside = z / fx * SIGMA_PX * scale
    ahead = z * z * SIGMA_DISPARITY_PX * scale / (fx * BASELINE_M)
    square = (normal[0] ** 2 + normal[1] ** 2) * aside**2 + normal[2] ** 2 * ahead**2
    return np.sqrt(square)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _cauchy(sigmas):
    """Cost of a residual in standard deviations."""
    return _CAUCHY**2 / 2 * np.log(1 + (sigmas / _CAUCHY) ** 2)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _paired(point, normal, points, normals, fx, fy, cx, cy):
    """The pixel (v, u) that a point of the model falls on, and what they are to each other:
    2 a pair, 1 not of one surface, 0 where nothing is measured, -1 out of view."""
    height, width = points.shape[:2]
    if point[2] < 0.1:
        return 0, 0, -1
    u = int(np.floor(fx * point[0] / point[2] + cx + 0.5))
    v = int(np.floor(fy * point[1] / point[2] + cy + 0.5))
    if not (0 <= u < width and 0 <= v < height):
        return 0, 0, -1
    if points[v, u, 2] <= 0:
        return v, u, 0
    away, cosine, known = 0.0, 0.0, 0.0
    for k in range(3):
        away += (point[k] - points[v, u, k]) ** 2
        cosine += normal[k] * normals[v, u, k]
        known += abs(normals[v, u, k])
    if known == 0:
        return v, u, 0
    return v, u, 2 if away <= MAX_DISTANCE_M**2 and cosine >= MIN_COSINE else 1


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _weighted_equations(
    points, normals, light, frame_points, frame_normals, image, T,
    scale, fx, fy, cx, cy,
):  # fmt: skip
    """J^T W J, J^T W r, the mean cost and the pairs of points that entered. A point that is of no
    pair costs as much as one just within reach, lest finding more pairs seem a loss."""
    A, b = np.zeros((6, 6)), np.zeros(6)
    point, normal, row = np.empty(3), np.empty(3), np.empty(6)
    cost, terms, pairs = 0.0, 0, 0
    for i in range(len(points)):
        move_into(T, points[i], 1.0, point)
        move_into(T, normals[i], 0.0, normal)
        v, u, kind = _paired(point, normal, frame_points, frame_normals, fx, fy, cx, cy)
        if kind < 0:
            continue
        if kind > 0:
            sigma = _deviation(normal, frame_points[v, u, 2], scale, fx)
            ratio = MAX_DISTANCE_M / sigma
            if kind == 2:
                residual = geometric_row(point, normal, frame_points[v, u], row)
                ratio = residual / sigma
                add_row(A, b, row, residual, 1 / (sigma**2 * (1 + (ratio / _CAUCHY) ** 2)))
                pairs += 1
            cost += _cauchy(ratio)
            terms += 1
        if kind == 0 or abs(point[2] - frame_points[v, u, 2]) <= MAX_DISTANCE_M:
            residual = photometric_row(point, light[i], image, fx, fy, cx, cy, row)
            if np.isfinite(residual):
                ratio = residual / SIGMA_LIGHT
                add_row(A, b, row, residual, 1 / (SIGMA_LIGHT**2 * (1 + (ratio / _CAUCHY) ** 2)))
                cost += _cauchy(ratio)
                terms += 1
    return mirrored(A), b, cost / terms if terms else np.inf, pairs


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _outliers(
    points, normals, light, frame_points, frame_normals, image, T,
    scale, fx, fy, cx, cy,
):  # fmt: skip
    """How many points the frame speaks against."""
    point, normal, row = np.empty(3), np.empty(3), np.empty(6)
    count = 0
    for i in range(len(points)):
        move_into(T, points[i], 1.0, point)
        move_into(T, normals[i], 0.0, normal)
        v, u, kind = _paired(point, normal, frame_points, frame_normals, fx, fy, cx, cy)
        if kind <= 0:
            continue
        against = kind == 1
        if kind == 2:
            residual = geometric_row(point, normal, frame_points[v, u], row)
            sigma = _deviation(normal, frame_points[v, u, 2], scale, fx)
            against = abs(residual) > MAX_SIGMAS * sigma
        brighter = photometric_row(point, light[i], image, fx, fy, cx, cy, row)
        if against or (np.isfinite(brighter) and abs(brighter) > MAX_SIGMAS * SIGMA_LIGHT):
            count += 1
    return count
