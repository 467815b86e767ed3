"""Scores as tables (Markdown, terminal) and as results.json."""

from __future__ import annotations

import json
import math
import os
import platform
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rich.table import Table

import composenet
from composenet.files import write_atomic
from composenet.metrics.detection import mean_over_classes
from composenet.metrics.evaluate import DatasetScores
from composenet.records import CLASS_NAMES

_UNDEFINED = float("nan")
_QUIET: dict[str, Any] = {"check": True, "capture_output": True, "text": True}


def source_commit() -> str:
    """The git commit of the checkout that runs ("-dirty" where changed), else the version."""
    folder = Path(composenet.__file__).resolve().parent
    git = ["git", "-C", str(folder)]
    try:
        subprocess.run([*git, "ls-files", "--error-unmatch", "__init__.py"], **_QUIET)
        commit = subprocess.run([*git, "rev-parse", "--short=12", "HEAD"], **_QUIET).stdout.strip()
        dirty = subprocess.run([*git, "status", "--porcelain", "-uno"], **_QUIET).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return f"version {composenet.__version__}"
    return commit + ("-dirty" if dirty else "")


def hardware() -> str:
    """Processor, usable cores, and the GPU where torch is in use and has one."""
    name = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        models = [line for line in cpuinfo.read_text().splitlines() if "model name" in line]
        name = models[0].split(":", 1)[1].strip() if models else name
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    torch = sys.modules.get("torch")
    gpu = f", {torch.cuda.get_device_name()}" if torch and torch.cuda.is_available() else ""
    return f"{name}, {cores} cores{gpu}"


@dataclass(frozen=True)
class RunInfo:
    """Where results come from. data: name or folder; seed: of the run or data; command: that
    made them; weights: which; date: ISO, UTC."""

    data: str
    seed: int
    command: str = ""
    weights: str = ""
    commit: str = field(default_factory=source_commit)
    hardware: str = field(default_factory=hardware)
    date: str = field(default_factory=lambda: datetime.now(UTC).date().isoformat())


@dataclass(frozen=True)
class Section:
    """One table: a title, column names and rows of text."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def results(
    info: RunInfo, variants: Mapping[str, DatasetScores], failures: Sequence[str] = ()
) -> dict[str, Any]:
    """What results.json holds: shares as percentages, null where undefined. failures: one line for
    every sequence that could not be scored."""
    return {
        "data": info.data,
        "commit": info.commit,
        "seed": info.seed,
        "hardware": info.hardware,
        "date": info.date,
        "command": info.command,
        "weights": info.weights,
        "variants": {name: _variant(scores) for name, scores in variants.items()},
        "not_scored": list(failures),
    }


def write_results(
    path: Path,
    info: RunInfo,
    variants: Mapping[str, DatasetScores],
    failures: Sequence[str] = (),
) -> None:
    """Write results.json, whole or not at all. Raises DataError."""
    data = results(info, variants, failures)
    write_atomic(path, (json.dumps(data, indent=2, allow_nan=False) + "\n").encode())


def sections(variants: Mapping[str, DatasetScores]) -> list[Section]:
    """The benchmark's tables: one row a variant, for those of single frames only the variants
    that were scored on them."""
    items = list(variants.items())
    single = [(name, scores) for name, scores in items if scores.precisions is not None]
    tables = (
        (
            "tracking, %: MOTA by class, mean over sequences with its 95 % interval, pooled",
            _tracking,
            items,
        ),
        ("tracking events, pooled", _events, items),
        (
            "detection, completion and pose in each frame, with what earlier ones saw",
            _objects,
            single,
        ),
    )
    result = []
    for title, cells, shown in tables:
        rows = [cells(scores) for _, scores in shown]
        if not rows:
            continue
        result.append(
            Section(
                title,
                ("variant", *rows[0]),
                tuple((name, *row.values()) for (name, _), row in zip(shown, rows, strict=True)),
            )
        )
    for title, name in (("detection AP@0.5", "box50"), ("completion AP@0.25", "completion25")):
        columns = ("variant", *CLASS_NAMES, "mean")
        if single:
            result.append(Section(f"{title} by class, %", columns, _class_rows(single, name)))
    return result


def to_markdown(info: RunInfo, variants: Mapping[str, DatasetScores]) -> str:
    """All tables as Markdown, with where they come from."""
    lines = [f"Data {info.data}, commit {info.commit}, seed {info.seed}, {info.hardware}.", ""]
    for section in sections(variants):
        lines += [f"**{section.title}**", "", _line(section.columns)]
        lines += [_line(["---"] * len(section.columns))]
        lines += [*(_line(row) for row in section.rows), ""]
    return "\n".join(lines)


def to_rich(section: Section) -> Table:
    """One table for the terminal."""
    table = Table(title=section.title)
    for index, column in enumerate(section.columns):
        table.add_column(column, justify="left" if index == 0 else "right")
    for row in section.rows:
        table.add_row(*row)
    return table


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _variant(scores: DatasetScores) -> dict[str, Any]:
    pose = scores.pose
    return {
        "sequences": len(scores.mota_by_sequence),
        "mota_mean": _percent(scores.mota_mean),
        "mota_pooled": _percent(scores.clear.mota),
        "mota_per_class": _named([clear.mota for clear in scores.clear_per_class]),
        "idf1": _percent(scores.identity.idf1),
        "hota": _percent(scores.hota.hota),
        "counted": scores.clear.truths,
        "tracked": scores.clear.tp,
        "false_positives": scores.clear.fp,
        "id_switches": scores.clear.id_switches,
        "det_map25": _percent(_map(scores, "box25")),
        "det_map50": _percent(_map(scores, "box50")),
        "completion_map25": _percent(_map(scores, "completion25")),
        "completion_map50": _percent(_map(scores, "completion50")),
        "track_iou": _percent(scores.track_iou),
        "rotation_error_deg_median": _number(pose.rotation_deg_median if pose else _UNDEFINED),
        "translation_error_cm_median": _number(pose.translation_cm_median if pose else _UNDEFINED),
        "pose_recall": _percent(pose.recall if pose else _UNDEFINED),
        "seconds_per_frame_median": _number(scores.seconds_median),
        "mota_interval": [_percent(bound) for bound in scores.mota_interval],
        "det_ap50_per_class": _named(_by_class(scores, "box50")),
        "completion_ap25_per_class": _named(_by_class(scores, "completion25")),
        "mota_per_sequence": {k: _percent(v) for k, v in scores.mota_by_sequence.items()},
    }


def _named(shares: Sequence[float]) -> dict[str, float | None]:
    """Percentages by class name."""
    return {name: _percent(share) for name, share in zip(CLASS_NAMES, shares, strict=True)}


def _percent(share: float) -> float | None:
    return _number(100 * share)


def _number(value: float) -> float | None:
    return None if math.isnan(value) else round(value, 6)


def _text(value: float, digits: int = 1) -> str:
    return "-" if math.isnan(value) else f"{value:.{digits}f}"


def _share(value: float) -> str:
    return _text(100 * value)


def _tracking(scores: DatasetScores) -> dict[str, str]:
    low, high = scores.mota_interval
    per_class = zip(CLASS_NAMES, scores.clear_per_class, strict=True)
    return {
        **{name: _share(clear.mota) for name, clear in per_class},
        "seq. mean": f"{_share(scores.mota_mean)} [{_share(low)}, {_share(high)}]",
        "pooled": _share(scores.clear.mota),
        "IDF1": _share(scores.identity.idf1),
        "HOTA": _share(scores.hota.hota),
        "IDSW": str(scores.clear.id_switches),
        "s / frame": _text(scores.seconds_median, 3),
    }


def _events(scores: DatasetScores) -> dict[str, str]:
    clear = scores.clear
    return {
        "sequences": str(len(scores.mota_by_sequence)),
        "counted": str(clear.truths),
        "FN": str(clear.fn),
        "FP": str(clear.fp),
        "IDSW": str(clear.id_switches),
        "Frag": str(clear.fragmentations),
        "MT": str(clear.mostly_tracked),
        "ML": str(clear.mostly_lost),
        "MOTP cm": _text(clear.motp_cm),
        "DetA %": _share(scores.hota.det_a),
        "AssA %": _share(scores.hota.ass_a),
        "track IoU %": _share(scores.track_iou),
        "s / frame, 95th percentile": _text(scores.seconds_p95, 3),
    }


def _objects(scores: DatasetScores) -> dict[str, str]:
    pose, completion = scores.pose, scores.completion
    return {
        "det. mAP@0.25 %": _share(_map(scores, "box25")),
        "@0.5": _share(_map(scores, "box50")),
        "oriented @0.25": _share(_map(scores, "oriented25")),
        "oriented @0.5": _share(_map(scores, "oriented50")),
        "compl. mAP@0.25 %": _share(_map(scores, "completion25")),
        "compl. @0.5": _share(_map(scores, "completion50")),
        "IoU %": _share(completion.volume_iou if completion else _UNDEFINED),
        "Chamfer cm": _text(completion.chamfer_cm if completion else _UNDEFINED),
        "seen / unseen cm": " / ".join(
            _text(value)
            for value in (
                (completion.seen_cm, completion.unseen_cm)
                if completion
                else (_UNDEFINED, _UNDEFINED)
            )
        ),
        "rot. deg": _text(pose.rotation_deg_median if pose else _UNDEFINED),
        "transl. cm": _text(pose.translation_cm_median if pose else _UNDEFINED),
        "matched %": _share(pose.recall if pose else _UNDEFINED),
        "AUC rot. %": _share(pose.rotation_auc if pose else _UNDEFINED),
        "AUC transl. %": _share(pose.translation_auc if pose else _UNDEFINED),
    }


def _class_rows(
    items: Sequence[tuple[str, DatasetScores]], name: str
) -> tuple[tuple[str, ...], ...]:
    return tuple(
        (variant, *(_share(value) for value in (*_by_class(scores, name), _map(scores, name))))
        for variant, scores in items
    )


def _by_class(scores: DatasetScores, name: str) -> tuple[float, ...]:
    if scores.precisions is None:
        return (_UNDEFINED,) * len(CLASS_NAMES)
    values: tuple[float, ...] = getattr(scores.precisions, name)
    return values


def _map(scores: DatasetScores, name: str) -> float:
    return mean_over_classes(_by_class(scores, name))
