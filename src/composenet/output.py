"""The folder that `track` writes. docs/output.md describes every file in it."""

from __future__ import annotations

import copy
import dataclasses
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import trimesh

from composenet import config as configuration
from composenet.config import Config
from composenet.files import write_atomic
from composenet.predictions import (
    CANONICAL,
    TRACKS_JSON,
    TRACKS_TXT,
    FrameRecord,
    PredictedSequence,
    read_predictions,
)
from composenet.records import Camera, FloatArray, Frame, Track, TrackedObject, TrackState
from composenet.result_folder import CONFIG, REPLAY, REPORT, TIMINGS, claim, clear, writing
from composenet.timings import summarise_timings
from composenet.tracks_file import FrameText, frame_text, tracks_json, tracks_text
from composenet.view.figures import ColoredMesh, overlay, track_color
from composenet.view.meshes import canonical_mesh, last_observed, place, save_mesh
from composenet.view.replay import NoReplay, Replay, open_replay
from composenet.view.report import Picture, write_report

__all__ = ["OutputWriter", "read_predictions"]

TIMINGS_SCHEMA = "composenet.timings/1"
MAX_PICTURES = 12
SAVE_SHARE = 0.05
"""Files are written whole, so they are renewed only once so much has come."""


OTHER_CAMERA = (
    "some frames are of another camera than `meta.camera`, by which they cannot be projected"
)


class OutputWriter:
    """Writes one result folder while frames come in.

    Every `save_every` frames (in long recordings whenever a twentieth has come on top, so that
    writing takes a fixed share of the time), and when left by an exception or ctrl-C, tracks.json,
    tracks.txt and timings.json are written with what is done (meta.complete is false); `finish`
    adds meshes, reconstructions and the report. Files appear whole or not at all; those of an
    earlier run in the same folder are replaced with the first frame.

    commit, weights_id: noted in tracks.json; so is T_level_source, (4, 4), which maps the
    recording's own world to that of the frames, where there is one. replay: write replay.rrd where
    rerun is installed.
    Raises DataError when the folder cannot be written, or holds files of these names that are no
    earlier result.
    """

    def __init__(
        self,
        out_dir: Path,
        sequence_name: str,
        camera: Camera,
        config: Config,
        *,
        commit: str = "",
        weights_id: str = "",
        T_level_source: FloatArray | None = None,
        save_every: int = 50,
        replay: bool = True,
    ) -> None:
        self.out_dir = Path(out_dir)
        self.save_every = save_every
        self._run = PredictedSequence(
            sequence_name,
            camera,
            (),
            {},
            commit=commit,
            weights_id=weights_id,
            complete=False,
            T_level_source=T_level_source,
        )
        self._frames: list[FrameRecord] = []
        self._texts: list[FrameText] = []
        self._timings: list[dict[str, float]] = []
        self._class_ids: dict[int, int] = {}
        self._recording_warnings: tuple[str, ...] = ()
        self._skipped: tuple[int, ...] = ()
        self._warnings: list[str] = []
        self._keepsakes = _Keepsakes()
        self._config, self._wants_replay = config, replay
        self._replay: Replay = NoReplay()
        self._next_save = save_every
        self._begun = self._finished = False
        claim(self.out_dir)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._begun and not self._finished:
            self.save()
            self._replay.close()

    @property
    def frames_taken(self) -> int:
        """How many frames it was given."""
        return len(self._frames)

    def warn(self, text: str) -> None:
        """Add one line to the warnings of the report and of tracks.json."""
        if text not in self._warnings:
            self._warnings.append(text)

    def warn_of_recording(self, lines: Sequence[str], skipped: Sequence[int] = ()) -> None:
        """Warnings about the recording, and the indices of the frames that it could not give, in
        place of those given before: they grow."""
        self._recording_warnings, self._skipped = tuple(lines), tuple(skipped)

    def add_frame(
        self, frame: Frame, tracked: Sequence[TrackedObject], timings_ms: Mapping[str, float]
    ) -> None:
        """Take one tracked frame. timings_ms: milliseconds by stage, stages apart (no sums). Warns
        in the result of a frame of another camera than it was given."""
        self._begin()
        if frame.camera != self._run.camera:
            self.warn(OTHER_CAMERA)
        self._frames.append(
            FrameRecord(
                index=frame.index,
                name=frame.name,
                timestamp_s=frame.timestamp_s,
                T_world_camera=np.array(frame.T_world_camera, dtype=np.float64),
                objects=tuple(tracked),
            )
        )
        self._texts.append(frame_text(self._frames[-1]))
        self._timings.append(dict(timings_ms))
        self._class_ids.update({entry.track_id: entry.class_id for entry in tracked})
        self._keepsakes.offer(len(self._frames) - 1, frame)
        self._replay.add_frame(frame, tracked)
        if len(self._frames) >= self._next_save:
            self.save()

    def save(self) -> None:
        """Write tracks.json, tracks.txt and timings.json with what is done so far."""
        self._begin()
        self._save(self._snapshot())
        done = len(self._frames)
        self._next_save = done + max(self.save_every, int(SAVE_SHARE * done))

    def finish(self, tracks: Sequence[Track], *, complete: bool = True) -> PredictedSequence:
        """Write everything. complete: False after an interruption. Raises DataError.

        tracks: all of them, ended ones too, with whole histories. These replace what add_frame
        was given, so that an offline pass over the sequence is what ends up in the files.
        """
        self._begin()
        canonical = {track.track_id: track.canonical for track in tracks if track.history}
        meshes = {
            track_id: mesh
            for track_id, grid in canonical.items()
            if (mesh := canonical_mesh(grid)) is not None
        }
        self._class_ids = {track.track_id: track.class_id for track in tracks if track.history}
        self._frames = _frames_of(self._frames, tracks)
        self._texts = [frame_text(frame) for frame in self._frames]
        run = dataclasses.replace(self._snapshot(), canonical=canonical, complete=complete)
        placed = self._save_meshes(run, meshes)
        files = {track_id: f"meshes/track_{track_id}.ply" for track_id in placed}
        run = dataclasses.replace(run, mesh_files=files, warnings=self._all_warnings())
        self._save_canonical(canonical)
        self._save(run)
        timings = summarise_timings(self._timings)
        write_report(self.out_dir / REPORT, run, placed, self._pictures(run, meshes), timings)
        self._finished = True
        self._replay.finish(meshes)
        return run

    def _begin(self) -> None:
        """Put this run, still without frames, in the place of an earlier one; once."""
        if self._begun:
            return
        with writing(self.out_dir):
            run = self._snapshot()
            tracks_json(run, self._texts)  # what cannot be written costs no earlier result
            clear(self.out_dir)
            self._save(run)
            configuration.dump(self._config, self.out_dir / CONFIG)
        if self._wants_replay:
            self._replay = open_replay(self.out_dir / REPLAY, self._run.sequence)
        if self._replay.hint:
            self.warn(self._replay.hint)
        self._begun = True

    def _snapshot(self) -> PredictedSequence:
        return dataclasses.replace(
            self._run,
            frames=tuple(self._frames),
            class_ids=dict(self._class_ids),
            warnings=self._all_warnings(),
            skipped=self._skipped,
        )

    def _all_warnings(self) -> tuple[str, ...]:
        return (*self._recording_warnings, *self._warnings)

    def _save(self, run: PredictedSequence) -> None:
        # tracks.json first: by it a folder is known for a result
        write_atomic(self.out_dir / TRACKS_JSON, tracks_json(run, self._texts).encode())
        write_atomic(self.out_dir / TRACKS_TXT, tracks_text(self._texts).encode())
        stages = summarise_timings(self._timings)
        table = {s.stage: {"median_ms": s.median_ms, "p95_ms": s.p95_ms, "n": s.n} for s in stages}
        text = json.dumps({"schema": TIMINGS_SCHEMA, "stages": table}, indent=2)
        write_atomic(self.out_dir / TIMINGS, f"{text}\n".encode())

    def _save_meshes(
        self, run: PredictedSequence, meshes: Mapping[int, trimesh.Trimesh]
    ) -> dict[int, trimesh.Trimesh]:
        """Write the mesh of each track at its last observed pose; returns them, world frame."""
        placed = {}
        for track_id, history in run.histories.items():
            if track_id not in meshes:
                self.warn(f"track {track_id} has an empty reconstruction: no mesh")
                continue
            mesh = place(meshes[track_id], last_observed(history).S_world_canonical)
            if not mesh.is_watertight:
                self.warn(f"mesh of track {track_id} is not watertight")
            stem = self.out_dir / "meshes" / f"track_{track_id}"
            save_mesh(mesh, track_color(track_id), stem)
            placed[track_id] = mesh
        return placed

    def _save_canonical(self, canonical: Mapping[int, np.ndarray]) -> None:
        data = io.BytesIO()
        arrays: dict[str, Any] = {f"track_{i}": np.float32(g) for i, g in canonical.items()}
        np.savez_compressed(data, **arrays)
        write_atomic(self.out_dir / CANONICAL, data.getvalue())

    def _pictures(
        self, run: PredictedSequence, meshes: Mapping[int, trimesh.Trimesh]
    ) -> list[Picture]:
        pictures = []
        for position, frame in self._keepsakes.chosen(MAX_PICTURES):
            objects = run.frames[position].objects
            placed = [
                ColoredMesh(
                    place(meshes[entry.track_id], entry.S_world_canonical),
                    track_color(entry.track_id),
                )
                for entry in objects
                if entry.track_id in meshes and entry.state is not TrackState.ENDED
            ]
            pictures.append(Picture(position, overlay(frame, objects, placed)))
        return pictures


class _Keepsakes:
    """Keeps evenly spaced frames of a stream of unknown length: at most twice MAX_PICTURES."""

    def __init__(self) -> None:
        self._kept: list[tuple[int, Frame]] = []
        self._stride = 1

    def offer(self, position: int, frame: Frame) -> None:
        if position % self._stride == 0:
            self._kept.append((position, copy.deepcopy(frame)))  # a driver may fill its arrays anew
        if len(self._kept) > 2 * MAX_PICTURES:
            self._kept = self._kept[::2]
            self._stride *= 2

    def chosen(self, count: int) -> list[tuple[int, Frame]]:
        if not self._kept:
            return []
        places = np.linspace(0, len(self._kept) - 1, min(count, len(self._kept)))
        return [self._kept[round(place)] for place in places]


def _frames_of(frames: Sequence[FrameRecord], tracks: Sequence[Track]) -> list[FrameRecord]:
    """The frames, with the entries of the tracks' histories, by track id."""
    entries: dict[int, list[TrackedObject]] = {}
    for track in sorted(tracks, key=lambda track: track.track_id):
        for entry in track.history:
            entries.setdefault(entry.frame_index, []).append(entry)
    return [dataclasses.replace(f, objects=tuple(entries.get(f.index, ()))) for f in frames]
