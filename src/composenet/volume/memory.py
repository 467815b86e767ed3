"""What earlier frames saw and the present one does not contradict: surfaces, and empty space.

A camera that moves sees an object's sides one after the other. The surface voxels of the last
frames are kept in the world frame and given to the network beside the frame's own (the paper looks
at each frame alone). What the present frame sees is taken from it alone; only what it cannot see
is remembered: surfaces hidden behind others, outside the image, or on pixels without depth.
Whatever the camera sees through is forgotten, so that an object that moved leaves nothing behind
where one can look. Space that was seen to be empty is remembered in coarse cells until a surface is
seen there: where an object may reach, and where it cannot.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numba
import numpy as np
from numpy.typing import NDArray

from composenet.geometry.transform import apply_T, inverse_T

LOWEST_M = 0.08
"""The floor is not worth remembering: surfaces below this height are forgotten at once."""
HIGHEST_M = 2.2
"""Neither is the ceiling."""
FREE_CELL_M = 0.1
"""Edge of a cell of empty space."""
_WINDOW_CELLS = (160, 160, 22)  # around the camera, from the floor up
_NEVER = np.iinfo(np.int32).min


@dataclass(frozen=True)
class Surface:
    """M voxels of surface, in the world or in axes turned against it. points: (M, 3) mean point,
    metres. normals: (M, 3) unit or zero. counts: (M,) pixels. labels: (M,) int32 instance ids.
    seen: (M,) int64, the index of the frame that saw it last."""

    points: NDArray[np.float64]
    normals: NDArray[np.float32]
    counts: NDArray[np.float32]
    labels: NDArray[np.int32]
    seen: NDArray[np.int64]

    @staticmethod
    def nothing() -> Surface:
        """No voxel at all."""
        none = np.zeros((0, 3))
        empty = np.zeros(0, np.int32)
        return Surface(
            none, none.astype(np.float32), empty.astype(np.float32), empty, empty.astype(np.int64)
        )

    def __len__(self) -> int:
        return len(self.points)

    def __getitem__(self, wanted: NDArray[np.bool_]) -> Surface:
        """Some of the voxels."""
        rows = np.flatnonzero(wanted)  # once for all, and copied whole: a third of the time
        return Surface(*(value.take(rows, axis=0) for value in vars(self).values()))

    def turned(self, R: NDArray[np.float64]) -> Surface:
        """The same surface with other axes: p -> R p."""
        normals = (self.normals @ R.T).astype(np.float32)
        return replace(self, points=self.points @ R.T, normals=normals)

    def __add__(self, other: Surface) -> Surface:
        """Both, one after the other."""
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return Surface(*(np.concatenate(pair) for pair in pairs))


@dataclass(frozen=True)
class FreeSpace:
    """Space seen to be empty. cells: (X, Y, Z) bool, of edge FREE_CELL_M. low: (3,) corner of the
    first cell, metres, in the world or in axes turned against it by quarters."""

    cells: NDArray[np.bool_]
    low: NDArray[np.float64]

    @staticmethod
    def nothing() -> FreeSpace:
        """No cell at all."""
        return FreeSpace(np.zeros((0, 0, 0), np.bool_), np.zeros(3))

    def turned(self, R: NDArray[np.float64]) -> FreeSpace:
        """The same space with other axes: p -> R p. R: a quarter turn about z."""
        order = np.abs(R).argmax(axis=1)
        back = tuple(np.flatnonzero(R[np.arange(3), order] < 0).tolist())
        ends = np.stack([self.low, self.low + FREE_CELL_M * np.array(self.cells.shape)]) @ R.T
        return FreeSpace(np.flip(self.cells.transpose(order), back), ends.min(axis=0))

    def within(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> FreeSpace:
        """The part of it whose cells touch a box."""
        first = np.floor((low - self.low) / FREE_CELL_M).astype(int)
        last = np.ceil((high - self.low) / FREE_CELL_M).astype(int)
        first, last = (np.clip(cell, 0, self.cells.shape) for cell in (first, last))
        part = self.cells[tuple(map(slice, first, np.maximum(first, last)))]
        return FreeSpace(np.ascontiguousarray(part), self.low + FREE_CELL_M * first)


class Memory:
    """The remembered surface and empty space of one recording."""

    def __init__(self, frames: int) -> None:
        """frames: what no frame has seen for longer than this is forgotten."""
        self.frames = frames
        self._surface = Surface.nothing()
        self._emptied = np.full(_WINDOW_CELLS, _NEVER, np.int32)  # the frame that saw it last
        self._corner = np.zeros(3, np.int64)  # the window's first cell, counted from the world's

    def recall(
        self,
        index: int,
        depth_m: NDArray[np.float32],
        K: NDArray[np.float64],
        T_world_camera: NDArray[np.float64],
    ) -> Surface:
        """Forget what frame `index` contradicts or sees anew, and give the rest.

        depth_m: (H, W), 0 where unknown.
        """
        kept = self._surface
        kept = kept[np.abs(index - kept.seen) <= self.frames]
        self._surface = kept[_hidden(kept.points, depth_m, K, T_world_camera)]
        return self._surface

    @property
    def surface(self) -> Surface:
        """What is remembered now, world frame."""
        return self._surface

    def remember(self, surface: Surface) -> None:
        """Keep what was recalled and what the frame saw, world frame. No voxel twice."""
        height = surface.points[:, 2]
        self._surface = surface[(height > LOWEST_M) & (height < HIGHEST_M)]

    def see_through(
        self,
        index: int,
        depth_m: NDArray[np.float32],
        K: NDArray[np.float64],
        T_world_camera: NDArray[np.float64],
    ) -> None:
        """Keep which space around the camera frame `index` sees to be empty."""
        self._move_window(T_world_camera[:3, 3])
        _empty(self._emptied, self._low, depth_m, K, inverse_T(T_world_camera), index)

    def free_space(self, index: int) -> FreeSpace:
        """Space around the camera of the last frame, `index`, that it or one before it saw to be
        empty, and where none has seen a surface since; world frame."""
        return FreeSpace(_not_older(self._emptied, index, self.frames), self._low)

    @property
    def _low(self) -> NDArray[np.float64]:
        """(3,) corner of the window, metres."""
        return FREE_CELL_M * self._corner.astype(np.float64)

    def _move_window(self, eye: NDArray[np.float64]) -> None:
        """Such that the camera is in its middle; what falls out is forgotten."""
        corner = np.round(eye / FREE_CELL_M).astype(np.int64) - np.array(_WINDOW_CELLS) // 2
        corner[2] = 0
        shift = corner - self._corner
        if not shift.any():
            return
        moved, size = np.full(_WINDOW_CELLS, _NEVER, np.int32), np.array(_WINDOW_CELLS)
        if (np.abs(shift) < size).all():
            to = tuple(map(slice, np.maximum(-shift, 0), size - np.maximum(shift, 0)))
            of = tuple(map(slice, np.maximum(shift, 0), size - np.maximum(-shift, 0)))
            moved[to] = self._emptied[of]
        self._emptied, self._corner = moved, corner


@numba.njit(cache=True, nogil=True)
def _empty(emptied, low, depth_m, K, T_camera_world, index):
    """Mark, in place, the cells whose centre frame `index` sees through, and unmark those on the
    surface it sees; the rest stays. By more, and less, than half a cell and the noise of depth."""
    height, width = depth_m.shape
    nx, ny, nz = emptied.shape
    T = T_camera_world
    us, vs, zs = np.empty(nz), np.empty(nz), np.empty(nz)
    for i in range(nx):
        for j in range(ny):
            a = low[0] + (i + 0.5) * FREE_CELL_M
            b = low[1] + (j + 0.5) * FREE_CELL_M
            if _out_of_view(a, b, low[2], low[2] + nz * FREE_CELL_M, height, width, K, T):
                continue
            for k in range(nz):  # no branch within, so that several go at once
                c = low[2] + (k + 0.5) * FREE_CELL_M
                x = T[0, 0] * a + T[0, 1] * b + T[0, 2] * c + T[0, 3]
                y = T[1, 0] * a + T[1, 1] * b + T[1, 2] * c + T[1, 3]
                zs[k] = T[2, 0] * a + T[2, 1] * b + T[2, 2] * c + T[2, 3]
                safe_z = zs[k] if zs[k] > 0.1 else 1.0
                us[k] = np.floor(K[0, 0] * x / safe_z + K[0, 2] + 0.5)
                vs[k] = np.floor(K[1, 1] * y / safe_z + K[1, 2] + 0.5)
            for k in range(nz):
                u, v, z = us[k], vs[k], zs[k]
                if z <= 0.1 or u < 0 or v < 0 or u >= width or v >= height:
                    continue
                measured = depth_m[int(v), int(u)]
                if measured <= 0:
                    continue
                gap = FREE_CELL_M / 2 + 0.03 + 0.01 * measured * measured
                if z < measured - gap:
                    emptied[i, j, k] = index
                elif z <= measured + gap:
                    emptied[i, j, k] = _NEVER


@numba.njit(cache=True, nogil=True)
def _out_of_view(a, b, lowest, highest, height, width, K, T):
    """Whether the whole vertical line at (a, b) is behind the camera or beyond one border of its
    image: as both of its ends are, for each of these is a plane."""
    behind = left = right = above = below = True
    for c in (lowest, highest):
        x = T[0, 0] * a + T[0, 1] * b + T[0, 2] * c + T[0, 3]
        y = T[1, 0] * a + T[1, 1] * b + T[1, 2] * c + T[1, 3]
        z = T[2, 0] * a + T[2, 1] * b + T[2, 2] * c + T[2, 3]
        u = K[0, 0] * x + (K[0, 2] + 0.5) * z  # z times the pixel's
        v = K[1, 1] * y + (K[1, 2] + 0.5) * z
        behind &= z <= 0.1
        left &= u < 0
        right &= u > width * z
        above &= v < 0
        below &= v > height * z
    return behind | left | right | above | below


@numba.njit(cache=True, nogil=True)
def _not_older(emptied, index, frames):
    """Bool like emptied: marked, and at most so many frames from `index`."""
    known = np.empty(emptied.size, np.bool_)
    first, last = np.int32(max(index - frames, _NEVER + 1)), np.int32(index + frames)
    when = emptied.ravel()
    for cell in range(len(when)):
        known[cell] = (when[cell] >= first) & (when[cell] <= last)
    return known.reshape(emptied.shape)


def _hidden(
    points: NDArray[np.float64],
    depth_m: NDArray[np.float32],
    K: NDArray[np.float64],
    T_world_camera: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """(M,) bool: outside the image, on a pixel without depth, or behind the surface seen there by
    more than the noise of depth."""
    x, y, z = apply_T(inverse_T(T_world_camera), points).T
    height, width = depth_m.shape
    ahead = z > 0.1
    safe_z = np.where(ahead, z, 1.0)
    u = np.round(K[0, 0] * x / safe_z + K[0, 2])
    v = np.round(K[1, 1] * y / safe_z + K[1, 2])
    inside = ahead & (u >= 0) & (u < width) & (v >= 0) & (v < height)
    measured = np.zeros(len(points))
    measured[inside] = depth_m[v[inside].astype(int), u[inside].astype(int)]
    return (measured <= 0) | (z > measured + 0.06 + 0.01 * measured**2)
