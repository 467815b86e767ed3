"""Quick figures on fixed frames while training; `composenet eval` gives the real ones."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

import numpy as np
import torch

from composenet.detection import Proposals, propose, second_look
from composenet.geometry.aligned_boxes import pairwise_iou
from composenet.metrics.detection import UNMATCHED, match_greedily, outcomes
from composenet.metrics.records import COUNTED_PIXELS, ScoredFrame
from composenet.network.model import ComposeNet
from composenet.training.config import TrainingConfig
from composenet.training.losses import box_losses, detection_losses, object_losses
from composenet.training.proposals import chosen_objects, training_boxes
from composenet.training.silent import watched
from composenet.training.targets import TrainingBatch


@torch.no_grad()
def validate(
    network: ComposeNet,
    batches: Sequence[TrainingBatch],
    config: TrainingConfig,
    device: torch.device,
) -> dict[str, float]:
    """Mean losses; completion and pose on jittered true boxes; recall, precision and class
    accuracy of the proposals at box IoU 0.25 (class ignored for the first two); silent share of the
    network's channels."""
    network.eval()
    sums: dict[str, list[float]] = defaultdict(list)
    counts, threshold = torch.zeros(5), config.model.network.occupancy_threshold
    generator = torch.Generator().manual_seed(0)
    with watched(network) as channels:
        for batch in batches:
            batch = batch.to(device)
            fields = network.voxel_fields(batch.volume)
            boxes = training_boxes(batch, (), generator)
            at = network.box_fields(fields, batch.volume, boxes.center, boxes.extents, boxes.frame)
            chosen = chosen_objects(boxes, config.max_crops, generator)
            objects = network.object_fields(
                fields,
                batch.volume,
                boxes[chosen].crops(config.model.network.crop_margin),
                at.class_logits[chosen].softmax(dim=1),
            )
            losses, errors = object_losses(objects, batch, boxes.rows[chosen], threshold)
            losses |= box_losses(at, batch, boxes)
            for name, value in (detection_losses(fields, batch) | losses).items():
                sums[name].append(float(value))
            for name, values in vars(errors).items():
                sums[name].extend(values.tolist())
            proposals = propose(fields, batch.volume, config.model.detection)
            proposals = second_look(
                network, fields, batch.volume, proposals, config.model.detection
            )
            counts += _count(proposals, batch)
    network.train()
    found, true, proposed, right_class, tight = counts.tolist()
    result = {name: sum(v) / max(1, len(v)) for name, v in sums.items()}
    for name in ("rotation_deg", "translation_m"):
        result[name] = float(torch.tensor(sums[name]).median()) if sums[name] else float("nan")
    return result | {
        "recall25": found / max(1, true),
        "precision25": found / max(1, proposed),
        "recall50": tight / max(1, true),
        "class_accuracy": right_class / max(1, found),
        "silent": channels.share(),
    }


def _count(proposals: Sequence[Proposals], batch: TrainingBatch) -> torch.Tensor:
    """Found, true, proposed, found with the right class, found at IoU 0.5. As in `composenet eval`
    each proposal finds one object, and objects of few pixels are neither missed nor proposed
    falsely."""
    found = true = proposed = right = tight = 0
    for index, p in enumerate(proposals):
        rows = batch.frame == index
        iou = pairwise_iou(batch.center[rows], batch.extents[rows], p.center, p.extents)
        few = (batch.visible_pixels[rows] < COUNTED_PIXELS).numpy(force=True)
        frame = ScoredFrame(iou.numpy(force=True), p.score.numpy(force=True), few)
        loose = outcomes([frame], 0.25)
        true += loose.truths
        proposed += len(loose.correct)
        found += int(loose.correct.sum())
        tight += int(outcomes([frame], 0.5).correct.sum())
        taken = match_greedily(frame, 0.25)
        hit = np.flatnonzero(taken != UNMATCHED)
        hit = hit[~few[taken[hit]]]
        told = p.class_probabilities.argmax(dim=1).numpy(force=True)
        right += int((told[hit] == batch.class_id[rows].numpy(force=True)[taken[hit]]).sum())
    return torch.tensor([found, true, proposed, right, tight], dtype=torch.float32)
