"""`composenet bench`: the paper's comparison systems and our variants in one table."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from rich.console import Console

from composenet.baselines.ours import OwnCamera, no_masks
from composenet.baselines.records import Cameras, Row
from composenet.baselines.registry import ROWS
from composenet.baselines.run import run_system
from composenet.baselines.start_shift import start_at_true_centres
from composenet.commands.bench_page import write_page
from composenet.commands.jobs import Job, Outcome, aggregated, failure_lines, run_jobs
from composenet.commands.score_cache import ScoreCache
from composenet.commands.scoring import (
    VARIANTS,
    ScoredSequence,
    moved_truth,
    score_tracks,
    score_variants,
    sequence_folders,
    tall_table,
)
from composenet.errors import DataError, WeightsError
from composenet.metrics.report import RunInfo, sections, write_results
from composenet.sequences import open_sequence
from composenet.synth.dataset import read_truth

METHODS = (*ROWS, *reversed(VARIANTS))
"""Rows of the table, in its order."""


@dataclass(frozen=True)
class Asked:
    """What all rows share. weights: of our own network."""

    cameras: Cameras
    weights: Path | None
    device: str


def run_bench(
    data: Path,
    out: Path,
    *,
    methods: Sequence[str],
    camera: Cameras,
    weights: Path | None,
    device: str,
    workers: int,
    report: Path | None = None,
) -> int:
    """The command. Finished sequences are kept in `out`, so that a run can be resumed. A sequence
    that a method fails on is named under the table and makes the exit code 1."""
    console = Console()
    names = chosen_methods(methods)
    folders = sequence_folders(data)
    out.mkdir(parents=True, exist_ok=True)
    asked = _checked(names, Asked(camera, weights, device))
    made_of = _weights_by_row(names, asked, "all" in methods, console)
    names = list(made_of)
    outcomes: dict[Job, Outcome] = {}
    work = partial(score_methods, asked=asked)
    for together in _run_together(names, camera):
        file = made_of[together[0]]
        cache = ScoreCache(out / "sequences", file or Path(os.devnull), camera, device)
        outcomes |= run_jobs(together, folders, work, cache, workers, console)
    scores, lines = aggregated(outcomes), failure_lines(outcomes)
    if scores:
        info = _origin(data, names, asked)
        write_results(out / "results.json", info, scores, lines)
        page = report or out / "results.md"
        write_page(page, info, outcomes, camera)
        for section in sections(scores)[:2]:
            console.print(tall_table(section))
        paths = f"{out / 'results.json'} and {page}"
        console.print(f"wrote {paths}", highlight=False, soft_wrap=True)
    for line in lines:
        print(f"composenet: {line}", file=sys.stderr)
    return 1 if lines else 0


def chosen_methods(asked: Sequence[str]) -> list[str]:
    """The methods by name, in the table's order; `all` is every one. Raises DataError."""
    unknown = sorted(set(asked) - {*METHODS, "all"})
    if unknown or not asked:
        known = ", ".join(("all", *METHODS))
        raise DataError(f"--methods {unknown[0] if unknown else ''!r}: expected some of {known}")
    return [name for name in METHODS if "all" in asked or name in asked]


def _run_together(names: Sequence[str], cameras: Cameras) -> list[list[str]]:
    """Rows that share work: our variants, as long as they see with the same cameras."""
    own = [name for name in names if name in VARIANTS and cameras is Cameras.GIVEN]
    return [*([name] for name in names if name not in own), *([own] if own else [])]


def score_methods(folder: Path, names: Sequence[str], *, asked: Asked) -> dict[str, ScoredSequence]:
    """Some rows over one sequence."""
    if set(names) <= set(VARIANTS) and asked.cameras is Cameras.GIVEN:
        assert asked.weights is not None
        return score_variants(folder, names, weights=asked.weights, device=asked.device)
    return {name: _score_row(folder, name, asked) for name in names}


def _score_row(folder: Path, name: str, asked: Asked) -> ScoredSequence:
    row = ROWS[name] if name in ROWS else _own_row(name, asked)
    return score_system(folder, row, asked.cameras, shifted=name in ROWS)


def score_system(folder: Path, row: Row, cameras: Cameras, *, shifted: bool) -> ScoredSequence:
    """Track one sequence and score the tracks. shifted: they begin at the true centres."""
    sequence = open_sequence(folder)
    run = run_system(row.make(cameras), row.masks(folder), sequence, cameras)
    truth = moved_truth(read_truth(folder), sequence.T_level_source)
    # Frames that could not be read count as seen by nobody.
    tracked = [run.tracked.get(index, ()) for index in range(len(truth.frames))]
    if shifted:
        tracked = start_at_true_centres(truth, tracked)
    return score_tracks(truth, tracked, seconds_per_frame=run.seconds)


def _checked(names: Sequence[str], asked: Asked) -> Asked:
    """With the weights filled in where our own network runs; what is wrong is said once."""
    if not set(names) & set(VARIANTS):
        return Asked(asked.cameras, None, asked.device)
    from composenet.network.weights import default_weights
    from composenet.pipeline import load_tracker

    weights = asked.weights or default_weights()
    load_tracker(weights, device=asked.device)
    return Asked(asked.cameras, weights, asked.device)


def _weights_by_row(
    names: Sequence[str], asked: Asked, lenient: bool, console: Console
) -> dict[str, Path | None]:
    """See `_weights_of`. lenient: a row whose weights are not to be had is left out, and said so,
    instead of WeightsError."""
    found = {}
    for name in names:
        try:
            found[name] = _weights_of(name, asked)
        except WeightsError as error:
            if not lenient:
                raise
            console.print(f"without {name}: {error}", highlight=False, soft_wrap=True)
    return found


def _weights_of(name: str, asked: Asked) -> Path | None:
    """The file that a row's networks are in, if it has any."""
    if name in VARIANTS:
        return asked.weights
    weights = ROWS[name].weights
    return weights() if weights else None


def _own_row(name: str, asked: Asked) -> Row:
    """One of our variants, tracking its own camera."""
    import torch

    from composenet.pipeline import load_tracker

    torch.set_num_threads(1)
    tracker = load_tracker(asked.weights, device=asked.device, **VARIANTS[name])
    return Row(lambda _: OwnCamera(tracker), lambda _: no_masks, told="nothing")


def _origin(data: Path, names: Sequence[str], asked: Asked) -> RunInfo:
    command = " ".join(["composenet", *sys.argv[1:]])
    made_with = ""
    if asked.weights is not None:
        from composenet.network.weights import weights_id

        made_with = weights_id(asked.weights)
    return RunInfo(data.resolve().name, 0, command, made_with)
