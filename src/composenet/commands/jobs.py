"""Scoring many sequences: in parallel processes, resumed where interrupted, none dropped."""

from __future__ import annotations

import signal
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path

from rich.console import Console

from composenet.commands.progress import progress_bar
from composenet.commands.score_cache import ScoreCache
from composenet.commands.scoring import ScoredSequence
from composenet.errors import ComposenetError
from composenet.metrics.evaluate import DatasetScores, aggregate

Job = tuple[str, Path]
"""variant or method, sequence folder"""
Outcome = ScoredSequence | str
"""the scores, or why there are none"""
Work = Callable[[Path, str], ScoredSequence]

DIED = "the process that scored it died (out of memory?)"


def run_jobs(
    jobs: Sequence[Job], work: Work, cache: ScoreCache, workers: int, console: Console
) -> dict[Job, Outcome]:
    """Every job's outcome, in the order of the jobs, however many workers there are.

    Where a process dies, what others have under way dies with it: these jobs are done again, each
    in a process of its own, so that only the one at fault fails.
    """
    done: dict[Job, Outcome] = {}
    for name, folder in jobs:
        if (stored := cache.load(folder, name)) is not None:
            done[name, folder] = stored
    with progress_bar(console) as progress:
        task = progress.add_task("scoring", total=len(jobs), completed=len(done), note="")

        def finish(job: Job, outcome: Outcome) -> None:
            name, folder = job
            done[job] = outcome
            if isinstance(outcome, ScoredSequence):
                cache.save(folder, name, outcome)
            progress.update(task, advance=1, note=f"{folder.name} {name}")

        lost = _run_pool([job for job in jobs if job not in done], work, workers, finish)
        for job in lost:
            if _run_pool([job], work, 1, finish):
                finish(job, DIED)
    return {job: done[job] for job in jobs}


def _run_pool(
    jobs: Sequence[Job], work: Work, workers: int, finish: Callable[[Job, Outcome], None]
) -> list[Job]:
    """Run jobs in processes, reporting each as it ends; those that a dying process took along."""
    lost = []
    with worker_pool(workers) as pool:
        futures = {
            pool.submit(guarded, work, folder, name): (name, folder) for name, folder in jobs
        }
        for future in as_completed(futures):
            try:
                outcome = future.result()
            except BrokenProcessPool:
                lost.append(futures[future])
            else:
                finish(futures[future], outcome)
    return sorted(lost, key=jobs.index)


@contextmanager
def worker_pool(workers: int) -> Iterator[ProcessPoolExecutor]:
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


def guarded(work: Callable[..., ScoredSequence], *arguments: object) -> Outcome:
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
    scored: dict[str, list[ScoredSequence]] = {}
    for (name, _), outcome in outcomes.items():
        if isinstance(outcome, ScoredSequence):
            scored.setdefault(name, []).append(outcome)
    return {name: aggregate([part.scores for part in parts]) for name, parts in scored.items()}


def failure_lines(outcomes: Mapping[Job, Outcome]) -> list[str]:
    """One line for every sequence that could not be scored."""
    return [
        f"not scored: {folder.name} ({name}): {outcome}"
        for (name, folder), outcome in outcomes.items()
        if isinstance(outcome, str)
    ]
