"""Boxes that training looks at, which of them are completed, and what a correction costs."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from composenet.detection import BOX_LIMITS_M, Proposals
from composenet.geometry.aligned_boxes import paired_iou
from composenet.geometry.box import iou
from composenet.metrics.records import MATCH_GATE_M
from composenet.network.box_head import BoxFields
from composenet.records import Box
from composenet.training.losses import box_losses
from composenet.training.proposals import (
    CROP_IOU,
    POSITIVE_IOU,
    TrainingBoxes,
    chosen_objects,
    training_boxes,
)
from composenet.training.targets import TrainingBatch
from training_cases import no_object, one_object


def generator() -> torch.Generator:
    return torch.Generator().manual_seed(0)


def matched(batch: TrainingBatch, moves: list[float], frame: int = 1) -> TrainingBoxes:
    """Copies of the one object's box, moved along x by shares of its side."""
    n = len(moves)
    center, extents = batch.center.repeat(n, 1), batch.extents.repeat(n, 1)
    center[:, 0] += torch.tensor(moves) * extents[:, 0]
    return TrainingBoxes.matched(batch, torch.full((n,), frame), center, extents)


def proposal(batch: TrainingBatch) -> Proposals:
    one = torch.ones(1)
    return Proposals(batch.center, batch.extents, one[:, None], one, one)


def nothing() -> Proposals:
    return Proposals(torch.zeros(0, 3), torch.zeros(0, 3), torch.zeros(0, 1), *[torch.zeros(0)] * 2)


def test_boxes_know_their_object() -> None:
    batch = one_object()
    boxes = matched(batch, [0.0, -0.7, 0.9, 2.0])
    assert boxes.rows.tolist() == [0, 0, 0, 0]
    np.testing.assert_allclose(boxes.iou, [1, 0.3 / 1.7, 0.1 / 1.9, 0], atol=1e-6)
    assert boxes.positive.tolist() == [True, True, False, False]
    other = matched(batch, [0.0], frame=0)  # the same place, another frame
    assert other.iou.tolist() == [0] and not other.positive.any()
    assert boxes[torch.tensor([1])].iou.tolist() == boxes.iou[1:2].tolist()


@pytest.mark.parametrize("seed", range(3))
def test_the_object_of_a_box_against_a_slow_loop(seed: int) -> None:
    rng = np.random.default_rng(seed)

    def cubes(n: int) -> tuple[Tensor, Tensor, Tensor]:
        frame = torch.from_numpy(rng.integers(0, 2, n))
        return frame, *(torch.from_numpy(rng.uniform(a, 1.5, (n, 3))) for a in (0, 0.5))

    frame, center, extents = cubes(5)
    batch = replace(one_object(), frame=frame, center=center, extents=extents)
    boxes = TrainingBoxes.matched(batch, *cubes(20))
    for m in range(20):
        ours = Box(boxes.center[m].numpy(), boxes.extents[m].numpy())
        overlaps = [
            iou(ours, Box(center[k].numpy(), extents[k].numpy())) * bool(frame[k] == boxes.frame[m])
            for k in range(5)
        ]
        assert boxes.iou[m].item() == pytest.approx(max(overlaps), abs=1e-9)
        assert overlaps[boxes.rows[m]] == pytest.approx(max(overlaps), abs=1e-9)


def test_training_boxes_are_jittered_random_and_the_detectors_own() -> None:
    batch = one_object()
    boxes = training_boxes(batch, [nothing(), proposal(batch)], generator())
    jittered, first, second, own = range(4)
    assert boxes.frame[[jittered, own]].tolist() == [1, 1]
    assert POSITIVE_IOU < boxes.iou[jittered] < 0.99 and boxes.iou[own] == 1
    low, high = BOX_LIMITS_M
    assert (boxes.extents >= low).all() and (boxes.extents <= high).all()
    near = batch.volume.coords[:, 1:] * batch.volume.voxel_size_m
    for random in (first, second):  # about some voxel
        assert (near - boxes.center[random]).norm(dim=1).min() < 1.0
    again = training_boxes(batch, [nothing(), proposal(batch)], generator())
    assert torch.equal(boxes.center, again.center) and torch.equal(boxes.extents, again.extents)
    crops = boxes.crops(1.25)
    side = boxes.extents[:, :2].amax(dim=1)
    torch.testing.assert_close(crops.size[:, 0], 1.25 * side)
    torch.testing.assert_close(crops.size[:, 2], 1.25 * boxes.extents[:, 2])


def test_what_is_no_furniture_is_looked_at_too() -> None:
    """Jittered as objects are, beside them, in its own frame; no object to be taught but to be
    refused."""
    batch = one_object()
    away = torch.cat([batch.center + 5, batch.extents], dim=1)
    batch = replace(batch, other_frame=torch.tensor([0]), other_boxes=away)
    g = generator()
    many = [training_boxes(batch, (), g) for _ in range(300)]
    assert all(boxes.frame[:2].tolist() == [1, 0] for boxes in many)
    assert not any(boxes.positive[1] for boxes in many)
    gaps = torch.stack([(boxes.center[1] - away[0, :3]) / batch.extents[0] for boxes in many])
    assert gaps.mean(dim=0).abs().max() < 0.03 and 0.05 < gaps.std() < 0.3
    boxes = many[0]
    fields = BoxFields(
        boxes.center, boxes.extents, torch.zeros(4, requires_grad=True), torch.zeros(4, 10)
    )
    box_losses(fields, batch, boxes)["quality"].backward()
    taught = 0.5 - 4 * fields.quality.grad  # the sigmoid less its gradient
    assert taught[0] > 0.5 and taught[1:].tolist() == pytest.approx([0, 0, 0], abs=1e-6)


def test_jitter_varies_about_the_truth() -> None:
    """Most copies still show their object; none is exact; on the average they are unbiased."""
    batch = one_object()
    g, first = generator(), torch.tensor([0])
    many = [training_boxes(batch, (), g)[first] for _ in range(300)]
    overlaps = torch.cat([boxes.iou for boxes in many])
    assert (overlaps >= CROP_IOU).double().mean() > 0.9 and overlaps.max() < 1
    assert overlaps.min() < 0.4 and overlaps.max() > 0.9
    gaps = torch.cat([(boxes.center - batch.center) / batch.extents for boxes in many])
    assert gaps.mean(dim=0).abs().max() < 0.03


def test_frames_without_objects_have_random_boxes_only() -> None:
    boxes = training_boxes(no_object(), (), generator())
    assert len(boxes.frame) == 2 and not boxes.positive.any() and not boxes.iou.any()
    assert len(chosen_objects(boxes, 7, generator())) == 0


@settings(max_examples=60)
@given(
    st.lists(st.tuples(st.integers(0, 7), st.booleans()), max_size=30),
    st.integers(1, 4),
    st.integers(0, 5),
)
def test_chosen_objects(boxes: list[tuple[int, bool]], max_crops: int, seed: int) -> None:
    """Only those that show enough, none twice, never more than asked for a frame, as many as there
    are."""
    rows = torch.tensor([row for row, _ in boxes], dtype=torch.long)
    overlap = torch.tensor([CROP_IOU if good else CROP_IOU - 0.01 for _, good in boxes])
    box = torch.ones(len(boxes), 3)
    given_boxes = TrainingBoxes(rows % 3, box, box, rows, overlap)
    chosen = chosen_objects(given_boxes, max_crops, torch.Generator().manual_seed(seed))
    assert chosen.dtype == torch.long
    kept = given_boxes[chosen]
    assert (kept.iou >= CROP_IOU).all()
    assert len(set(kept.rows.tolist())) == len(chosen)
    there = Counter(row % 3 for row in {row for row, good in boxes if good})
    expected = {frame: min(count, max_crops) for frame, count in there.items()}
    assert Counter(kept.frame.tolist()) == expected


def test_the_choice_is_by_chance() -> None:
    rows = torch.arange(6)
    box = torch.ones(6, 3)
    boxes = TrainingBoxes(rows * 0, box, box, rows, torch.ones(6))
    g = generator()
    seen = {row for _ in range(30) for row in chosen_objects(boxes, 2, g).tolist()}
    assert seen == set(range(6))


def corrected(
    batch: TrainingBatch, boxes: TrainingBoxes, moves: list[float], quality: float = 0.0
) -> BoxFields:
    """The true box moved along x by shares of its side, of the true class."""
    right = matched(batch, moves)
    return BoxFields(
        center=right.center.requires_grad_(True),
        extents=right.extents.requires_grad_(True),
        quality=torch.full((len(moves),), quality, requires_grad=True),
        class_logits=(
            40.0 * torch.nn.functional.one_hot(batch.class_id[boxes.rows], 10)
        ).requires_grad_(True),
    )


def test_a_perfect_correction_costs_nothing_but_quality() -> None:
    batch = one_object()
    boxes = matched(batch, [0.2, -0.3, 3.0])
    fields = corrected(batch, boxes, [0.0, 0.0, 0.0])
    losses = box_losses(fields, batch, boxes)
    assert losses["box"].item() == pytest.approx(0, abs=1e-5)
    assert losses["place"].item() == pytest.approx(0, abs=1e-5)
    assert losses["box_class"].item() == pytest.approx(0, abs=1e-5)
    assert losses["quality"].item() == pytest.approx(np.log(2))
    sure = replace(fields, quality=torch.tensor([20.0, 20, -20]))  # the third shows nothing
    assert box_losses(sure, batch, boxes)["quality"].item() == pytest.approx(0, abs=1e-5)


@pytest.mark.parametrize(("side", "share"), [(0.4, 0.1), (0.6, 0.1), (1.8, 0.3)])
def test_the_cost_of_a_box_by_hand(side: float, share: float) -> None:
    """Moved by 0.1 of its side: IoU 0.9 / 1.1; the gap counts by NEAR_M where the side is longer.
    Sides 1.2 times as long: IoU 1 / 1.2^3."""
    batch = one_object()
    batch.extents[:, 0] = side
    boxes = matched(batch, [0.2])
    moved = corrected(batch, boxes, [0.1])
    expected = share + 1 - 0.9 / 1.1
    assert box_losses(moved, batch, boxes)["box"].item() == pytest.approx(expected, rel=1e-4)
    grown = replace(corrected(batch, boxes, [0.0]), extents=1.2 * batch.extents)
    expected = 3 * np.log(1.2) + 1 - 1.2**-3
    assert box_losses(grown, batch, boxes)["box"].item() == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(("gap_m", "cost"), [(0, 0), (0.25, 1 - np.exp(-1)), (1.0, 1)])
def test_the_cost_of_a_place_by_hand(gap_m: float, cost: float) -> None:
    """Rises around the distance at which centres match, and hardly pulls at what is far off."""
    batch = one_object()
    boxes = matched(batch, [0.2])
    fields = corrected(batch, boxes, [gap_m / float(batch.extents[0, 0])])
    loss = box_losses(fields, batch, boxes)["place"]
    assert loss.item() == pytest.approx(cost, abs=1e-5)
    loss.backward()
    assert (fields.center.grad.norm().item() < 1e-4) == (gap_m != 0.25)


@pytest.mark.parametrize(
    ("overlap", "shared"), [(0.05, 0), (0.1, 0), (0.35, 0.5), (0.6, 1), (1, 1)]
)
@pytest.mark.parametrize("side", [0.2, 0.9, 2.4])
def test_the_quality_that_is_taught(overlap: float, shared: float, side: float) -> None:
    """Half overlap, half place, read off the gradient of the cross-entropy, which is the sigmoid
    less what is taught."""
    batch = one_object()
    batch.extents[:, 0] = side
    near = side * (1 - overlap) / (1 + overlap) < MATCH_GATE_M
    quality = (shared + near) / 2
    boxes = matched(batch, [0.2])
    fields = corrected(batch, boxes, [(1 - overlap) / (1 + overlap)])
    box_losses(fields, batch, boxes)["quality"].backward()
    assert 0.5 - fields.quality.grad.item() == pytest.approx(quality, abs=1e-4)
    assert fields.center.grad is None and fields.extents.grad is None  # judged, not moved


def test_gradients_correct_the_box() -> None:
    batch = one_object()
    boxes = matched(batch, [0.2, -0.3, 5.0])
    fields = corrected(batch, boxes, [0.3, -0.4, 0.3])
    before = box_losses(fields, batch, boxes)
    before["box"].backward()
    assert not fields.center.grad[2].any()  # no object to move to
    step = replace(
        fields,
        center=(fields.center - 0.02 * fields.center.grad).detach(),
        extents=(fields.extents - 0.02 * fields.extents.grad).detach(),
    )
    assert box_losses(step, batch, boxes)["box"] < before["box"]
    true = [x.expand(2, 3) for x in (batch.center, batch.extents)]
    overlaps = [paired_iou(f.center[:2], f.extents[:2], *true) for f in (fields, step)]
    assert (overlaps[1] > overlaps[0]).all()


@pytest.mark.parametrize("batch", [one_object(), no_object()], ids=["missed", "none there"])
def test_no_positive_boxes(batch: TrainingBatch) -> None:
    boxes = training_boxes(batch, (), generator())
    boxes = replace(boxes, iou=torch.zeros_like(boxes.iou))
    n = len(boxes.frame)
    fields = BoxFields(
        boxes.center.requires_grad_(True),
        boxes.extents.requires_grad_(True),
        torch.zeros(n, requires_grad=True),
        torch.zeros(n, 10, requires_grad=True),
    )
    losses = box_losses(fields, batch, boxes)
    assert not losses["box"] and not losses["place"] and not losses["box_class"]
    assert losses["quality"].item() == pytest.approx(np.log(2))
    sum(losses.values()).backward()
    assert (fields.quality.grad > 0).all() and not fields.class_logits.grad.any()
