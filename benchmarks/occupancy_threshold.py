"""Which probability a cell should count as filled from: completion by threshold, measured as
`composenet eval` does.

python benchmarks/occupancy_threshold.py [--weights FILE] [--start 100] [--count 12]
    [--out benchmarks/results/occupancy_threshold.json]

Generated validation scenes are tracked once, with the threshold of the weights; their
reconstructions are then cut at other probabilities.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import torch
import tyro

from composenet.metrics.evaluate import SequenceScores, aggregate, evaluate_sequence
from composenet.metrics.report import RunInfo
from composenet.network.object_net import stretched
from composenet.network.weights import default_weights, weights_id
from composenet.pipeline import ObjectTracker, load_tracker
from composenet.records import ObjectEstimate
from composenet.synth.scene import Scene, generate_scene

THRESHOLDS = (0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5)


def scores_by_level(
    scene: Scene, tracker: ObjectTracker, levels: tuple[float, ...]
) -> Iterator[SequenceScores]:
    """Scores of the scene's detections with reconstructions cut at each level."""
    frames = [scene.render(i, color=False).frame for i in range(scene.n_frames)]
    found = [tracker(frame).estimates for frame in frames]
    untracked = [()] * len(frames)
    for level in levels:
        cut = [tuple(_cut(estimate, level) for estimate in each) for each in found]
        yield evaluate_sequence(scene.truth, untracked, cut, frames=frames)


def _cut(estimate: ObjectEstimate, level: float) -> ObjectEstimate:
    return replace(estimate, canonical=(estimate.canonical >= level).astype(np.float32))


def main(
    weights: Path | None = None, start: int = 100, count: int = 12, out: Path | None = None
) -> None:
    """Print completion by threshold."""
    path = weights or default_weights()
    tracker = load_tracker(path)
    used = tracker.config.network.occupancy_threshold
    levels = tuple(stretched(torch.tensor(THRESHOLDS), used).tolist())
    parts: list[dict[str, SequenceScores]] = [{} for _ in THRESHOLDS]
    for index in range(start, start + count):
        scene = generate_scene("val", index)
        for part, score in zip(
            parts, scores_by_level(scene, tracker.restart(), levels), strict=True
        ):
            part[scene.name] = score
        print(f"{scene.name} done", flush=True)
    rows = {}
    for threshold, part in zip(THRESHOLDS, parts, strict=True):
        scores = aggregate(part)
        if scores.precisions is None or scores.completion is None:
            raise SystemExit("nothing was found in these scenes; take more of them (--count)")
        rows[str(threshold)] = {
            "completion_map25": round(100 * float(np.nanmean(scores.precisions.completion25)), 2),
            "completion_map50": round(100 * float(np.nanmean(scores.precisions.completion50)), 2),
            "mean_iou": round(100 * scores.completion.volume_iou, 2),
        }
        print(f"threshold {threshold:4.2f}  {rows[str(threshold)]}")
    if out is not None:
        command = f"python benchmarks/occupancy_threshold.py --start {start} --count {count}"
        info = RunInfo(f"val {start}-{start + count - 1}", 1, command, weights_id(path))
        out.write_text(
            json.dumps(asdict(info) | {"tracked_with": used, "thresholds": rows}, indent=2) + "\n"
        )


if __name__ == "__main__":
    tyro.cli(main)
