"""`composenet eval`: track every sequence of a folder and score it, or score what `track` wrote."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console

from composenet.commands.jobs import aggregated, failure_lines, guarded, run_jobs
from composenet.commands.score_cache import ScoreCache
from composenet.commands.scoring import (
    WAYS,
    ScoredSequence,
    moved_truth,
    score_tracks,
    sequence_folders,
    tall_table,
)
from composenet.commands.terminal import say
from composenet.errors import DataError
from composenet.files import write_atomic
from composenet.metrics.report import RunInfo, sections, to_markdown, write_results
from composenet.predictions import read_predictions
from composenet.synth.dataset import read_truth


def run_eval(
    data: Path,
    out: Path,
    *,
    variants: Sequence[str],
    predictions: Path | None,
    weights: Path | None,
    device: str,
    workers: int,
    seed: int,
) -> int:
    """The command. Finished sequences are kept in `out`, so that a run can be resumed. A sequence
    that cannot be scored is named at the end and makes the exit code 1."""
    console = Console()
    from composenet.network.weights import default_weights, weights_id

    folders = sequence_folders(data)
    unknown = sorted(set(variants) - set(WAYS))
    if unknown:
        raise DataError(f"--variants {unknown[0]!r}: expected some of {', '.join(WAYS)}")
    out.mkdir(parents=True, exist_ok=True)
    if predictions is not None:
        outcomes = {("predictions", f): guarded(score_folder, f, predictions) for f in folders}
        cache = ScoreCache(out / "sequences", (), Path(os.devnull))
        for (name, folder), outcome in outcomes.items():
            if isinstance(outcome, ScoredSequence):
                cache.save(folder, name, outcome)
    else:
        from composenet.commands.variants import score_variants, variant_cache
        from composenet.pipeline import load_tracker

        weights = weights or default_weights()
        load_tracker(weights, device=device)  # what is wrong with them is said once
        cache = variant_cache(out, weights, device)
        work = partial(score_variants, weights=weights, device=device)
        names = list(dict.fromkeys(variants))
        outcomes = run_jobs(names, folders, work, cache, workers, console)
    scores, lines = aggregated(outcomes), failure_lines(outcomes)
    made_with = weights_id(weights) if weights else ""
    command = " ".join(["composenet", *sys.argv[1:]])
    info = RunInfo(data.resolve().name, seed, command, made_with)
    if scores:
        write_results(out / "results.json", info, scores, lines)
        text = "\n".join([to_markdown(info, scores), *lines])
        write_atomic(out / "results.md", text.encode(errors="replace"))
        for section in sections(scores):
            console.print(tall_table(section))
        paths = f"{out / 'results.json'} and {out / 'results.md'}"
        say(console, f"wrote {paths}")
    for line in lines:
        print(f"composenet: {line}", file=sys.stderr)
    return 1 if lines else 0


def score_folder(folder: Path, predictions: Path) -> ScoredSequence:
    """Score one result folder of `track` (PREDICTIONS/NAME, or PREDICTIONS itself). Raises
    DataError where it is of another sequence."""
    own = predictions / folder.name
    own = own if own.is_dir() else predictions
    run, name = read_predictions(own), folder.resolve().name
    if run.sequence != name:
        raise DataError(
            f"{own}: a result of {run.sequence!r}, not of {name!r}; "
            f"give what `composenet track {folder}` wrote"
        )
    if not run.frames:
        raise DataError(f"{own}: no tracked frame in it; run `composenet track {folder}` first")
    truth = read_truth(folder)
    by_index = {frame.index: frame.objects for frame in run.frames}
    if missing := set(range(len(truth.frames))) - by_index.keys():
        raise DataError(
            f"{own}: tells of {len(truth.frames) - len(missing)} of the {len(truth.frames)} frames "
            f"of {name}, not of frame {min(missing)}; track all of them, without --stride and "
            "--max-frames and to the end"
        )
    if len(by_index) < len(run.frames):
        raise DataError(f"{own}: tells of a frame twice; each has one entry in tracks.json")
    first = run.frames[0]
    T_source_camera = np.loadtxt(folder / "pose" / f"{first.name}.txt")
    truth = moved_truth(truth, first.T_world_camera @ np.linalg.inv(T_source_camera))
    tracked = [by_index[i] for i in range(len(truth.frames))]
    return score_tracks(truth, tracked, canonical=run.canonical)
