"""How good the meshes of the tracks are, and their sizes along their own axes.

python benchmarks/shapes.py DATA [--workers 2] [--out benchmarks/results/shapes.json]

DATA is a folder of sequences with ground truth (`composenet synth`). Every sequence is tracked. A
track's object is the one of its class whose centre is nearest, if that is within the gate of CLEAR
MOT. Meshes are compared once a track, in the last frame that saw it; sizes in every frame that did.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from concurrent.futures import as_completed
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import trimesh
import tyro
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from composenet.commands.scoring import sequence_folders, truth_of
from composenet.metrics.completion import VOXEL_M, voxelize_truth
from composenet.metrics.evaluate import posed_truths
from composenet.metrics.objects import PosedTruth
from composenet.metrics.records import MATCH_GATE_M
from composenet.metrics.report import RunInfo
from composenet.network.weights import default_weights, weights_id
from composenet.pipeline import load_tracker
from composenet.process import worker_pool
from composenet.records import CLASS_NAMES, TrackedObject
from composenet.sequences import open_sequence
from composenet.view.meshes import FAINT, SURE, canonical_mesh, place

NEAR_M = 0.05
LEVELS = {"meshes": FAINT, "meshes_at_half": SURE}
"""the lowest level of the surface; the second cuts everywhere where a cell is half as sure as the
surest"""


@dataclass(frozen=True)
class MeshError:
    """A mesh against the true solid. precision, recall: share of its surface within 5 cm of the
    true one, and of the true one within 5 cm of it. chamfer_cm: mean of the two mean distances.
    missing_below_cm: how far its lowest point is above the object's."""

    precision: float
    recall: float
    f_score: float
    chamfer_cm: float
    missing_below_cm: float


@dataclass(frozen=True)
class ShapesOf:
    """One sequence: by entry of LEVELS errors of meshes with class, and (class, (3,) difference of
    extents to the true ones, metres, along the object's axes)."""

    meshes: dict[str, list[tuple[int, MeshError]]]
    sizes: list[tuple[int, NDArray[np.float64]]]


def mesh_error(mesh: trimesh.Trimesh, gt: PosedTruth) -> MeshError:
    """Of a mesh in the world. The true surface are its cells of 2.5 cm, of ours as many points."""
    surface = voxelize_truth(gt.truth, gt.placed.T_world_object).surface()
    count = max(100, round(float(mesh.area) / VOXEL_M**2))
    points = trimesh.sample.sample_surface(mesh, count, seed=0)[0]
    to_true, to_mesh = cKDTree(surface).query(points)[0], cKDTree(points).query(surface)[0]
    precision, recall = float((to_true < NEAR_M).mean()), float((to_mesh < NEAR_M).mean())
    bottom = gt.placed.box.center[2] - gt.placed.box.extents[2] / 2
    return MeshError(
        precision,
        recall,
        2 * precision * recall / max(precision + recall, 1e-9),
        50 * float(to_true.mean() + to_mesh.mean()),
        100 * float(mesh.bounds[0, 2] - bottom),
    )


def size_error(entry: TrackedObject, gt: PosedTruth) -> NDArray[np.float64]:
    """(3,) metres, front to back, side to side, up. Sides are told apart by the pose."""
    R_true_ours = gt.placed.T_world_object[:3, :3].T @ entry.S_world_canonical.R
    turned = abs(R_true_ours[1, 0]) > abs(R_true_ours[0, 0])
    ours = entry.extents_m[[1, 0, 2]] if turned else entry.extents_m
    return np.asarray(ours - gt.truth.extents_m, dtype=np.float64)


def object_of(entry: TrackedObject, truths: Sequence[PosedTruth]) -> PosedTruth | None:
    """The counted object of its class that is nearest, None beyond the gate."""
    same = [gt for gt in truths if not gt.ignored and gt.truth.class_id == entry.class_id]
    away = [float(np.linalg.norm(gt.placed.box.center - entry.box.center)) for gt in same]
    nearest = int(np.argmin(away)) if away else -1
    return same[nearest] if away and away[nearest] < MATCH_GATE_M else None


def shapes_of(folder: Path, weights: Path) -> ShapesOf:
    """Track a sequence and compare."""
    torch.set_num_threads(1)
    tracker, sequence = load_tracker(weights), open_sequence(folder)
    for frame in sequence:
        tracker(frame)
    truths = posed_truths(truth_of(folder, sequence))
    result = ShapesOf({name: [] for name in LEVELS}, [])
    for track in tracker.tracks():
        seen = [
            (entry, object_of(entry, truths[entry.frame_index]))
            for entry in track.history
            if entry.observed
        ]
        result.sizes.extend((track.class_id, size_error(entry, gt)) for entry, gt in seen if gt)
        last, gt = seen[-1] if seen else (None, None)
        if last is None or gt is None:
            continue
        for name, level in LEVELS.items():
            mesh = canonical_mesh(track.canonical, level)
            if mesh is not None:
                placed = place(mesh, last.S_world_canonical)
                result.meshes[name].append((track.class_id, mesh_error(placed, gt)))
    return result


def mesh_rows(errors: Sequence[tuple[int, MeshError]]) -> dict[str, dict[str, float]]:
    """Means of all and by class; of the missing height the median."""

    def row(some: Sequence[MeshError]) -> dict[str, float]:
        columns = {name: [asdict(e)[name] for e in some] for name in asdict(some[0])}
        missing = columns.pop("missing_below_cm")
        shares = {k: round(float(np.mean(v)), 3) for k, v in columns.items()}
        return (
            {"tracks": len(some)}
            | shares
            | {"missing_below_cm": round(float(np.median(missing)), 1)}
        )

    return {name: row(some) for name, some in _grouped(errors)}


def size_rows(errors: Sequence[tuple[int, NDArray[np.float64]]]) -> dict[str, dict[str, object]]:
    """Medians of the difference and of its size, of all and by class."""
    return {
        name: {
            "object_frames": len(some),
            "bias_cm": (100 * np.median(some, axis=0)).round(1).tolist(),
            "error_cm": (100 * np.median(np.abs(some), axis=0)).round(1).tolist(),
        }
        for name, some in _grouped(errors)
    }


def _grouped(errors: Sequence[tuple[int, object]]) -> Iterator[tuple[str, list]]:
    yield "all", [error for _, error in errors]
    for class_id, name in enumerate(CLASS_NAMES):
        if some := [error for own, error in errors if own == class_id]:
            yield name, some


def main(
    data: Annotated[Path, tyro.conf.Positional],
    weights: Path | None = None,
    workers: int = 1,
    out: Path | None = None,
) -> None:
    """Print what all sequences together give."""
    path = weights or default_weights()
    folders = sequence_folders(data)
    found: dict[Path, ShapesOf] = {}
    with worker_pool(workers) as pool:
        jobs = {pool.submit(partial(shapes_of, weights=path), f): f for f in folders}
        for job in as_completed(jobs):
            found[jobs[job]] = job.result()
            print(f"{jobs[job].name} done, {len(found)} of {len(folders)}", flush=True)
    ordered = [found[folder] for folder in folders]
    rows: dict[str, object] = {
        name: mesh_rows([error for one in ordered for error in one.meshes[name]]) for name in LEVELS
    }
    rows["sizes"] = size_rows([error for one in ordered for error in one.sizes])
    print(json.dumps(rows, indent=2))
    if out is not None:
        info = RunInfo(
            data.resolve().name, 0, f"python benchmarks/shapes.py {data}", weights_id(path)
        )
        out.write_text(json.dumps(asdict(info) | rows, indent=2) + "\n")


if __name__ == "__main__":
    tyro.cli(main)
