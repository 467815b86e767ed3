"""`composenet bench`: the paper's comparison systems and our variants in one table."""

from __future__ import annotations

import inspect
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from rich.console import Console

from composenet.baselines.records import Cameras, Row, unwrapped
from composenet.baselines.registry import ROWS
from composenet.commands.bench_page import write_page
from composenet.commands.jobs import Job, Outcome, aggregated, failure_lines, run_jobs
from composenet.commands.rows import score_system
from composenet.commands.score_cache import ScoreCache
from composenet.commands.scoring import (
    VARIANTS,
    ScoredSequence,
    claim_scores,
    sequence_folders,
    tall_table,
)
from composenet.commands.terminal import say
from composenet.errors import DataError, WeightsError
from composenet.metrics.report import RunInfo, sections, write_results

METHODS = (*ROWS, *reversed(VARIANTS))
"""Rows of the table, in its order."""


@dataclass(frozen=True)
class Asked:
    """What all rows share. weights: of our own network. device: of every network."""

    cameras: Cameras
    weights: Path | None
    device: str

    @property
    def odometry(self) -> bool:
        """Whether our own tracker finds the cameras' poses."""
        return self.cameras is Cameras.ESTIMATED


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
    if report is not None and (not report.suffix or report.is_dir()):
        raise DataError(f"--report {report}: name a file, such as {report / 'benchmark.md'}")
    names = chosen_methods(methods)
    folders = sequence_folders(data)
    claim_scores(out, data)
    asked = _checked(names, Asked(camera, weights, device))
    made_of = _weights_by_row(names, asked, "all" in methods, console)
    names = list(made_of)
    outcomes: dict[Job, Outcome] = {}
    work = partial(score_methods, asked=asked)
    own = [name for name in names if name in VARIANTS]  # they share work
    for together in (*([name] for name in names if name not in own), *([own] if own else [])):
        cache = _cache(out, together[0], made_of[together[0]], asked)
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
        say(console, f"wrote {paths}")
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


def score_methods(folder: Path, names: Sequence[str], *, asked: Asked) -> dict[str, ScoredSequence]:
    """Some rows over one sequence."""
    if names[0] in VARIANTS:
        from composenet.commands.variants import score_variants

        assert asked.weights is not None
        return score_variants(
            folder, names, weights=asked.weights, device=asked.device, odometry=asked.odometry
        )
    from composenet.pipeline import select_device

    device = str(select_device(asked.device))
    return {name: score_system(folder, ROWS[name], asked.cameras, device=device) for name in names}


def _cache(out: Path, name: str, weights: Path | None, asked: Asked) -> ScoreCache:
    """Where a row's scores are kept; those of our variants where `composenet eval` keeps them."""
    if name in VARIANTS:
        from composenet.commands.variants import variant_cache

        assert weights is not None
        return variant_cache(out, weights, asked.device, asked.odometry)
    from composenet.pipeline import select_device

    weights, device = weights or Path(os.devnull), str(select_device(asked.device))
    made = (made_by(name), weights, asked.cameras, device)
    return ScoreCache(out / "sequences", *made, *_options(ROWS[name]))


def made_by(name: str) -> list[str]:
    """The modules that score a comparison system."""
    makers = [unwrapped(make).__module__ for make in (ROWS[name].make, ROWS[name].masks)]
    return [score_system.__module__, *makers]


def _options(row: Row) -> list[str]:
    """What of a row its modules do not tell: arguments of partials, by their `repr`, and the file
    of a callable from elsewhere; nothing where it has none of it."""
    told = [] if row.starts_at_true_centre else ["starts where it says"]
    for make in (row.make, row.masks):
        own = unwrapped(make)
        while isinstance(make, partial):
            told.append(repr((make.args, make.keywords)))
            make = make.func
        if not own.__module__.startswith("composenet."):
            plain = inspect.isroutine(own) or inspect.isclass(own)
            told.append(Path(inspect.getfile(own if plain else type(own))).read_text())
    return told


def _checked(names: Sequence[str], asked: Asked) -> Asked:
    """With the weights filled in where our own network runs; what is wrong is said once."""
    from composenet.pipeline import load_tracker, select_device

    select_device(asked.device)
    if not set(names) & set(VARIANTS):
        return Asked(asked.cameras, None, asked.device)
    from composenet.network.weights import default_weights

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
            say(console, f"without {name}: {error}")
    return found


def _weights_of(name: str, asked: Asked) -> Path | None:
    """The file that a row's networks are in, if it has any."""
    if name in VARIANTS:
        return asked.weights
    weights = ROWS[name].weights
    return weights() if weights else None


def _origin(data: Path, names: Sequence[str], asked: Asked) -> RunInfo:
    command = " ".join(["composenet", *sys.argv[1:]])
    made_with = ""
    if asked.weights is not None:
        from composenet.network.weights import weights_id

        made_with = weights_id(asked.weights)
    return RunInfo(data.resolve().name, 0, command, made_with)
