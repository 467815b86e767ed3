"""Where the camera is among the surfaces and images of the frames before.

A frame is aligned with a map of the hundred before it: generalised ICP against the Gaussians of
its cells (VGICP, Koide et al., ICRA 2021; the normal equations are small_gicp's, an optional
extra), from coarse cells to fine. It begins from the last motion, from rest and from turns to
either side, for hands turn a camera fast; the guess that leads nearest to the frame before is
taken. What moves is outvoted by what rests, unless it fills the image.

Along a wall or the floor the surfaces say nothing, but the rims of half-filled cells do, and they
lie. So a guess holds its place by a spring: weak against surfaces that face that way, strong
against rims, and nearly none with the finest cells.

Where there is colour, brightness tells what surfaces do not (`brightness`): the pose that surfaces
give is bettered by both together, and so is one that brightness finds alone. Of the three the one
is taken that leads near to the frame before, and looks like it. What is bettered looks like an
image of some time ago as well, so that errors from one image to the next do not add up.
"""

from __future__ import annotations

from dataclasses import dataclass
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from composenet.geometry.camera import back_project
from composenet.geometry.transform import (
    angle_between_deg,
    apply_T,
    inverse_T,
    make_T,
    rotation_z,
)
from composenet.gicp import small_gicp
from composenet.records import Camera, FloatArray
from composenet.sequences.brightness import LEVELS, Equations, LitPair, LitView, moved

_CELLS_M = (0.4, 0.2, 0.1)
_SPRINGS = (20.0, 5.0, 0.05)  # by cell size, 1/m^2 a partner; along its normal a surface has 500
_REACH_CELLS = 3.0  # a point this far from a cell's Gaussian has no partner
_ITERATIONS = 10
_DONE = 0.001  # a step of fewer metres and radians is the last one
_SPACING_M = 0.05  # between the points of a frame that are aligned
_NEIGHBOURS = 12
_FAR_M = 6.0  # depth beyond this is too noisy to align
_MIN_POINTS = 100
_MIN_CELLS = 10  # of a map; small_gicp aligns with no smaller one
_TURNS_DEG = (8.0, -8.0, 16.0, -16.0, 24.0, -24.0)  # about the vertical
_NEAR_M = 0.06
_GOOD_SHARE = 0.75  # of a frame's points near the frame before: no other guess is tried
_FAIR_SHARE = 0.6  # likewise where two guesses lead to the same pose
_SAME_M, _SAME_DEG = 0.01, 0.5
_LOST_SHARE = 0.3
_MAX_STEP_M, _MAX_TURN_DEG = 1.0, 45.0  # farther from one frame to the next no hand moves
_BETTER_SHARE = 0.03  # a later guess must lead that much nearer
_BRIGHTNESS = 8.0  # squared, of a pixel, against a squared metre of a partner; see `_bettered`
_ROUGH_BRIGHTNESS = 3.0  # the same where colour lies on the depth to some pixels only
_NOISY_M = 2.0  # beyond, a frame's surfaces are noisy and brightness weighs more
_LIT_SPRING = 0.1  # as above, while brightness leads
_LIKENESS = 0.2  # a share that e times the misfit weighs up
_MISFITS = (0.005, 0.15)  # beyond these nothing is told
_CLEARLY = 0.05  # so much more a pose by brightness alone must have
_EARLIER_M, _EARLIER_DEG, _EARLIER_MISFIT = 0.5, 30.0, 0.06  # beyond these an image places no other
_SURE_SHARE, _SURE_MISFIT = 0.5, 0.06  # of two frames that show the same
_SURE_BARE_SHARE = 0.7  # likewise without colour
_FAR_NEARER, _FAR_LIKER = 0.1, 0.7  # a share so much larger, a misfit so many times: far better


@dataclass(frozen=True)
class Shot:
    """A frame to be placed. cloud: of small_gicp, its points apart by `_SPACING_M`, with
    covariances; points: (P, 3), the same points; both in camera axes. lit: its image, None without
    colour."""

    cloud: Any
    points: NDArray[np.float64]
    lit: LitView | None

    @classmethod
    def taken(
        cls, depth_m: FloatArray, camera: Camera, color: NDArray[np.uint8] | None
    ) -> Shot | None:
        """Of images as `Odometry` takes them; None where too little is measured."""
        points = back_project(depth_m, camera)[(depth_m > 0) & (depth_m < _FAR_M)]
        if len(points) < _MIN_POINTS:
            return None
        cloud, _ = small_gicp().preprocess_points(
            points.astype(np.float64), _SPACING_M, num_neighbors=_NEIGHBOURS
        )
        points = cloud.points()[:, :3]
        if len(points) < _MIN_POINTS:
            return None
        lit = None
        if color is not None:
            lit = LitView(np.where(depth_m < _FAR_M, depth_m, 0), color, camera)
        return cls(cloud, points, lit)


@dataclass(frozen=True)
class PosedImage:
    """An image, and the camera's pose (4, 4) in the world."""

    lit: LitView
    T: NDArray[np.float64]

    def equations(self, now: LitView, T: FloatArray, level: int) -> Equations:
        """What it says of the pose of another image."""
        return LitPair(self.lit, now).equations(inverse_T(self.T) @ T, level)

    def misfit(self, now: LitView, T: FloatArray) -> float:
        """How unlike it another image is at that pose; infinite with too little in common."""
        return LitPair(self.lit, now).misfit(inverse_T(self.T) @ T)

    def guessed(self, now: LitView, T_guess: FloatArray) -> NDArray[np.float64]:
        """The pose of another image by brightness alone, from a guess."""
        return self.T @ LitPair(self.lit, now).guessed(inverse_T(self.T) @ T_guess)

    def shows(self, other: PosedImage) -> bool:
        """Whether it is near enough to another image, and like it, to place the next."""
        near = alike(other.T, self.T, _EARLIER_M, _EARLIER_DEG)
        return near and self.misfit(other.lit, other.T) < _EARLIER_MISFIT


class Surroundings:
    """The map of the frames before, and the images and the motion of the last. T: (4, 4), the
    camera's pose there."""

    def __init__(self, rough_color: bool) -> None:
        """rough_color: see `Odometry`. Raises ConfigError where small_gicp is not installed."""
        self.T: NDArray[np.float64] = np.eye(4)
        self._rough_color = rough_color
        self._maps = [small_gicp().GaussianVoxelMap(cell_m) for cell_m in _CELLS_M]
        self._motion: NDArray[np.float64] = np.eye(4)  # of the last frame, T_before_now
        self._before: cKDTree | None = None  # points of the last frame that was placed
        self._lit: PosedImage | None = None  # the last image with colour
        self._earlier: PosedImage | None = None  # one of some time ago

    @property
    def empty(self) -> bool:
        """Whether no frame was placed yet."""
        return self._before is None

    def add(self, shot: Shot, T: NDArray[np.float64]) -> None:
        """A frame that was placed; the next is sought from there."""
        self.remember(shot, T)
        self._motion = np.eye(4) if self.empty else inverse_T(self.T) @ T
        self.T = T
        self._before = cKDTree(apply_T(T, shot.points), balanced_tree=False, compact_nodes=False)
        if shot.lit is not None:
            self._lit = PosedImage(shot.lit, T)
            if not self._rough_color and (
                self._earlier is None or not self._earlier.shows(self._lit)
            ):
                self._earlier = self._lit

    def remember(self, shot: Shot, T: FloatArray) -> None:
        """A frame for the map alone."""
        for cells in self._maps:
            cells.insert(shot.cloud, T)

    def find(self, shot: Shot) -> NDArray[np.float64] | None:
        """The pose (4, 4) of the next frame; None where too little of it agrees with what was seen
        before. The motion until now is then forgotten, until a frame is added."""
        T = self._aligned(shot.cloud, shot.points)
        if shot.lit is not None and self._lit is not None:
            T = self._aligned_in_light(shot.cloud, shot.points, shot.lit, self._lit, T)
        self._motion = np.eye(4)
        return T

    def shows(self, shot: Shot, T: FloatArray) -> bool:
        """Whether a frame at that pose surely shows what the last one did."""
        near, misfit = self._agreement(shot, T)
        if misfit is None:
            return near > _SURE_BARE_SHARE
        return near > _SURE_SHARE and misfit < _SURE_MISFIT

    def prefers(self, shot: Shot, T: FloatArray, T_other: FloatArray) -> bool:
        """Whether a frame agrees with the last one far better at one pose than at another."""
        near, misfit = self._agreement(shot, T)
        other_near, other_misfit = self._agreement(shot, T_other)
        nearer = near > other_near + _FAR_NEARER
        if misfit is None or other_misfit is None:
            return nearer
        return misfit < _FAR_LIKER * other_misfit or (nearer and misfit < other_misfit)

    def _aligned(self, cloud: Any, points: FloatArray) -> NDArray[np.float64] | None:
        """The best guess's pose, if it is good enough."""
        best, share = self.T, _LOST_SHARE - _BETTER_SHARE
        poses: list[NDArray[np.float64]] = []
        for guess in (*self._carried_on(), *self._turned()):
            T = self._refined(cloud, guess)
            if not self._within_reach(T):
                continue
            near = self._near_share(apply_T(T, points))
            if near > share + _BETTER_SHARE:
                best, share = T, near
            again = any(alike(T, other, _SAME_M, _SAME_DEG) for other in poses)
            if share > _GOOD_SHARE or (share > _FAIR_SHARE and again):
                break
            poses.append(T)
        return best if share >= _LOST_SHARE else None

    def _carried_on(self) -> list[NDArray[np.float64]]:
        """Guesses: the last motion, if there was one, and rest."""
        moves = not np.array_equal(self._motion, np.eye(4))
        return [*([self.T @ self._motion] if moves else []), self.T]

    def _turned(self) -> list[NDArray[np.float64]]:
        R, t = self.T[:3, :3], self.T[:3, 3]
        return [make_T(rotation_z(angle) @ R, t) for angle in np.radians(_TURNS_DEG)]

    def _within_reach(self, T: FloatArray) -> bool:
        return alike(T, self.T, _MAX_STEP_M, _MAX_TURN_DEG)

    def _aligned_in_light(
        self,
        cloud: Any,
        points: FloatArray,
        lit: LitView,
        last: PosedImage,
        by_surface: NDArray[np.float64] | None,
    ) -> NDArray[np.float64] | None:
        """The best of the pose by surfaces, if there is one, that pose bettered by brightness, and
        one that was sought by brightness first. last: the last image with colour, as that of a slow
        camera several frames ago."""

        def worth(T: FloatArray) -> float:
            near = self._near_share(apply_T(T, points))
            if near < _LOST_SHARE or not self._within_reach(T):
                return -np.inf
            return near - _LIKENESS * float(np.log(np.clip(last.misfit(lit, T), *_MISFITS)))

        best, most = by_surface, -np.inf
        if by_surface is not None:
            both = (by_surface, self._bettered(cloud, lit, last, by_surface))
            most, best = max(((worth(T), T) for T in both), key=itemgetter(0))
        sure = best is not None and self._near_share(apply_T(best, points)) > _GOOD_SHARE
        guesses = self._carried_on() if sure else [*self._carried_on(), *self._turned()]
        by_light = [last.guessed(lit, guess) for guess in guesses]
        least, likest = min(((last.misfit(lit, T), T) for T in by_light), key=itemgetter(0))
        if np.isfinite(least):
            bettered = self._bettered(cloud, lit, last, likest)
            if worth(bettered) > most + _CLEARLY:
                best = bettered
        return best

    def _bettered(
        self, cloud: Any, lit: LitView, last: PosedImage, T_start: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """The pose after Gauss-Newton by the finest map and brightness, from small images on.
        Brightness weighs little, so that it moves the camera where surfaces let it, and more in a
        frame of far surfaces: the noise of depth cameras grows with its square."""
        weight = _ROUGH_BRIGHTNESS
        if not self._rough_color:
            far = max(1.0, float(np.median(cloud.points()[:, 2])) / _NOISY_M)
            weight = _BRIGHTNESS * far**2
        T = T_start
        for level in reversed(range(LEVELS)):
            for _ in range(_ITERATIONS):
                at_T = self._equations(-1, cloud, T)
                says = last.equations(lit, T, level)
                if at_T.num_inliers < _MIN_POINTS or not says.pixels:
                    break
                if self._earlier is not None and self._earlier is not last:
                    says += self._earlier.equations(lit, T, level)
                says = says.weighed(weight * at_T.num_inliers / says.pixels)
                step = _step(at_T, T, T_start, _LIT_SPRING, says)
                T = moved(T, step)
                if np.abs(step).max() < _DONE:
                    break
        return T

    def _equations(self, size: int, cloud: Any, T: FloatArray) -> Any:
        """small_gicp's normal equations at a pose, by the map of cells of that size."""
        return small_gicp().align(
            self._maps[size],
            cloud,
            init_T_target_source=T,
            max_correspondence_distance=_REACH_CELLS * _CELLS_M[size],
            max_iterations=1,
        )

    def _refined(self, cloud: Any, T_guess: NDArray[np.float64]) -> NDArray[np.float64]:
        """The pose after Gauss-Newton with each map, coarse to fine."""
        T = T_guess
        for size, spring in enumerate(_SPRINGS):
            if self._maps[size].size() < _MIN_CELLS:
                continue
            for _ in range(_ITERATIONS):
                at_T = self._equations(size, cloud, T)
                if at_T.num_inliers < _MIN_POINTS:
                    break
                step = _step(at_T, T, T_guess, spring)
                T = moved(T, step)
                if np.abs(step).max() < _DONE:
                    break
        return T

    def _agreement(self, shot: Shot, T: FloatArray) -> tuple[float, float | None]:
        """Of a frame at a pose and the last one: the share of its points near that one's, and how
        unlike the images are, infinite with too little in common, None where one has none."""
        near = self._near_share(apply_T(T, shot.points))
        if shot.lit is None or self._lit is None:
            return near, None
        return near, self._lit.misfit(shot.lit, T)

    def _near_share(self, points: FloatArray) -> float:
        assert self._before is not None
        distance_m, _ = self._before.query(points, distance_upper_bound=_NEAR_M)
        return float(np.isfinite(distance_m).mean())


def _step(
    at_T: Any, T: FloatArray, T_guess: FloatArray, spring: float, lit: Equations | None = None
) -> NDArray[np.float64]:
    """(6,) rotation vector and translation, in the camera's axes, that best fits the surfaces, the
    spring and brightness. at_T: small_gicp's normal equations at the pose T; lit: those of
    brightness, weighed against them."""
    stiffness = spring * at_T.num_inliers
    H, b = at_T.H.copy(), -at_T.b
    if lit is not None:
        H += lit.H
        b -= lit.b
    H[3:, 3:] += stiffness * np.eye(3)
    b[3:] += stiffness * T[:3, :3].T @ (T_guess[:3, 3] - T[:3, 3])
    return np.asarray(np.linalg.lstsq(H, b, rcond=None)[0])


def alike(T: FloatArray, other: FloatArray, metres: float, degrees: float) -> bool:
    """Whether two poses are not farther apart than that."""
    apart_m = np.linalg.norm(T[:3, 3] - other[:3, 3])
    return bool(apart_m <= metres and angle_between_deg(T[:3, :3], other[:3, :3]) <= degrees)
