"""What `composenet eval` and `composenet bench` share: sequences, and tracks scored on one."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from composenet.errors import DataError
from composenet.geometry.transform import inverse_T
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
    TrackedObject,
)
from composenet.sequences.recording import RecordedSequence
from composenet.synth.sequence_folder import annotated_folders, read_truth

VARIANTS: dict[str, dict[str, Any]] = {
    "full": {"use_correspondences": True, "use_completion": True},
    "no-compl": {"use_correspondences": True, "use_completion": False},
    "no-corr": {"use_correspondences": False, "use_completion": True},
    "no-corr-no-compl": {"use_correspondences": False, "use_completion": False},
}
"""The paper's table 1."""

WAYS: dict[str, dict[str, Any]] = {
    name: {**options, "offline": False} for name, options in VARIANTS.items()
} | {
    "offline" if name == "full" else f"offline-{name}": {**options, "offline": True}
    for name, options in VARIANTS.items()
}
"""The variants, which see nothing to come, and each of them looking back, as the paper does."""


@dataclass(frozen=True)
class ScoredSequence:
    """One sequence. tracked: what was scored; errors: of the tracks. Both have one entry for every
    frame of the ground truth. completions: of the tracks, empty where they have no
    reconstructions. T_world_source: (4, 4), maps the world of the sequence's poses to that of what
    was tracked."""

    scores: SequenceScores
    tracked: tuple[tuple[TrackedObject, ...], ...]
    errors: tuple[FrameErrors, ...]
    completions: tuple[TrackletCompletion, ...] = ()
    T_world_source: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))

    def truth(self, folder: Path) -> SequenceTruth:
        """The ground truth of its folder, in the world of what was tracked."""
        return moved_truth(read_truth(folder), self.T_world_source)


def score_tracks(
    truth: SequenceTruth,
    tracked: Sequence[Sequence[TrackedObject]],
    estimates: Sequence[Sequence[ObjectEstimate]] | None = None,
    *,
    frames: Sequence[Frame] | None = None,
    seconds_per_frame: Sequence[float] = (),
    canonical: Mapping[int, FloatArray] | None = None,
) -> ScoredSequence:
    """Score what was tracked in the truth's world, and keep it. canonical: (64, 64, 64) in 0..1,
    reconstructions by track id. See `evaluate_sequence`."""
    scores = evaluate_sequence(
        truth, tracked, estimates, frames=frames, seconds_per_frame=seconds_per_frame
    )
    errors = frame_errors(tracking_frames(truth, tracked))
    completions = tracklet_completions(truth, tracked, canonical or {})
    kept = tuple(tuple(entries) for entries in tracked)
    return ScoredSequence(scores, kept, tuple(errors), completions, truth.T_world_source)


def sequence_folders(data: Path) -> list[Path]:
    """Folders with annotations.json, in name order; or `data` itself. Raises DataError."""
    if not data.is_dir():
        raise DataError(f"{data}: no such folder; make one with `composenet synth --out {data}`")
    folders = annotated_folders(data)
    if not folders:
        raise DataError(f"{data}: no sequence with an annotations.json in it, nothing to score")
    return folders


def truth_of(
    folder: Path, sequence: RecordedSequence, odometry_first: Frame | None = None
) -> SequenceTruth:
    """The ground truth of a written sequence in the world of its frames. odometry_first: the first
    of them where odometry has placed them, which tells where its world lies. Raises DataError where
    the truth is of more or fewer frames than the recording has."""
    truth = read_truth(folder)
    if sequence.recorded != len(truth.frames):
        raise DataError(
            f"{folder}: {sequence.recorded} frames, but annotations.json tells of "
            f"{len(truth.frames)}; frame N of the one would be scored by another of the other: "
            "write or copy the sequence again"
        )
    if odometry_first is None:
        return moved_truth(truth, sequence.T_level_source)
    T_source_camera = true_cameras(folder, [odometry_first.name])[0]
    return moved_truth(truth, odometry_first.T_world_camera @ inverse_T(T_source_camera))


def true_cameras(folder: Path, names: Sequence[str]) -> NDArray[np.float64]:
    """(N, 4, 4) poses of frames of a written sequence, by name."""
    return np.array([np.loadtxt(folder / "pose" / f"{name}.txt") for name in names])


def moved_truth(truth: SequenceTruth, T_level_source: FloatArray) -> SequenceTruth:
    """The ground truth in the levelled world that tracking used; boxes drawn tight anew."""
    hulls = {item.gt_id: item.hull for item in truth.objects}

    def moved(entry: ObjectFrameTruth) -> ObjectFrameTruth:
        T_world_object = T_level_source @ entry.T_world_object
        points = hulls[entry.gt_id] @ T_world_object[:3, :3].T + T_world_object[:3, 3]
        low, high = points.min(axis=0), points.max(axis=0)
        box = Box((low + high) / 2, high - low)
        return replace(entry, T_world_object=T_world_object, box=box)

    return replace(
        truth,
        frames=tuple(tuple(map(moved, frame)) for frame in truth.frames),
        T_world_source=T_level_source @ truth.T_world_source,
    )


def claim_scores(out: Path, data: Path) -> None:
    """Make the folder that scores go to. Raises DataError where it holds a results.json that is
    not of `eval` or `bench`, or is of another data folder."""
    out.mkdir(parents=True, exist_ok=True)
    path, name = out / "results.json", data.resolve().name
    if not path.exists():
        return
    try:
        earlier = json.loads(path.read_text())
        of = str(earlier["data"]) if "variants" in earlier else None
    except (OSError, ValueError, TypeError, KeyError):
        of = None
    if of != name:
        what = "a results.json that is not ours" if of is None else f"the scores of {of!r}"
        raise DataError(f"{out}: holds {what}; give another --out folder for those of {name!r}")


def tall_table(section: Section) -> Table:
    """A section with its variants side by side, so that it fits a narrow terminal."""
    names, *values = zip(section.columns, *section.rows, strict=True)
    return to_rich(Section(section.title, names, tuple(values)))
