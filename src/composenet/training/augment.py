"""What keeps a network from trusting clean frames: other views, poses and colours than rendered."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageFilter
from scipy.spatial.transform import Rotation

from composenet.geometry.transform import make_T
from composenet.records import Camera, Frame

NO_COLORS, GREY, OTHER_HUES = 0.15, 0.15, 0.2
"""Shares of the samples without a colour image, and, of the others, of those without hues and,
of the rest, with red, green and blue in another order."""
BLURRED, MISALIGNED = 0.2, 0.3
"""Shares of the colour images that are out of focus and that lie beside their depth images: by a
hundredth of the width, and a fiftieth larger or smaller."""


def small_motion(rng: np.random.Generator) -> NDArray[np.float64]:
    """(4, 4): how wrong a camera pose may be, about a centimetre and a quarter of a degree."""
    turn = Rotation.from_rotvec(np.radians(0.25) * rng.standard_normal(3)).as_matrix()
    return make_T(turn, 0.008 * rng.standard_normal(3))


def crop_view(frame: Frame, ids: np.ndarray, rng: np.random.Generator) -> tuple[Frame, np.ndarray]:
    """Blank everything outside a random window: narrower views and objects cut by the border."""
    height, width = frame.depth_m.shape
    w, h = int(width * rng.uniform(0.5, 0.95)), int(height * rng.uniform(0.5, 0.95))
    u, v = rng.integers(0, width - w + 1), rng.integers(0, height - h + 1)
    depth = np.zeros_like(frame.depth_m)
    depth[v : v + h, u : u + w] = frame.depth_m[v : v + h, u : u + w]
    camera, color = Camera(frame.camera.K, width, height), frame.color
    if color is not None:
        color = np.zeros_like(color)
        color[v : v + h, u : u + w] = np.asarray(frame.color)[v : v + h, u : u + w]
    return replace(frame, depth_m=depth, camera=camera, color=color), ids


def vary_color(
    color: NDArray[np.uint8] | None, rng: np.random.Generator
) -> NDArray[np.uint8] | None:
    """Other exposure, white balance and noise; now and then grey, other hues or none at all: a
    colour says where things end more surely than what they are. Some images are out of focus or
    beside their depth images, as those of real cameras are."""
    if color is None or rng.random() < NO_COLORS:
        return None
    picture = Image.fromarray(color)
    if rng.random() < BLURRED:
        picture = picture.filter(ImageFilter.GaussianBlur(rng.uniform(0.5, 1.5)))
    if rng.random() < MISALIGNED:
        picture = _beside(picture, rng)
    image = np.asarray(picture).astype(np.float32) / 255
    if rng.random() < GREY:
        image = image.mean(axis=2, keepdims=True).repeat(3, axis=2)
    elif rng.random() < OTHER_HUES:
        image = image[..., rng.permutation(3)]
    image = image ** rng.uniform(0.7, 1.4) * rng.uniform(0.8, 1.2, 3) * rng.uniform(0.7, 1.2)
    image += rng.normal(0, 0.02, image.shape)
    return (255 * image.clip(0, 1)).astype(np.uint8)


def _beside(picture: Image.Image, rng: np.random.Generator) -> Image.Image:
    """A little larger or smaller about its centre, and shifted."""
    (width, height), scale = picture.size, rng.uniform(0.98, 1.02)
    x, y = rng.uniform(-0.01, 0.01, 2) * width + (1 - scale) / 2 * np.array([width, height])
    matrix = (scale, 0.0, x, 0.0, scale, y)
    affine, smooth = Image.Transform.AFFINE, Image.Resampling.BILINEAR
    return picture.transform(picture.size, affine, matrix, smooth)
