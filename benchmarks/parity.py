"""Our tracking metrics against py-motmetrics and TrackEval, on the same ids and distances.

Neither library is a dependency of ours, and none of the three shall bend the others' versions of
numpy, so this runs in two halves, each in an environment of its own (commands in
benchmarks/README.md):

python benchmarks/parity.py cases --data DIR --results OUT --file cases.json
    in ours: what `composenet bench --data DIR --out OUT` tracked, sequence by sequence and class by
    class, and random cases of many shapes, with our scores;
python benchmarks/parity.py compare --file cases.json --out benchmarks/results/parity.json
    in theirs: the same scores by both libraries, and the largest differences.

Where the libraries disagree with each other, each is compared with our own rules of its kind
(`composenet.metrics.clear.Convention`); the table counts those cases. Distances are continuous:
with ties the best assignment is not unique. A metric is compared where it is defined: MOTA needs
truth, MOTP a match, the others truth or predictions.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import math
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

GATE_M = 0.25
TOLERANCE = 1e-9
RANDOM_CASES = 300
COUNTS = ("FN", "FP", "IDSW", "Frag", "MT", "ML")
METRICS = {
    "trackeval": ("MOTA", *COUNTS, "MOTP", "IDF1", "HOTA", "DetA", "AssA"),
    "motmetrics": ("MOTA", *COUNTS, "MOTP", "IDF1"),
}
PACKAGES = {"trackeval": "trackeval", "motmetrics": "motmetrics", "numpy": "numpy"}

Case = dict[str, Any]
"""name, frames [{gt_ids, track_ids, distance_m (null: a match is forbidden)}], ours by library"""


def main() -> int:
    """The program; exit code 1 where a difference exceeds the tolerance."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    halves = parser.add_subparsers(dest="half", required=True)
    cases = halves.add_parser("cases")
    cases.add_argument("--data", type=Path, required=True)
    cases.add_argument("--results", type=Path, required=True)
    compare = halves.add_parser("compare")
    compare.add_argument("--out", type=Path)
    for half in (cases, compare):
        half.add_argument("--file", type=Path, required=True)
    asked = parser.parse_args()
    if asked.half == "cases":
        return write_cases(asked.data, asked.results, asked.file)
    return compare_cases(asked.file, asked.out)


# In our environment


def write_cases(data: Path, results: Path, file: Path) -> int:
    """Every case with our scores of it, and where they come from."""
    import composenet
    from composenet.metrics.report import RunInfo

    cases = [*_real_cases(data, results), *_random_cases(np.random.default_rng(0))]
    run = json.loads((results / "results.json").read_text())
    command = "python " + " ".join(sys.argv)
    made = {
        **asdict(RunInfo(data.resolve().name, run["seed"], command, run["weights"])),
        "versions": {"composenet": composenet.__version__, "numpy": version("numpy")},
        "tracked_by": run["command"],
        "tracked_at": run["commit"],
    }
    file.write_text(json.dumps({"made": made, "cases": cases}) + "\n")
    print(f"{len(cases)} cases in {file}")
    return 0


def _real_cases(data: Path, results: Path) -> Iterator[Case]:
    """What the rows of a benchmark tracked: each sequence, all classes and each class alone."""
    from composenet.commands.score_cache import kept_sequences
    from composenet.commands.scoring import sequence_folders
    from composenet.metrics.evaluate import tracking_frames

    folders = {folder.name: folder for folder in sequence_folders(data)}
    for name, method, scored in kept_sequences(results / "sequences"):
        truth = scored.truth(folders[name])
        yield _case(f"{method} {name}", tracking_frames(truth, scored.tracked))
        for class_id in sorted({item.class_id for item in truth.objects}):
            ids = {item.gt_id for item in truth.objects if item.class_id == class_id}
            frames = [tuple(o for o in frame if o.gt_id in ids) for frame in truth.frames]
            tracked = [[e for e in f if e.class_id == class_id] for f in scored.tracked]
            alone = type(truth)(truth.objects, tuple(frames), truth.image_size)
            yield _case(f"{method} {name} class {class_id}", tracking_frames(alone, tracked))


def _random_cases(rng: np.random.Generator) -> Iterator[Case]:
    """Objects that walk and tracks that follow them, lose them and swap, or follow nothing."""
    for index in range(RANDOM_CASES):
        objects, length = int(rng.integers(0, 7)), int(rng.integers(0, 25))
        spare = int(rng.integers(0, 5))
        noise_m = rng.choice([0.02, 0.1, 0.2])
        seen, found, swap = rng.choice([0.0, 0.5, 0.9, 1.0], 3, p=[0.1, 0.3, 0.3, 0.3])
        names = rng.permutation(1000)
        places = rng.uniform(0, rng.choice([0.3, 1.0, 4.0]), (objects + spare, 3))
        followed = rng.permutation(objects + spare)
        frames = []
        for _ in range(length):
            places += rng.normal(0, 0.05, places.shape)
            if len(followed) > 1 and rng.random() < 0.2 * swap:
                a, b = rng.choice(len(followed), 2, replace=False)
                followed[[a, b]] = followed[[b, a]]
            present = np.flatnonzero(rng.random(objects) < seen)
            tracked = np.flatnonzero(rng.random(len(followed)) < found)
            at = places[followed[tracked]] + rng.normal(0, noise_m, (len(tracked), 3))
            distance_m = np.linalg.norm(places[present][:, None] - at[None], axis=2)
            distance_m[rng.random(distance_m.shape) < 0.05] = np.inf  # another class
            frames.append((names[present], names[500 + tracked], distance_m))
        yield _case(f"random {index}", frames)


def _case(name: str, frames: list[Any]) -> Case:
    from composenet.metrics.clear import Convention, clear_mot
    from composenet.metrics.hota import hota_scores
    from composenet.metrics.identity import identity_scores
    from composenet.metrics.records import TrackingFrame

    frames = [f if isinstance(f, TrackingFrame) else TrackingFrame(*f) for f in frames]
    identity, hota = identity_scores(frames, GATE_M), hota_scores(frames, GATE_M)
    ours = {}
    for library in METRICS:
        clear = clear_mot(frames, GATE_M, Convention(library))
        values = {
            "MOTA": clear.mota,
            "FN": clear.fn,
            "FP": clear.fp,
            "IDSW": clear.id_switches,
            "Frag": clear.fragmentations,
            "MT": clear.mostly_tracked,
            "ML": clear.mostly_lost,
            "MOTP": clear.motp_cm / 100,
            "IDF1": identity.idf1,
            "HOTA": hota.hota,
            "DetA": hota.det_a,
            "AssA": hota.ass_a,
        }
        ours[library] = {key: _number(values[key]) for key in METRICS[library]}
    return {
        "name": name,
        "frames": [
            {
                "gt_ids": frame.gt_ids.tolist(),
                "track_ids": frame.track_ids.tolist(),
                "distance_m": [[_number(d) for d in row] for row in frame.distance_m.tolist()],
            }
            for frame in frames
        ],
        "ours": ours,
    }


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


# In theirs


def compare_cases(file: Path, out: Path | None) -> int:
    """Score every case by both libraries; print and keep the largest differences."""
    data = json.loads(file.read_text())
    cases, made = data["cases"], data["made"]
    scorers: dict[str, Callable[[Case], dict[str, float]]] = {
        "trackeval": _trackeval_scorer(),
        "motmetrics": _motmetrics_scorer(),
    }
    theirs = {name: [scorer(case) for case in cases] for name, scorer in scorers.items()}
    table = {
        library: {metric: _compared(cases, library, theirs[library], metric) for metric in metrics}
        for library, metrics in METRICS.items()
    }
    rows = [(library, metric, row) for library, by in table.items() for metric, row in by.items()]
    for library, metric, row in rows:
        print(
            f"{library:10s} {metric:5s} {row['compared']:5d} cases  largest difference "
            f"{row['largest_difference']:.1e}  {row['at'] or ''}"
        )
    split = _disagreements(theirs)
    shown = ", ".join(f"{metric} in {count}" for metric, count in split.items())
    print(f"{len(cases)} cases; the two libraries differ from each other: {shown}")
    equal = all(row["largest_difference"] <= TOLERANCE for _, _, row in rows)
    if out is not None:
        kinds = [case["name"].split()[0] for case in cases]
        result = {
            **made,
            "compared_by": "python " + " ".join(sys.argv),
            "versions": {
                **made["versions"],
                **{f"{name} (theirs)": version(package) for name, package in PACKAGES.items()},
            },
            "cases": {kind: kinds.count(kind) for kind in dict.fromkeys(kinds)},
            "tolerance": TOLERANCE,
            "equal": equal,
            "libraries": table,
            "cases_where_the_libraries_differ": split,
        }
        out.write_text(json.dumps(result, indent=2) + "\n")
    return 0 if equal else 1


def _compared(
    cases: list[Case], library: str, theirs: list[dict[str, float]], metric: str
) -> dict[str, Any]:
    """How many cases define a metric, and where ours is farthest from theirs."""
    largest, at, compared = 0.0, None, 0
    for case, scores in zip(cases, theirs, strict=True):
        value, ours = scores[metric], case["ours"][library][metric]
        if not _defined(case, metric, ours):
            continue
        compared += 1
        difference = abs(value - ours) if ours is not None else math.inf
        if not difference <= largest:  # NaN, too
            largest, at = difference, case["name"]
    return {"compared": compared, "largest_difference": largest, "at": at}


def _defined(case: Case, metric: str, ours: float | None) -> bool:
    truths = sum(len(frame["gt_ids"]) for frame in case["frames"])
    predictions = sum(len(frame["track_ids"]) for frame in case["frames"])
    if metric in COUNTS:
        return True
    if metric == "MOTA":
        return truths > 0
    return ours is not None if metric == "MOTP" else truths + predictions > 0


def _disagreements(theirs: dict[str, list[dict[str, float]]]) -> dict[str, int]:
    pairs = list(zip(theirs["trackeval"], theirs["motmetrics"], strict=True))
    return {
        metric: sum(a[metric] != b[metric] for a, b in pairs)
        for metric in ("FN", "FP", "IDSW", "Frag", "MT", "ML")
    }


def _distances(frame: dict[str, Any]) -> np.ndarray:
    shape = len(frame["gt_ids"]), len(frame["track_ids"])
    values = [np.inf if d is None else d for row in frame["distance_m"] for d in row]
    return np.array(values, dtype=float).reshape(shape)


def _trackeval_scorer() -> Callable[[Case], dict[str, float]]:
    with contextlib.redirect_stdout(io.StringIO()):  # it prints what it lacks for other data sets
        from trackeval.metrics import CLEAR, HOTA, Identity
    quiet = {"PRINT_CONFIG": False, "THRESHOLD": 0.5}
    clear, hota, identity = CLEAR(quiet), HOTA(), Identity(quiet)

    def score(case: Case) -> dict[str, float]:
        frames = case["frames"]
        gt_ids = sorted({i for frame in frames for i in frame["gt_ids"]})
        track_ids = sorted({i for frame in frames for i in frame["track_ids"]})
        data = {
            "num_timesteps": len(frames),
            "num_gt_ids": len(gt_ids),
            "num_tracker_ids": len(track_ids),
            "num_gt_dets": sum(len(frame["gt_ids"]) for frame in frames),
            "num_tracker_dets": sum(len(frame["track_ids"]) for frame in frames),
            "gt_ids": [np.searchsorted(gt_ids, f["gt_ids"]).astype(int) for f in frames],
            "tracker_ids": [np.searchsorted(track_ids, f["track_ids"]).astype(int) for f in frames],
            # centre distances as TrackEval's own 3D data sets have them: the gate is at 0.5
            "similarity_scores": [np.maximum(0, 1 - _distances(f) / (2 * GATE_M)) for f in frames],
        }
        with contextlib.redirect_stdout(io.StringIO()):
            counts, ids = clear.eval_sequence(data), identity.eval_sequence(data)
            higher = hota.eval_sequence(data)
        return {
            "MOTA": float(counts["MOTA"]),
            "FN": int(counts["CLR_FN"]),
            "FP": int(counts["CLR_FP"]),
            **{key: int(counts[key]) for key in ("IDSW", "Frag", "MT", "ML")},
            "MOTP": (1 - float(counts["MOTP"])) * 2 * GATE_M,
            "IDF1": float(ids["IDF1"]),
            **{key: float(np.mean(higher[key])) for key in ("HOTA", "DetA", "AssA")},
        }

    return score


def _motmetrics_scorer() -> Callable[[Case], dict[str, float]]:
    import motmetrics

    names = {
        "mota": "MOTA",
        "num_misses": "FN",
        "num_false_positives": "FP",
        "num_switches": "IDSW",
        "num_fragmentations": "Frag",
        "mostly_tracked": "MT",
        "mostly_lost": "ML",
        "motp": "MOTP",
        "idf1": "IDF1",
    }
    host = motmetrics.metrics.create()

    def score(case: Case) -> dict[str, float]:
        events = motmetrics.MOTAccumulator(auto_id=True)
        for frame in case["frames"]:
            distance = _distances(frame)
            distance[distance >= GATE_M] = np.nan
            events.update(frame["gt_ids"], frame["track_ids"], distance)
        row = host.compute(events, metrics=list(names), return_dataframe=False)
        return {key: float(row[name]) for name, key in names.items()}

    return score


if __name__ == "__main__":
    sys.exit(main())
