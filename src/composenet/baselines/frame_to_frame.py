"""F2F: every object's motion from one frame to the next by ICP of its visible surface.

The paper's own baseline (section "Results", "frame-to-frame tracking for each object using the
Iterative Closest Point algorithm, given 2D detection"). With true masks and identities it is
F2F-GT; with predicted masks, associated by their overlap after warping, F2F-MaskRCNN. The paper
gives no parameters; ours:

- point-to-plane ICP of clouds thinned to 3 cm, begun from constant velocity and from rest (in
  that order for what moved by over 3 cm a frame) and from the shift of the visible points; the
  best fit wins, and the earlier one where two fit alike;
- masks of under 77 pixels (of 320x240) are left out, as by MID-Fusion;
- correspondences are rejected where they are not mutual and beyond 30, then 10, then 5 cm;
- an alignment that under 30 % of the points agree with, or that turns by over 45 degrees, has
  failed, and the object goes on as it last moved;
- an object that comes back is aligned with the cloud it was last seen with, constant velocity
  holding for three frames; predicted masks find a track again for ten.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from composenet.baselines.association import MIN_BIRTH_SCORE, mask_iou, projected_mask
from composenet.baselines.camera import OdometryCamera
from composenet.baselines.icp import MIN_POINTS, Cloud, align
from composenet.baselines.records import Cameras, InstanceMasks, surface_track
from composenet.geometry.camera import back_project
from composenet.geometry.transform import apply_T, make_T
from composenet.records import CLASS_NAMES, FloatArray, Frame, TrackedObject, TrackState
from composenet.tracking.assignment import assign

MIN_MASK_SHARE = 0.001
"""of the image; a smaller mask shows too little to say where its object is"""
MASK_IOU_GATE = 0.2
"""a warped and a new mask that overlap less are two objects"""
MOVING_M = 0.03
"""an object that moved farther in a frame is first expected to go on, else to rest"""
MAX_STEP_M = 0.4
"""an alignment that moves an object farther in a frame has failed"""
GOES_ON_FRAMES = 3
"""an object out of sight goes on as it last moved for so long, then it rests"""
END_AFTER_FRAMES = 10
"""a track without true identity that is unseen for longer has ended"""


class FrameToFrame:
    """Tracks one recording (see `records.ComparisonSystem`)."""

    def __init__(self, cameras: Cameras = Cameras.GIVEN) -> None:
        self._camera = OdometryCamera() if cameras is Cameras.ESTIMATED else None
        self._tracks: list[_Track] = []
        self._born = 0

    def __call__(self, frame: Frame, masks: InstanceMasks) -> tuple[TrackedObject, ...]:
        """Every living track. Tracks out of sight are called occluded: why an object is not
        seen is not looked into."""
        T_world_camera = frame.T_world_camera
        if self._camera is not None:
            T_world_camera = self._camera(frame, masks.union)
        points_world = apply_T(T_world_camera, back_project(frame.depth_m, frame.camera))
        measured = frame.depth_m > 0
        matched = self._matched(frame, masks, T_world_camera)
        for index, mask in enumerate(masks.masks):
            if mask.mean() < MIN_MASK_SHARE:
                continue
            points = points_world[mask & measured]
            track = matched.get(index)
            if track is None and masks.scores[index] >= MIN_BIRTH_SCORE:
                track = self._start(points, masks, index)
            if track is not None:
                track.votes[masks.class_ids[index]] += masks.scores[index]
                track.see(frame.index, points, float(masks.scores[index]))
        if masks.gt_ids is None:
            self._tracks = [t for t in self._tracks if t.unseen(frame.index) <= END_AFTER_FRAMES]
        return tuple(track.record(frame.index) for track in self._tracks)

    def _matched(
        self, frame: Frame, masks: InstanceMasks, T_world_camera: FloatArray
    ) -> dict[int, _Track]:
        """The track of each mask that continues one."""
        if masks.gt_ids is not None:
            known = {track.gt_id: track for track in self._tracks}
            ids = enumerate(masks.gt_ids.tolist())
            return {index: known[gt_id] for index, gt_id in ids if gt_id in known}
        warped = [
            projected_mask(t.predicted_points(frame.index), T_world_camera, frame.camera)
            for t in self._tracks
        ]
        overlap = mask_iou(np.array(warped, bool).reshape(-1, *frame.depth_m.shape), masks.masks)
        pairs = assign(overlap, overlap >= MASK_IOU_GATE)
        return {column: self._tracks[row] for row, column in pairs}

    def _start(self, points: FloatArray, masks: InstanceMasks, index: int) -> _Track | None:
        """A new track, if the mask has enough of a surface to follow."""
        if len(Cloud(points)) < MIN_POINTS:
            return None
        gt_id = None if masks.gt_ids is None else int(masks.gt_ids[index])
        self._tracks.append(_Track(self._born, gt_id, points))
        self._born += 1
        return self._tracks[-1]


class _Track:
    """One object: its pose since birth, its last motion and the surface it was last seen with."""

    def __init__(self, track_id: int, gt_id: int | None, points: FloatArray) -> None:
        low, middle, high = np.percentile(points, [5, 50, 95], axis=0)
        self.track_id, self.gt_id = track_id, gt_id
        self.votes = np.zeros(len(CLASS_NAMES))
        self._extents_m = high - low  # a mask's rim shows what lies behind
        self._T: FloatArray = make_T(np.eye(3), middle)  # now, as far as it is known
        self._T_aligned: FloatArray = self._T  # when its cloud was seen
        self._step_m, self._turn = np.zeros(3), np.zeros(3)  # motion a frame; rotation vector
        self._points, self._cloud = points, Cloud(np.zeros((0, 3)))
        self._seen_at: int | None = None
        self._aligned_at = 0
        self._state, self._score = TrackState.TRACKED, 1.0

    def unseen(self, frame_index: int) -> int:
        """Frames since it was last seen."""
        return 0 if self._seen_at is None else frame_index - self._seen_at

    def see(self, frame_index: int, points: FloatArray, score: float) -> None:
        """Follow it to the next frame in which it is seen."""
        cloud, first = Cloud(points), self._seen_at is None
        gap = frame_index - self._aligned_at
        self._state = TrackState.TRACKED if self.unseen(frame_index) <= 1 else TrackState.RE_FOUND
        self._seen_at, self._score = frame_index, score
        if not first:
            predicted = self._prediction(gap)
            shift = make_T(np.eye(3), cloud.origin - self._cloud.origin)
            moving = np.linalg.norm(self._step_m) > MOVING_M
            likely = [predicted, np.eye(4)] if moving else [np.eye(4), predicted]
            reach_m = MAX_STEP_M * gap
            found = align(cloud, self._cloud, [*likely, shift], reach_m=reach_m)
            self._T = (predicted if found is None else found.T_target_source) @ self._T_aligned
            if found is not None:
                self._learn_motion(gap)
        if first or len(cloud) >= MIN_POINTS:
            self._points, self._cloud = points, cloud
            self._T_aligned, self._aligned_at = self._T, frame_index

    def predicted_points(self, frame_index: int) -> FloatArray:
        """(P, 3) points it was last seen with, where they are now expected."""
        return apply_T(self._prediction(frame_index - self._aligned_at), self._points)

    def record(self, frame_index: int) -> TrackedObject:
        """Its entry for this frame."""
        state = self._state if self._seen_at == frame_index else None
        return surface_track(
            self.track_id,
            frame_index,
            int(self.votes.argmax()),
            state,
            self._score,
            self._T,
            self._extents_m,
        )

    def _prediction(self, gap: int) -> FloatArray:
        """Motion in the `gap` frames since its cloud was seen: the last one goes on for a while,
        then it rests."""
        frames = min(gap, GOES_ON_FRAMES)
        turn, t = Rotation.from_rotvec(frames * self._turn).as_matrix(), self._T_aligned[:3, 3]
        return make_T(turn, t + frames * self._step_m - turn @ t)

    def _learn_motion(self, gap: int) -> None:
        """Its mean motion a frame since its cloud was seen, about the reference point."""
        before, now = self._T_aligned, self._T
        self._step_m = (now[:3, 3] - before[:3, 3]) / gap
        self._turn = Rotation.from_matrix(now[:3, :3] @ before[:3, :3].T).as_rotvec() / gap
