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
_MOST = 200  # of 2 to 3 MB; beyond, the one that was not seen for longest is forgotten
_SMALL = (20, 15)  # pixels, across and down
_NEAREST_M = 0.3  # what is nearer looks as near
_ALIKE = 0.5  # correlation of small images
_AROUND_M, _AROUND_DEG, _AROUND = 1.0, 60.0, 8  # other keyframes whose surfaces help


@dataclass(eq=False)
class Keyframe:
    """number: of the frame. seen, asked: numbers of the last frame that agreed with it, and of the
    last that was compared with it. bent: moved with the way since, and not seen again."""

    number: int
    shot: Shot
    small: NDArray[np.float32]
    seen: int
    asked: int = -1
    bent: bool = False


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
            self.forget(min(self._keys, key=lambda key: key.seen))
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

    def forget(self, key: Keyframe) -> None:
        """Keep it no longer."""
        self._keys.remove(key)

    def around(self, key: Keyframe) -> Surroundings:
        """What it and the older ones near it have seen; the next frame is sought at its place."""
        place, T = Surroundings(self._rough_color), self.pose(key)
        older = [(other, self.pose(other)) for other in self._keys if other.number < key.number]
        older = [(other, pose) for other, pose in older if alike(pose, T, _AROUND_M, _AROUND_DEG)]
        older.sort(key=lambda one: float(np.linalg.norm(one[1][:3, 3] - T[:3, 3])))
        for other, pose in older[:_AROUND]:
            place.remember(other.shot, pose)
        place.add(key.shot, T)
        return place

    def length(self, since: int) -> tuple[float, float]:
        """Of the way from frame `since` to the last: metres and degrees of turns."""
        T = np.stack([T for T in self.poses[since:] if T is not None])
        if len(T) < 2:
            return 0.0, 0.0
        turns = Rotation.from_matrix(T[:-1, :3, :3]).inv() * Rotation.from_matrix(T[1:, :3, :3])
        steps_m = np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1)
        return float(steps_m.sum()), float(np.degrees(turns.magnitude()).sum())

    def bend(self, since: int, T_wrong: FloatArray, T_right: FloatArray) -> None:
        """Move the frames after number `since`, the more the later, so that the next one comes from
        T_wrong to T_right: every step turns by its part of the way, and what is left of the
        distance is shared alike."""
        until = len(self.poses)
        T_since = self.poses[since]
        assert T_since is not None
        known = [i for i in range(since + 1, until) if self.poses[i] is not None]
        poses = [T_since, *(self.poses[i] for i in known), T_wrong]
        t = np.stack([T[:3, 3] for T in poses if T is not None])
        parts = (np.array([since, *known, until]) - since) / (until - since)
        whole = Rotation.from_matrix(T_right[:3, :3] @ T_wrong[:3, :3].T).as_rotvec()
        turns = Rotation.from_rotvec(parts[:, None] * whole).as_matrix()
        steps = np.einsum("nij,nj->ni", turns[:-1], np.diff(t, axis=0))
        bent = t[0] + np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
        bent += parts[:, None] * (T_right[:3, 3] - bent[-1])
        for i, R, position in zip(known, turns[1:], bent[1:], strict=False):
            T = self.poses[i]
            assert T is not None
            self.poses[i] = make_T(R @ T[:3, :3], position)
        for key in self._keys:
            key.bent = key.bent or key.number > since
