"""Colour of another camera brought onto the depth images; and where that camera is, from the
images alone, if nobody says.

Where depth jumps, brightness mostly changes: the edges of things in the depth images are taken to
the colour images, and the camera that brings most of them onto strong gradients is the one. It has
square pixels and looks the same way as the depth camera, from a place at its side.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.stats import rankdata

from composenet.geometry.camera import back_project
from composenet.geometry.transform import apply_T, make_T
from composenet.records import Camera, FloatArray

_JUMP = 0.07  # of its depth something lies before what is behind
_MOST_EDGES, _FEWEST_EDGES = 4000, 300
_BLUR_PX, _MARGIN_PX = 1.0, 3
_LEAST_WITHIN = 0.25  # of the edges are in the colour images
_ZOOMS = np.exp(np.arange(np.log(0.6), np.log(1.9), 0.04))
_SHIFTS = np.arange(-0.06, 0.061, 0.0125)  # of the middle, in widths of the image
_STEPS = (0.02, 0.006, 0.006, 0.006)  # of the search around the best: zoom, shifts, sideways
_FINEST = 1 / 8
_BOUNDS = ((0.6, -0.08, -0.08, -0.08), (1.9, 0.08, 0.08, 0.08))
_FEWEST_IMAGES = 4
_BESIDE = 0.03  # widths of the image
_BETTER = 0.03  # by so much another camera's peak must be higher than that of none


@dataclass(frozen=True)
class ColorCamera:
    """Where the colour of a point is. K: (3, 3), pixels of the colour image. T_color_depth: (4, 4),
    the depth camera in its axes."""

    K: FloatArray
    T_color_depth: FloatArray

    def stretched(self, size: tuple[int, int], to: tuple[int, int]) -> ColorCamera:
        """Of its images of that size (width, height) when they are brought to another."""
        x, y = to[0] / size[0], to[1] / size[1]
        K = np.array(self.K, dtype=float)
        K[0], K[1] = K[0] * x, K[1] * y
        K[:2, 2] += (x - 1) / 2, (y - 1) / 2  # pixel centres
        return replace(self, K=K)

    def pixels_off(self, camera: Camera, depth_m: float = 2.0) -> float:
        """How far from its place in the depth image the colour of a point is, at most, of all
        points at that depth that both cameras see."""
        seen = np.full((camera.height, camera.width), depth_m, np.float32)
        points = apply_T(self.T_color_depth, back_project(seen, camera).reshape(-1, 3))
        there = points[:, :2] / points[:, 2:] * self.K[[0, 1], [0, 1]] + self.K[:2, 2]
        v, u = np.indices(seen.shape).reshape(2, -1)
        off = np.hypot(there[:, 0] - u, there[:, 1] - v)
        within = ((there >= 0) & (there <= np.array([camera.width, camera.height]) - 1)).all(axis=1)
        return float(off[within].max()) if within.any() else 0.0

    def onto(
        self, rgb: NDArray[np.uint8], depth_m: NDArray[np.float32], camera: Camera
    ) -> NDArray[np.uint8]:
        """(H, W, 3): of each depth pixel its colour in the image rgb, black where that does not
        reach. Pixels without depth are taken to be as far as the nearest that has it; what is
        hidden from the colour camera has the colour of what hides it."""
        known = depth_m > 0
        if not known.any():
            return np.zeros((*depth_m.shape, 3), np.uint8)
        where = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
        points = back_project(depth_m[tuple(where)], camera).reshape(-1, 3)
        x, y, z = apply_T(self.T_color_depth, points).T
        z = np.maximum(z, 1e-6)
        u = np.rint(self.K[0, 0] * x / z + self.K[0, 2])
        v = np.rint(self.K[1, 1] * y / z + self.K[1, 2])
        seen = (u >= 0) & (v >= 0) & (u < rgb.shape[1]) & (v < rgb.shape[0]) & (z > 1e-6)
        out = np.zeros((len(z), 3), np.uint8)
        out[seen] = rgb[v[seen].astype(int), u[seen].astype(int)]
        return out.reshape(*depth_m.shape, 3)


@dataclass(frozen=True)
class _Edges:
    """image: (E,) in which of them each is. rays: (E, 2) from the depth camera at depth 1.
    inverse_m: (E,) one over depth. gradients: (I, H, W) float32, by how much the rank of a pixel's
    gradient in its image, 0..1, is above the mean; NaN where there is no colour."""

    image: NDArray[np.int64]
    rays: NDArray[np.float64]
    inverse_m: NDArray[np.float64]
    gradients: NDArray[np.float32]

    def of(self, chosen: NDArray[Any]) -> _Edges:
        """Some of the edges, of the same images."""
        return replace(
            self,
            image=self.image[chosen],
            rays=self.rays[chosen],
            inverse_m=self.inverse_m[chosen],
        )


def find_color_camera(
    images: Sequence[tuple[NDArray[np.float32], NDArray[np.uint8]]],
    camera: Camera,
    aspect: float = 1.0,
) -> ColorCamera | None:
    """The camera of colour images that do not lie on their depth images.

    images: depth (H, W), metres, 0 where unknown, and colour (H, W, 3) stretched to its size, of a
    few frames; black is no colour. camera: of the depth. aspect: how much higher than wide that
    made pixels which were square. None where colour lies on depth already, or edges do not tell: of
    a camera that is found by half of the images the others must show as well that its edges lie
    where no camera beside it would have them.
    """
    if len(images) < _FEWEST_IMAGES:
        return None
    edges = _thinned([_edges(depth_m, rgb, camera) for depth_m, rgb in images])
    halves = [edges.of(edges.image % 2 == half) for half in (0, 1)]
    if min(len(half.rays) for half in halves) < _FEWEST_EDGES:
        return None

    def made(guess: FloatArray) -> ColorCamera:
        return _color_camera(guess, camera, aspect)

    own, guesses = ColorCamera(camera.K, np.eye(4)), []
    grid = [np.array([z, a, b, 0.0]) for z, a, b in product(_ZOOMS, _SHIFTS, _SHIFTS)]
    for half, other in (halves, halves[::-1]):
        best = max(grid, key=lambda guess: _share(half, made(guess)))
        guesses.append(_refined(half, best, made))
        if not _peak(other, made(guesses[-1])) > _peak(other, own) + _BETTER:
            return None
    return made(_refined(edges, guesses[0], made))


def _refined(
    edges: _Edges, guess: FloatArray, made: Callable[[FloatArray], ColorCamera]
) -> FloatArray:
    """The best guess by ever smaller steps within the bounds."""
    most, step = _share(edges, made(guess)), np.array(_STEPS)
    while step[0] >= _STEPS[0] * _FINEST:
        tries = [np.clip(guess + way * step, *_BOUNDS) for way in (*np.eye(4), *-np.eye(4))]
        found = max(tries, key=lambda one: _share(edges, made(one)))
        if (share := _share(edges, made(found))) > most:
            most, guess = share, found
        else:
            step = step / 2
    return guess


def _color_camera(guess: FloatArray, camera: Camera, aspect: float) -> ColorCamera:
    """guess: focal length in those of the depth camera, the middle's shift to the right and down
    and the sideways place, in widths of the image (at a metre)."""
    zoom, right, down, aside = guess
    fx = zoom * camera.K[0, 0]
    K = np.array(
        [
            [fx, 0, (camera.width - 1) / 2 + right * camera.width],
            [0, fx * aspect, (camera.height - 1) / 2 + down * camera.width],
            [0, 0, 1],
        ]
    )
    return ColorCamera(K, make_T(np.eye(3), [aside * camera.width / fx, 0, 0]))


def _edges(depth_m: NDArray[np.float32], rgb: NDArray[np.uint8], camera: Camera) -> _Edges:
    """The pixels at which something ends before what is behind it."""
    behind = ndimage.maximum_filter(depth_m, 5)
    near = (depth_m > 0) & (depth_m < (1 - _JUMP) * behind)
    edge = np.zeros_like(near)
    for axis, way in product((0, 1), (1, -1)):
        beside = np.roll(depth_m, way, axis)
        edge |= near & ((beside == 0) | (beside > (1 + _JUMP) * depth_m))
    edge[[0, -1]] = edge[:, [0, -1]] = False
    v, u = np.nonzero(edge)
    K, z = camera.K, depth_m[v, u].astype(np.float64)
    rays = np.column_stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1]])
    light = ndimage.gaussian_filter(rgb.mean(axis=-1, dtype=np.float32), _BLUR_PX)
    slope = np.hypot(ndimage.sobel(light, 0), ndimage.sobel(light, 1))
    known = ndimage.minimum_filter(rgb.any(axis=-1), 2 * _MARGIN_PX + 1)
    rank = np.full(slope.shape, 0.5, np.float32)
    rank[known] = (rankdata(slope[known]) - 0.5) / max(np.count_nonzero(known), 1)
    gradients = ndimage.gaussian_filter(rank - 0.5, _BLUR_PX)
    gradients[~known] = np.nan
    return _Edges(np.zeros(len(z), np.int64), rays, 1 / z, gradients[None])


def _thinned(edges: list[_Edges]) -> _Edges:
    """So many edges of all images as are enough."""
    every = _Edges(
        image=np.repeat(np.arange(len(edges)), [len(e.rays) for e in edges]),
        rays=np.concatenate([e.rays for e in edges]),
        inverse_m=np.concatenate([e.inverse_m for e in edges]),
        gradients=np.concatenate([e.gradients for e in edges]),
    )
    return every.of(np.random.default_rng(0).permutation(len(every.rays))[:_MOST_EDGES])


def _share(edges: _Edges, color_camera: ColorCamera) -> float:
    """By how much the mean rank of gradients at the edges is above that of all pixels."""
    K, t = color_camera.K, color_camera.T_color_depth[:3, 3]
    pinhole = (K[0, 0], K[1, 1], K[0, 2], K[1, 2])
    total, within = _sum(
        edges.image, edges.rays, edges.inverse_m, edges.gradients, pinhole, float(t[0])
    )
    return total / within if within > _LEAST_WITHIN * len(edges.rays) else -np.inf


def _peak(edges: _Edges, color_camera: ColorCamera) -> float:
    """By how much the share is above what it is where all colour is moved a little."""
    width = edges.gradients.shape[2]
    beside = []
    for right, down in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        K = np.array(color_camera.K)
        K[:2, 2] += np.array([right, down]) * _BESIDE * width
        beside.append(_share(edges, replace(color_camera, K=K)))
    share = _share(edges, color_camera)
    return share - sum(beside) / 4 if np.isfinite([share, *beside]).all() else 0.0


@numba.njit(cache=True, nogil=True)
def _sum(image, rays, inverse_m, gradients, pinhole, aside_m):  # type: ignore[no-untyped-def]
    fx, fy, cx, cy = pinhole
    height, width = gradients.shape[1:]
    total, within = 0.0, 0
    for i in range(len(image)):
        u = int(np.rint(fx * (rays[i, 0] + aside_m * inverse_m[i]) + cx))
        v = int(np.rint(fy * rays[i, 1] + cy))
        if 0 <= u < width and 0 <= v < height and not np.isnan(gradients[image[i], v, u]):
            total += gradients[image[i], v, u]
            within += 1
    return total, within
