"""Frame -> sparse grid of surface voxels (paper section 4.1: the surface grid S)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numba
import numpy as np
from numpy.typing import NDArray

from composenet.config import VolumeConfig
from composenet.geometry.transform import make_T
from composenet.records import Frame
from composenet.volume.memory import FreeSpace, Memory, Surface

FEATURE_NAMES = (
    "offset_x",
    "offset_y",
    "offset_z",
    "normal_x",
    "normal_y",
    "normal_z",
    "height",
    "distance",
    "view_x",
    "view_y",
    "count",
    "age",
)
"""Channels of a voxel: mean point within the voxel (voxels), mean normal (grid axes, towards
the camera that saw it), height above the floor / 2 m, distance from the camera / 4 m, horizontal
viewing direction, log of the pixel count / 4, and age: 0 for what this frame sees, 0.5 to 1 for
what only earlier frames saw (1 from OLD_FRAMES ago on)."""

OLD_FRAMES = 20


@dataclass(frozen=True)
class Volume:
    """One frame as a sparse surface grid, with what the signed distance field needs.

    coords: (N, 3) int32 voxel indices, all >= 0, no two alike: those of the frame first, then the
    remembered ones. features: (N, len(FEATURE_NAMES)) float32. labels: (N,) int32, majority
    instance id of the voxel's pixels (zeros without an id image). n_seen: how many of the N
    voxels the frame itself sees.
    free: what this frame and earlier ones saw to be empty, grid frame.
    shape: cells of the grid, multiples of 16. T_world_grid: (4, 4), grid metres to world; voxel
    (i, j, k) is centred at voxel_size_m * (i, j, k). depth_m (H, W), K (3, 3) and T_camera_grid
    (4, 4) are the frame's.
    """

    coords: NDArray[np.int32]
    features: NDArray[np.float32]
    labels: NDArray[np.int32]
    n_seen: int
    free: FreeSpace
    shape: tuple[int, int, int]
    voxel_size_m: float
    T_world_grid: NDArray[np.float64]
    depth_m: NDArray[np.float32]
    K: NDArray[np.float64]
    T_camera_grid: NDArray[np.float64]


def quarter_turn(T_world_camera: NDArray[np.floating]) -> NDArray[np.float64]:
    """(3, 3) R_world_grid: the multiple of 90 degrees about z for which the camera looks along
    the grid's +x within 45 degrees. Axis-aligned boxes stay axis-aligned."""
    forward = T_world_camera[:3, 2]
    if np.hypot(forward[0], forward[1]) < 1e-6:  # straight up or down: take the image's up
        forward = -T_world_camera[:3, 1]
    k = int(np.round(np.arctan2(forward[1], forward[0]) / (np.pi / 2))) % 4
    c, s = ((1, 0), (0, 1), (-1, 0), (0, -1))[k]
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]], dtype=np.float64)


@numba.njit(cache=True, nogil=True)
def smooth_depth(depth):
    """Edge-preserving mean: each pixel becomes the mean of the neighbours, up to 2 pixels away,
    whose depth differs by less than 0.015 + 0.006 z^2 metres (depth noise grows with the square of
    distance). (H, W) float32 -> the same; invalid pixels (not positive, not finite) become 0."""
    radius = 2
    height, width = depth.shape
    out = np.zeros_like(depth)
    padded = np.zeros((height + 2 * radius, width + 2 * radius), depth.dtype)
    padded[radius : radius + height, radius : radius + width] = depth
    limit, total, count = np.empty(width), np.empty(width), np.empty(width)
    for v in range(height):
        row = depth[v]
        for u in range(width):
            limit[u] = 0.015 + 0.006 * row[u] * row[u] if 0 < row[u] < np.inf else -1.0
            total[u], count[u] = 0.0, 0.0
        for y in range(v, v + 2 * radius + 1):
            for x in range(2 * radius + 1):
                near = padded[y, x : x + width]
                for u in range(width):  # no branch within, so that several go at once
                    like = (near[u] > 0) & (abs(near[u] - row[u]) < limit[u])
                    total[u] += near[u] if like else np.float32(0)
                    count[u] += like
        for u in range(width):
            if count[u] > 0:
                out[v, u] = total[u] / count[u]
    return out


@numba.njit(cache=True, nogil=True)
def _points_and_normals(depth, fx, fy, cx, cy, R, t, max_depth):
    """Back-projected points (grid frame) and normals towards the camera; valid mask."""
    height, width = depth.shape
    points = np.empty((height, width, 3), np.float32)
    valid = np.empty((height, width), np.bool_)
    across = np.empty(width)
    for u in range(width):
        across[u] = (u - cx) / fx
    for v in range(height):
        down = (v - cy) / fy
        for u in range(width):
            z = depth[v, u]
            seen = (z > 0.1) & (z <= max_depth)
            x, y = across[u] * z, down * z
            p0 = R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + t[0]
            p1 = R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + t[1]
            p2 = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + t[2]
            points[v, u, 0] = p0 if seen else 0.0
            points[v, u, 1] = p1 if seen else 0.0
            points[v, u, 2] = p2 if seen else 0.0
            valid[v, u] = seen
    normals = np.zeros((height, width, 3), np.float32)
    step = max(1, width // 160)
    for v in range(step, height - step):
        for u in range(step, width - step):
            limit = 0.05 * step * depth[v, u]
            if not (
                valid[v, u]
                & valid[v, u - step]
                & valid[v, u + step]
                & valid[v - step, u]
                & valid[v + step, u]
                & (abs(depth[v, u + step] - depth[v, u - step]) <= limit)
                & (abs(depth[v + step, u] - depth[v - step, u]) <= limit)
            ):
                continue
            a0 = points[v, u + step, 0] - points[v, u - step, 0]
            a1 = points[v, u + step, 1] - points[v, u - step, 1]
            a2 = points[v, u + step, 2] - points[v, u - step, 2]
            b0 = points[v + step, u, 0] - points[v - step, u, 0]
            b1 = points[v + step, u, 1] - points[v - step, u, 1]
            b2 = points[v + step, u, 2] - points[v - step, u, 2]
            n0 = b1 * a2 - b2 * a1
            n1 = b2 * a0 - b0 * a2
            n2 = b0 * a1 - b1 * a0
            norm = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
            if norm > 1e-9:
                normals[v, u, 0] = n0 / norm
                normals[v, u, 1] = n1 / norm
                normals[v, u, 2] = n2 / norm
    return points, normals, valid


@numba.njit(cache=True, nogil=True)
def _accumulate(points, normals, valid, ids, low, size, shape):
    """Sums per voxel: count, offset (3), normal (3); majority id (Boyer-Moore)."""
    table = np.full(shape[0] * shape[1] * shape[2], -1, np.int32)
    capacity = min(points.shape[0] * points.shape[1], table.shape[0])
    coords = np.empty((capacity, 3), np.int32)
    sums = np.zeros((capacity, 7), np.float32)
    labels = np.zeros(capacity, np.int32)
    votes = np.zeros(capacity, np.int32)
    n = 0
    for v in range(points.shape[0]):
        for u in range(points.shape[1]):
            if not valid[v, u]:
                continue
            f0 = (points[v, u, 0] - low[0]) / size
            f1 = (points[v, u, 1] - low[1]) / size
            f2 = (points[v, u, 2] - low[2]) / size
            i, j, k = int(np.floor(f0 + 0.5)), int(np.floor(f1 + 0.5)), int(np.floor(f2 + 0.5))
            if i < 0 or j < 0 or k < 0 or i >= shape[0] or j >= shape[1] or k >= shape[2]:
                continue
            key = (i * shape[1] + j) * shape[2] + k
            row = table[key]
            if row < 0:
                row = n
                table[key] = n
                coords[n, 0], coords[n, 1], coords[n, 2] = i, j, k
                n += 1
            sums[row, 0] += 1
            sums[row, 1] += f0 - i
            sums[row, 2] += f1 - j
            sums[row, 3] += f2 - k
            sums[row, 4] += normals[v, u, 0]
            sums[row, 5] += normals[v, u, 1]
            sums[row, 6] += normals[v, u, 2]
            if votes[row] == 0:
                labels[row] = ids[v, u]
                votes[row] = 1
            elif labels[row] == ids[v, u]:
                votes[row] += 1
            else:
                votes[row] -= 1
    return coords[:n], sums[:n], labels[:n]


def _bounds(
    low: NDArray[np.float64], high: NDArray[np.float64], size: float
) -> tuple[NDArray[np.float64], tuple[int, int, int]]:
    """Lowest corner (a multiple of the voxel size) and shape (multiples of 16) around what reaches
    from low to high, two voxels of margin; heights kept between 1 m under the floor and 3.2 m."""
    low, high = low - 2 * size, high + 2 * size
    low[2], high[2] = max(low[2], -1.0), min(max(high[2], 0.5), 3.2)
    low = np.floor(low / size) * size
    cells = np.ceil((high - low) / size).astype(int) + 1
    nx, ny, nz = (int(max(16, -(-c // 16) * 16)) for c in cells)
    return low, (nx, ny, nz)


def voxelize(
    frame: Frame,
    config: VolumeConfig,
    ids: NDArray[np.integer] | None = None,
    memory: Memory | None = None,
) -> Volume | None:
    """Surface voxels of one frame, or None where the frame has no usable depth.

    frame: world levelled, z up. ids: (H, W) instance ids for training labels. memory: what earlier
    frames saw, which is added where this one cannot see; it then remembers this frame too. A
    frame whose pose is unknown adds nothing and is not remembered.
    """
    seen = _look(frame, config, ids, memory)
    if seen is None:
        return None
    old, low, size, R = seen.old, seen.low, config.voxel_size_m, seen.R_world_grid
    coords, features, labels = seen.coords, seen.features, seen.own.labels
    if len(old):
        cells = seen.cells
        recalled = _features(cells, _sums(old, cells, low, size), low, size, seen.eye)
        recalled[:, -1] = 0.5 + 0.5 * (np.abs(frame.index - old.seen) / OLD_FRAMES).clip(0, 1)
        coords = np.concatenate([coords, cells])
        features = np.concatenate([features, recalled])
        labels = np.concatenate([labels, old.labels])
    T_world_grid = make_T(R, R @ low)
    beyond = config.memory_reach_m
    free = seen.memory.free_space(frame.index).turned(R.T)
    free = free.within(low - beyond, low + np.array(seen.shape) * size + beyond)
    return Volume(
        coords=coords,
        features=features,
        labels=labels,
        n_seen=len(seen.own),
        free=replace(free, low=free.low - low),
        shape=seen.shape,
        voxel_size_m=size,
        T_world_grid=T_world_grid,
        depth_m=seen.depth_m,
        K=np.asarray(frame.camera.K, dtype=np.float64),
        T_camera_grid=np.linalg.inv(seen.T_world_camera) @ T_world_grid,
    )


def remember(
    frame: Frame, config: VolumeConfig, ids: NDArray[np.integer] | None, memory: Memory
) -> None:
    """What `voxelize` does to the memory, in less time."""
    _look(frame, config, ids, memory)


@dataclass(frozen=True)
class _Look:
    """What a frame sees, and what it cannot see and memory has near it, in the grid's axes from
    the world's origin. own: voxels of the frame, at coords; features: of these. old: remembered
    ones, in cells. eye: the camera's place. T_world_camera: (4, 4) float64, whatever the frame's.
    memory: that of the recording, or one of this frame."""

    own: Surface
    coords: NDArray[np.int32]
    features: NDArray[np.float32]
    old: Surface
    cells: NDArray[np.int32]
    low: NDArray[np.float64]
    shape: tuple[int, int, int]
    T_world_camera: NDArray[np.float64]
    R_world_grid: NDArray[np.float64]
    eye: NDArray[np.float64]
    depth_m: NDArray[np.float32]
    memory: Memory


def _look(
    frame: Frame,
    config: VolumeConfig,
    ids: NDArray[np.integer] | None,
    memory: Memory | None,
) -> _Look | None:
    """The frame's own surface, remembered from now on; None where it has no usable depth."""
    T_world_camera = np.array(frame.T_world_camera, dtype=np.float64)
    R = quarter_turn(T_world_camera)
    T_turned_camera = T_world_camera.copy()
    T_turned_camera[:3] = R.T @ T_turned_camera[:3]
    eye, size = T_turned_camera[:3, 3], config.voxel_size_m
    K = np.asarray(frame.camera.K, dtype=np.float64)
    # a copy: loops are compiled anew for an array that cannot be written to
    depth_m = smooth_depth(np.array(frame.depth_m, dtype=np.float32, order="C"))
    points, normals, valid = _points_and_normals(
        depth_m, K[0, 0], K[1, 1], K[0, 2], K[1, 2], T_turned_camera[:3, :3], eye,
        config.max_depth_m,
    )  # fmt: skip
    memory = memory if memory is not None and frame.pose_known else Memory(0)
    memory.see_through(frame.index, depth_m, K, T_world_camera)
    recalled = memory.recall(frame.index, depth_m, K, T_world_camera)
    if valid.sum() < 100:
        return None
    old = recalled.turned(R.T)
    depth_m[depth_m > config.max_depth_m] = 0
    seen_low, seen_high = _span(points, valid)
    near = _near(old.points, seen_low, seen_high, config.memory_reach_m)
    old_low, old_high = _span(old.points[None], near[None])
    low, shape = _bounds(np.minimum(seen_low, old_low), np.maximum(seen_high, old_high), size)
    ids = np.zeros(frame.depth_m.shape, np.int32) if ids is None else ids.astype(np.int32)
    coords, sums, labels = _accumulate(points, normals, valid, ids, low, size, shape)
    solid = sums[:, 0] >= config.min_pixels
    coords, sums, labels = coords[solid], sums[solid], labels[solid]
    if len(coords) == 0:
        return None
    features = _features(coords, sums, low, size, eye)
    means = (coords + features[:, :3]) * size + low
    seen = np.full(len(coords), frame.index, np.int64)
    own = Surface(means, features[:, 3:6], sums[:, 0], labels, seen)
    cells = np.floor((old.points - low) / size + 0.5).astype(np.int32)
    unlike = _unlike(cells, coords, shape)
    memory.remember((old[unlike] + own).turned(R))
    old, cells = old[unlike & near], cells[unlike & near]
    return _Look(
        own, coords, features, old, cells, low, shape, T_world_camera, R, eye, depth_m, memory
    )


def _sums(old: Surface, cells: NDArray[np.int32], low: NDArray, size: float) -> NDArray[np.float32]:
    """(M, 7) what `_accumulate` would have summed of remembered voxels, in the turned frame."""
    mean = (old.points - low) / size - cells
    ones = np.ones((len(old), 1))
    return (np.hstack([ones, mean, old.normals]) * old.counts[:, None]).astype(np.float32)


@numba.njit(cache=True, nogil=True)
def _span(points, wanted):
    """(3,) float64 lowest and highest coordinates of the wanted ones of (H, W, 3) points; infinite
    where none is."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for v in range(points.shape[0]):
        for u in range(points.shape[1]):
            if wanted[v, u]:
                for a in range(3):
                    low[a] = min(low[a], points[v, u, a])
                    high[a] = max(high[a], points[v, u, a])
    return low, high


def _near(
    old_points: NDArray[np.float64],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    reach_m: float,
) -> NDArray[np.bool_]:
    """(M,) bool: within reach of what reaches from low to high, and in the grid's heights."""
    low, high = low - reach_m, high + reach_m
    low[2], high[2] = max(low[2], -1.0), min(high[2], 3.2)
    return np.all((old_points >= low) & (old_points <= high), axis=1)


@numba.njit(cache=True, nogil=True)
def _unlike(cells, coords, shape):
    """(M,) bool: cells that are none of coords nor an earlier row; those out of the grid are."""
    taken = np.zeros(shape, np.bool_)
    for n in range(len(coords)):
        taken[coords[n, 0], coords[n, 1], coords[n, 2]] = True
    unlike = np.ones(len(cells), np.bool_)
    for n in range(len(cells)):
        i, j, k = cells[n, 0], cells[n, 1], cells[n, 2]
        if i < 0 or j < 0 or k < 0 or i >= shape[0] or j >= shape[1] or k >= shape[2]:
            continue
        unlike[n] = not taken[i, j, k]
        taken[i, j, k] = True
    return unlike


def _features(coords, sums, low, size, camera_position) -> NDArray[np.float32]:
    """(N, len(FEATURE_NAMES)) of voxels (N, 3) and their sums (see `_accumulate`); age 0."""
    features: NDArray[np.float32] = _without_count(coords, sums, low, size, camera_position)
    features[:, 10] = np.log(sums[:, 0]) / 4
    return features


@numba.njit(cache=True, nogil=True)
def _without_count(coords, sums, low, size, camera_position):
    out = np.zeros((len(coords), len(FEATURE_NAMES)), np.float32)
    ray = np.empty(3)
    for n in range(len(coords)):
        count, total = sums[n, 0], np.float32(0)
        for a in range(3):
            total += sums[n, 4 + a] * sums[n, 4 + a]
            ray[a] = coords[n, a] * size + low[a] - camera_position[a]
        length = max(np.sqrt(total), np.float32(1e-6))
        level = ray[0] * ray[0] + ray[1] * ray[1]
        for a in range(3):
            out[n, a] = sums[n, 1 + a] / count
            out[n, 3 + a] = sums[n, 4 + a] / length
        out[n, 6] = (coords[n, 2] * size + low[2]) / 2
        out[n, 7] = np.sqrt(level + ray[2] * ray[2]) / 4
        out[n, 8] = ray[0] / max(np.sqrt(level), 1e-6)
        out[n, 9] = ray[1] / max(np.sqrt(level), 1e-6)
    return out
