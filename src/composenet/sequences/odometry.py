"""The camera's way from its images, for recordings without poses.

Each frame is placed among those before it (`surroundings`). Errors add up, a frame slips now and
then, and a camera that was covered is lost. So frames that differ are kept (`keyframes`), and where
the present one looks like one of long ago it is placed by that, too. If two frames in a row agree
that the camera is elsewhere, it goes on from there, and the way since then is bent to end there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from composenet.geometry.transform import inverse_T
from composenet.records import Camera, FloatArray, usable_color, usable_depth
from composenet.sequences.keyframes import Keyframe, Way, small_image
from composenet.sequences.leveling import CameraLeveler, surface_of
from composenet.sequences.surroundings import Shot, Surroundings, alike

_EVERY = 3  # frames: so often one is compared with a keyframe
_UNSEEN = 10  # frames: one that was seen since says nothing new
_LIKE, _TRIED = 4, 2  # keyframes that a frame is most like; those tried where it is lost
_SAME_M, _SAME_DEG = 0.03, 1.5  # nearer poses are the same
_AGREE_M, _AGREE_DEG = 0.05, 2.0  # likewise of two frames' corrections
_STEP_M, _STEP_DEG = 0.3, 30.0  # from one frame to the next
_DRIFT, _DRIFT_BY_TURNS_M = 0.15, 0.002  # at most, of metres or degrees, and by a degree of turns
_SLACK_M, _SLACK_DEG = 0.1, 3.0  # that it may drift besides


@dataclass(frozen=True)
class _Return:
    """A frame at a place where the camera seems to be again. key: seen there, surroundings: its
    own; since: number of the last frame that agreed with it or an older one. T_there, T_here: (4,
    4), the frame's pose by them, and as it was found, None where the camera was lost."""

    key: Keyframe
    surroundings: Surroundings
    since: int
    shot: Shot
    T_there: NDArray[np.float64]
    T_here: NDArray[np.float64] | None

    def confirmed(self, shot: Shot, T_here: FloatArray | None) -> NDArray[np.float64] | None:
        """The next frame's pose, if it shows the place, too, and is corrected alike, or is near the
        first where both were lost. T_here: as it was found."""
        T_there = _sure_pose(self.surroundings, shot)
        if T_there is None or (T_here is None) != (self.T_here is None):
            return None
        if T_here is None or self.T_here is None:
            return T_there if alike(self.T_there, T_there, _STEP_M, _STEP_DEG) else None
        expected = self.T_there @ inverse_T(self.T_here) @ T_here
        agrees = alike(expected, T_there, _AGREE_M, _AGREE_DEG)
        return T_there if agrees and self.surroundings.prefers(shot, T_there, T_here) else None


def _sure_pose(place: Surroundings, shot: Shot) -> NDArray[np.float64] | None:
    T = place.find(shot)
    return T if T is not None and place.shows(shot, T) else None


class Odometry:
    """Camera poses of one recording or live camera, frame by frame.

    >>> odometry = Odometry()
    >>> T_world_camera = odometry(depth_m, camera, color)
    """

    def __init__(self, rough_color: bool = False) -> None:
        """rough_color: colour lies on the depth images to some pixels only, so that it counts for
        less, and no image of some time ago betters the last one. Raises ConfigError where
        small_gicp is not installed."""
        self._here = Surroundings(rough_color)
        self._way = Way(rough_color)
        self._return: _Return | None = None

    def __call__(
        self, depth_m: FloatArray, camera: Camera, color: NDArray[np.uint8] | None = None
    ) -> NDArray[np.float64] | None:
        """`T_world_camera` (4, 4) of the next frame by this one and those before; None where too
        little of it agrees with what was seen. The world is levelled as the first frame shows it: z
        up, the floor it sees at z = 0. depth_m: (H, W) metres, 0 where unknown, or where a moving
        thing should not be trusted. color: (H, W, 3) uint8, RGB, registered to the depth, black
        where it is not known, for what surfaces do not tell. Raises SequenceError where they are
        not such images of the camera."""
        depth_m = usable_depth("odometry", depth_m, camera)
        if color is not None:
            color = usable_color("odometry", color, camera)
        T, shot = None, Shot.taken(depth_m, camera, color)
        if shot is not None:
            small = small_image(depth_m, color)
            if self._here.empty:
                _, T = CameraLeveler().level(surface_of(depth_m, camera))
            else:
                T = self._corrected(shot, small, self._here.find(shot))
        else:
            self._return = None
        if shot is None or T is None:
            self._way.lose()
            return None
        self._here.add(shot, T)
        self._way.add(shot, small, T)
        return T.copy()

    def way(self) -> list[NDArray[np.float64] | None]:
        """The poses of all frames so far, as those after them have corrected them; None where the
        camera was lost."""
        return [None if T is None else T.copy() for T in self._way.poses]

    def _corrected(
        self, shot: Shot, small: NDArray[np.float32], T: NDArray[np.float64] | None
    ) -> NDArray[np.float64] | None:
        """The frame's pose by keyframes where they correct it, else T, as it was found."""
        back, self._return = self._return, None
        T_there = None if back is None else back.confirmed(shot, T)
        if back is not None and T_there is not None:
            now = len(self._way.poses)
            if T is not None:
                self._way.bend(back.since, T, T_there)
            back.surroundings.add(back.shot, back.T_there)
            self._here, back.key.seen = back.surroundings, now
            return T_there
        if T is None:
            self._return = self._found(shot, small)
        elif len(self._way.poses) % _EVERY == 0:
            self._return = self._seen_again(shot, small, T)
        return T

    def _found(self, shot: Shot, small: NDArray[np.float32]) -> _Return | None:
        """Where a keyframe says that the lost camera is."""
        for key in self._way.likest(small, _TRIED):
            place = self._way.around(key)
            T_there = _sure_pose(place, shot)
            if T_there is not None:
                return _Return(key, place, self._way.last_seen(key), shot, T_there, None)
        return None

    def _seen_again(
        self, shot: Shot, small: NDArray[np.float32], T: NDArray[np.float64]
    ) -> _Return | None:
        """Where the oldest keyframe that is like the frame says that the camera is, if that is not
        where it was found, and no farther from there than it may have drifted."""
        now = len(self._way.poses)
        keys = [key for key in self._way.likest(small, _LIKE) if now - key.asked >= _UNSEEN]
        key = min(keys, key=lambda key: key.number, default=None)
        if key is None or now - (since := self._way.last_seen(key)) < _UNSEEN:
            return None
        place, key.asked = self._way.around(key), now
        T_there = _sure_pose(place, shot)
        if T_there is None:
            return None
        if alike(T_there, T, _SAME_M, _SAME_DEG):
            key.seen, key.bent = now, False
            return None
        if key.bent:  # not far enough, or too far
            self._way.forget(key)
            return None
        metres, degrees = self._way.length(since)
        reach_m = _SLACK_M + _DRIFT * metres + _DRIFT_BY_TURNS_M * degrees
        drifted = alike(T_there, T, reach_m, _SLACK_DEG + _DRIFT * degrees)
        if not (drifted and place.prefers(shot, T_there, T)):
            return None
        return _Return(key, place, since, shot, T_there, T)
