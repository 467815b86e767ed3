"""Tiny tracking cases that several metric tests share."""

import numpy as np

from composenet.metrics.records import TrackingFrame


def line(gts: str, tracks: str) -> list[TrackingFrame]:
    """One frame a column; a letter is an id at its own place, '.' absent, rows split by '/'.

    Row r of tracks stands where row r of the truth stands, 10 m from other rows.
    """
    gt_rows, track_rows = gts.split("/"), tracks.split("/")
    frames = []
    for t in range(len(gt_rows[0])):
        gt = [(ord(row[t]), r) for r, row in enumerate(gt_rows) if row[t] != "."]
        track = [(ord(row[t]), r) for r, row in enumerate(track_rows) if row[t] != "."]
        distance = [[10.0 * abs(a - b) for _, b in track] for _, a in gt]
        frames.append(frame([i for i, _ in gt], [i for i, _ in track], distance))
    return frames


def frame(gt_ids, track_ids, distance) -> TrackingFrame:
    return TrackingFrame(
        np.array(gt_ids, dtype=np.int64),
        np.array(track_ids, dtype=np.int64),
        np.array(distance, dtype=float).reshape(len(gt_ids), len(track_ids)),
    )


def random_frames(rng, objects=4, tracks=5, count=12, spread=0.5) -> list[TrackingFrame]:
    frames = []
    for _ in range(count):
        gt_ids = np.flatnonzero(rng.random(objects) < 0.8)
        track_ids = np.flatnonzero(rng.random(tracks) < 0.7)
        distance = spread * rng.random((len(gt_ids), len(track_ids)))
        distance[rng.random(distance.shape) < 0.2] = np.inf
        frames.append(TrackingFrame(gt_ids, track_ids, distance))
    return frames
