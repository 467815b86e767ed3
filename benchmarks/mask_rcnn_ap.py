"""Mask AP of the comparison systems' Mask R-CNN on frames of the validation split.

python benchmarks/mask_rcnn_ap.py [--weights FILE] [--out benchmarks/results/mask_rcnn.json]

`all` is what average precision is taken of; `used` are the masks that the systems are given
(certain ones, none shown twice), of which precision and recall tell more.
"""

from __future__ import annotations

import json
import math
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from composenet.baselines.mask_ap import MaskScores, mask_scores, scored_classes
from composenet.baselines.mask_rcnn import MaskRcnnMasks, distinct, mask_rcnn_weights
from composenet.baselines.records import InstanceMasks
from composenet.errors import ComposenetError
from composenet.metrics.report import RunInfo
from composenet.records import CLASS_NAMES
from composenet.synth.scene import Scene, SceneOptions, generate_scene


def true_masks(scene: Scene, ids: np.ndarray) -> InstanceMasks:
    """The truth of one frame, given its id image (H, W)."""
    gt_ids = np.array([i for i in np.unique(ids).tolist() if i], np.int64)
    names = [scene.shape_of(gt_id).class_name for gt_id in gt_ids.tolist()]
    return InstanceMasks(
        masks=ids[None] == gt_ids[:, None, None],
        class_ids=np.array([CLASS_NAMES.index(name) for name in names], np.int64),
        scores=np.ones(len(gt_ids), np.float32),
    )


def evaluate(
    source: MaskRcnnMasks, scenes: int, frames: int, options: SceneOptions
) -> dict[str, MaskScores]:
    """Scores of all detections and of those used, over evenly spread frames of val scenes."""
    every, used = [], []
    for index in range(scenes):
        scene = generate_scene("val", index, options)
        for i in np.linspace(0, scene.n_frames - 1, frames).round().astype(int).tolist():
            rendered = scene.render(i)
            truth, found = true_masks(scene, rendered.ids), source.detections(rendered.frame)
            every.append(scored_classes(truth, found))
            used.append(scored_classes(truth, distinct(found)))
    return {"all": mask_scores(every), "used": mask_scores(used)}


def plain(scores: MaskScores) -> dict[str, Any]:
    """As percentages, null where undefined."""
    values = asdict(scores)
    truths, of_class = values.pop("truths"), values.pop("class_ap50")
    named = dict(zip(CLASS_NAMES, map(_percent, of_class), strict=True))
    percents = {name: _percent(value) for name, value in values.items()}
    return percents | {"class_ap50": named, "truths": truths}


def _percent(value: float) -> float | None:
    return None if math.isnan(value) else round(100 * value, 2)


def main(
    weights: Path | None = None,
    scenes: int = 50,
    frames: int = 4,
    image_size: tuple[int, int] = (320, 240),
    out: Path | None = None,
) -> None:
    """Print the scores and write them as JSON.

    Args:
        weights: a file; the one in the package without.
        scenes: number of scenes.
        frames: of each, evenly spread over its time.
        image_size: width and height.
        out: JSON file.
    """
    try:
        from composenet.baselines.mask_rcnn_network import load_network
        from composenet.network.weights import weights_id

        path = weights or mask_rcnn_weights()
        notes = load_network(path)[1]
        scores = evaluate(MaskRcnnMasks(path), scenes, frames, SceneOptions(image_size=image_size))
    except ComposenetError as error:
        sys.exit(f"mask_rcnn_ap: {error}")
    command = f"benchmarks/mask_rcnn_ap.py --scenes {scenes} --frames {frames}"
    info = asdict(RunInfo(f"val, {scenes} scenes, {frames} frames each", 0, command))
    data = info | {"weights": weights_id(path), "training": notes}
    data |= {name: plain(part) for name, part in scores.items()}
    print(json.dumps(data, indent=2))
    if out is not None:
        out.write_text(json.dumps(data, indent=2) + "\n")


if __name__ == "__main__":
    tyro.cli(main)
