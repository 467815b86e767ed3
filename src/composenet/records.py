"""The records that pass between stages. Frozen; each field with shape, unit and frame.

Frames, axes and units are those of CONVENTIONS.md.
"""

from __future__ import annotations

import operator
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from composenet.errors import SequenceError
from composenet.geometry.rigid import is_rigid

FloatArray = NDArray[np.floating]

CLASS_NAMES: tuple[str, ...] = (
    "bathtub",
    "bed",
    "bookshelf",
    "cabinet",
    "chair",
    "desk",
    "sink",
    "sofa",
    "table",
    "toilet",
)


FARTHEST_M = 20.0
"""No depth camera measures farther indoors; 16 bits of millimetres end at 65.535."""


FARTHEST_CAMERA_M = 10_000.0
"""Points are kept in single precision: a millimetre here, and half a metre at a map's coordinates
of five thousand kilometres."""


LARGEST_INDEX = 2**30
"""Frames are counted in 32 bits, those that are remembered beside them."""


MILLIMETRES = 100.0
"""An image whose depth is mostly larger than this is not in metres."""


class Symmetry(StrEnum):
    """Rotational symmetry of an object about its up axis (Scan2CAD's four kinds)."""

    NONE = "none"
    TWO = "two"
    FOUR = "four"
    INF = "inf"


class TrackState(StrEnum):
    """What a user may act on.

    TRACKED: seen in this frame. RE_FOUND: seen in this frame after an absence.
    OCCLUDED: not seen, and not expected to be (hidden or outside the view).
    LOST: not seen although it should be in view. ENDED: given up, never returns.
    """

    TRACKED = "tracked"
    OCCLUDED = "occluded"
    LOST = "lost"
    RE_FOUND = "re-found"
    ENDED = "ended"


@dataclass(frozen=True, eq=False)
class Camera:
    """Pinhole intrinsics of the depth image. K: (3, 3) float64, pixels. Raises SequenceError where
    K is no such matrix, or cannot be that of an image of this size. Cameras of equal numbers are
    equal."""

    K: FloatArray
    width: int
    height: int

    def __post_init__(self) -> None:
        try:
            object.__setattr__(self, "width", operator.index(self.width))
            object.__setattr__(self, "height", operator.index(self.height))
        except TypeError:
            raise SequenceError(
                f"camera of {self.width}x{self.height}: expected whole numbers of pixels"
            ) from None
        try:
            K = np.array(self.K, dtype=np.float64)
        except (TypeError, ValueError):
            K = np.zeros(0)
        if K.shape != (3, 3) or not _possible(K, self.width, self.height):
            told = K.tolist() if K.size else self.K
            raise SequenceError(
                f"intrinsics of a {self.width}x{self.height} camera: K is {told}; expected a "
                "(3, 3) matrix fx 0 cx, 0 fy cy, 0 0 1 in pixels of the depth image (halve them "
                "with it)"
            )
        object.__setattr__(self, "K", K)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Camera) and self._numbers() == other._numbers()

    def __hash__(self) -> int:
        return hash(self._numbers())

    def _numbers(self) -> tuple[float, ...]:
        return (self.width, self.height, *self.K.ravel().tolist())


_SKEW = 0.01
"""Of the focal length; what is left of it in calibrations is not looked at."""


def _possible(K: FloatArray, width: int, height: int) -> bool:
    """Whether K (3, 3) may be the intrinsics of an image of this size."""
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    if not np.isfinite(K).all() or not np.allclose(K[2], (0, 0, 1)):
        return False
    if abs(K[1, 0]) > _SKEW * fy or abs(K[0, 1]) > _SKEW * fx:
        return False
    focal_fits = 0.1 * width < min(fx, fy) and max(fx, fy) < 20 * width
    border = 0.02  # at the very border lies the middle of an image twice the size
    within = all(border < at < 1 - border for at in (cx / width, cy / height))
    return bool(focal_fits and within)


@dataclass(frozen=True)
class Frame:
    """One RGB-D frame. Raises SequenceError where its depth is not in metres or not the camera's,
    its pose no rigid motion or too far off (FARTHEST_CAMERA_M), or its colour of another size.

    index: the frame's number; memory and gates count frames by it, so it grows by about one from
    frame to frame. depth_m: (H, W) float32, z-depth, 0 = invalid; what is negative, not finite or
    beyond FARTHEST_M is set to 0 (a sensor may say so that it measured nothing). color: (H, W, 3)
    uint8, RGB, or None. T_world_camera: (4, 4) float64, world levelled (z up). pose_known: False
    where that world is the camera's own levelled frame, so that places in different frames cannot
    be compared.
    """

    index: int
    depth_m: FloatArray
    camera: Camera
    T_world_camera: FloatArray
    color: NDArray[np.uint8] | None = None
    timestamp_s: float | None = None
    name: str = ""
    pose_known: bool = True

    def __post_init__(self) -> None:
        what = f"frame {self.index}"
        try:
            object.__setattr__(self, "index", operator.index(self.index))
        except TypeError:
            raise SequenceError(
                f"{what}: index is no whole number; give times as timestamp_s"
            ) from None
        if abs(self.index) > LARGEST_INDEX:
            raise SequenceError(f"{what}: index is no count of frames; give times as timestamp_s")
        if self.timestamp_s is not None:
            object.__setattr__(self, "timestamp_s", _usable_time(what, self.timestamp_s))
        object.__setattr__(self, "depth_m", usable_depth(what, self.depth_m, self.camera))
        object.__setattr__(self, "T_world_camera", _usable_pose(what, self.T_world_camera))
        if self.color is not None:
            object.__setattr__(self, "color", usable_color(what, self.color, self.camera))


def usable_depth(what: str, depth_m: FloatArray, camera: Camera) -> FloatArray:
    """Depth (H, W) in metres with 0 where it cannot be; the same array where nothing is to be
    changed. what: it is of. Raises SequenceError where it is not in metres or not the camera's."""
    depth, expected = np.asarray(depth_m), (camera.height, camera.width)
    if depth.shape != expected or not np.issubdtype(depth.dtype, np.floating):
        raise SequenceError(
            f"{what}: depth_m is {depth.dtype} of shape {depth.shape}; "
            f"expected metres as float32 of shape {expected}, the camera's (height, width)"
        )
    measured = (depth >= 0) & (depth <= FARTHEST_M)
    if measured.all():
        return depth
    finite = depth[(depth > 0) & (depth < np.inf)]
    if len(finite) and np.median(finite) > MILLIMETRES:
        raise SequenceError(
            f"{what}: depth_m has a median of {np.median(finite):.0f}; "
            "expected metres, divide millimetres by 1000"
        )
    return np.where(measured, depth, 0).astype(depth.dtype)


def usable_color(what: str, color: NDArray[np.uint8], camera: Camera) -> NDArray[np.uint8]:
    """An image (H, W, 3) uint8, as it is. what: it is of. Raises SequenceError for another."""
    given, expected = np.asarray(color), (camera.height, camera.width, 3)
    if given.shape != expected or given.dtype != np.uint8:
        raise SequenceError(
            f"{what}: color is {given.dtype} of shape {given.shape}; expected uint8 of "
            f"shape {expected}, or None"
        )
    return given


def _usable_time(what: str, timestamp_s: float) -> float:
    try:
        if np.isfinite(seconds := float(timestamp_s)):
            return seconds
    except (TypeError, ValueError):
        pass
    raise SequenceError(f"{what}: timestamp_s is {timestamp_s}; expected seconds, or None")


def _usable_pose(what: str, T_world_camera: FloatArray) -> FloatArray:
    try:
        T = np.array(T_world_camera, dtype=np.float64)
    except (TypeError, ValueError):
        T = np.zeros(0)
    if T.shape != (4, 4) or not np.isfinite(T).all():
        raise SequenceError(
            f"{what}: T_world_camera is no (4, 4) matrix of finite numbers; leave "
            "frames without a pose out (pose_known=False is for recordings without any)"
        )
    if not is_rigid(T):
        raise SequenceError(
            f"{what}: T_world_camera is no rigid motion; expected camera to world, a rotation and "
            "metres, with (0, 0, 0, 1) in its last row"
        )
    if (away_m := float(np.abs(T[:3, 3]).max())) > FARTHEST_CAMERA_M:
        raise SequenceError(
            f"{what}: the camera is {away_m / 1000:,.0f} km from the world's origin, where single "
            "precision is too coarse; subtract one place near it from all poses (and are they in "
            "metres?)"
        )
    return T


@dataclass(frozen=True)
class Box:
    """Axis-aligned box in the world frame. center, extents (full): (3,) float64, metres."""

    center: FloatArray
    extents: FloatArray


@dataclass(frozen=True)
class Similarity:
    """p_world = scale_m * R @ p_canonical + t. R: (3, 3); t: (3,) metres; scale_m > 0."""

    scale_m: float
    R: FloatArray
    t: FloatArray

    @property
    def T_world_object(self) -> NDArray[np.float64]:
        """(4, 4) rigid pose of the object's own axes, in metres: the similarity without its
        scale."""
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = self.R, self.t
        return T


@dataclass(frozen=True)
class ObjectEstimate:
    """A posed detection: one object in one frame, completed.

    class_probabilities: (n_classes,), sum 1. score: 0..1, of being an object and of its likeliest
    class. box: world, of the whole object; its centre is not the pose's where that is no rectangle
    from above. S_world_canonical: fitted by Procrustes; pose_observable is False where the
    correspondences do not fix it (then the similarity is the detector's box with identity
    rotation). extents_m: (3,) full extents in object axes. points_world: (P, 3) float32, occupied
    cells.
    canonical: (64, 64, 64) float32 in 0..1, the canonical reconstruction.
    """

    class_probabilities: FloatArray
    score: float
    box: Box
    S_world_canonical: Similarity
    pose_observable: bool
    extents_m: FloatArray
    points_world: FloatArray
    canonical: FloatArray

    @property
    def class_id(self) -> int:
        """The likeliest class."""
        return int(np.argmax(self.class_probabilities))

    @property
    def class_name(self) -> str:
        """Its name."""
        return CLASS_NAMES[self.class_id]


@dataclass(frozen=True)
class TrackedObject:
    """One track in one frame: what the user reads.

    confidence: 0..1. box, S_world_canonical, extents_m as in ObjectEstimate, or the last ones
    known while the object is not seen. observed: whether this frame contributed a detection.
    """

    track_id: int
    frame_index: int
    class_id: int
    state: TrackState
    confidence: float
    box: Box
    S_world_canonical: Similarity
    extents_m: FloatArray
    observed: bool

    @property
    def class_name(self) -> str:
        """The name of its class, one of CLASS_NAMES."""
        return CLASS_NAMES[self.class_id]

    @property
    def T_world_object(self) -> NDArray[np.float64]:
        """(4, 4) rigid pose of its own axes (x front, y left, z up), metres."""
        return self.S_world_canonical.T_world_object


@dataclass(frozen=True)
class Track:
    """One identity over time.

    history: one entry for every frame in which it was told of, earliest first; with
    tracking.offline for every frame of the recording from the first to the last of these.
    canonical: (64, 64, 64) float32 in 0..1, the running mean of its reconstructions. class_id: by
    weighted vote.
    """

    track_id: int
    class_id: int
    history: tuple[TrackedObject, ...]
    canonical: FloatArray

    @property
    def class_name(self) -> str:
        """The name of its class, one of CLASS_NAMES."""
        return CLASS_NAMES[self.class_id]


@dataclass(frozen=True)
class ObjectTruth:
    """Ground truth of one object, constant over its sequence.

    extents_m: (3,) full extents in object axes. occupancy: (64, 64, 64) bool over that box
    (CONVENTIONS.md). hull: (H, 3) float32 vertices of the convex hull, object axes, metres.
    """

    gt_id: int
    class_id: int
    symmetry: Symmetry
    extents_m: FloatArray
    occupancy: NDArray[np.bool_]
    hull: FloatArray
    recipe: str = ""


@dataclass(frozen=True)
class ObjectFrameTruth:
    """Ground truth of one object in one frame.

    T_world_object: (4, 4). box: world, tight around the whole geometry. visible_pixels: pixels
    of the object in the instance image. visible_fraction: those over the pixels it would have
    alone and whole in a wider image. moving: whether it moved since the frame before.
    """

    gt_id: int
    T_world_object: FloatArray
    box: Box
    visible_pixels: int
    visible_fraction: float
    moving: bool = False


@dataclass(frozen=True)
class SequenceTruth:
    """Ground truth of a sequence: objects, and for each frame (same order as the frames)
    every object, whether visible or not. image_size: width, height of the id images.
    T_world_source: (4, 4), maps the world that it was written in to the one that it is in."""

    objects: tuple[ObjectTruth, ...]
    frames: tuple[tuple[ObjectFrameTruth, ...], ...]
    image_size: tuple[int, int] = field(default=(320, 240))
    T_world_source: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))
