"""What earlier frames saw and the present one does not contradict.

A camera that moves sees an object's sides one after the other. The surface voxels of the last
frames are kept in the world frame and given to the network beside the frame's own (the paper looks
at each frame alone). What the present frame sees is taken from it alone; only what it cannot see
is remembered: surfaces hidden behind others, outside the image, or on pixels without depth.
Whatever the camera sees through is forgotten, so that an object that moved leaves nothing behind
where one can look.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from composenet.geometry.transform import apply_T, inverse_T

LOWEST_M = 0.08
"""The floor is not worth remembering: surfaces below this height are forgotten at once."""
HIGHEST_M = 2.2
"""Neither is the ceiling."""


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

    def __getitem__(self, rows: NDArray) -> Surface:
        """Some of the voxels."""
        return Surface(*(value[rows] for value in vars(self).values()))

    def turned(self, R: NDArray[np.float64]) -> Surface:
        """The same surface with other axes: p -> R p."""
        normals = (self.normals @ R.T).astype(np.float32)
        return replace(self, points=self.points @ R.T, normals=normals)

    def __add__(self, other: Surface) -> Surface:
        """Both, one after the other."""
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return Surface(*(np.concatenate(pair) for pair in pairs))


class SurfaceMemory:
    """The remembered surface of one recording."""

    def __init__(self, frames: int) -> None:
        """frames: what no frame has seen for longer than this is forgotten."""
        self.frames = frames
        self._surface = Surface.nothing()

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

    def remember(self, surface: Surface) -> None:
        """Keep what was recalled and what the frame saw, world frame. No voxel twice."""
        height = surface.points[:, 2]
        self._surface = surface[(height > LOWEST_M) & (height < HIGHEST_M)]


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
