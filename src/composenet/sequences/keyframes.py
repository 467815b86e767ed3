"""Frames of the whole way by which a camera that comes back, or was lost, finds its place again.

A small image of depth and brightness tells which of them the present frame is most like (as in
Klein and Murray, ECCV 2008); surfaces and brightness then place it among those (`surroundings`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation

from composenet.geometry.photometric import brightness
from composenet.geometry.transform import make_T
from composenet.records import FloatArray
from composenet.sequences.surroundings import Shot, Surroundings, alike

_APART_M, _APART_DEG = 0.3, 15.0  # a keyframe so far from all others
_MOST = 300  # of them; beyond, the one that was not seen for longest is forgotten
_SMALL = (20, 15)  # pixels, across and down
_NEAREST_M = 0.3  # what is nearer looks as near
_ALIKE = 0.5  # correlation of small images
_AROUND_M, _AROUND_DEG = 1.0, 60.0  # other keyframes whose surfaces help


@dataclass
class Keyframe:
    """number: of the frame. seen: number of the last frame that agreed with it."""

    number: int
    shot: Shot
    small: NDArray[np.float32]
    seen: int


def small_image(depth_m: FloatArray, color: NDArray[np.uint8] | None) -> NDArray[np.float32]:
    """(2, 300) of inverse depth and brightness, each of mean 0 and length 1, or all 0 where it is
    the same everywhere, as brightness is without colour."""
    near = np.where(depth_m > 0, 1 / np.maximum(depth_m, _NEAREST_M), 0)
    light = np.zeros_like(near) if color is None else brightness(color)
    small = np.stack([_shrunk(near), _shrunk(light)])
    small -= small.mean(axis=1, keepdims=True)
    length = np.linalg.norm(small, axis=1, keepdims=True)
    return np.asarray(np.where(length > 1e-3, small / np.maximum(length, 1e-3), 0), np.float32)


def _likeness(small: NDArray[np.float32], other: NDArray[np.float32]) -> float:
    """The mean correlation of what both have; -1 where that is nothing."""
    both = small.any(axis=1) & other.any(axis=1)
    return float((small * other)[both].sum()) / both.sum() if both.any() else -1.0


def _shrunk(image: FloatArray) -> FloatArray:
    whole = Image.fromarray(np.asarray(image, np.float32))
    return np.asarray(whole.resize(_SMALL, Image.Resampling.BOX)).ravel()


class Way:
    """The camera's poses so far, and the keyframes among them. Frames are numbered as they come."""

    def __init__(self, rough_color: bool) -> None:
        """rough_color: see `Odometry`."""
        self.poses: list[NDArray[np.float64] | None] = []
        self._rough_color = rough_color
        self._keys: list[Keyframe] = []

    def add(self, shot: Shot, small: NDArray[np.float32], T: NDArray[np.float64]) -> None:
        """The next frame; a keyframe, unless there is one near it."""
        number = len(self.poses)
        self.poses.append(T)
        if any(alike(T, self.pose(key), _APART_M, _APART_DEG) for key in self._keys):
            return
        if len(self._keys) >= _MOST:
            self._keys.remove(min(self._keys, key=lambda key: key.seen))
        self._keys.append(Keyframe(number, shot, small, number))

    def lose(self) -> None:
        """The next frame, where it is not known."""
        self.poses.append(None)

    def pose(self, key: Keyframe) -> NDArray[np.float64]:
        """`T_world_camera` (4, 4)."""
        T = self.poses[key.number]
        assert T is not None
        return T

    def likest(self, small: NDArray[np.float32], count: int) -> list[Keyframe]:
        """Those that the frame is most like, best first."""
        likeness = [_likeness(key.small, small) for key in self._keys]
        order = np.argsort(likeness)[::-1][:count]
        return [self._keys[i] for i in order if likeness[i] > _ALIKE]

    def last_seen(self, key: Keyframe) -> int:
        """Number of the last frame that agreed with it or an older one."""
        return max(other.seen for other in self._keys if other.number <= key.number)

    def around(self, key: Keyframe) -> Surroundings:
        """What it and the older ones near it have seen; the next frame is sought at its place."""
        place, T = Surroundings(self._rough_color), self.pose(key)
        for other in self._keys[: self._keys.index(key)]:
            if alike(self.pose(other), T, _AROUND_M, _AROUND_DEG):
                place.remember(other.shot, self.pose(other))
        place.add(key.shot, T)
        return place

    def bend(self, since: int, T_wrong: FloatArray, T_right: FloatArray) -> None:
        """Move the frames after the one of that number, the more the later, so that a next one at
        T_wrong would be at T_right."""
        turn = Rotation.from_matrix(T_right[:3, :3] @ T_wrong[:3, :3].T).as_rotvec()
        center, shift = T_wrong[:3, 3], T_right[:3, 3] - T_wrong[:3, 3]
        for number in range(since + 1, len(self.poses)):
            T = self.poses[number]
            if T is not None:
                part = (number - since) / (len(self.poses) - since)
                R = Rotation.from_rotvec(part * turn).as_matrix()
                t = center + part * shift + R @ (T[:3, 3] - center)
                self.poses[number] = make_T(R @ T[:3, :3], t)
