"""The text of tracks.json and tracks.txt. docs/output.md describes both."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from composenet.geometry.transform import quaternion_from_rotation
from composenet.predictions import SCHEMA, FrameRecord, PredictedSequence
from composenet.records import CLASS_NAMES, FloatArray, TrackedObject

TEXT_HEADER = "frame,track_id,class,score,cx,cy,cz,ex,ey,ez,qw,qx,qy,qz,scale,state"
AXES = (
    "metres; world right-handed, z up; camera x right, y down, z forward; canonical axes "
    "x front, y left, z up, box diagonal 1; p_world = scale * R(quaternion) @ p_canonical + t"
)


@dataclass(frozen=True)
class FrameText:
    """One frame as it stands in the files: an element of tracks.json, lines of tracks.txt."""

    json: str
    lines: tuple[str, ...]


def frame_text(frame: FrameRecord) -> FrameText:
    """Encode one frame. Numbers of the JSON read back exactly."""
    entries = frame.objects
    rotations = np.array([entry.S_world_canonical.R for entry in entries]).reshape(-1, 3, 3)
    quaternions = quaternion_from_rotation(rotations) if entries else rotations
    pairs = list(zip(entries, quaternions, strict=True))
    data = {
        "index": int(frame.index),
        "name": frame.name,
        "timestamp_s": None if frame.timestamp_s is None else float(frame.timestamp_s),
        "T_world_camera": np.asarray(frame.T_world_camera, dtype=np.float64).tolist(),
        "objects": [_object(entry, wxyz) for entry, wxyz in pairs],
    }
    lines = tuple(_line(entry, wxyz) for entry, wxyz in pairs)
    return FrameText(json.dumps(data, allow_nan=False), lines)


def tracks_json(run: PredictedSequence, frames: Sequence[FrameText]) -> str:
    """The whole of tracks.json, one line a frame. frames: those of the run, encoded."""
    K = np.asarray(run.camera.K, dtype=np.float64)
    level = run.T_level_source
    head = {
        "schema": SCHEMA,
        "meta": {
            "sequence": run.sequence,
            "complete": run.complete,
            "commit": run.commit,
            "weights": run.weights_id,
            "camera": {"K": K.tolist(), "width": run.camera.width, "height": run.camera.height},
            "T_level_source": None if level is None else np.asarray(level, np.float64).tolist(),
            "skipped": [int(index) for index in run.skipped],
            "classes": list(CLASS_NAMES),
            "axes": AXES,
            "warnings": list(run.warnings),
        },
        "tracks": [_track(run, *item) for item in run.histories.items()],
    }
    body = ",\n".join(frame.json for frame in frames)
    return f'{json.dumps(head, allow_nan=False)[:-1]}, "frames": [\n{body}\n]}}\n'


def tracks_text(frames: Sequence[FrameText]) -> str:
    """The whole of tracks.txt."""
    return "\n".join([TEXT_HEADER, *(line for frame in frames for line in frame.lines), ""])


def _object(entry: TrackedObject, wxyz: FloatArray) -> dict[str, Any]:
    S = entry.S_world_canonical
    return {
        "id": int(entry.track_id),
        "class": entry.class_name,
        "state": entry.state.value,
        "confidence": float(entry.confidence),
        "observed": bool(entry.observed),
        "box": {"center": _floats(entry.box.center), "extents": _floats(entry.box.extents)},
        "S_world_canonical": {
            "scale": float(S.scale_m),
            "quaternion_wxyz": _floats(wxyz),
            "t": _floats(S.t),
        },
        "extents": _floats(entry.extents_m),
    }


def _line(entry: TrackedObject, wxyz: FloatArray) -> str:
    scale = entry.S_world_canonical.scale_m
    numbers = [*entry.box.center, *entry.box.extents, *wxyz, scale]
    head = f"{entry.frame_index},{entry.track_id},{entry.class_name}"
    text = ",".join(f"{value:.6f}" for value in numbers)
    return f"{head},{entry.confidence:.6f},{text},{entry.state.value}"


def _track(
    run: PredictedSequence, track_id: int, history: Sequence[TrackedObject]
) -> dict[str, Any]:
    ply = run.mesh_files.get(track_id)
    return {
        "id": int(track_id),
        "class": CLASS_NAMES[run.class_ids[track_id]],
        "first_frame": int(history[0].frame_index),
        "last_frame": int(history[-1].frame_index),
        "observed_frames": sum(entry.observed for entry in history),
        "meshes": {"ply": ply, "glb": ply.removesuffix("ply") + "glb"} if ply else None,
    }


def _floats(values: FloatArray) -> list[float]:
    return [float(value) for value in values]
