"""Weights set against each other on the same sequences: the mean difference of MOTA from the first,
with its standard error.

python benchmarks/paired.py SCORES SCORES... --data DATA --numbers FILE

Each SCORES is the --out folder of `composenet eval --data DATA`, with weights of its own. Open only
folders that you trust: what they keep of each sequence is a pickle.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from figures import read_scores

from composenet.commands.scoring import sequence_folders
from composenet.metrics.report import RunInfo


def main(
    scores: Annotated[tuple[Path, ...], tyro.conf.Positional],
    data: Path,
    numbers: Path,
    variant: str = "full",
) -> None:
    """Raises DataError where something is missing."""
    folders = sequence_folders(data)
    motas: list[dict[Path, float]] = []
    rows = {}
    for folder in scores:
        run, kept = read_scores(folder, folders, variant)
        motas.append({path: 100 * item.scores.clear.mota for path, item in kept.items()})
        mean, error = difference(motas[-1], motas[0])
        told = {"mota_minus_first": mean, "standard_error": error}
        ahead = {key: round(v, 2) if np.isfinite(v) else None for key, v in told.items()}
        name = folder.name if folder.name not in rows else str(folder)
        rows[name] = run | {"variants": {variant: run["variants"][variant] | ahead}}
        print(f"{name}: MOTA {mean:+.2f}, standard error {error:.2f}")
    command = f"python benchmarks/paired.py {' '.join(map(str, scores))} --data {data}"
    info = RunInfo(data.name, 0, f"{command} --variant {variant}")
    numbers.write_text(json.dumps(asdict(info) | {"runs": rows}, indent=2, allow_nan=False) + "\n")


def difference(ours: Mapping[Path, float], first: Mapping[Path, float]) -> tuple[float, float]:
    """Mean of ours minus first over the sequences of both, and its standard error."""
    gaps = np.array([ours[path] - first[path] for path in ours if path in first])
    gaps = gaps[np.isfinite(gaps)]
    if len(gaps) < 2:
        return float("nan"), float("nan")
    return float(gaps.mean()), float(np.std(gaps, ddof=1) / np.sqrt(len(gaps)))


if __name__ == "__main__":
    tyro.cli(main)
