"""What was tracked in a recording, in memory and on disk (schema `composenet.tracks/1`).

docs/output.md describes the files field by field.
"""

from __future__ import annotations

import json
import zipfile
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from composenet.errors import DataError, SequenceError
from composenet.geometry.transform import rotation_from_quaternion
from composenet.records import (
    CLASS_NAMES,
    Box,
    Camera,
    FloatArray,
    Similarity,
    Track,
    TrackedObject,
    TrackState,
)

SCHEMA = "composenet.tracks/1"
TRACKS_JSON, TRACKS_TXT, CANONICAL = "tracks.json", "tracks.txt", "canonical.npz"
_UNREADABLE = (OSError, ValueError, TypeError, EOFError, zlib.error, zipfile.BadZipFile)
_T = TypeVar("_T")


@dataclass(frozen=True)
class FrameRecord:
    """One frame of a result. T_world_camera: (4, 4). objects: every track that was told
    of."""

    index: int
    name: str
    timestamp_s: float | None
    T_world_camera: FloatArray
    objects: tuple[TrackedObject, ...]


@dataclass(frozen=True)
class PredictedSequence:
    """Everything `track` found in one recording.

    complete: False where the run was interrupted. canonical: of each track id (64, 64, 64)
    float32 in 0..1, the final reconstruction; empty when the run was killed before its end.
    class_ids: final class of each track, by vote. mesh_files: PLY of a track, where it has one,
    relative to the result folder. T_level_source: (4, 4), maps the recording's own world to that
    of the result; None where the recording's poses were not used. skipped: indices of the
    recording's frames that could not be used; why is in the warnings.
    """

    sequence: str
    camera: Camera
    frames: tuple[FrameRecord, ...]
    class_ids: Mapping[int, int]
    canonical: Mapping[int, FloatArray] = field(default_factory=dict)
    mesh_files: Mapping[int, str] = field(default_factory=dict)
    complete: bool = True
    commit: str = ""
    weights_id: str = ""
    warnings: tuple[str, ...] = ()
    T_level_source: FloatArray | None = None
    skipped: tuple[int, ...] = ()

    @property
    def histories(self) -> dict[int, tuple[TrackedObject, ...]]:
        """Entries of every track in frame order, by track id."""
        entries: dict[int, list[TrackedObject]] = {}
        for frame in self.frames:
            for entry in frame.objects:
                entries.setdefault(entry.track_id, []).append(entry)
        return {track_id: tuple(entries[track_id]) for track_id in sorted(entries)}

    @property
    def tracks(self) -> tuple[Track, ...]:
        """The tracks that have a canonical reconstruction."""
        return tuple(
            Track(track_id, self.class_ids[track_id], history, self.canonical[track_id])
            for track_id, history in self.histories.items()
            if track_id in self.canonical
        )


def object_from_json(data: Mapping[str, Any], frame_index: int) -> TrackedObject:
    """One entry of `frames[].objects[]`. Raises KeyError, TypeError or ValueError."""
    S, box = data["S_world_canonical"], data["box"]
    return TrackedObject(
        track_id=int(data["id"]),
        frame_index=frame_index,
        class_id=_class_id(data["class"]),
        state=TrackState(data["state"]),
        confidence=float(data["confidence"]),
        box=Box(_array(box["center"], 3), _array(box["extents"], 3)),
        S_world_canonical=Similarity(
            scale_m=float(S["scale"]),
            R=rotation_from_quaternion(_array(S["quaternion_wxyz"], 4)),
            t=_array(S["t"], 3),
        ),
        extents_m=_array(data["extents"], 3),
        observed=bool(data["observed"]),
    )


def sequence_from_json(data: Mapping[str, Any], where: Path) -> PredictedSequence:
    """The content of tracks.json as a record, without the canonical grids. Raises DataError
    naming the file and the frame or field."""
    if not isinstance(data, dict) or data.get("schema") != SCHEMA:
        found = data.get("schema") if isinstance(data, dict) else type(data).__name__
        raise DataError(f"{where}: schema {found!r} instead of {SCHEMA!r}; run `track` again")
    meta, camera, tracks = _read(where, "meta", lambda: _header(data))
    listed = _read(where, "frames", lambda: list(data["frames"]))
    frames = tuple(
        _read(where, f"frames[{n}]", partial(_frame_from_json, frame))
        for n, frame in enumerate(listed)
    )
    class_ids, mesh_files = _read(where, "tracks", lambda: _tracks_from_json(tracks))
    unknown = {entry.track_id for frame in frames for entry in frame.objects} - set(class_ids)
    if unknown:
        raise DataError(f"{where}: frames hold track {min(unknown)}, which `tracks` does not list")
    return PredictedSequence(
        sequence=str(meta["sequence"]),
        camera=camera,
        frames=frames,
        class_ids=class_ids,
        mesh_files=mesh_files,
        complete=bool(meta["complete"]),
        commit=str(meta["commit"]),
        weights_id=str(meta["weights"]),
        warnings=tuple(meta["warnings"]),
        T_level_source=meta["T_level_source"],
        skipped=meta["skipped"],
    )


def _header(data: Mapping[str, Any]) -> tuple[dict[str, Any], Camera, list[dict[str, Any]]]:
    meta, tracks = dict(data["meta"]), list(data["tracks"])
    for key in ("sequence", "complete", "commit", "weights", "warnings"):
        meta[key]
    level = meta.get("T_level_source")
    meta["T_level_source"] = None if level is None else _array(level, (4, 4))
    meta["skipped"] = tuple(int(index) for index in meta.get("skipped", ()))
    camera = meta["camera"]
    K = _array(camera["K"], (3, 3))
    return meta, Camera(K, int(camera["width"]), int(camera["height"])), tracks


def _tracks_from_json(tracks: list[dict[str, Any]]) -> tuple[dict[int, int], dict[int, str]]:
    class_ids = {int(track["id"]): _class_id(track["class"]) for track in tracks}
    meshes = {int(t["id"]): str(t["meshes"]["ply"]) for t in tracks if t["meshes"]}
    return class_ids, meshes


def _frame_from_json(frame: Mapping[str, Any]) -> FrameRecord:
    index, time = int(frame["index"]), frame["timestamp_s"]
    return FrameRecord(
        index=index,
        name=str(frame["name"]),
        timestamp_s=None if time is None else float(time),
        T_world_camera=_array(frame["T_world_camera"], (4, 4)),
        objects=tuple(object_from_json(entry, index) for entry in frame["objects"]),
    )


def read_predictions(folder: Path) -> PredictedSequence:
    """What `track` wrote to a folder: tracks.json and canonical.npz.

    An interrupted run reads too (complete is False). Raises DataError naming the file.
    """
    path = Path(folder) / TRACKS_JSON
    try:
        data = json.loads(path.read_text())
    except OSError:
        raise DataError(f"{path}: no such file; give a folder that `track` wrote") from None
    except ValueError as error:
        raise DataError(f"{path}: not readable as JSON ({error}); run `track` again") from None
    run = sequence_from_json(data, path)
    return _with_canonical(run, Path(folder) / CANONICAL)


def _with_canonical(run: PredictedSequence, path: Path) -> PredictedSequence:
    if not path.exists() and not run.complete:
        return run
    try:
        with np.load(path, allow_pickle=False) as grids:
            canonical = {int(key.removeprefix("track_")): grids[key] for key in grids.files}
    except _UNREADABLE as error:
        raise DataError(f"{path}: not readable ({error}); run `track` again") from None
    for track_id, grid in canonical.items():
        if grid.shape != (64, 64, 64):
            raise DataError(f"{path}: track {track_id} has shape {grid.shape}, not (64, 64, 64)")
    return replace(run, canonical=canonical)


def _read(where: Path, part: str, read: Callable[[], _T]) -> _T:
    try:
        return read()
    except KeyError as error:
        raise DataError(f"{where}: {part} lacks {error}; run `track` again") from None
    except (TypeError, ValueError, AttributeError, SequenceError) as error:
        raise DataError(f"{where}: {part} is wrong ({error}); run `track` again") from None


def _class_id(name: str) -> int:
    if name not in CLASS_NAMES:
        raise ValueError(f"unknown class {name!r}")
    return CLASS_NAMES.index(name)


def _array(values: Any, shape: int | tuple[int, ...]) -> FloatArray:
    array = np.asarray(values, dtype=np.float64)
    wanted = (shape,) if isinstance(shape, int) else shape
    if array.shape != wanted or not np.isfinite(array).all():
        raise ValueError(f"expected finite numbers of shape {wanted}, found {values}")
    return array
