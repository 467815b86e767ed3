"""What `composenet eval` and `composenet bench` share: sequences, and our tracker scored on one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.table import Table

from composenet.errors import DataError
from composenet.metrics.clear import FrameErrors, frame_errors
from composenet.metrics.evaluate import SequenceScores, evaluate_sequence, tracking_frames
from composenet.metrics.report import Section, to_rich
from composenet.metrics.tracklets import TrackletCompletion, tracklet_completions
from composenet.records import (
    Box,
    FloatArray,
    Frame,
    ObjectEstimate,
    ObjectFrameTruth,
    SequenceTruth,
    Track,
    TrackedObject,
)
from composenet.sequences import open_sequence
from composenet.synth.dataset import read_truth

if TYPE_CHECKING:
    from composenet.pipeline import FrameResult

VARIANTS: dict[str, dict[str, Any]] = {
    "full": {},
    "no-compl": {"use_completion": False},
    "no-corr": {"use_correspondences": False},
    "no-corr-no-compl": {"use_correspondences": False, "use_completion": False},
}
"""The paper's table 1."""


@dataclass(frozen=True)
class ScoredSequence:
    """One sequence. tracked: what was scored, in the levelled world; errors: of the tracks. Both
    have one entry for every frame of the ground truth. completions: of the tracks, empty where
    they have no reconstructions."""

    scores: SequenceScores
    tracked: tuple[tuple[TrackedObject, ...], ...]
    errors: tuple[FrameErrors, ...]
    completions: tuple[TrackletCompletion, ...] = ()


def score_tracks(
    truth: SequenceTruth,
    tracked: Sequence[Sequence[TrackedObject]],
    estimates: Sequence[Sequence[ObjectEstimate]] | None = None,
    *,
    frames: Sequence[Frame] | None = None,
    seconds_per_frame: Sequence[float] = (),
    canonical: Mapping[int, FloatArray] | None = None,
) -> ScoredSequence:
    """Score what was tracked, and keep it. canonical: (64, 64, 64) in 0..1, reconstructions by
    track id. See `evaluate_sequence`."""
    scores = evaluate_sequence(
        truth, tracked, estimates, frames=frames, seconds_per_frame=seconds_per_frame
    )
    errors = frame_errors(tracking_frames(truth, tracked))
    completions = tracklet_completions(truth, tracked, canonical or {})
    kept = tuple(tuple(entries) for entries in tracked)
    return ScoredSequence(scores, kept, tuple(errors), completions)


def sequence_folders(data: Path) -> list[Path]:
    """Folders with annotations.json, in name order; or `data` itself. Raises DataError."""
    if not data.is_dir():
        raise DataError(f"{data}: no such folder; make one with `composenet synth --out {data}`")
    if (data / "annotations.json").exists():
        return [data]
    folders = sorted(p.parent for p in data.glob("*/annotations.json"))
    if not folders:
        raise DataError(f"{data}: no sequence with an annotations.json in it, nothing to score")
    return folders


def score_variants(
    folder: Path, variants: Sequence[str], *, weights: Path, device: str, offline: bool = False
) -> dict[str, ScoredSequence]:
    """Track one sequence with several variants, which share what they see alike, and score each.
    Ground truth is read by the scorer only.

    One compute thread: sums are then taken in the same order on every machine.
    """
    import torch

    from composenet.pipeline import load_tracker

    torch.set_num_threads(1)
    eyes = load_tracker(weights, device=device, offline=offline)
    trackers = {variant: eyes.restart(**VARIANTS[variant]) for variant in variants}
    results: dict[str, dict[int, FrameResult]] = {variant: {} for variant in variants}
    sequence = open_sequence(folder)
    frames = list(sequence)
    for frame in frames:
        sight = eyes.look(frame)
        for variant, tracker in trackers.items():
            results[variant][frame.index] = tracker.follow(sight)
    truth = moved_truth(read_truth(folder), sequence.T_level_source)
    return {
        variant: _score(truth, frames, results[variant], tracker.tracks(), offline)
        for variant, tracker in trackers.items()
    }


def _score(
    truth: SequenceTruth,
    frames: Sequence[Frame],
    results: Mapping[int, FrameResult],
    tracks: Sequence[Track],
    offline: bool,
) -> ScoredSequence:
    """One variant over one sequence; results by frame index."""
    seconds = [sum(result.timings_ms.values()) / 1e3 for result in results.values()]
    tracked = {index: result.objects for index, result in results.items()}
    if offline:
        histories = [entry for track in tracks for entry in track.history]
        tracked = {i: tuple(e for e in histories if e.frame_index == i) for i in results}
    blank = replace(frames[0], depth_m=np.zeros_like(frames[0].depth_m))
    shown = {frame.index: frame for frame in frames}
    every = range(len(truth.frames))  # frames that could not be read count as seen by nobody
    return score_tracks(
        truth,
        [tracked.get(i, ()) for i in every],
        [results[i].estimates if i in results else () for i in every],
        frames=[shown.get(i, blank) for i in every],
        seconds_per_frame=seconds,
        canonical={track.track_id: track.canonical for track in tracks},
    )


def moved_truth(truth: SequenceTruth, T_level_source: FloatArray) -> SequenceTruth:
    """The ground truth in the levelled world that tracking used; boxes drawn tight anew."""
    hulls = {item.gt_id: item.hull for item in truth.objects}

    def moved(entry: ObjectFrameTruth) -> ObjectFrameTruth:
        T_world_object = T_level_source @ entry.T_world_object
        points = hulls[entry.gt_id] @ T_world_object[:3, :3].T + T_world_object[:3, 3]
        low, high = points.min(axis=0), points.max(axis=0)
        box = Box((low + high) / 2, high - low)
        return replace(entry, T_world_object=T_world_object, box=box)

    return replace(truth, frames=tuple(tuple(map(moved, frame)) for frame in truth.frames))


def tall_table(section: Section) -> Table:
    """A section with its variants side by side, so that it fits a narrow terminal."""
    names, *values = zip(section.columns, *section.rows, strict=True)
    return to_rich(Section(section.title, names, tuple(values)))
