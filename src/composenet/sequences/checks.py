"""Doubts about a recording: errors where nothing can be done, notes where a user should look."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from composenet.errors import SequenceError
from composenet.geometry.camera import back_project, project
from composenet.geometry.transform import apply_T, make_T
from composenet.records import Camera, FloatArray, Frame
from composenet.sequences.leveling import surface_of
from composenet.sequences.source import Source, SourceFrame

_POSSIBLE_MEDIAN_M = (0.1, 30.0)
_USUAL_MEDIAN_M = (0.4, 8.0)
_COMMON_SCALES = (1000.0, 5000.0, 4000.0, 10000.0, 256.0, 100.0, 1.0)
_MAX_STEP_M = 5.0
MAX_SPAN_M = 1000.0
_USUAL_MISFIT_M = 0.03
_NEAR_M = 0.1
_SHARED = 0.3  # of the points of one frame, those that another must see, too
_ROOM_M = (-0.15, 3.2)  # where the things of a room are, above its floor
_BELOW_SHARE, _ABOVE_SHARE = 0.1, 0.4  # of a frame's points; less is a reflection, or a high hall
_DOUBTFUL_FRAMES, _JUDGED_FRAMES = 5, 20  # at least so many, of at most so many last ones
_JUDGED_LATER = 4  # then every so many frames
_LEVEL = float(np.cos(np.radians(15)))
_MIN_LEVEL_SHARE = 0.001  # of what is seen; by wrong axes little lies level
_ELSEWHERE = (
    ", where nothing is looked for: the world must have z up and its floor at z = 0 "
    "(composenet.level_camera gives a live camera such a pose; a recording may want "
    "gravity-direction.txt or another --depth-scale)"
)
_BELOW = f"part of what is seen lies below the floor{_ELSEWHERE}"
_ABOVE = f"much of what is seen lies above 3 m{_ELSEWHERE}"
_AXES = (
    "what lies level faces down: the world must have z up, the camera x right, y down, z forward "
    "(a world that begins as the first camera's axes has not: composenet.level_camera turns it; "
    "from OpenGL or ARKit take T @ diag(1, -1, -1, 1); a camera that sees ceilings alone is right)"
)
_PANNED = 0.02  # mean directions lose so much of their length in turns of about 11 degrees
_IN_MILLIMETRES = "are the poses in millimetres? Metres are expected"


def check_camera(source: Source, K: FloatArray | None, width: int, height: int) -> Camera:
    """The camera of the depth images. Raises SequenceError when K is missing or impossible."""
    if K is None:
        raise SequenceError(
            f"{source.path}: no intrinsics ({source.intrinsics_file} expected); --intrinsics "
            f"fx,fy,cx,cy gives them, in pixels of the {width}x{height} depth images"
        )
    try:
        return Camera(K, width, height)
    except SequenceError:
        fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
        raise SequenceError(
            f"{source.path}: intrinsics fx {fx:g} fy {fy:g} cx {cx:g} cy {cy:g} cannot belong to "
            f"{width}x{height} depth images; check {source.intrinsics_file} or --intrinsics"
        ) from None


def camera_notes(camera: Camera) -> list[str]:
    """A note when the principal point is far from the image's middle."""
    cx, cy = camera.K[0, 2], camera.K[1, 2]
    off = max(abs(cx / camera.width - 0.5), abs(cy / camera.height - 0.5))
    if off < 0.1:
        return []
    return [
        f"principal point ({cx:.1f}, {cy:.1f}) is far from the middle of the "
        f"{camera.width}x{camera.height} depth images: are the intrinsics of another image size?"
    ]


def check_depth(path: Path, samples: Mapping[int, FloatArray], scale: float) -> list[str]:
    """A note when the median depth is unusual for a room.

    samples: depth images in metres by the given scale, 0 invalid. Raises SequenceError when no
    room could have such depth.
    """
    median_m = float(np.median(np.concatenate([d[d > 0] for d in samples.values()])))
    low, high = _USUAL_MEDIAN_M
    if low <= median_m <= high:
        return []
    raw = median_m * scale
    meant = next((s for s in _COMMON_SCALES if low <= raw / s <= high and s != scale), None)
    text = f"median depth {_metres(median_m)}"
    text += f": is depth_scale {meant:g} meant?" if meant else " is unusual for a room"
    text += f" (depth_scale is {scale:g} units a metre; --depth-scale sets it)"
    if not _POSSIBLE_MEDIAN_M[0] <= median_m <= _POSSIBLE_MEDIAN_M[1]:
        raise SequenceError(f"{path}: {text}")
    return [text]


def lost_cameras(path: Path, frames: Sequence[SourceFrame]) -> list[SourceFrame]:
    """Frames whose camera is over 1 km from the others' median; none without poses.

    Raises SequenceError when that is 30 % of them or more: no room is that large.
    """
    centers = _centers(frames)
    if not len(centers):
        return []
    far_m = np.abs(centers - np.median(centers, axis=0)).max(axis=1)
    lost = far_m > MAX_SPAN_M
    if lost.mean() >= 0.3:
        raise SequenceError(f"{path}: the camera travels {_metres(far_m.max())}: {_IN_MILLIMETRES}")
    return [frame for frame, is_lost in zip(frames, lost, strict=True) if is_lost]


def nearer(camera_centers: FloatArray) -> tuple[NDArray[np.float64], list[str]]:
    """(4, 4) the shift that brings cameras near the origin along the axes along which they are over
    1 km from it, as with a map's coordinates, which single precision cannot tell apart. And a note
    of it.

    camera_centers: (N, 3), the recording's own world.
    """
    middle = np.round(np.median(camera_centers, axis=0))
    middle[np.abs(middle) <= MAX_SPAN_M] = 0
    if not middle.any():
        return np.eye(4), []
    x, y, z = middle
    note = f"the world's origin was moved to the cameras, by ({x:.0f}, {y:.0f}, {z:.0f}) m"
    return make_T(np.eye(3), -middle), [note]


def check_steps(path: Path, frames: Sequence[SourceFrame]) -> list[str]:
    """A note on a camera that jumps; nothing without poses.

    Raises SequenceError when its median step is over 5 m.
    """
    steps_m = np.linalg.norm(np.diff(_centers(frames), axis=0), axis=1)
    if not len(steps_m):
        return []
    step_m, jumps = float(np.median(steps_m)), int((steps_m > _MAX_STEP_M).sum())
    if step_m > _MAX_STEP_M:
        raise SequenceError(
            f"{path}: the camera moves {_metres(step_m)} a frame: {_IN_MILLIMETRES}"
        )
    return [f"jumps of the camera over {_MAX_STEP_M:g} m between frames: {jumps}"] * (jumps > 0)


def pose_notes(
    pairs: Iterable[tuple[FloatArray, FloatArray, FloatArray]], camera: Camera
) -> list[str]:
    """A note when the depth of frames does not fit later ones five times better by the poses than
    without any motion, and not to 3 cm.

    pairs: depth of a frame and of a later one, (H, W) metres, and T_later_earlier, (4, 4).
    """
    errors = [
        (moved, still)
        for earlier, later, T in pairs
        if (moved := _misfit_m(earlier, later, T, camera)) is not None
        and (still := _misfit_m(earlier, later, np.eye(4), camera)) is not None
    ]
    if not errors:
        return []
    moved_m, still_m = np.median(errors, axis=0)
    if moved_m <= max(_USUAL_MISFIT_M, still_m / 5):
        return []
    return [
        f"by the camera poses depth images fit each other badly (off by {100 * moved_m:.0f} cm; if "
        f"the camera stood still, by {100 * still_m:.0f} cm): are the poses camera to world, in "
        "metres, with x right, y down, z forward?"
    ]


def _misfit_m(
    earlier: FloatArray, later: FloatArray, T_later_earlier: FloatArray, camera: Camera
) -> float | None:
    """Median difference between the later depth and the earlier one's points seen from there;
    None where they see too little in common."""
    points = back_project(earlier, camera)[::4, ::4].reshape(-1, 3)
    points = points[points[:, 2] > 0]
    moved = apply_T(T_later_earlier, points)
    moved = moved[moved[:, 2] > _NEAR_M]
    columns, rows = np.rint(project(moved, camera)).astype(int).T
    inside = (columns >= 0) & (columns < camera.width) & (rows >= 0) & (rows < camera.height)
    measured = later[rows[inside], columns[inside]]
    differences = np.abs(measured - moved[inside, 2])[measured > 0]
    if len(differences) < max(_SHARED * len(points), 1):
        return None
    return float(np.median(differences))


def _centers(frames: Sequence[SourceFrame]) -> FloatArray:
    """(N, 3) camera centres; empty without poses."""
    centers = [f.T_source_camera[:3, 3] for f in frames if f.T_source_camera is not None]
    return np.array(centers).reshape(-1, 3)


def may_stand_on(height_m: float) -> bool:
    """Whether a camera so high above a plane may have it for a floor."""
    return 0.25 <= height_m <= 4


def floor_notes(camera_centers: FloatArray, gravity_known: bool) -> list[str]:
    """A note when the lowest plane is implausibly close under the camera, or above it.

    camera_centers: (N, 3), levelled world with the supposed floor at z = 0.
    """
    height_m = float(np.median(camera_centers[:, 2]))
    if may_stand_on(height_m):
        return []
    upright = (
        "" if gravity_known else "the images may not be upright (gravity-direction.txt helps), "
    )
    return [
        f"the camera is {_metres(height_m)} above the lowest plane seen: the floor may not have "
        f"been in view, {upright}or the scale of poses and depth differ"
    ]


def upright_notes(T_world_camera: FloatArray) -> list[str]:
    """A note when a camera turned as one does that is held sideways and panned: about an axis that
    runs across its images. Where the world came from what it sees, a wall was then taken for the
    floor.

    T_world_camera: (N, 4, 4), poses in any world.
    """
    steadiness = np.linalg.norm(T_world_camera[:, :3, :2].mean(axis=0), axis=0)
    across, down = 1 - steadiness  # of the images' axes; 0: it never turned away
    if down < _PANNED or across > down / 2:
        return []
    return [
        "the camera turned about an axis across its images, as one that is held sideways does when "
        "it looks round; if it was, the floor was sought in vain: turn images and intrinsics "
        "upright, or write gravity-direction.txt (of no use with --odometry); if it only nodded, "
        "all is well"
    ]


def _metres(value: float) -> str:
    return f"{value:,.0f} m" if abs(value) >= 100 else f"{value:.2g} m"


class WorldCheck:
    """Whether frames have the world that the tracker expects: z up, its floor at z = 0. Where most
    of the last ones do not, little is found in them."""

    def __init__(self) -> None:
        self._doubts: deque[str] = deque(maxlen=_JUDGED_FRAMES)
        self._frames, self._said = 0, False

    def __call__(self, frame: Frame) -> str | None:
        """What to tell the user after this frame; once at most. Of a long recording not every frame
        is judged."""
        self._frames += 1
        full = len(self._doubts) == _JUDGED_FRAMES
        if self._said or (full and self._frames % _JUDGED_LATER):
            return None
        if (doubt := _doubt(frame)) is None:
            return None
        self._doubts.append(doubt)
        doubtful = [text for text in self._doubts if text]
        if len(doubtful) <= max(_DOUBTFUL_FRAMES - 1, len(self._doubts) / 2):
            return None
        self._said = True
        often = max(doubtful, key=doubtful.count)
        return f"in {doubtful.count(often)} of {len(self._doubts)} frames {often}"


def _doubt(frame: Frame) -> str | None:
    """What speaks against a frame's world, if anything does; None where it shows nothing."""
    points = back_project(frame.depth_m, frame.camera)[::8, ::8].reshape(-1, 3)
    heights = apply_T(frame.T_world_camera, points[points[:, 2] > 0])[:, 2]
    if not len(heights):
        return None
    surface = surface_of(frame.depth_m, frame.camera)
    facing = surface.normals @ frame.T_world_camera[2, :3]
    up, down = (surface.weights[sign * facing > _LEVEL].sum() for sign in (1, -1))
    if down > max(2 * up, _MIN_LEVEL_SHARE * surface.weights.sum()):
        return _AXES
    below, above = (heights < _ROOM_M[0]).mean(), (heights > _ROOM_M[1]).mean()
    if below > _BELOW_SHARE:
        return _BELOW
    return _ABOVE if above > _ABOVE_SHARE else ""
