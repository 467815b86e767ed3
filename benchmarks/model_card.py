"""The tables of docs/model_card.md: the shipped weights' own notes and what was measured with them.

python benchmarks/model_card.py [--card docs/model_card.md] [--results benchmarks/results]

Figures come from the results files whose weights are those of the card; others are named, not
shown. A test fails while the card, the weights and the results disagree.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import tyro
from safetensors import safe_open

from composenet.commands.scoring import WAYS
from composenet.config import flat
from composenet.network.weights import default_weights, load_weights, weights_id
from composenet.records import CLASS_NAMES

ROOT = Path(__file__).resolve().parents[1]
BEGIN, END = "<!-- begin: python benchmarks/model_card.py -->", "<!-- end -->"
COLUMNS = {
    "sequences": "sequences",
    "mota_mean": "MOTA, mean",
    "idf1": "IDF1",
    "hota": "HOTA",
    "id_switches": "id switches",
    "det_map25": "detection mAP@0.25",
    "det_map50": "@0.5",
    "completion_map25": "completion mAP@0.25",
    "rotation_error_deg_median": "rotation, deg",
    "translation_error_cm_median": "translation, cm",
    "pose_recall": "posed, %",
    "seconds_per_frame_median": "s a frame",
}
BY_CLASS = {
    "mota_per_class": "MOTA",
    "det_ap50_per_class": "detection AP@0.5",
    "completion_ap25_per_class": "completion AP@0.25",
}


def main(
    card: Path = ROOT / "docs" / "model_card.md", results: Path = ROOT / "benchmarks" / "results"
) -> None:
    """Write the tables anew."""
    text = refreshed(card.read_text(), default_weights(), results)
    card.write_text(text)
    print(f"wrote {card}")


def refreshed(card: str, weights: Path, results: Path) -> str:
    """The card with its tables made anew; what stands outside the two marks is kept."""
    before, rest = card.split(BEGIN)
    after = rest.split(END)[1]
    parts = [about(weights), *figures(weights_id(weights), results)]
    return before + "\n\n".join([BEGIN, *parts, END]) + after


def about(path: Path) -> str:
    """The file, what it says of its own making, and the configuration that it holds."""
    network, _, notes = load_weights(path)
    parameters = sum(value.numel() for value in network.parameters())
    rows = {
        "file": f"`{weights_id(path)}`, {path.stat().st_size / 1e6:.1f} MB",
        "parameters": f"{parameters / 1e6:.2f} million, stored in half precision",
        **{f"made with: {name}": value for name, value in flat(notes).items()},
    }
    with safe_open(path, framework="pt") as file:
        config = json.dumps(json.loads(file.metadata()["config"]), indent=2)
    table = _table(("", ""), [(name, str(value)) for name, value in rows.items()])
    summary = "<details><summary>The configuration inside it</summary>"
    return f"{table}\n\n{summary}\n\n```json\n{config}\n```\n\n</details>"


def figures(identity: str, folder: Path) -> list[str]:
    """Tables of all results made with these weights, and a line on the others. A comparison
    with other systems has a page of its own, and is left out."""
    runs = {path.name: json.loads(path.read_text()) for path in sorted(folder.glob("*.json"))}
    scored = {name: run for name, run in runs.items() if _is_ours(run)}
    own = {name: run for name, run in scored.items() if run["weights"] == identity}
    parts = [*_overall(own), *_by_class(own), *_pictures(runs, identity)]
    others = [f"{name} ({scored[name]['weights']})" for name in scored if name not in own]
    if others:
        parts.append(f"Made with other weights, so not shown here: {', '.join(others)}.")
    return parts


def _is_ours(run: Mapping[str, Any]) -> bool:
    """Scores of our variants and of nothing else."""
    return "variants" in run and set(run["variants"]) <= set(WAYS)


def _overall(runs: Mapping[str, Any]) -> list[str]:
    if not runs:
        return ["Nothing was measured with these weights yet."]
    rows = [
        (f"{_data(run)}, {variant}", *(_number(values[key]) for key in COLUMNS))
        for run in runs.values()
        for variant, values in run["variants"].items()
    ]
    origin = [
        f"- `{name}`: commit {run['commit']}, {run['date']}, seed {run['seed']}, "
        f"{run['hardware']}; `{run['command']}`"
        for name, run in runs.items()
    ]
    return ["## Figures", _table(("data", *COLUMNS.values()), rows), "\n".join(origin)]


def _data(run: Mapping[str, Any]) -> str:
    estimated = "--camera estimated" in run["command"]
    return f"{run['data']} without camera poses" if estimated else run["data"]


def _by_class(runs: Mapping[str, Any]) -> list[str]:
    rows, worst = [], []
    for run in runs.values():
        values = run["variants"].get("full", {})
        where = _data(run)
        for key, name in BY_CLASS.items():
            if any(value is not None for value in values.get(key, {}).values()):
                shown = (_number(values[key][c]) for c in CLASS_NAMES)
                rows.append((f"{where}, {name}", *shown))
        motas = values.get("mota_per_class", {})
        negative = sorted((v, c) for c, v in motas.items() if v is not None and v < 0)
        if negative:
            names = ", ".join(f"{c} ({v:.0f})" for v, c in negative)
            worst.append(f"- {where}: {names}")
    if not rows:
        return []
    parts = ["## By class, *full*, %", _table(("data", *CLASS_NAMES), rows)]
    if worst:
        parts.append(
            "Classes whose tracks do more harm than good (MOTA under 0: more misses, false and "
            "switched tracks than objects):\n\n" + "\n".join(worst)
        )
    return parts


def _pictures(runs: Mapping[str, Any], identity: str) -> list[str]:
    for run in runs.values():
        if "calibration" in run and run["weights"] == identity:
            error = run["calibration"]["tracks"]["expected_calibration_error"]
            return [
                "## Confidence",
                f"Expected calibration error of a track's confidence in a frame on {run['data']}: "
                f"{error:.3f}.",
                "![Share of frames in which a track is right, by its confidence]"
                "(images/calibration.png)",
                "![MOTA of sequences by the completion of their tracks]"
                "(images/mota_completion.png)",
            ]
    return []


def _number(value: float | None) -> str:
    if value is None:
        return "-"
    if isinstance(value, int):
        return str(value)
    return f"{value:.1f}" if abs(value) >= 2 else f"{value:.2f}"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


if __name__ == "__main__":
    tyro.cli(main)
