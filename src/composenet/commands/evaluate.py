"""`composenet eval`: track every sequence of a folder and score it, or score what `track` wrote."""

from __future__ import annotations

import os
import pickle
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from rich.console import Console

from composenet.commands.track import _progress
from composenet.errors import DataError
from composenet.metrics.evaluate import DatasetScores, SequenceScores, aggregate, evaluate_sequence
from composenet.metrics.report import RunInfo, sections, to_markdown, to_rich, write_results
from composenet.predictions import read_predictions
from composenet.records import Box, FloatArray, ObjectFrameTruth, SequenceTruth
from composenet.sequences import open_sequence
from composenet.synth.dataset import read_truth

VARIANTS: dict[str, dict[str, bool]] = {
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
    """The command. Finished sequences are kept in `out`, so that a run can be resumed."""
    console = Console()
    folders = sequence_folders(data)
    out.mkdir(parents=True, exist_ok=True)
    if predictions is not None:
        scores = {"predictions": aggregate([score_folder(f, predictions) for f in folders])}
    else:
        unknown = sorted(set(variants) - set(VARIANTS))
        if unknown:
            raise DataError(f"--variants {unknown[0]!r}: expected some of {', '.join(VARIANTS)}")
        scores = _track_and_score(
            folders, out, tuple(variants), weights, device, offline, workers, console
        )
    info = RunInfo(data=data.resolve().name, seed=seed)
    write_results(out / "results.json", info, scores)
    (out / "results.md").write_text(to_markdown(info, scores))
    for section in sections(scores):
        console.print(to_rich(section))
    console.print(f"wrote {out / 'results.json'} and {out / 'results.md'}", highlight=False)
    return 0


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


def _track_and_score(
    folders: list[Path],
    out: Path,
    variants: tuple[str, ...],
    weights: Path | None,
    device: str,
    offline: bool,
    workers: int,
    console: Console,
) -> dict[str, DatasetScores]:
    cache = out / "sequences"
    cache.mkdir(exist_ok=True)
    work = partial(
        score_sequence, weights=weights, device=device, offline=offline, threads=_threads(workers)
    )
    jobs = [(variant, folder) for folder in folders for variant in variants]
    done: dict[tuple[str, Path], SequenceScores] = {}
    with _progress(console) as progress:
        task = progress.add_task("scoring", total=len(jobs), note="")
        missing = []
        for job in jobs:
            stored = cache / f"{job[1].name}.{job[0]}.pkl"
            if stored.exists():
                done[job] = pickle.loads(stored.read_bytes())
                progress.advance(task)
            else:
                missing.append(job)
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            futures = {
                pool.submit(work, folder, variant): (variant, folder) for variant, folder in missing
            }
            for future in as_completed(futures):
                variant, folder = futures[future]
                done[variant, folder] = future.result()
                stored = cache / f"{folder.name}.{variant}.pkl"
                stored.with_suffix(".partial").write_bytes(pickle.dumps(done[variant, folder]))
                stored.with_suffix(".partial").replace(stored)
                progress.update(task, advance=1, note=f"{folder.name} {variant}")
    return {v: aggregate([done[v, folder] for folder in folders]) for v in variants}


def _threads(workers: int) -> int:
    return max(1, (os.cpu_count() or 1) // workers)


def score_sequence(
    folder: Path, variant: str, *, weights: Path | None, device: str, offline: bool, threads: int
) -> SequenceScores:
    """Track one sequence with one variant and score it. Ground truth is read by the scorer only."""
    import torch

    from composenet.pipeline import load_tracker

    torch.set_num_threads(threads)
    tracker = load_tracker(weights, device=device, offline=offline, **VARIANTS[variant])
    frames, tracked, estimates, seconds = [], [], [], []
    sequence = open_sequence(folder)
    for frame in sequence:
        result = tracker(frame)
        frames.append(frame)
        tracked.append(result.objects)
        estimates.append(result.estimates)
        seconds.append(sum(result.timings_ms.values()) / 1e3)
    if offline:
        histories = [entry for track in tracker.tracks() for entry in track.history]
        tracked = [tuple(e for e in histories if e.frame_index == frame.index) for frame in frames]
    truth = moved_truth(read_truth(folder), sequence.T_level_source)
    return evaluate_sequence(truth, tracked, estimates, frames=frames, seconds_per_frame=seconds)


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
