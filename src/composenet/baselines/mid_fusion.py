"""MID-Fusion: a volumetric map of the background and of every object, tracked where it moves.

Xu, Li, Tzoumanikas, Bloesch, Davison, Leutenegger: "MID-Fusion: Octree-based Object-Level
Multi-Instance Dynamic SLAM", ICRA 2019. Written from the paper; numbers are those of its public
code, pixel counts for images half as wide.

Every frame: track the camera against everything (or take the given pose), ask of every object
whether its rendering agrees with the frame as it rests in the world, and track those that do not by
ICP and brightness (the camera again, without them); let masks grow by the pieces of the image that
they nearly cover, give each to the model whose rendering it overlaps, else start a model; fuse.

As in the original, masks are compared with the renderings of the models among themselves, never
with measured depth, so that a mask in front of a large model may be taken for it;
tracking comes before masks are looked at; points farther apart than 10 cm or
37 degrees are no pairs, so an object that moves farther in a frame is lost; a mask that overlaps a
model a little is neither its nor starts another; a model that is in view but has no mask is told
that its pixels are half, or less, its own, fades, and then is shown no more; nothing is deleted
otherwise; a model's class is the one that most of its masks had.

Deviations, all in its favour where they matter to the scores:

- blocks of 8^3 voxels are found by a hash table, not in an octree, and no volume has a wall;
- voxels are 5 to 10 mm, 20 for the background (1.25 to 2.5 mm for objects; 5 to 20): a pixel of
  furniture is a centimetre wide; depth ends at 6 m (4 m);
- disparity is known to an eighth of a pixel of an image 640 wide (one pixel, which makes 20 cm of
  depth mean nothing at furniture's distance; the others are for a desk); so an object of which
  nothing agrees with rest is tracked too (it is given up);
- a mask takes one model and a model one mask, of greatest total overlap (the first that fits; masks
  of one class are merged), and may be larger than its model to any degree (by half, where one holds
  the other); a mask that is left over is fused nowhere (into the background);
- a pixel in no mask that shows a model goes to that model, as if in its mask (to the background);
- points of the rendering are sought in the frame, not the frame's in the rendering, which is made
  for the present camera; its brightness is that of the last frame where that showed it, as in the
  original, else that of its voxels;
- a point that is of no pair counts in the cost by which a step is kept or taken back, as much as
  one just within reach (the cost is of pairs alone, so that losing them seems a gain);
- where a left-over mask covers a model without a mask that model fades at once, and its object is
  sooner begun anew, at its true centre (it keeps a half or a tenth there);
- what moved out of its model's surface is left out of its fusion by distance, not by brightness;
- the camera's first guess, where it is not given, is turned by brightness alone first;
- a mask of 77 pixels starts a model, as in the demonstrations with small objects (the default is
  ten times as many), but not if Mask R-CNN is unsure of it (all that it finds start one); a track
  is claimed only in frames in which a mask is its own;
- no persons to leave out, and no classes that never move.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from composenet.baselines.association import MIN_BIRTH_SCORE, mask_iou
from composenet.baselines.frame_maps import Maps, measured_maps, pyramid
from composenet.baselines.geometric_segmentation import overlap_counts, pieces
from composenet.baselines.hashed_tsdf import HashedTsdf
from composenet.baselines.mid_fusion_body import (
    BACKGROUND_VOXEL_M,
    TRUNCATION_M,
    Body,
    Model,
    View,
    composed,
    own_pixels,
    with_brightness,
)
from composenet.baselines.photometric_icp import LEVELS, MAX_DISTANCE_M, MIN_PAIRS, turned
from composenet.baselines.records import Cameras, InstanceMasks
from composenet.baselines.weighted_icp import align_weighted, share_at_rest
from composenet.geometry.transform import apply_T, inverse_T
from composenet.records import Camera, FloatArray, Frame, TrackedObject
from composenet.tracking.assignment import assign

AT_REST = 0.9
"""an object moves where a smaller share of its pixels agrees with rest"""
PIECE_SHARE = 0.8
"""of a piece's pixels, that a mask must cover to be given the rest of it"""
OVERLAP = 0.5
"""of a mask or of a model's pixels, that they must share to be of one object"""
NEW_OVERLAP = 0.01
"""a mask that shares more with any model starts none"""
MIN_PIXELS = 0.001
"""of the image: a smaller mask is not used"""
UNSEEN_SHARE, UNSEEN_SMALL_SHARE, LARGE = 0.5, 0.1, 0.03
"""own share that a model without a mask is told in its own pixels, if these are fewer than so much
of the image, and else"""
BACKGROUND, IGNORED = 0, -1


class MidFusion:
    """Tracks one recording (see `records.ComparisonSystem`). Identities of masks are not used."""

    def __init__(self, cameras: Cameras = Cameras.GIVEN) -> None:
        self._estimates_camera = cameras is Cameras.ESTIMATED
        self._background = Body(HashedTsdf(BACKGROUND_VOXEL_M, TRUNCATION_M), np.eye(4))
        self._objects: list[Model] = []
        self._before: tuple[list[Maps], FloatArray] | None = None  # last frame, T_world_camera

    def __call__(self, frame: Frame, masks: InstanceMasks) -> tuple[TrackedObject, ...]:
        """Every object so far; those that no mask was given to are called occluded."""
        maps = measured_maps(frame)
        levels = pyramid(maps, LEVELS)
        T_world_camera, view = self._follow(frame, levels)
        given = grown_masks(masks.masks, pieces(maps))
        owners = self._owners(frame, masks, given, view, maps, T_world_camera)
        self._fuse(given, owners, view, maps, T_world_camera)
        self._before = levels, T_world_camera
        return tuple(model.record(frame.index) for model in self._objects)

    def _follow(self, frame: Frame, levels: list[Maps]) -> tuple[FloatArray, View]:
        """Move the camera, and the objects that do not rest. (4, 4) T_world_camera, and all bodies
        as that camera sees them."""
        if self._before is None:
            return frame.T_world_camera, composed(self._views(frame.T_world_camera, frame.camera))
        before, T_world_before = self._before
        T_world_guess = frame.T_world_camera
        if self._estimates_camera:
            T_world_guess = T_world_before @ inverse_T(turned(before[-1], levels[-1]))
        views = self._views(T_world_guess, frame.camera)
        view = composed(views)
        known = with_brightness(view.maps, before[0], inverse_T(T_world_before) @ T_world_guess)
        surface = pyramid(known, LEVELS)
        T_now_guess, anything = np.eye(4), view.shown >= 0
        if self._estimates_camera:
            T_now_guess, _ = align_weighted(surface, anything, levels, T_now_guess)
        moving = [
            number
            for number in range(1, len(views))
            if share_at_rest(known, view.shown == number, levels[0], T_now_guess) < AT_REST
        ]
        if self._estimates_camera and moving:
            still = anything & ~np.isin(view.shown, moving)
            T_now_guess, _ = align_weighted(surface, still, levels, T_now_guess)
        T_world_camera = T_world_guess @ inverse_T(T_now_guess)
        for number in moving:
            T, pairs = align_weighted(surface, view.shown == number, levels, T_now_guess)
            if pairs >= MIN_PAIRS:
                model = self._objects[number - 1]
                T_guess_body = inverse_T(T_world_guess) @ model.T_world_body
                model.T_world_body = T_world_camera @ T @ T_guess_body
                views[number] = model.view(T_world_camera, frame.camera)
        if self._estimates_camera:
            views = self._views(T_world_camera, frame.camera)
        return T_world_camera, composed(views)

    def _views(self, T_world_camera: FloatArray, camera: Camera) -> list[Maps]:
        """What a camera sees of the background and of every object."""
        bodies = [self._background, *self._objects]
        return [body.view(T_world_camera, camera) for body in bodies]

    def _owners(
        self,
        frame: Frame,
        masks: InstanceMasks,
        given: NDArray[np.bool_],
        view: View,
        maps: Maps,
        T_world_camera: FloatArray,
    ) -> list[int]:
        """Which object each mask shows, from 1, or IGNORED. Starts models for masks that share
        next to nothing with any."""
        sizes = given.sum(axis=(1, 2))
        usable = sizes >= MIN_PIXELS * view.shown.size
        shown = view.shown == np.arange(1, len(self._objects) + 1)[:, None, None]
        iou = mask_iou(given, shown)
        overlap = shared_of_smaller(given, shown)
        pairs = dict(assign(iou, (overlap > OVERLAP) & usable[:, None]))
        owners = []
        for index in range(len(given)):
            pixels = given[index] & maps.valid
            sure, owner = masks.scores[index] >= MIN_BIRTH_SCORE, IGNORED
            if index in pairs:
                owner = pairs[index] + 1
            elif sure and usable[index] and pixels.any() and (overlap[index] < NEW_OVERLAP).all():
                points_world = apply_T(T_world_camera, maps.points[pixels])
                self._objects.append(Model(len(self._objects), points_world))
                owner = len(self._objects)
            if owner != IGNORED:
                class_id, score = int(masks.class_ids[index]), float(masks.scores[index])
                self._objects[owner - 1].see(frame.index, class_id, score)
            owners.append(owner)
        return owners

    def _fuse(
        self,
        given: NDArray[np.bool_],
        owners: list[int],
        view: View,
        maps: Maps,
        T_world_camera: FloatArray,
    ) -> None:
        """Each body takes its pixels."""
        labels = np.where(view.shown > 0, view.shown, BACKGROUND)
        of_masks = given.any(axis=0)
        labels[of_masks] = IGNORED
        for owner, mask in zip(owners, given, strict=True):
            labels[mask] = owner
        away = np.abs(view.maps.points[..., 2] - maps.points[..., 2]) > MAX_DISTANCE_M
        for number, body in enumerate([self._background, *self._objects]):
            mask, shown = labels == number, view.shown == number
            if not (mask | shown).any():
                continue
            share = 1.0
            if number and number not in owners:
                share = UNSEEN_SHARE if mask.mean() >= LARGE else UNSEEN_SMALL_SHARE
            own = own_pixels(mask, shown & (number > 0), share)
            if number in owners:
                own[shown & mask & away] = IGNORED
            body.fuse(maps, own, T_world_camera)
            if isinstance(body, Model):
                body.measure()


def grown_masks(masks: NDArray[np.bool_], numbers: NDArray[np.int32]) -> NDArray[np.bool_]:
    """The masks (M, H, W) with the whole of every piece that they nearly cover. numbers: (H, W)
    the piece of a pixel from 1, 0 for none."""
    result = masks.copy()
    for mask in result:
        counts = overlap_counts(numbers, mask.astype(np.int32), 2)
        covered = counts[:, 1] > PIECE_SHARE * counts.sum(axis=1)
        covered[0] = False
        mask |= covered[numbers]
    return result


def shared_of_smaller(a: NDArray[np.bool_], b: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(A, B) pixels that masks (A, H, W) and (B, H, W) share, over those of the smaller one."""
    flat_a = a.reshape(len(a), np.prod(a.shape[1:])).astype(np.float32)
    flat_b = b.reshape(len(b), np.prod(b.shape[1:])).astype(np.float32)
    smaller = np.minimum(flat_a.sum(axis=1)[:, None], flat_b.sum(axis=1))
    return np.asarray(flat_a @ flat_b.T / np.maximum(smaller, 1), np.float64)
