"""MaskFusion: surfel maps of the background and of every object, tracked and fused.

Ruenz, Buffier, Agapito: "MaskFusion: Real-Time Recognition, Tracking and Reconstruction of
Multiple Moving Objects", ISMAR 2018. Written from the paper; numbers are those of its public code
where it has them, pixel counts for images half as wide.

Every frame: track the camera against the background (or take the given pose), track every object
in view by ICP of its rendered surfels, cut the image into pieces and refine the masks by them,
give each mask to the model it overlaps if the classes agree, else start a model, and fuse.

As in the original, tracking comes before segmentation and looks at the whole image; pairs of
points farther apart than 10 cm or 20 degrees are dropped, so an object that moves farther in a
frame, or has little but the floor left in view, is lost; the frame that starts a model weighs a
hundred times as much as a later one; a mask whose pieces run over into the background is lost, and
one before a larger model of another class is ignored, for measured depth is not compared.

Deviations, all in its favour where they matter to the scores:

- all objects are tracked, all the time, and a first guess lets them rest in the world (originally:
  those that a person touches or that are classed as movable; they first rest in the camera);
- models may start in every frame, several at once (originally one in 20 frames);
- masks are there in every frame (originally at 5 Hz, with pieces alone in between);
- the Gauss-Newton step has its full length and robust weights (the public code solves
  `(A_rgb + w^2 A_icp) x = b_rgb + w b_icp`);
- thresholds of the segmentation grow with depth, as sensor noise does: its own are for a desk; the
  background becomes stable as fast as objects do, as the sequences are short; depth ends at 6 m;
- a model that no mask was given to for 10 frames ends if it is small; a large one waits at rest
  in the world and may be found again (the public code names these numbers but does not use them);
- a mask of 500 pixels starts a model (2,000 at 640x480; 7,000 in the last public version);
- a track is claimed only in frames in which a mask is its own (the original draws every model);
- a motion is too large by where it takes the middle of the model, not the camera seen from it;
- every pixel of the smoothed depth is fused (a quarter of the raw ones, in turn); surfels are
  sought in 3x3 pixels of an index map of the image's size (of one four times as wide);
- only the camera's first guess, where it is not given, is turned by brightness alone first;
- no loop closure, no relocalisation (both off in the public code), and no persons to leave out.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from composenet.baselines.association import MIN_BIRTH_SCORE
from composenet.baselines.frame_maps import Maps, measured_maps, pyramid
from composenet.baselines.geometric_segmentation import masks_of_pieces, overlap_counts, pieces
from composenet.baselines.photometric_icp import LEVELS, MIN_PAIRS, align, turned
from composenet.baselines.records import Cameras, InstanceMasks, surface_track
from composenet.baselines.surfels import SurfelMap
from composenet.geometry.transform import apply_T, inverse_T, make_T
from composenet.records import Camera, FloatArray, Frame, TrackedObject, TrackState

MODEL_OVERLAP = 0.05
"""of a mask's pixels, that must show a model for the mask to be the model's"""
PIECE_OVERLAP = 0.6
"""of a piece in no mask, that must show a model for the piece to be the model's"""
MIN_NEW_PIXELS = 500
"""a smaller mask starts no model"""
BIRTH_WEIGHT = 100.0
"""of the frame that starts a model, when it is fused"""
FULL_MOTION, MIN_WEIGHT = 0.01, 0.5
"""motion against the camera (metres or radians a frame) from which a frame weighs least, and how
much that is"""
MAX_CONFIDENCE, GROWTH_FRAMES = 4.5, 25
"""surfels are stable from a confidence of (age in frames / the second), at most the first"""
MAX_STEP_M = 0.3
"""an alignment that moves a model farther in a frame has failed"""
END_AFTER_FRAMES, KEPT_SURFELS = 10, 1000
"""a model that no mask was given to for so long ends, if it has fewer surfels"""
STENCIL, BACKGROUND_STENCIL = 0.85, 0.21
"""factor on the confidence of surfels that lie in another body's pixels"""
IGNORED = -1
"""label of pixels that go into no map: a mask's that is no model's and starts none"""


class MaskFusion:
    """Tracks one recording (see `records.ComparisonSystem`). Identities of masks are not used."""

    def __init__(self, cameras: Cameras = Cameras.GIVEN) -> None:
        self._estimates_camera = cameras is Cameras.ESTIMATED
        self._background = Body(0)
        self._objects: list[Body] = []
        self._born = 0
        self._T_world_camera: FloatArray | None = None
        self._before: Maps | None = None

    def __call__(self, frame: Frame, masks: InstanceMasks) -> tuple[TrackedObject, ...]:
        """Every living track; those that no mask was given to are called occluded."""
        maps = measured_maps(frame)
        levels = pyramid(maps, LEVELS)
        T_world_camera = self._camera_pose(frame, levels)
        for body in self._objects:
            body.track(T_world_camera, levels)
        shown = self._projected(T_world_camera, frame.camera)
        order = np.argsort(masks.scores, kind="stable")
        numbers = pieces(maps)
        refined, owned = masks_of_pieces(numbers, masks.masks[order])
        labels = self._labels(frame, masks, order, refined, shown, maps, T_world_camera)
        _add_pieces(labels, numbers, owned, shown, len(self._objects))
        self._fuse(frame, maps, labels, T_world_camera)
        self._T_world_camera, self._before = T_world_camera, levels[-1]
        self._objects = [body for body in self._objects if not body.ended(frame.index)]
        return tuple(body.record(frame.index) for body in self._objects)

    def _camera_pose(self, frame: Frame, levels: list[Maps]) -> FloatArray:
        """(4, 4) T_world_camera of the frame: given, or by ICP of the background's rendering."""
        if not self._estimates_camera or self._T_world_camera is None:
            return frame.T_world_camera
        assert self._before is not None
        guess = self._T_world_camera @ inverse_T(turned(self._before, levels[-1]))
        view = self._background.view(guess, frame.camera)
        T, pairs = align(view, levels)
        if pairs < MIN_PAIRS or np.linalg.norm(T[:3, 3]) > MAX_STEP_M:
            return guess
        return guess @ inverse_T(T)

    def _projected(self, T_world_camera: FloatArray, camera: Camera) -> NDArray[np.int32]:
        """(H, W) which body is nearest at each pixel: objects from 1 in their order, else 0."""
        shown = np.zeros((camera.height, camera.width), np.int32)
        depth = self._background.view(T_world_camera, camera).points[..., 2].copy()
        depth[depth <= 0] = np.inf
        for number, body in enumerate(self._objects, start=1):
            z = body.view(T_world_camera, camera).points[..., 2]
            nearer = (z > 0) & (z < depth)
            shown[nearer], depth[nearer] = number, z[nearer]
        return shown

    def _labels(
        self,
        frame: Frame,
        masks: InstanceMasks,
        order: NDArray[np.int64],
        refined: NDArray[np.int32],
        shown: NDArray[np.int32],
        maps: Maps,
        T_world_camera: FloatArray,
    ) -> NDArray[np.int32]:
        """(H, W) the body that each pixel goes to: objects from 1, background 0, or IGNORED.
        Starts models for masks that show none."""
        counts = overlap_counts(refined, shown, len(self._objects) + 1)
        owner = np.zeros(len(order) + 1, np.int32)
        for number, index in enumerate(order.tolist(), start=1):
            pixels = (refined == number) & maps.valid
            size = int(pixels.sum())
            overlap = counts[number, 1:] if number < len(counts) else np.zeros(0, np.int64)
            best = int(overlap.argmax()) if len(overlap) else 0
            class_id, score = int(masks.class_ids[index]), float(masks.scores[index])
            owner[number] = IGNORED
            if size and len(overlap) and overlap[best] >= max(1, MODEL_OVERLAP * size):
                body = self._objects[best]
                if body.class_id == class_id:
                    owner[number] = best + 1
                    body.see(frame.index, score)
            elif size >= MIN_NEW_PIXELS and score >= MIN_BIRTH_SCORE:
                points_world = apply_T(T_world_camera, maps.points[pixels])
                self._objects.append(Body(frame.index, class_id, self._born, points_world))
                self._objects[-1].see(frame.index, score)
                self._born += 1
                owner[number] = len(self._objects)
        return owner[refined]

    def _fuse(
        self, frame: Frame, maps: Maps, labels: NDArray[np.int32], T_world_camera: FloatArray
    ) -> None:
        """Each body takes its pixels; surfels in other bodies' pixels lose confidence."""
        colors = _colors(frame)
        for number, body in enumerate([self._background, *self._objects]):
            stencil = STENCIL if number else BACKGROUND_STENCIL
            others = np.where((labels == number) | (labels == IGNORED), 1, stencil)
            body.fuse(frame, maps, colors, labels == number, others, T_world_camera)


def _add_pieces(
    labels: NDArray[np.int32],
    numbers: NDArray[np.int32],
    owned: NDArray[np.bool_],
    shown: NDArray[np.int32],
    n_objects: int,
) -> None:
    """Pieces in no mask that show a model become that model's, in place."""
    counts = overlap_counts(numbers, shown, n_objects + 1)
    sizes = counts.sum(axis=1)
    counts[:, 0] = 0
    best = counts.argmax(axis=1)
    taken = (counts.max(axis=1) > PIECE_OVERLAP * sizes) & ~owned & (best > 0)
    taken[0] = False
    pixels = taken[numbers] & (labels == 0)
    labels[pixels] = best[numbers[pixels]]


def _colors(frame: Frame) -> NDArray[np.float32]:
    if frame.color is None:
        return np.full((*frame.depth_m.shape, 3), np.nan, np.float32)
    return np.asarray(frame.color / 255, np.float32)


class Body:
    """The background or one object: its surfels, its pose and when it was seen."""

    def __init__(
        self,
        frame_index: int,
        class_id: int = -1,
        track_id: int = -1,
        points_world: FloatArray | None = None,
    ) -> None:
        self.class_id, self.track_id = class_id, track_id
        self.surfels = SurfelMap()
        middle = np.zeros(3) if points_world is None else np.median(points_world, axis=0)
        self._T_world_body: FloatArray = make_T(np.eye(3), middle)
        self._T_camera_body: FloatArray | None = None  # in the frame that was fused last
        self._born_at = self._age_at = frame_index
        self._seen_at = frame_index
        self._state, self._score = TrackState.TRACKED, 0.0
        self._extents_m: FloatArray = np.zeros(3)

    @property
    def _min_confidence(self) -> float:
        return min(MAX_CONFIDENCE, (self._age_at - self._born_at) / GROWTH_FRAMES)

    def view(self, T_world_camera: FloatArray, camera: Camera) -> Maps:
        """What is seen of its stable surfels."""
        T_camera_body = inverse_T(T_world_camera) @ self._T_world_body
        return self.surfels.render(T_camera_body, camera, self._min_confidence)

    def track(self, T_world_camera: FloatArray, levels: list[Maps]) -> None:
        """Follow it into the next frame, where enough of it is in view; else it rests."""
        view = self.view(T_world_camera, levels[0].camera)
        T, pairs = align(view, levels)
        if pairs < MIN_PAIRS:
            return
        middle = view.points[view.valid].mean(axis=0)
        if np.linalg.norm(apply_T(T, middle) - middle) <= MAX_STEP_M:
            T_camera_body = T @ inverse_T(T_world_camera) @ self._T_world_body
            self._T_world_body = T_world_camera @ T_camera_body

    def see(self, frame_index: int, score: float) -> None:
        """A mask of this frame is its own."""
        absent = frame_index - self._seen_at > 1
        if frame_index != self._seen_at:
            self._state = TrackState.RE_FOUND if absent else TrackState.TRACKED
        self._seen_at, self._score = frame_index, score

    def fuse(
        self,
        frame: Frame,
        maps: Maps,
        colors: NDArray[np.float32],
        mask: NDArray[np.bool_],
        others: FloatArray,
        T_world_camera: FloatArray,
    ) -> None:
        """Take the pixels of the mask (H, W). others: see `SurfelMap.clean`."""
        T_camera_body = inverse_T(T_world_camera) @ self._T_world_body
        if mask.any():
            weight = self._weight(T_camera_body)
            self.surfels.fuse(maps, colors, mask, T_camera_body, frame.index, weight)
        self._age_at, self._T_camera_body = frame.index, T_camera_body
        self.surfels.clean(
            maps.points[..., 2], others.astype(np.float32), T_camera_body, frame.camera,
            frame.index, self._min_confidence,
        )  # fmt: skip
        if self.class_id >= 0 and mask.any():
            self._measure()

    def ended(self, frame_index: int) -> bool:
        """Whether it is given up."""
        return frame_index - self._seen_at > END_AFTER_FRAMES and len(self.surfels) < KEPT_SURFELS

    def record(self, frame_index: int) -> TrackedObject:
        """Its entry for this frame."""
        state = self._state if self._seen_at == frame_index else None
        return surface_track(
            self.track_id,
            frame_index,
            self.class_id,
            state,
            self._score,
            self._T_world_body,
            self._extents_m,
        )

    def _measure(self) -> None:
        """The box of what was seen so far, less stray surfels."""
        if len(self.surfels):
            low, high = np.percentile(self.surfels.positions, [5, 95], axis=0)
            self._extents_m = (high - low).astype(np.float64)

    def _weight(self, T_camera_body: FloatArray) -> float:
        """Of a frame when it is fused: fast motion blurs."""
        if self._T_camera_body is None:
            return BIRTH_WEIGHT if self.class_id >= 0 else 1.0
        T = T_camera_body @ inverse_T(self._T_camera_body)
        turn = np.linalg.norm(Rotation.from_matrix(T[:3, :3]).as_rotvec())
        motion = max(float(np.linalg.norm(T[:3, 3])), float(turn))
        return max(1 - motion / FULL_MOTION, MIN_WEIGHT)
