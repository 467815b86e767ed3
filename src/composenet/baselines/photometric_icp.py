"""Projective ICP of a rendered surface against a frame: geometry and brightness, coarse to fine.

The energy of MaskFusion (section "Tracking"): the distance of a measured point from the plane of
the model's point that projects onto its pixel, plus the photometric difference there, solved by
Gauss-Newton with robust (Huber) weights on a pyramid of images.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from composenet.baselines.frame_maps import Maps, pyramid
from composenet.geometry.camera import subsample_camera
from composenet.geometry.photometric import (
    add_row,
    halved,
    mirrored,
    move_into,
    photometric_row,
)
from composenet.geometry.transform import make_T
from composenet.records import Camera, FloatArray

LEVELS = 3
TURNING_LEVELS = 3
"""of a camera's first guess, beginning with the coarsest of those"""
ITERATIONS = (10, 5, 4)
"""finest level first"""
MAX_DISTANCE_M = 0.1
"""a pair of points farther apart is none"""
MAX_SINE = float(np.sin(np.radians(20)))
"""nor is one whose normals differ by more"""
MAX_DEPTH_STEP_M = 0.07
"""brightness is compared only where depths agree to this"""
PHOTOMETRIC_WEIGHT = 0.1
"""of a squared difference of brightness (0..1) against a squared metre: 3 % weigh like 1 cm"""
MIN_PAIRS = 60
"""with fewer pairs at the finest level nothing is estimated; coarser ones need as much surface"""
_HUBER_M, _HUBER_LIGHT = 0.02, 0.1
_MIN_GRADIENT = 0.01  # brightness a pixel
_CONVERGED = 1e-6


def align(model: Maps, frame: list[Maps]) -> tuple[NDArray[np.float64], int]:
    """The motion (4, 4) that brings the model's points, in camera axes, onto the frame's, and the
    pairs of points that agreed in the end. frame: its `pyramid`. Nothing agreed: no motion."""
    T = np.eye(4)
    count = 0
    views = pyramid(model, LEVELS)
    for step_down in reversed(range(LEVELS)):
        view, level = views[step_down], frame[step_down]
        points, normals, light = view.chosen(view.valid)
        K = level.camera.K
        for _ in range(ITERATIONS[step_down]):
            A, b, count = _normal_equations(
                points, normals, light, level.points, level.normals, level.intensity,
                T, K[0, 0], K[1, 1], K[0, 2], K[1, 2],
            )  # fmt: skip
            if count < max(10, MIN_PAIRS // 4**step_down):
                break
            step = np.linalg.lstsq(A, -b, rcond=1e-9)[0]
            T = increment(step) @ T
            if np.abs(step).max() < _CONVERGED:
                break
    return T, count


def turned(before: Maps, now: Maps) -> NDArray[np.float64]:
    """The rotation (4, 4) of a camera's axes that best explains two small images by brightness
    alone, as if all were far away, coarse to fine: a first guess. Identity where there is no
    colour."""
    levels = [(before.intensity, now.intensity, now.camera)]
    while len(levels) < TURNING_LEVELS:
        light, image, camera = levels[-1]
        levels.append((halved(light), halved(image), subsample_camera(camera, 2)))
    T = np.eye(4)
    for light, image, camera in reversed(levels):
        T = _turned(light, image, camera, T)
    return T


def _turned(
    light: FloatArray, image: FloatArray, camera: Camera, T_guess: FloatArray
) -> NDArray[np.float64]:
    """From a guess, with images (H, W) of one size."""
    K, T = camera.K, np.asarray(T_guess, dtype=np.float64)
    v, u = np.mgrid[1 : camera.height - 1, 1 : camera.width - 1]
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(u.shape)], axis=-1)
    light = light[1:-1, 1:-1]
    kept = np.isfinite(light)
    best, least = T, np.inf
    for _ in range(10):
        A, b, misfit = _turning_equations(
            rays[kept], light[kept], image, T, K[0, 0], K[1, 1], K[0, 2], K[1, 2]
        )
        if misfit >= least:
            break
        best, least = T, misfit
        step = np.zeros(6)
        step[3:] = np.linalg.lstsq(A[3:, 3:], -b[3:], rcond=1e-9)[0]
        T = increment(step) @ T
    return best


def increment(step: FloatArray) -> NDArray[np.float64]:
    """(4, 4) motion of (6,): metres moved, then the rotation vector."""
    return make_T(Rotation.from_rotvec(step[3:]).as_matrix(), step[:3])


@numba.njit(cache=True, nogil=True)
def geometric_row(point, normal, measured, row):
    """Distance in metres of the model's point from the measured one along the model's normal, all
    (3,) in camera axes; row (6,) becomes its derivative by `increment` of point and normal."""
    residual = 0.0
    for k in range(3):
        residual += normal[k] * (point[k] - measured[k])
        row[k] = normal[k]
    row[3] = measured[1] * normal[2] - measured[2] * normal[1]
    row[4] = measured[2] * normal[0] - measured[0] * normal[2]
    row[5] = measured[0] * normal[1] - measured[1] * normal[0]
    return residual


@numba.njit(cache=True, nogil=True)
def _normal_equations(
    points, normals, light, frame_points, frame_normals, image, T, fx, fy, cx, cy
):
    """J^T W J, J^T W r and the pairs of points that entered."""
    height, width = image.shape
    A, b = np.zeros((6, 6)), np.zeros(6)
    point, normal, row = np.empty(3), np.empty(3), np.empty(6)
    pairs = 0
    for i in range(len(points)):
        move_into(T, points[i], 1.0, point)
        if point[2] < 0.1:
            continue
        u = int(np.round(fx * point[0] / point[2] + cx))
        v = int(np.round(fy * point[1] / point[2] + cy))
        if not (0 <= u < width and 0 <= v < height) or frame_points[v, u, 2] <= 0:
            continue
        measured, other = frame_points[v, u], frame_normals[v, u]
        move_into(T, normals[i], 0.0, normal)
        away, cosine = 0.0, 0.0
        for k in range(3):
            away += (point[k] - measured[k]) ** 2
            cosine += normal[k] * other[k]
        if away <= MAX_DISTANCE_M**2 and cosine > 0 and 1 - cosine * cosine < MAX_SINE**2:
            residual = geometric_row(point, normal, measured, row)
            weight = min(1.0, _HUBER_M / max(abs(residual), 1e-12))
            add_row(A, b, row, residual, weight)
            pairs += 1
        if abs(point[2] - measured[2]) <= MAX_DEPTH_STEP_M:
            residual = photometric_row(point, light[i], image, fx, fy, cx, cy, row)
            slope = (row[0] / fx) ** 2 + (row[1] / fy) ** 2
            if np.isfinite(residual) and slope * point[2] ** 2 > _MIN_GRADIENT**2:
                weight = min(1.0, _HUBER_LIGHT / max(abs(residual), 1e-12)) * PHOTOMETRIC_WEIGHT
                add_row(A, b, row, residual, weight)
    return mirrored(A), b, pairs


@numba.njit(cache=True, nogil=True)
def _turning_equations(rays, light, image, T, fx, fy, cx, cy):
    """As `_normal_equations`, of brightness alone, and the mean squared difference."""
    A, b = np.zeros((6, 6)), np.zeros(6)
    point, row = np.empty(3), np.empty(6)
    total, count = 0.0, 0
    for i in range(len(rays)):
        move_into(T, rays[i], 0.0, point)
        if point[2] < 0.1:
            continue
        residual = photometric_row(point, light[i], image, fx, fy, cx, cy, row)
        if np.isfinite(residual):
            add_row(A, b, row, residual, 1.0)
            total += residual * residual
            count += 1
    return mirrored(A), b, total / count if count > len(rays) // 2 else np.inf
