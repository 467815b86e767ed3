"""`composenet eval`: track every sequence of a folder and score it, or score what `track` wrote."""

from __future__ import annotations

import signal
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from composenet.commands.progress import progress_bar
from composenet.commands.score_cache import ScoreCache
from composenet.errors import ComposenetError, DataError
from composenet.metrics.evaluate import DatasetScores, SequenceScores, aggregate, evaluate_sequence
from composenet.metrics.report import (
    RunInfo,
    Section,
    sections,
    to_markdown,
    to_rich,
    write_results,
)
from composenet.predictions import read_predictions
from composenet.records import Box, FloatArray, ObjectFrameTruth, SequenceTruth
from composenet.sequences import open_sequence
from composenet.synth.dataset import read_truth

Job = tuple[str, Path]
"""variant, sequence folder"""
Outcome = SequenceScores | str
"""the scores, or why there are none"""

VARIANTS: dict[str, dict[str, Any]] = {
    "full": {},
    "no-compl": {"use_completion": False},
    "no-corr": {"use_correspondences": False},
    "no-corr-no-compl": {"use_correspondences": False, "use_completion": False},
}
"""The paper's table 1."""


def run_eval(
    data: Path,
    out: Path,
    *,
    variants: Sequence[str],
    predictions: Path | None,
    weights: Path | None,
    device: str,
    offline: bool,
    workers: int,
    seed: int,
) -> int:
    """The command. Finished sequences are kept in `out`, so that a run can be resumed. A sequence
    that cannot be scored is named at the end and makes the exit code 1."""
    console = Console()
    from composenet.network.weights import default_weights, weights_id

    folders = sequence_folders(data)
    unknown = sorted(set(variants) - set(VARIANTS))
    if unknown:
        raise DataError(f"--variants {unknown[0]!r}: expected some of {', '.join(VARIANTS)}")
    out.mkdir(parents=True, exist_ok=True)
    if predictions is not None:
        outcomes = {("predictions", f): _guarded(score_folder, f, predictions) for f in folders}
    else:
        from composenet.pipeline import load_tracker

        weights = weights or default_weights()
        load_tracker(weights, device=device)  # what is wrong with them is said once
        cache = ScoreCache(out / "sequences", weights, device, offline)
        jobs = [(variant, folder) for variant in dict.fromkeys(variants) for folder in folders]
        work = partial(score_sequence, weights=weights, device=device, offline=offline)
        outcomes = _score_all(jobs, work, cache, workers, console)
    failed = {job: outcome for job, outcome in outcomes.items() if isinstance(outcome, str)}
    scores = _aggregated(outcomes)
    made_with = weights_id(weights) if weights else ""
    command = " ".join(["composenet", *sys.argv[1:]])
    info = RunInfo(data.resolve().name, seed, command, made_with)
    lines = [
        f"not scored: {folder.name} ({name}): {failed[name, folder]}" for name, folder in failed
    ]
    if scores:
        write_results(out / "results.json", info, scores)
        (out / "results.md").write_text("\n".join([to_markdown(info, scores), *lines]))
        for section in sections(scores):
            console.print(tall_table(section))
        paths = f"{out / 'results.json'} and {out / 'results.md'}"
        console.print(f"wrote {paths}", highlight=False, soft_wrap=True)
    for line in lines:
        print(f"composenet: {line}", file=sys.stderr)
    return 1 if failed else 0


def tall_table(section: Section) -> Table:
    """A section with its variants side by side, so that it fits a narrow terminal."""
    names, *values = zip(section.columns, *section.rows, strict=True)
    return to_rich(Section(section.title, names, tuple(values)))


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


def score_folder(folder: Path, predictions: Path) -> SequenceScores:
    """Score one result folder of `track` (PREDICTIONS/NAME, or PREDICTIONS itself)."""
    own = predictions / folder.name
    run = read_predictions(own if own.is_dir() else predictions)
    if not run.frames:
        raise DataError(f"{own}: no tracked frame in it; run `composenet track {folder}` first")
    first = run.frames[0]
    T_source_camera = np.loadtxt(folder / "pose" / f"{first.name}.txt")
    truth = moved_truth(read_truth(folder), first.T_world_camera @ np.linalg.inv(T_source_camera))
    by_index = {frame.index: frame.objects for frame in run.frames}
    return evaluate_sequence(truth, [by_index.get(i, ()) for i in range(len(truth.frames))])


def _aggregated(outcomes: Mapping[Job, Outcome]) -> dict[str, DatasetScores]:
    """By variant, over the sequences that could be scored, in their order."""
    scored: dict[str, list[SequenceScores]] = {}
    for (variant, _), outcome in outcomes.items():
        if isinstance(outcome, SequenceScores):
            scored.setdefault(variant, []).append(outcome)
    return {variant: aggregate(parts) for variant, parts in scored.items()}


def _score_all(
    jobs: Sequence[Job],
    work: Callable[[Path, str], SequenceScores],
    cache: ScoreCache,
    workers: int,
    console: Console,
) -> dict[Job, Outcome]:
    """Every job's outcome, in the order of the jobs, however many workers there are."""
    done: dict[Job, Outcome] = {}
    for variant, folder in jobs:
        if (stored := cache.load(folder, variant)) is not None:
            done[variant, folder] = stored
    with progress_bar(console) as progress, _pool(workers) as pool:
        task = progress.add_task("scoring", total=len(jobs), completed=len(done), note="")
        futures = {
            pool.submit(_guarded, work, folder, variant): (variant, folder)
            for variant, folder in jobs
            if (variant, folder) not in done
        }
        for future in as_completed(futures):
            variant, folder = futures[future]
            try:
                outcome = future.result()
            except BrokenProcessPool:
                outcome = "the process that scored it, or one beside it, died (out of memory?)"
            done[variant, folder] = outcome
            if isinstance(outcome, SequenceScores):
                cache.save(folder, variant, outcome)
            progress.update(task, advance=1, note=f"{folder.name} {variant}")
    return {job: done[job] for job in jobs}


@contextmanager
def _pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Worker processes that die of ctrl-C without a word; then nothing more is begun."""
    with ProcessPoolExecutor(workers, get_context("spawn"), initializer=_die_of_ctrl_c) as pool:
        try:
            yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _die_of_ctrl_c() -> None:
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)


def _guarded(work: Callable[..., SequenceScores], *arguments: object) -> Outcome:
    """What the work gives, or one line on why it failed: no sequence may stop the others."""
    try:
        return work(*arguments)
    except ComposenetError as error:
        return str(error)
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        return f"{reason} ({Path(place.filename).name}, line {place.lineno})"


def score_sequence(
    folder: Path, variant: str, *, weights: Path, device: str, offline: bool
) -> SequenceScores:
    """Track one sequence with one variant and score it. Ground truth is read by the scorer only.

    One compute thread: sums are then taken in the same order on every machine.
    """
    import torch

    from composenet.pipeline import load_tracker

    torch.set_num_threads(1)
    tracker = load_tracker(weights, device=device, offline=offline, **VARIANTS[variant])
    sequence = open_sequence(folder)
    frames = list(sequence)
    results = {frame.index: tracker(frame) for frame in frames}
    seconds = [sum(result.timings_ms.values()) / 1e3 for result in results.values()]
    tracked = {index: result.objects for index, result in results.items()}
    if offline:
        histories = [entry for track in tracker.tracks() for entry in track.history]
        tracked = {i: tuple(e for e in histories if e.frame_index == i) for i in results}
    truth = moved_truth(read_truth(folder), sequence.T_level_source)
    blank = replace(frames[0], depth_m=np.zeros_like(frames[0].depth_m))
    shown = {frame.index: frame for frame in frames}
    every = range(len(truth.frames))  # frames that could not be read count as seen by nobody
    return evaluate_sequence(
        truth,
        [tracked.get(i, ()) for i in every],
        [results[i].estimates if i in results else () for i in every],
        frames=[shown.get(i, blank) for i in every],
        seconds_per_frame=seconds,
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
