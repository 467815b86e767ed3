"""`composenet eval`: track every sequence of a folder and score it, or score what `track` wrote."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from composenet.commands.jobs import (
    Job,
    Outcome,
    aggregated,
    failure_lines,
    guarded,
    run_jobs,
)
from composenet.commands.score_cache import ScoreCache
from composenet.commands.scoring import (
    WAYS,
    ScoredSequence,
    claim_scores,
    moved_truth,
    score_tracks,
    sequence_folders,
    tall_table,
    true_cameras,
)
from composenet.commands.terminal import say
from composenet.config import Config
from composenet.config import load as load_config
from composenet.errors import DataError
from composenet.files import write_atomic
from composenet.geometry.transform import inverse_T
from composenet.metrics.report import RunInfo, sections, to_markdown, write_results
from composenet.predictions import PredictedSequence, read_predictions
from composenet.synth.sequence_folder import read_truth

SAME_POSE = 0.01
"""metres, and entries of rotations: poses of one camera differ by less"""


def run_eval(
    data: Path,
    out: Path,
    *,
    variants: Sequence[str],
    predictions: Path | None,
    weights: Path | None,
    config: Path | None,
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
    for option, value in (("--config", config), ("--weights", weights)):
        if predictions is not None and value is not None:
            raise DataError(f"{option} is for tracking, not for --predictions; give it to `track`")
    chosen = load_config(config) if config else None
    claim_scores(out, data)
    if predictions is not None:
        outcomes, made_with = _score_predictions(folders, predictions, out), ""
    else:
        weights = weights or default_weights()
        outcomes = _track_and_score(
            folders,
            variants,
            out,
            weights=weights,
            config=chosen,
            device=device,
            workers=workers,
            console=console,
        )
        made_with = weights_id(weights)
    scores, lines = aggregated(outcomes), failure_lines(outcomes)
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


def _score_predictions(folders: Sequence[Path], predictions: Path, out: Path) -> dict[Job, Outcome]:
    """What `track` wrote of every sequence, scored and kept in `out`."""
    outcomes = {("predictions", f): guarded(score_folder, f, predictions) for f in folders}
    cache = ScoreCache(out / "sequences", (), Path(os.devnull))
    for (name, folder), outcome in outcomes.items():
        if isinstance(outcome, ScoredSequence):
            cache.save(folder, name, outcome)
    return outcomes


def _track_and_score(
    folders: Sequence[Path],
    variants: Sequence[str],
    out: Path,
    *,
    weights: Path,
    config: Config | None,
    device: str,
    workers: int,
    console: Console,
) -> dict[Job, Outcome]:
    """Every variant of our tracker on every sequence."""
    from composenet.commands.variants import score_variants, variant_cache
    from composenet.pipeline import load_tracker

    load_tracker(weights, device=device, config=config)  # what is wrong with it is said once
    cache = variant_cache(out, weights, device, config=config)
    work = partial(score_variants, weights=weights, device=device, config=config)
    return run_jobs(list(dict.fromkeys(variants)), folders, work, cache, workers, console)


def score_folder(folder: Path, predictions: Path) -> ScoredSequence:
    """Score one result folder of `track` (PREDICTIONS/NAME, or PREDICTIONS itself). Raises
    DataError where it is of another sequence."""
    own = predictions / folder.name
    own = own if own.is_dir() else predictions
    run, name = read_predictions(own), folder.resolve().name
    if run.sequence != name:
        raise DataError(
            f"{own}: a result of {run.sequence!r}, not of {name!r}; give what `composenet track "
            f"{folder}` wrote, or an OutputWriter of that name"
        )
    if not run.frames:
        raise DataError(f"{own}: no tracked frame in it; run `composenet track {folder}` first")
    truth = read_truth(folder)
    by_index = {frame.index: frame.objects for frame in run.frames}
    if missing := set(range(len(truth.frames))) - by_index.keys() - set(run.skipped):
        raise DataError(
            f"{own}: tells of {len(truth.frames) - len(missing)} of the {len(truth.frames)} frames "
            f"of {name}, not of frame {min(missing)}; track all of them, without --stride and "
            "--max-frames and to the end"
        )
    if len(by_index) < len(run.frames):
        raise DataError(f"{own}: tells of a frame twice; each has one entry in tracks.json")
    truth = moved_truth(truth, _world_of(run, folder, own))
    # Frames that could not be used count as seen by nobody.
    tracked = [by_index.get(i, ()) for i in range(len(truth.frames))]
    return score_tracks(truth, tracked, canonical=run.canonical)


def _world_of(run: PredictedSequence, folder: Path, result: Path) -> NDArray[np.float64]:
    """(4, 4), maps the world of the sequence's poses to that of the result, by the first frame.
    Raises DataError where the result's cameras cannot be those of the sequence."""
    T_world = np.array([frame.T_world_camera for frame in run.frames])
    names = [frame.name for frame in run.frames]
    T_source = true_cameras(folder, names)
    T_world_source: NDArray[np.float64] = T_world[0] @ inverse_T(T_source[0])
    off = np.abs(T_world_source @ T_source - T_world).max(axis=(1, 2))
    if run.T_level_source is not None and off.max() > SAME_POSE:
        raise DataError(
            f"{result}: its camera is elsewhere than that of {folder} in frame "
            f"{names[int(off.argmax())]}; give what `composenet track {folder}` wrote "
            "(T_level_source is null where a tracker had poses of its own)"
        )
    level_by_level = run.T_level_source is None and not T_world[:, :2, 3].any()
    if level_by_level and np.ptp(T_source[:, :3, 3], axis=0).max() > SAME_POSE:
        raise DataError(
            f"{result}: tracked without poses, each frame in a world of its own, and only tracks "
            f"of one world can be scored; track {folder} with its poses or with --odometry"
        )
    return T_world_source
