"""Scoring many sequences: in parallel processes, resumed where interrupted, none dropped."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from rich.console import Console

from composenet.commands.progress import progress_bar
from composenet.commands.score_cache import ScoreCache
from composenet.commands.scoring import ScoredSequence
from composenet.errors import ComposenetError
from composenet.files import held
from composenet.metrics.evaluate import DatasetScores, SequenceScores, aggregate
from composenet.process import worker_pool

Job = tuple[str, Path]
"""variant or method, sequence folder"""
Outcome = ScoredSequence | str
"""the scores, or why there are none"""
Work = Callable[[Path, tuple[str, ...]], dict[str, ScoredSequence]]
"""scores a sequence with several variants or methods at once"""

Scores = TypeVar("Scores")
DIED = "the process that scored it died (out of memory?)"


def run_jobs(
    names: Sequence[str],
    folders: Sequence[Path],
    work: Work,
    cache: ScoreCache,
    workers: int,
    console: Console,
) -> dict[Job, Outcome]:
    """Every name's outcome on every folder, name after name, however many workers there are.

    Where a process dies, what others have under way dies with it: these folders are done again,
    each in a process of its own, so that only the one at fault fails. Raises DataError where
    another run is keeping scores in the same folder.
    """
    done: dict[Job, Outcome] = {}
    todo: dict[Path, tuple[str, ...]] = {}
    for folder in folders:
        kept = {name: cache.load(folder, name) for name in names}
        done |= {(name, folder): scores for name, scores in kept.items() if scores is not None}
        if missing := tuple(name for name, scores in kept.items() if scores is None):
            todo[folder] = missing
    with held(cache.folder), progress_bar(console) as progress:
        total = len(folders)
        what = names[0] if len(names) == 1 else f"{len(names)} variants"
        task = progress.add_task(
            f"scoring {what}", total=total, completed=total - len(todo), note=""
        )

        def finish(folder: Path, outcome: dict[str, ScoredSequence] | str) -> None:
            for name in todo[folder]:
                one = outcome if isinstance(outcome, str) else outcome[name]
                done[name, folder] = one
                if isinstance(one, ScoredSequence):
                    cache.save(folder, name, one)
            progress.update(task, advance=1, note=folder.name)

        for folder in _run_pool(todo, work, workers, finish):
            if _run_pool({folder: todo[folder]}, work, 1, finish):
                finish(folder, DIED)
    return {(name, folder): done[name, folder] for name in names for folder in folders}


def _run_pool(
    todo: Mapping[Path, tuple[str, ...]],
    work: Work,
    workers: int,
    finish: Callable[[Path, dict[str, ScoredSequence] | str], None],
) -> list[Path]:
    """Run the work in processes, reporting each folder as it ends; those that a dying process
    took along."""
    lost = []
    with worker_pool(workers) as pool:
        futures = {
            pool.submit(guarded, work, folder, names): folder for folder, names in todo.items()
        }
        for future in as_completed(futures):
            try:
                outcome = future.result()
            except BrokenProcessPool:
                lost.append(futures[future])
            else:
                finish(futures[future], outcome)
    return sorted(lost, key=list(todo).index)


def guarded(work: Callable[..., Scores], *arguments: object) -> Scores | str:
    """What the work gives, or one line on why it failed: no sequence may stop the others."""
    try:
        return work(*arguments)
    except ComposenetError as error:
        return str(error)
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        return f"{reason} ({Path(place.filename).name}, line {place.lineno})"


def aggregated(outcomes: Mapping[Job, Outcome]) -> dict[str, DatasetScores]:
    """By variant or method, over the sequences that could be scored, in their order."""
    scored: dict[str, dict[str, SequenceScores]] = {}
    for (name, folder), outcome in outcomes.items():
        if isinstance(outcome, ScoredSequence):
            scored.setdefault(name, {})[folder.name] = outcome.scores
    return {
        name: replace(aggregate(parts), track_iou=_track_iou(name, outcomes))
        for name, parts in scored.items()
    }


def _track_iou(name: str, outcomes: Mapping[Job, Outcome]) -> float:
    """See DatasetScores."""
    ious = [
        item.volume_iou
        for (other, _), outcome in outcomes.items()
        if other == name and isinstance(outcome, ScoredSequence)
        for item in outcome.completions
    ]
    return sum(ious) / len(ious) if ious else float("nan")


def failure_lines(outcomes: Mapping[Job, Outcome]) -> list[str]:
    """One line for every sequence that could not be scored."""
    return [
        f"not scored: {folder.name} ({name}): {outcome}"
        for (name, folder), outcome in outcomes.items()
        if isinstance(outcome, str)
    ]
