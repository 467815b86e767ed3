"""Who is whom where masks have no identity: overlap of masks in the image, after warping."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_closing

from composenet.geometry.camera import project
from composenet.geometry.transform import apply_T, inverse_T
from composenet.records import Camera, FloatArray

MIN_BIRTH_SCORE = 0.8
"""a weaker mask may continue a track or a model but starts none"""
_CLOSED = np.ones((3, 3), dtype=bool)


def projected_mask(
    points_world: FloatArray, T_world_camera: FloatArray, camera: Camera
) -> NDArray[np.bool_]:
    """(H, W) bool: where points (P, 3) of a surface, one a pixel of an earlier image, fall;
    small holes are closed. What would hide them is not looked at."""
    mask = np.zeros((camera.height, camera.width), dtype=bool)
    pixels = project(apply_T(inverse_T(T_world_camera), points_world), camera)
    columns, rows = np.rint(pixels[np.isfinite(pixels).all(axis=1)]).T
    inside = (columns >= 0) & (columns < camera.width) & (rows >= 0) & (rows < camera.height)
    mask[rows[inside].astype(int), columns[inside].astype(int)] = True
    return np.asarray(binary_closing(np.pad(mask, 2), _CLOSED, iterations=2)[2:-2, 2:-2])


def mask_iou(a: NDArray[np.bool_], b: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(A, B) overlap of masks (A, H, W) and (B, H, W); 0 where both are empty."""
    flat_a = a.reshape(len(a), np.prod(a.shape[1:])).astype(np.float32)
    flat_b = b.reshape(len(b), np.prod(b.shape[1:])).astype(np.float32)
    shared = (flat_a @ flat_b.T).astype(np.float64)
    union = flat_a.sum(axis=1)[:, None] + flat_b.sum(axis=1) - shared
    return np.divide(shared, union, out=np.zeros_like(shared), where=union > 0)
