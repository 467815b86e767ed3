"""How well the reconstructions of tracks fill their objects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from composenet.geometry.box import OrientedBox
from composenet.metrics.clear import correspondences
from composenet.metrics.completion import OCCUPIED, volume_iou, voxelize
from composenet.metrics.evaluate import posed_truths, tracking_frames
from composenet.metrics.objects import TruthVolumes
from composenet.metrics.records import MATCH_GATE_M
from composenet.records import FloatArray, SequenceTruth, TrackedObject


@dataclass(frozen=True)
class TrackletCompletion:
    """A track over the frames in which CLEAR MOT matches it to one object. volume_iou: mean over
    these frames, 0..1, of the track's final reconstruction placed by its pose there."""

    track_id: int
    gt_id: int
    frames: int
    volume_iou: float


def tracklet_completions(
    truth: SequenceTruth,
    tracked: Sequence[Sequence[TrackedObject]],
    canonical: Mapping[int, FloatArray],
) -> tuple[TrackletCompletion, ...]:
    """Of every track and counted object that match in some frame, by track and object.

    tracked: one entry for every frame of the truth. canonical: (64, 64, 64) in 0..1 by track id;
    tracks without one are left out. Volumes are those of the completion metric: world frame, cells
    of 2.5 cm.
    """
    frames = tracking_frames(truth, tracked)
    true_volume = TruthVolumes()
    values: dict[tuple[int, int], list[float]] = {}
    for frame, matches, entries, present in zip(
        frames, correspondences(frames, MATCH_GATE_M), tracked, posed_truths(truth), strict=True
    ):
        posed = {item.truth.gt_id: item for item in present}
        similarities = {entry.track_id: entry.S_world_canonical for entry in entries}
        pairs = zip(frame.track_ids[matches.columns], frame.gt_ids[matches.rows], strict=True)
        for track_id, gt_id in ((int(track), int(gt)) for track, gt in pairs):
            if track_id not in canonical:
                continue
            S = similarities[track_id]
            box = OrientedBox(S.t, S.R, np.full(3, S.scale_m, dtype=np.float64))
            found = voxelize(canonical[track_id] >= OCCUPIED, box)
            overlap = volume_iou(true_volume(posed[gt_id]), found)
            values.setdefault((track_id, gt_id), []).append(overlap)
    return tuple(
        TrackletCompletion(*pair, len(ious), float(np.mean(ious)))
        for pair, ious in sorted(values.items())
    )
