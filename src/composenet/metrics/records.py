"""What the metrics read: ids, classes and similarities of one frame. Frozen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

IntArray = NDArray[np.int64]

MATCH_GATE_M = 0.25
"""centres closer than this can match [paper]"""
COUNTED_PIXELS = 150
"""object-frames with fewer visible pixels are ignored, at 320x240"""


def counted_pixels(width: int, height: int) -> float:
    """COUNTED_PIXELS in an image of this size, scaled by its area."""
    return COUNTED_PIXELS * width * height / (320 * 240)


@dataclass(frozen=True)
class FrameEvaluation:
    """True and predicted objects of one frame, as the tracking metrics see them.

    gt_ids, gt_class_ids: (G,) int. gt_centers_m: (G, 3), world, centre of the completed box.
    ignored: (G,) bool, neither a miss nor, if matched, a false positive.
    track_ids, track_class_ids: (P,) int. track_centers_m: (P, 3), world. Ids are unique.
    """

    gt_ids: IntArray
    gt_class_ids: IntArray
    gt_centers_m: NDArray[np.float64]
    ignored: NDArray[np.bool_]
    track_ids: IntArray
    track_class_ids: IntArray
    track_centers_m: NDArray[np.float64]

    def of_class(self, class_id: int) -> FrameEvaluation:
        """Only the objects and tracks of one class."""
        gt, track = self.gt_class_ids == class_id, self.track_class_ids == class_id
        return FrameEvaluation(
            self.gt_ids[gt],
            self.gt_class_ids[gt],
            self.gt_centers_m[gt],
            self.ignored[gt],
            self.track_ids[track],
            self.track_class_ids[track],
            self.track_centers_m[track],
        )


@dataclass(frozen=True)
class TrackingFrame:
    """All that CLEAR, identity and HOTA know of a frame.

    gt_ids: (G,), track_ids: (P,), unique. distance_m: (G, P), inf where a match is forbidden.
    """

    gt_ids: IntArray
    track_ids: IntArray
    distance_m: NDArray[np.float64]

    def similarity(self, gate_m: float) -> NDArray[np.float64]:
        """(G, P) in 0..1: 1 at distance 0, 0.5 at the gate, 0 from twice the gate on (the
        convention of TrackEval for centre distances)."""
        return np.maximum(0.0, 1.0 - self.distance_m / (2 * gate_m))


@dataclass(frozen=True)
class ScoredFrame:
    """Detections of one class in one frame against the truth.

    similarity: (G, P) in 0..1, of boxes or volumes. scores: (P,). ignored: (G,) bool.
    """

    similarity: NDArray[np.float64]
    scores: NDArray[np.float64]
    ignored: NDArray[np.bool_]


def centre_distances(frame: FrameEvaluation) -> TrackingFrame:
    """Distances between centres, inf where the classes differ. Ignored objects are kept."""
    offset = frame.gt_centers_m[:, None] - frame.track_centers_m[None]
    same_class = frame.gt_class_ids[:, None] == frame.track_class_ids[None]
    distance = np.where(same_class, np.linalg.norm(offset, axis=-1), np.inf)
    return TrackingFrame(frame.gt_ids, frame.track_ids, distance)
