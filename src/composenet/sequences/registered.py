"""Colour of one camera as another camera would see it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from PIL import Image

from composenet.geometry.camera import back_project
from composenet.geometry.transform import apply_T
from composenet.records import Camera, FloatArray
from composenet.sequences.images import ImageSource, image_size, read_color, read_depth


@dataclass(frozen=True)
class RegisteredColor:
    """Colour brought onto a depth image: each pixel's depth is taken to the colour camera's image.
    What was not measured or lies beyond that image is black; what is hidden from that camera has
    the colour of what hides it.

    K_depth, K_color: (3, 3), pixels of the images as they are. T_color_depth: (4, 4). units_m:
    metres a step of depth.
    """

    depth: ImageSource
    color: ImageSource
    K_depth: FloatArray
    K_color: FloatArray
    T_color_depth: FloatArray
    units_m: float

    @property
    def known_size(self) -> tuple[int, int] | None:
        """(width, height): that of the depth image."""
        return image_size(self.depth)

    def open(self) -> Image.Image:
        """The colour image. Raises SequenceError where either cannot be read."""
        raw = read_depth(self.depth)
        rgb = read_color(self.color, *image_size(self.color))
        height, width = raw.shape
        depth_m = (raw * self.units_m).astype(np.float32)
        points = back_project(depth_m, Camera(np.asarray(self.K_depth), width, height))
        x, y, z = apply_T(self.T_color_depth, points.reshape(-1, 3)).T
        K, before = self.K_color, (raw.ravel() > 0) & (z > 0)
        u = np.rint(K[0, 0] * x[before] / z[before] + K[0, 2]).astype(int)
        v = np.rint(K[1, 1] * y[before] / z[before] + K[1, 2]).astype(int)
        within = (u >= 0) & (v >= 0) & (u < rgb.shape[1]) & (v < rgb.shape[0])
        seen = np.flatnonzero(before)[within]
        out = np.zeros((height * width, 3), np.uint8)
        out[seen] = rgb[v[within], u[within]]
        return Image.fromarray(out.reshape(height, width, 3))
