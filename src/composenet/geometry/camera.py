"""Pinhole camera: pixels to rays and points, and back.

The centre of the first pixel is (0, 0); camera axes are x right, y down, z forward.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from composenet.records import Camera, FloatArray


def pixel_rays(camera: Camera) -> NDArray[np.float64]:
    """(H, W, 3) direction of every pixel's centre in camera axes, scaled to z = 1."""
    K = camera.K
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    return np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones_like(u)], axis=-1)


def back_project(depth_m: FloatArray, camera: Camera) -> NDArray[np.float32]:
    """Points (H, W, 3), metres, camera axes, of z-depth (H, W). Invalid depth (0) gives 0, 0, 0."""
    K = camera.K
    u = ((np.arange(camera.width) - K[0, 2]) / K[0, 0]).astype(np.float32)
    v = ((np.arange(camera.height) - K[1, 2]) / K[1, 1]).astype(np.float32)
    z = np.asarray(depth_m, dtype=np.float32)
    return np.stack([z * u, z * v[:, None], z], axis=-1)


def project(points_camera: FloatArray, camera: Camera) -> NDArray[np.float64]:
    """Pixels (..., 2), u then v, of points (..., 3) in camera axes.

    NaN where a point is not in front of the camera (z <= 0). Pixels outside the image are
    returned as they are.
    """
    points = np.asarray(points_camera, dtype=np.float64)
    z = np.where(points[..., 2] > 0, points[..., 2], np.nan)
    K = camera.K
    u = K[0, 0] * points[..., 0] / z + K[0, 2]
    v = K[1, 1] * points[..., 1] / z + K[1, 2]
    return np.stack([u, v], axis=-1)


def resize_camera(camera: Camera, width: int, height: int) -> Camera:
    """The camera after its image is resampled to (width, height): `c -> (c + 0.5) * s - 0.5`."""
    sx, sy = width / camera.width, height / camera.height
    K = camera.K.astype(np.float64, copy=True)
    K[0] *= sx
    K[1] *= sy
    K[0, 2] = (camera.K[0, 2] + 0.5) * sx - 0.5
    K[1, 2] = (camera.K[1, 2] + 0.5) * sy - 0.5
    return Camera(K=K, width=width, height=height)


def subsample_offset(factor: int) -> int:
    """First row and column that `subsample_camera` keeps: the middle of each block."""
    return (factor - 1) // 2


def subsampled(image: NDArray[Any], factor: int) -> NDArray[Any]:
    """The pixels of an image (H, W) that `subsample_camera` keeps; a view of it."""
    offset = subsample_offset(factor)
    return image[offset::factor, offset::factor]


def subsample_camera(camera: Camera, factor: int) -> Camera:
    """The camera of an image `subsampled` by the factor.

    Exact for every factor: kept pixels see the same rays as before. For odd factors it equals
    `resize_camera` to a multiple; for even ones the kept pixel is not the block's centre, which
    this accounts for.
    """
    offset = subsample_offset(factor)
    K = camera.K.astype(np.float64, copy=True)
    K[:2] /= factor
    K[:2, 2] = (camera.K[:2, 2] - offset) / factor
    width = len(range(offset, camera.width, factor))
    height = len(range(offset, camera.height, factor))
    return Camera(K=K, width=width, height=height)
