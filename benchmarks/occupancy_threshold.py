"""Which probability a cell should count as filled from: mean IoU of completed crops by threshold.

python benchmarks/occupancy_threshold.py [--weights FILE] [--start 100] [--count 18]
    [--out benchmarks/results/occupancy_threshold.json]

Crops are jittered true boxes of generated validation scenes; headings and classes are the network's
own.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
import tyro
from torch import Tensor

from composenet.metrics.report import RunInfo
from composenet.network.model import ComposeNet
from composenet.network.weights import default_weights, load_weights, weights_id
from composenet.training.config import TrainingConfig
from composenet.training.data import SceneSource, samples_of_scene
from composenet.training.proposals import training_boxes
from composenet.training.targets import Sample, collate_samples, occupancy_in_crops

THRESHOLDS = (0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5)


@torch.no_grad()
def completed(network: ComposeNet, samples: list[Sample]) -> tuple[Tensor, Tensor]:
    """(M, cells) probability and (M, cells) bool truth of all positive crops."""
    generator = torch.Generator().manual_seed(0)
    margin, cells = network.config.crop_margin, network.config.crop_cells
    found, true = [], []
    for start in range(0, len(samples), 4):
        batch = collate_samples(samples[start : start + 4])
        boxes = training_boxes(batch, (), generator)
        boxes = boxes[boxes.positive]
        if not len(boxes.frame):
            continue
        fields = network.voxel_fields(batch.volume)
        looked = network.box_fields(fields, batch.volume, boxes.center, boxes.extents, boxes.frame)
        objects = network.object_fields(
            fields, batch.volume, boxes.crops(margin), looked.class_logits.softmax(dim=1)
        )
        target = occupancy_in_crops(batch, objects.crops, boxes.rows, cells)
        found.append(objects.occupancy.sigmoid().flatten(1))
        true.append((target > 0.5).flatten(1))
    return torch.cat(found), torch.cat(true)


def main(
    weights: Path | None = None, start: int = 100, count: int = 18, out: Path | None = None
) -> None:
    """Print IoU by threshold."""
    path = weights or default_weights()
    network, own, _ = load_weights(path)
    rng, config = np.random.default_rng(1), TrainingConfig(model=own)
    samples: list[Sample] = []
    for index in range(start, start + count):
        scene = SceneSource("val").scene(index)
        samples.extend(samples_of_scene(scene, config, rng, augment=False))
    found, true = completed(network, samples)
    ious = {}
    for threshold in THRESHOLDS:
        filled = found > threshold
        shared = (filled & true).sum(dim=1) / (filled | true).sum(dim=1).clamp_min(1)
        ious[str(threshold)] = round(shared.mean().item(), 4)
        print(f"threshold {threshold:4.2f}  mean IoU {ious[str(threshold)]:.3f}")
    if out is not None:
        command = f"benchmarks/occupancy_threshold.py --start {start} --count {count}"
        info = RunInfo(f"val {start}-{start + count - 1}", 1, command, weights_id(path))
        out.write_text(json.dumps(asdict(info) | {"mean_iou": ious}, indent=2) + "\n")


if __name__ == "__main__":
    tyro.cli(main)
