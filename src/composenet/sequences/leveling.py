"""Which way is up, and where is the floor: from the surfaces that frames show.

A room's furniture and floor face straight up, its walls and fronts sideways. The up direction
is the one that explains most surface normals that way, near where the camera's top points.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from composenet.geometry.camera import back_project
from composenet.geometry.transform import make_T, rotation_onto
from composenet.records import Camera, FloatArray, usable_depth

CAMERA_UP = np.array([0.0, -1.0, 0.0])
"""the camera's top in its own axes"""

_BLOCKS_ACROSS = 80  # the image is averaged to about this width
_NEAR_M, _FAR_M = 0.3, 6.0  # depth that normals are taken from
_MIN_SINE = float(np.sin(np.radians(10)))  # surfaces seen flatter than this are left out
_MAX_AREA_M2 = 0.01  # the most that one block counts
_CONE_DEG = 60.0  # up is sought this far around where the camera's top points
_PARALLEL_DEG, _SIDEWAYS_DEG = 8.0, 5.0  # a normal counts as facing up, or sideways
_REFINE_DEG = (12.0, 8.0, 5.0, 4.0, 4.0, 4.0)  # shrinking windows of the mean shift
_MIN_UP_SHARE = 0.03  # of all normals; fewer are no horizontal plane
_FLOOR_BIN_M = 0.02
_FLOOR_MIN_SHARE = 0.15  # of the largest horizontal plane; lower ones are reflections
_BENEATH_M, _BENEATH_MAX_SHARE = 0.1, 0.05  # of all that is seen; under a floor lies less
_SEAT_M, _BENEATH_SMALL_SHARE = 0.38, 0.005  # a floor that is hardly seen lies that far down
_MIN_SIDEWAYS_SHARE, _MIN_SECOND_WALL = 0.3, 0.1  # of all normals; of those of walls
_GRAVITY_DEG = 6.0
_LEVEL = float(np.cos(np.radians(3)))  # a world that is turned by less is z-up already


@dataclass(frozen=True)
class Surface:
    """Oriented points of one or more frames. points: (N, 3) metres; normals: (N, 3), unit,
    facing the camera; weights: (N,), the area a block stands for in square metres, limited so
    that far blocks do not outweigh near ones."""

    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    weights: NDArray[np.float64]

    def moved(self, T_a_b: FloatArray) -> Surface:
        """The surface of frame b in frame a."""
        R = T_a_b[:3, :3]
        return Surface(self.points @ R.T + T_a_b[:3, 3], self.normals @ R.T, self.weights)


def merge(surfaces: list[Surface]) -> Surface:
    """All points of several surfaces that share a frame; empty for an empty list."""
    if not surfaces:
        return Surface(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    return Surface(
        np.concatenate([s.points for s in surfaces]),
        np.concatenate([s.normals for s in surfaces]),
        np.concatenate([s.weights for s in surfaces]),
    )


def surface_of(depth_m: FloatArray, camera: Camera) -> Surface:
    """Oriented points, camera axes, of a depth image (H, W).

    Points are means over square blocks of pixels, which calms noise; normals are cross products
    of central differences between blocks. Blocks with a hole, or whose neighbours jump in
    depth, or that are seen at under 10 degrees, are left out.
    """
    block = max(1, round(camera.width / _BLOCKS_ACROSS))
    h, w = camera.height // block, camera.width // block
    if min(h, w) < 3:
        return merge([])
    pixels = back_project(depth_m, camera)[: h * block, : w * block].astype(np.float64)
    tiles = pixels.reshape(h, block, w, block, 3)
    points = tiles.mean(axis=(1, 3))
    nearest, farthest = tiles[..., 2].min(axis=(1, 3)), tiles[..., 2].max(axis=(1, 3))
    middle, nearest, farthest = points[1:-1, 1:-1], _cross(nearest), _cross(farthest)
    normals = np.cross(points[2:, 1:-1] - points[:-2, 1:-1], points[1:-1, 2:] - points[1:-1, :-2])
    area = np.linalg.norm(normals, axis=-1)
    good = (nearest.min(axis=0) > _NEAR_M) & (farthest.max(axis=0) < _FAR_M) & (area > 0)
    good &= farthest.max(axis=0) - nearest.min(axis=0) < 0.2 * middle[..., 2]
    normals, area, middle = normals[good], area[good], middle[good]
    normals /= area[:, None]
    seen = -(normals * middle).sum(axis=1) > _MIN_SINE * np.linalg.norm(middle, axis=1)
    weights = np.minimum(area / 4, _MAX_AREA_M2)
    return Surface(middle[seen], normals[seen], weights[seen])


def _cross(image: FloatArray) -> NDArray[np.float64]:
    """(5, H - 2, W - 2): every inner cell with its four neighbours."""
    middle, rows, columns = slice(1, -1), image[:, 1:-1], image[1:-1]
    return np.stack([image[middle, middle], rows[2:], rows[:-2], columns[:, 2:], columns[:, :-2]])


def find_up(surface: Surface, roughly_up: FloatArray) -> NDArray[np.float64] | None:
    """Unit up direction (3,) in the surface's frame, or None where nothing tells.

    Candidates within 60 degrees of `roughly_up` are scored by the share of normals within
    8 degrees of them plus half the share of those square to them (5 degrees), times the cosine
    to `roughly_up`. Mean shift over the normals, its window shrinking to 4 degrees, refines the
    best, then a fit to the largest plane. Where under 3 % of the normals face that way walls alone
    tell, if there are two that meet (`_square_to_walls`); else None.
    """
    total, length = surface.weights.sum(), np.linalg.norm(roughly_up)
    if not (total > 0 and length > 1e-6):
        return None
    roughly_up = roughly_up / length
    candidates = _directions(1500)
    candidates = candidates[candidates @ roughly_up > np.cos(np.radians(_CONE_DEG))]
    score = _levelness(surface, candidates) * (candidates @ roughly_up)
    start = up = candidates[np.argmax(score)]
    for window_deg in _REFINE_DEG:
        near = surface.normals @ up > np.cos(np.radians(window_deg))
        share = surface.weights[near].sum() / total
        if share < _MIN_UP_SHARE:
            return _square_to_walls(surface, start)
        up = surface.weights[near] @ surface.normals[near]
        up = up / np.linalg.norm(up)
    return _plane_refined(surface, up)


def _levelness(surface: Surface, candidates: FloatArray) -> NDArray[np.float64]:
    """How much speaks for each of some unit up directions (K, 3): the share of normals that face
    that way, and half of those square to it, by weight, of up to 2000 points."""
    pick = np.random.default_rng(0).permutation(len(surface.weights))[:2000]
    cosines = candidates @ surface.normals[pick].T
    upward = cosines > np.cos(np.radians(_PARALLEL_DEG))
    sideways = np.abs(cosines) < np.sin(np.radians(_SIDEWAYS_DEG))
    weights = surface.weights[pick]
    return np.asarray((upward + 0.5 * sideways) @ weights / max(weights.sum(), 1e-12))


def _square_to_walls(surface: Surface, up: FloatArray) -> NDArray[np.float64] | None:
    """The direction near `up` that is square to most normals. None where it is to under 30 % of
    them, or they all face one way and back."""
    for window_deg in (10.0, 8.0, 5.0, 5.0, 5.0):
        side = np.abs(surface.normals @ up) < np.sin(np.radians(window_deg))
        weights, normals = surface.weights[side], surface.normals[side]
        if weights.sum() < _MIN_SIDEWAYS_SHARE * surface.weights.sum():
            return None
        variances, vectors = np.linalg.eigh((normals.T * weights) @ normals / weights.sum())
        if variances[1] < _MIN_SECOND_WALL:
            return None
        up = vectors[:, 0] * np.sign(vectors[:, 0] @ up)
    return np.asarray(up, dtype=np.float64)


def _plane_refined(surface: Surface, up: FloatArray) -> NDArray[np.float64]:
    """The normal of the largest plane square to `up`, which a wide plane gives better than
    noisy normals do; `up` itself where the plane is narrow (under 0.15 m standard deviation
    across) or turns it over 5 degrees."""
    flat = surface.normals @ up > np.cos(np.radians(15))
    points, weights = surface.points[flat], surface.weights[flat]
    height = points @ up
    counts, edges = np.histogram(height, bins=_bins(height), weights=weights)
    level = edges[np.argmax(np.convolve(counts, np.ones(3), mode="same"))] + _FLOOR_BIN_M / 2
    near = np.abs(height - level) < 0.1
    refined = np.asarray(up, dtype=np.float64)
    up = refined
    for window_m in (0.06, 0.04, 0.03, 0.03):
        if not near.any():
            return up
        middle = np.average(points[near], axis=0, weights=weights[near])
        spread = np.cov(points[near].T, aweights=weights[near], ddof=0)
        variances, vectors = np.linalg.eigh(spread)
        refined = vectors[:, 0] * np.sign(vectors[:, 0] @ up)
        if variances[1] < 0.15**2 or refined @ up < np.cos(np.radians(5)):
            return up
        near = np.abs((points - middle) @ refined) < window_m
    return refined


def find_floor(surface: Surface) -> float | None:
    """Height z, metres, of the floor of a levelled surface, or None where none is seen.

    The lowest level of a histogram (2 cm bins, smoothed over 6 cm) of points that face up
    within 15 degrees, among its peaks of at least 15 % of the largest; refined by the
    median within 4 cm. Reflections below the floor fall under the share. Where over 5 % of all that
    is seen lies 10 cm or more below that, it may be a table top or a seat: the floor is then the
    largest peak 38 cm or more below it with next to nothing below that, however small. Without one
    it is no floor either, if over 0.5 % lies so far below it.
    """
    flat = surface.normals[:, 2] > np.cos(np.radians(15))
    z, weights = surface.points[flat, 2], surface.weights[flat]
    if weights.sum() <= _MIN_UP_SHARE * surface.weights.sum() or not len(z):
        return None
    counts, edges = np.histogram(z, bins=_bins(z), weights=weights)
    smooth = np.convolve(counts, np.ones(3), mode="same")
    padded = np.pad(smooth, 1)
    peaks = (smooth >= padded[:-2]) & (smooth >= padded[2:])
    large = peaks & (smooth >= _FLOOR_MIN_SHARE * smooth.max())
    at = int(np.argmax(large))
    beneath = _weight_below(surface, edges[:-1] - _BENEATH_M)
    if beneath[at] > _BENEATH_MAX_SHARE * surface.weights.sum():
        least = _BENEATH_SMALL_SHARE * surface.weights.sum()
        far_down = edges[:-1] <= edges[at] - _SEAT_M
        peaks &= far_down & (smooth > 0) & (beneath <= least)
        if peaks.any():
            at = int(np.argmax(np.where(peaks, smooth, 0)))
        elif _weight_below(surface, edges[at : at + 1] - _SEAT_M)[0] > least:
            return None
    level = float(edges[at] + _FLOOR_BIN_M / 2)
    return float(np.median(z[np.abs(z - level) < 0.04]))


def _weight_below(surface: Surface, z: FloatArray) -> NDArray[np.float64]:
    """Summed weight of the points under each of the heights z."""
    order = np.argsort(surface.points[:, 2])
    total = np.concatenate([[0.0], np.cumsum(surface.weights[order])])
    return total[np.searchsorted(surface.points[order, 2], z)]


def level_world(
    surface: Surface,
    camera_up: FloatArray,
    gravity: FloatArray | None,
    own_floor_m: float | None = None,
) -> tuple[NDArray[np.float64], list[str]]:
    """`T_level_source` (4, 4) of a recording with poses, and notes for the user.

    surface: of sampled frames, in the recording's world. camera_up: (3,), where the camera's
    top points on average. Up is, in this order: against `gravity`; what `find_up` finds; the
    world's axis within 45 degrees of `camera_up` and nearest to it; `camera_up`. The world is
    turned by the smallest rotation that brings up to +z (so one that is z-up already is
    hardly changed) and shifted along z only, so that the floor is z = 0. own_floor_m: z that may
    be the floor if the world is z-up, None where none may; it is where none is seen.
    """
    seen = find_up(surface, camera_up if gravity is None else -gravity)
    if own_floor_m is not None and _lowest(surface) < own_floor_m - _BENEATH_M:
        own_floor_m = None
    notes = []
    if gravity is not None:
        notes = _gravity_notes(surface, gravity, seen)
    elif own_floor_m is not None:
        notes = _sideways_notes(surface, seen)
    up = seen if gravity is None else -gravity
    if up is None:
        axes = np.concatenate([np.eye(3), -np.eye(3)])
        axis = axes[np.argmax(axes @ camera_up)]
        near = axis @ camera_up > np.cos(np.radians(45)) * np.linalg.norm(camera_up)
        up = axis if near else camera_up
        notes.append("no horizontal plane found: up is guessed from how the camera is held")
    R = rotation_onto(up, (0, 0, 1)) if np.linalg.norm(up) > 1e-6 else np.eye(3)
    turned = surface.moved(make_T(R, np.zeros(3)))
    floor = find_floor(turned)
    if R[2, 2] < _LEVEL or not len(surface.points):
        own_floor_m = None
    elif own_floor_m is not None:  # under what is seen: the world may be turned far from its origin
        x, y = np.median(surface.points[:, :2], axis=0)
        own_floor_m = float((R @ [x, y, own_floor_m])[2])
    if floor is None and own_floor_m is not None:
        floor = own_floor_m
        notes.append("no floor found: z = 0 of the recording's own world is taken for it")
    elif floor is None:
        floor = _lowest(turned)
        notes.append("no floor found: z = 0 is the lowest surface seen")
    elif own_floor_m is not None and floor > own_floor_m + _BENEATH_M:
        notes.append(
            f"the floor that was found is {floor - own_floor_m:.2f} m above z = 0 of the "
            "recording's own world, which has z up, too: if its floor is at z = 0, --levelled "
            "leaves it there"
        )
    return make_T(R, (0, 0, -floor)), notes


def _lowest(surface: Surface) -> float:
    """z, metres, that next to nothing lies under; 0 without points."""
    return float(np.percentile(surface.points[:, 2], 2)) if len(surface.points) else 0.0


def _sideways_notes(surface: Surface, up: FloatArray | None) -> list[str]:
    """A note where a world is turned in which as much lies level as in what it is turned to."""
    z = np.array([0.0, 0.0, 1.0])
    if up is None or up @ z > np.cos(np.radians(_CONE_DEG)):
        return []
    own, other = _levelness(surface, np.stack([z, up]))
    if own < other:
        return []
    return [
        "by how the camera is held the world's z is not up, but what is seen would be as level if "
        "it were: if it is, and the camera hangs sideways or upside down, --levelled (the floor at "
        "z = 0, too) or gravity-direction.txt (0 0 -1) says so"
    ]


def _gravity_notes(surface: Surface, gravity: FloatArray, up: FloatArray | None) -> list[str]:
    """A note where the up that is seen is not that of gravity."""
    with_it, against_it = _levelness(surface, np.stack([gravity, -gravity]))
    if with_it > against_it + _MIN_UP_SHARE:
        return [
            "by gravity-direction.txt what lies level is seen from below: it wants the direction "
            "in which things fall, and an accelerometer at rest points the other way"
        ]
    if up is None:
        return []
    off_deg = float(np.degrees(np.arccos(np.clip(-gravity @ up, -1, 1))))
    if off_deg <= _GRAVITY_DEG:
        return []
    return [
        f"what is seen lies level {off_deg:.0f} degrees from gravity-direction.txt: is that the "
        "direction in which things fall, in the world of the poses?"
    ]


@dataclass(frozen=True)
class CameraLeveler:
    """Levels frames one by one where there are no poses.

    up: (3,), unit, camera axes, and height_m, the camera's above the floor: those of the last
    frame that showed what is up, and a floor, taken over by frames that do not. height_m is None
    until then.
    """

    up: FloatArray = field(default_factory=CAMERA_UP.copy)
    height_m: float | None = None

    @staticmethod
    def from_samples(surfaces: list[Surface]) -> CameraLeveler:
        """The median over sampled frames, camera axes, for recordings that begin at a wall."""
        start = CameraLeveler()
        levelers = [start.level(surface)[0] for surface in surfaces]
        levelers = [leveler for leveler in levelers if leveler is not start]
        if not levelers:
            return start
        up = np.median([leveler.up for leveler in levelers], axis=0)
        heights_m = [leveler.height_m for leveler in levelers if leveler.height_m is not None]
        height_m = float(np.median(heights_m)) if heights_m else None
        return CameraLeveler(up / np.linalg.norm(up), height_m)

    def level(self, surface: Surface) -> tuple[CameraLeveler, NDArray[np.float64]]:
        """The leveler for the next frame and `T_world_camera` (4, 4) of this one.

        surface: this frame's, camera axes. The world has the camera above its origin, at the
        height of the floor seen, with +x where the camera looks; at its origin until one is.
        """
        up = find_up(surface, CAMERA_UP)
        leveler = self if up is None else replace(self, up=up)
        R = _facing_x(leveler.up)
        floor = None if up is None else find_floor(surface.moved(make_T(R, np.zeros(3))))
        if floor is not None:
            leveler = replace(leveler, height_m=-floor)
        return leveler, make_T(R, (0, 0, leveler.height_m or 0.0))


def level_camera(depth_m: FloatArray, camera: Camera) -> NDArray[np.float64] | None:
    """`T_world_camera` (4, 4) of a depth image, (H, W) metres, in a levelled world of its own: z
    up, the floor at z = 0, the camera above the origin, +x where it looks. None where the image
    shows no floor. Raises SequenceError where the depth is not in metres, or not the camera's."""
    depth_m = usable_depth("level_camera", depth_m, camera)
    leveler, T_world_camera = CameraLeveler().level(surface_of(depth_m, camera))
    return None if leveler.height_m is None else T_world_camera


def _facing_x(up: FloatArray) -> NDArray[np.float64]:
    """(3, 3) rotation of camera axes to a world where `up` is +z and the camera looks at +x
    (its top does, where it looks straight down or up)."""
    ahead = np.array([0.0, 0.0, 1.0])
    if abs(up[2]) > 0.999:
        ahead = CAMERA_UP
    x = ahead - up * (ahead @ up)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(up, x), up])


def _bins(height: FloatArray) -> NDArray[np.float64]:
    """Edges of 2 cm bins over the heights, at least three bins."""
    count = max(3, int(np.ptp(height) / _FLOOR_BIN_M) + 1)
    return height.min() + _FLOOR_BIN_M * np.arange(count + 1)


def _directions(count: int) -> NDArray[np.float64]:
    """(count, 3) directions spread evenly over the sphere (Fibonacci lattice)."""
    i = np.arange(count) + 0.5
    z = 1 - 2 * i / count
    angle = np.pi * (1 + 5**0.5) * i
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
