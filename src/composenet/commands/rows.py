"""A comparison system of the benchmark's table, scored on a sequence."""

from __future__ import annotations

from pathlib import Path

from composenet.baselines.records import Cameras, Row
from composenet.baselines.run import run_system
from composenet.baselines.start_shift import start_at_true_centres
from composenet.commands.scoring import ScoredSequence, score_tracks, truth_of
from composenet.sequences import open_sequence


def score_system(folder: Path, row: Row, cameras: Cameras, *, device: str) -> ScoredSequence:
    """Track one sequence and score the tracks. device: of the network that masks come from."""
    sequence = open_sequence(folder)
    run = run_system(row.make(cameras), row.masks(folder, device), sequence, cameras)
    truth = truth_of(folder, sequence)
    # Frames that could not be read count as seen by nobody.
    tracked = [run.tracked.get(index, ()) for index in range(len(truth.frames))]
    if row.starts_at_true_centre:
        tracked = start_at_true_centres(truth, tracked)
    return score_tracks(truth, tracked, seconds_per_frame=run.seconds)
