"""Our tracker and its variants, scored on a sequence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from composenet.commands.score_cache import ScoreCache
from composenet.commands.scoring import WAYS, ScoredSequence, score_tracks, truth_of
from composenet.config import Config
from composenet.metrics.completion import OCCUPIED
from composenet.objects import CANONICAL_CELLS
from composenet.pipeline import FrameResult, ObjectTracker, load_tracker, select_device
from composenet.records import Frame, ObjectEstimate, SequenceTruth, TrackedObject
from composenet.sequences import SequenceOptions, open_sequence


def score_variants(
    folder: Path,
    variants: Sequence[str],
    *,
    weights: Path,
    device: str,
    odometry: bool = False,
    config: Config | None = None,
) -> dict[str, ScoredSequence]:
    """Track one sequence with several variants, which share what they see alike, and score each.
    Ground truth is read by the scorer only. odometry: without the recording's poses, as `track
    --odometry` does; only where that world lies is taken from the true pose, of its first frame.
    config: instead of the weights' own; the variants replace fields of it.

    One compute thread: sums are then taken in the same order on every machine.
    """
    import torch

    torch.set_num_threads(1)
    eyes = load_tracker(weights, device=device, config=config)
    trackers = {variant: eyes.restart(**WAYS[variant]) for variant in variants}
    results: dict[str, dict[int, _Kept]] = {variant: {} for variant in variants}
    sequence = open_sequence(folder, options=SequenceOptions(odometry=odometry))
    frames = list(sequence)
    seconds = {variant: np.zeros(len(frames)) for variant in variants}

    def follow(place: int, followers: Mapping[str, ObjectTracker]) -> None:
        sight = eyes.look(frames[place])
        for variant, tracker in followers.items():
            result = tracker.follow(sight)
            results[variant][frames[place].index] = _Kept.of(result)
            seconds[variant][place] += sum(result.timings_ms.values()) / 1e3

    for place in range(len(frames)):
        follow(place, trackers)
    if twice := {variant: tracker for variant, tracker in trackers.items() if tracker.looks_twice}:
        for tracker in twice.values():
            tracker.turn_back()
        for place in reversed(range(len(frames))):
            follow(place, twice)
    truth = truth_of(folder, sequence, frames[0] if odometry else None)
    return {
        variant: _score(truth, frames, tracker, results[variant], seconds[variant].tolist())
        for variant, tracker in trackers.items()
    }


@dataclass(frozen=True)
class _Kept:
    """What the scorer needs of a frame's result, in little memory: grids as bits."""

    objects: tuple[TrackedObject, ...]
    estimates: tuple[ObjectEstimate, ...]
    occupied: tuple[NDArray[np.uint8], ...]

    @staticmethod
    def of(result: FrameResult) -> _Kept:
        nothing = np.zeros((0, 3), np.float32)
        return _Kept(
            result.objects,
            tuple(replace(e, points_world=nothing, canonical=nothing) for e in result.estimates),
            tuple(np.packbits(e.canonical >= OCCUPIED) for e in result.estimates),
        )

    def scored(self) -> tuple[ObjectEstimate, ...]:
        """The estimates, with grids of 0 and 1."""
        shape = (CANONICAL_CELLS,) * 3
        grids = [np.unpackbits(bits).reshape(shape).astype(np.float32) for bits in self.occupied]
        return tuple(replace(e, canonical=g) for e, g in zip(self.estimates, grids, strict=True))


class _Estimates(Sequence[tuple[ObjectEstimate, ...]]):
    """Of every frame; each frame's are made when they are looked at."""

    def __init__(self, kept: Sequence[_Kept | None]) -> None:
        self._kept = kept

    def __len__(self) -> int:
        return len(self._kept)

    def __getitem__(self, index: Any) -> Any:
        kept = self._kept[index]
        return () if kept is None else kept.scored()


def _score(
    truth: SequenceTruth,
    frames: Sequence[Frame],
    tracker: ObjectTracker,
    results: Mapping[int, _Kept],
    seconds: Sequence[float],
) -> ScoredSequence:
    """One variant over one sequence; results by frame index."""
    tracks = tracker.tracks()
    tracked: dict[int, Sequence[TrackedObject]] = {i: seen.objects for i, seen in results.items()}
    if tracker.config.tracking.offline:
        entries: dict[int, list[TrackedObject]] = {index: [] for index in results}
        for entry in (entry for track in tracks for entry in track.history):
            entries[entry.frame_index].append(entry)
        tracked = {**entries}
    blank = replace(frames[0], depth_m=np.zeros_like(frames[0].depth_m))
    shown = {frame.index: frame for frame in frames}
    every = range(len(truth.frames))  # frames that could not be used count as seen by nobody
    return score_tracks(
        truth,
        [tracked.get(i, ()) for i in every],
        _Estimates([results.get(i) for i in every]),
        frames=[shown.get(i, blank) for i in every],
        seconds_per_frame=seconds,
        canonical={track.track_id: track.canonical for track in tracks},
    )


def variant_cache(
    out: Path, weights: Path, device: str, odometry: bool = False, config: Config | None = None
) -> ScoreCache:
    """Where the variants' scores are kept."""
    options = (str(select_device(device)), odometry, config)
    return ScoreCache(out / "sequences", [__name__], weights, *options)
