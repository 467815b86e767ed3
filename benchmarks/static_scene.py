"""How still tracks stand in a recording where nothing but the camera moves.

python benchmarks/static_scene.py RESULT [--min-frames 10] [--out benchmarks/results/NAME.json]

RESULT is a folder of `composenet track`. The drift of a track is the median distance of its box's
centre, in the frames that saw it, from the median of these centres.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from composenet.metrics.report import RunInfo
from composenet.predictions import read_predictions
from composenet.records import CLASS_NAMES, TrackedObject


@dataclass(frozen=True)
class Stillness:
    """One track. drift_cm: median; start_to_end_cm: between the medians of the first and last
    quarter of its frames; side_start_cm, side_end_cm: longest horizontal side of its box, medians
    of these quarters: a box that grows as its object comes into view moves its centre, too;
    span_cm: largest distance between two of its centres, which shows a track that slid from one
    object to the next; upright_deg: median angle between its up axis and
    the world's."""

    track_id: int
    class_name: str
    frames_seen: int
    drift_cm: float
    start_to_end_cm: float
    side_start_cm: float
    side_end_cm: float
    span_cm: float
    upright_deg: float


def stillness(track_id: int, class_id: int, seen: list[TrackedObject]) -> Stillness:
    """Measures one track from its observed entries."""
    centers = np.array([entry.box.center for entry in seen])
    away = np.linalg.norm(centers - np.median(centers, axis=0), axis=1)
    quarter = max(1, len(seen) // 4)
    ends = np.median(centers[:quarter], axis=0) - np.median(centers[-quarter:], axis=0)
    sides = [100 * float(entry.box.extents[:2].max()) for entry in seen]
    tilt = [np.degrees(np.arccos(np.clip(e.S_world_canonical.R[2, 2], -1, 1))) for e in seen]
    return Stillness(
        track_id,
        CLASS_NAMES[class_id],
        len(seen),
        float(100 * np.median(away)),
        float(100 * np.linalg.norm(ends)),
        float(np.median(sides[:quarter])),
        float(np.median(sides[-quarter:])),
        float(100 * np.linalg.norm(centers[:, None] - centers[None], axis=-1).max()),
        float(np.median(tilt)),
    )


def main(
    result: Annotated[Path, tyro.conf.Positional], min_frames: int = 10, out: Path | None = None
) -> None:
    """Print a line a track, longest first, and the median drift."""
    run = read_predictions(result)
    rows = []
    for track_id, history in run.histories.items():
        seen = [entry for entry in history if entry.observed]
        if len(seen) >= min_frames:
            rows.append(stillness(track_id, run.class_ids[track_id], seen))
    rows.sort(key=lambda row: -row.frames_seen)
    for row in rows:
        print(
            f"track {row.track_id:3d} {row.class_name:10s} seen {row.frames_seen:4d}  "
            f"drift {row.drift_cm:5.1f} cm  start to end {row.start_to_end_cm:5.1f} cm  "
            f"side {row.side_start_cm:4.0f} to {row.side_end_cm:4.0f} cm  "
            f"span {row.span_cm:5.1f} cm  tilt {row.upright_deg:4.1f} deg"
        )
    median = float(np.median([row.drift_cm for row in rows])) if rows else None
    print(f"{len(rows)} tracks seen in {min_frames} or more frames; median drift: {median} cm")
    if out is not None:
        command = f"benchmarks/static_scene.py {result} --min-frames {min_frames}"
        info = asdict(RunInfo(run.sequence, 0, command, run.weights_id, run.commit))
        tracks = [asdict(row) for row in rows]
        data = info | {"median_drift_cm": median, "tracks": tracks}
        out.write_text(json.dumps(data, indent=2) + "\n")


if __name__ == "__main__":
    tyro.cli(main)
