"""How well odometry finds the camera's way in recordings whose poses are known.

python benchmarks/camera_error.py RECORDINGS... [--out benchmarks/results/odometry.json]

Each is a recording, or a folder of recordings. The error of a frame is the distance between the
found and the true camera, and the angle between them, both told from the first frame's camera: of
the poses as later frames have corrected them, and, `at once`, as each was found.
"""

from __future__ import annotations

import json
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from numpy.typing import NDArray

from composenet.errors import DataError, SequenceError
from composenet.geometry.transform import angle_between_deg, inverse_T
from composenet.metrics.report import RunInfo
from composenet.records import FloatArray
from composenet.sequences import RecordedSequence, open_sequence


@dataclass(frozen=True)
class CameraErrors:
    """Of one recording: (N,) of all frames, in order. cm, degrees: infinite where the camera was
    lost; cm_at_once: before later frames corrected it."""

    name: str
    cm: FloatArray
    degrees: FloatArray
    cm_at_once: FloatArray
    seconds: FloatArray

    @property
    def found(self) -> NDArray[np.bool_]:
        """(N,) where the camera was not lost."""
        return np.isfinite(self.cm)

    @property
    def row(self) -> dict[str, float | str | None]:
        """For the table; errors are of the frames where the camera was not lost."""
        return {
            "recording": self.name,
            "frames": len(self.cm),
            "lost": int((~self.found).sum()),
            "error_cm_median": round(float(np.median(self.cm[self.found])), 1),
            "error_cm_max": round(float(self.cm[self.found].max()), 1),
            "error_cm_end": round(float(self.cm[-1]), 1) if self.found[-1] else None,
            "error_deg_median": round(float(np.median(self.degrees[self.found])), 2),
            "seconds_per_frame_median": round(float(np.median(self.seconds)), 3),
        }


def camera_errors(sequence: RecordedSequence) -> CameraErrors:
    """Follow the camera through a recording with poses."""
    odometry, true, at_once, seconds = sequence.odometry(), [], [], []
    for frame in sequence:
        start = time.perf_counter()
        at_once.append(odometry(frame.depth_m, frame.camera, frame.color))
        seconds.append(time.perf_counter() - start)
        true.append(frame.T_world_camera)
    if all(T is None for T in at_once):
        raise DataError(f"{sequence.name}: odometry found no camera at all in it")
    cm, degrees = _errors(odometry.way(), true)
    return CameraErrors(sequence.name, cm, degrees, _errors(at_once, true)[0], np.array(seconds))


def _errors(
    found: list[NDArray[np.float64] | None], true: list[FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Centimetres and degrees, from the first frame that was found."""
    cm, degrees = np.full(len(true), np.inf), np.full(len(true), np.inf)
    T_found_true = None
    for i, (T, T_true) in enumerate(zip(found, true, strict=True)):
        if T is None:
            continue
        if T_found_true is None:
            T_found_true = T @ inverse_T(T_true)
        expected = T_found_true @ T_true
        cm[i] = 100 * np.linalg.norm(T[:3, 3] - expected[:3, 3])
        degrees[i] = angle_between_deg(T[:3, :3], expected[:3, :3])
    return cm, degrees


def opened(path: Path) -> list[RecordedSequence]:
    """The recording, or those in the folder, that have poses. Raises DataError."""
    try:
        found = [open_sequence(path)]
    except SequenceError:
        folders = sorted(p for p in path.glob("*") if p.is_dir())
        if not folders:
            raise
        found = [open_sequence(folder) for folder in folders]
    if lacking := [sequence.name for sequence in found if not sequence.has_poses]:
        raise DataError(f"{path}: {lacking[0]} has no poses to compare with")
    return found


def main(
    recordings: Annotated[tuple[Path, ...], tyro.conf.Positional], out: Path | None = None
) -> None:
    """Print the errors of each recording and of all: medians of the frames where the camera was not
    lost, shares of all."""
    found = []
    for sequence in (one for path in recordings for one in opened(path)):
        found.append(camera_errors(sequence))
        print(*(f"{name} {value} " for name, value in found[-1].row.items()), flush=True)
    cm = np.concatenate([one.cm for one in found])
    at_once = np.concatenate([one.cm_at_once for one in found])
    ends = np.array([one.cm[-1] for one in found])
    degrees, there = np.concatenate([one.degrees for one in found]), np.isfinite(cm)
    overall = {
        "recordings": len(found),
        "frames": len(cm),
        "lost": int((~there).sum()),
        "error_cm_median": round(float(np.median(cm[there])), 1),
        "error_deg_median": round(float(np.median(degrees[there])), 2),
        "frames_within_5_cm": round(100 * float((cm < 5).mean()), 1),
        "frames_within_25_cm": round(100 * float((cm < 25).mean()), 1),
        "frames_within_5_cm_at_once": round(100 * float((at_once < 5).mean()), 1),
        "frames_within_25_cm_at_once": round(100 * float((at_once < 25).mean()), 1),
        "ends_within_5_cm": round(100 * float((ends < 5).mean()), 1),
        "ends_within_25_cm": round(100 * float((ends < 25).mean()), 1),
        "seconds_per_frame_median": round(
            float(np.median(np.concatenate([one.seconds for one in found]))), 3
        ),
    }
    print(overall)
    if out is not None:
        names = " ".join(str(path) for path in recordings)
        data = ", ".join(path.resolve().name for path in recordings)
        info = RunInfo(data, 0, f"python benchmarks/camera_error.py {names}")
        rows = {"all": overall, "by_recording": [one.row for one in found]}
        out.write_text(json.dumps(asdict(info) | rows, indent=2) + "\n")


if __name__ == "__main__":
    tyro.cli(main)
