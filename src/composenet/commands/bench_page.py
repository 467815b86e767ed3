"""The page that `composenet bench` writes: tables, what each row was told, where each fails."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from composenet.baselines.mask_rcnn import frames_learned, mask_rcnn_masks
from composenet.baselines.records import Cameras, unwrapped
from composenet.baselines.registry import ROWS
from composenet.commands.failures import LEGEND, PICTURES, picture, worst_frames
from composenet.commands.jobs import Job, Outcome, aggregated, failure_lines
from composenet.commands.scoring import VARIANTS, ScoredSequence
from composenet.files import write_atomic
from composenet.metrics.evaluate import bootstrap_interval
from composenet.metrics.report import RunInfo, to_markdown

PAPERS_LEAD = 6.5
"""points of MOTA by which the paper's full system is ahead of its best other row"""
_OURS = {
    "full": "ComPoseNet",
    "no-compl": "ComPoseNet without completion",
    "no-corr": "ComPoseNet without correspondences",
    "no-corr-no-compl": "ComPoseNet without correspondences and completion",
}


_POSES = {
    Cameras.GIVEN: " to all alike.",
    Cameras.ESTIMATED: ". Those of ComPoseNet are from odometry, which is told nothing; where its "
    "world lies is taken from the true pose of the first frame, for the scoring alone, and frames "
    "where it loses the camera count as seen by nobody. The others track their own camera from "
    "the true pose of the first frame on.",
}


def write_page(
    page: Path, info: RunInfo, outcomes: Mapping[Job, Outcome], cameras: Cameras
) -> None:
    """Write the page; its pictures lie beside it, in a folder of its name."""
    page.parent.mkdir(parents=True, exist_ok=True)
    parts = [
        f"# Benchmark: {info.data}",
        f"Made on {info.date} by `{info.command}`; our weights: {info.weights or 'none'}.",
        markdown(info, outcomes, cameras),
        _failures(page, outcomes),
    ]
    write_atomic(page, ("\n\n".join(parts) + "\n").encode(errors="replace"))


def markdown(info: RunInfo, outcomes: Mapping[Job, Outcome], cameras: Cameras) -> str:
    """The tables, who is ahead, what each row is and was told, and what could not be scored."""
    counts = _sequence_counts(outcomes)
    partial = {name: f"{name} ({done} of {of})" for name, (done, of) in counts.items() if done < of}
    scores = {partial.get(name, name): row for name, row in aggregated(outcomes).items()}
    notes = [
        to_markdown(info, scores).rstrip(),
        "Tracking: a match needs the class to be equal and the centres to be under 25 cm apart; "
        "intervals are 95 %, by bootstrap over sequences. Seconds are those of the machine above, "
        "with as many processes as the command says and whatever else it had to do, but for "
        "sequences whose scores an earlier command had kept.",
        *_lead(outcomes),
        f"Camera poses: {cameras.value}{_POSES[cameras]}",
        "Rows that are told where each track starts see surfaces only, so the centre of an object "
        "is unknown to them. As the paper grants, each of their tracks begins at the true centre "
        "of its object (its first frame is moved there, and the estimated motion carries it on), "
        "one that begins after a loss as well: an advantage. The "
        "ComPoseNet rows are not helped so and are told no ground truth.",
        *_on_masks(counts),
        "\n".join(_row_line(name) for name in counts),
    ]
    failed = failure_lines(outcomes)
    return "\n\n".join([*notes, *(["\n".join(f"- {line}" for line in failed)] if failed else [])])


def _on_masks(names: Iterable[str]) -> list[str]:
    """A sentence on the rows that see the masks of our Mask R-CNN, if there are any."""
    rows = [name for name in names if name in ROWS and ROWS[name].masks is mask_rcnn_masks]
    if not rows:
        return []
    return [
        f"The masks of {', '.join(rows)} are those of a Mask R-CNN that has learned from "
        f"{frames_learned():,} generated frames, a small part of what our own detector has seen: "
        "a better one would narrow the gap."
    ]


def _row_line(name: str) -> str:
    """What a row is, by which code, and what it was told."""
    if name in VARIANTS:
        return f"- {name}: {_OURS[name]} (`composenet.pipeline`)."
    row = ROWS[name]
    start = ["where each track starts"] if row.starts_at_true_centre else []
    what = "; ".join([*([row.told] if row.told else []), *start]) or "nothing"
    return f"- {name}: told {what} (`{unwrapped(row.make).__module__}`)."


def _sequence_counts(outcomes: Mapping[Job, Outcome]) -> dict[str, tuple[int, int]]:
    """By row: sequences scored, and asked for."""
    counts: dict[str, tuple[int, int]] = {}
    for (name, _), outcome in outcomes.items():
        done, of = counts.get(name, (0, 0))
        counts[name] = done + isinstance(outcome, ScoredSequence), of + 1
    return counts


def _lead(outcomes: Mapping[Job, Outcome]) -> list[str]:
    """How far our full system is ahead of the best other row, and of the best that sees no true
    masks, each over the sequences of both."""
    motas: dict[str, dict[Path, float]] = {}
    for (name, folder), outcome in outcomes.items():
        if isinstance(outcome, ScoredSequence):
            motas.setdefault(name, {})[folder] = outcome.scores.clear.mota
    ours = motas.pop("full", {})
    others = {name: row for name, row in motas.items() if name in ROWS}
    alike = {name: row for name, row in others.items() if ROWS[name].told is None}
    lines = [_ahead_of(ours, others, "the best other row")]
    if alike != others:
        lines.append(_ahead_of(ours, alike, "the best that is given no true masks"))
    return [line for line in lines if line]


def _ahead_of(
    ours: Mapping[Path, float], others: Mapping[str, Mapping[Path, float]], which: str
) -> str:
    """One sentence on the row with the best mean, of those of all our sequences if there are any;
    empty where there is nothing to compare."""
    if not ours or not others:
        return ""
    others = {name: row for name, row in others.items() if ours.keys() <= row.keys()} or others
    best = max(others, key=lambda name: float(np.nanmean(list(others[name].values()))))
    shared = [folder for folder in ours if folder in others[best]]
    ahead = np.array([ours[folder] - others[best][folder] for folder in shared])
    if not np.isfinite(ahead).any():
        return ""
    points, (low, high) = 100 * float(np.nanmean(ahead)), bootstrap_interval(ahead)
    side = "ahead of" if points >= 0 else "behind"
    short = "" if points >= PAPERS_LEAD else " It falls short of the paper's lead."
    return (
        f"**full is {abs(points):.1f} points of MOTA {side} {best}**, {which} (95 % interval of "
        f"the difference {100 * low:+.1f} to {100 * high:+.1f}; the paper: +{PAPERS_LEAD}).{short}"
    )


def _failures(page: Path, outcomes: Mapping[Job, Outcome]) -> str:
    """Pictures of each row's worst frames; the files and the text that shows them."""
    folder = page.with_suffix("")
    folder.mkdir(exist_ok=True)
    parts = ["## Where each system fails", f"The {PICTURES} worst frames, one a sequence. {LEGEND}"]
    for name in _sequence_counts(outcomes):
        for old in folder.glob(f"{name}-[0-9]*.jpg"):
            old.unlink()
        scored = {
            path: outcome
            for (row, path), outcome in outcomes.items()
            if row == name and isinstance(outcome, ScoredSequence)
        }
        lines = []
        for number, failure in enumerate(worst_frames(scored), start=1):
            shown = picture(failure, scored[failure.folder])
            if shown is not None:
                file = folder / f"{name}-{number}.jpg"
                shown.save(file, quality=85)
                lines.append(f"![{failure.caption}]({file.relative_to(page.parent)})")
            lines.append(f"{failure.caption}\n")
        nothing = "No errors." if scored else "No sequence could be scored."
        parts.append("\n".join([f"### {name}", "", *(lines or [nothing])]).rstrip())
    if not os.listdir(folder):
        folder.rmdir()
    return "\n\n".join(parts)
