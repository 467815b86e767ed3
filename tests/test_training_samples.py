"""What samples hold of earlier frames, what losses cost, and the figures of validation, by hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from composenet.detection import Proposals
from composenet.geometry.transform import make_T
from composenet.network.batch import CropBatch
from composenet.network.detection_head import VoxelFields
from composenet.network.model import ComposeNet
from composenet.network.object_net import HEADING_BINS, ObjectFields
from composenet.records import Box, Camera, Frame, ObjectFrameTruth, ObjectTruth, Symmetry
from composenet.synth.scene import RenderedFrame
from composenet.training import data, validation
from composenet.training.data import samples_of_scene
from composenet.training.loop import Trainer
from composenet.training.losses import PoseErrors, detection_losses, object_losses
from composenet.training.targets import (
    UNKNOWN,
    Sample,
    TrainingBatch,
    collate_samples,
    make_sample,
    occupancy_in_crops,
)
from composenet.training.validation import validate
from composenet.volume.voxels import FEATURE_NAMES
from conftest import TINY
from training_cases import (
    ALONE,
    CONFIG,
    EXTENTS,
    SIZE_M,
    bumpy_block,
    one_object,
    options,
    volume_of,
)

ROW = torch.zeros(1, dtype=torch.long)


class Stripes:
    """Two looks at a wall of five stripes, 40 cm each. The second has no depth on the first three:
    1 has moved from there to the last, 2 is out of view, 3 stays where it is, half in view."""

    n_frames = 2
    ids = ((1, 2, 3, 3, 0), (0, 0, 0, 3, 1))
    middle_y_m = ({1: 0.8, 2: 0.4, 3: -0.2}, {1: -0.8, 2: 0.4, 3: -0.2})

    def render(self, i: int, *, color: bool = True) -> RenderedFrame:
        ids = np.tile(np.repeat(self.ids[i], 20).astype(np.uint16), (80, 1))
        depth_m = np.full(ids.shape, 2.0, np.float32)
        depth_m[:, : 60 * i] = 0
        K = np.array([[100.0, 0, 49.5], [0, 100, 39.5], [0, 0, 1]])
        ahead = make_T(np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]]), np.array([0, 0, 1.2]))
        return RenderedFrame(Frame(i, depth_m, Camera(K, 100, 80), ahead), ids, depth_m)

    def frame_truth(
        self, i: int, ids: np.ndarray, fractions: bool = True
    ) -> tuple[ObjectFrameTruth, ...]:
        truth = []
        for gt_id, y in self.middle_y_m[i].items():
            T = make_T(np.eye(3), np.array([2.0, y, 1.2]))
            pixels = int((ids == gt_id).sum())
            box = Box(T[:3, 3], self.object_truth(gt_id).extents_m)
            truth.append(ObjectFrameTruth(gt_id, T, box, pixels, 1.0, gt_id == 1))
        return tuple(truth)

    def object_truth(self, gt_id: int, solid: bool = True) -> ObjectTruth:
        extents, full = np.array([0.4, 0.8 if gt_id == 3 else 0.4, 1.6]), np.ones((64,) * 3, bool)
        return ObjectTruth(gt_id, 4, Symmetry.NONE, extents, full, np.zeros((0, 3), np.float32))

    def others(self, i: int) -> tuple[Box, ...]:
        return ()


def samples_of(monkeypatch: pytest.MonkeyPatch, count: int, seed: int = 0) -> list[Sample]:
    """So many of the two frames that are walked through."""
    monkeypatch.setattr(data, "walk", lambda *_: [0, 1])
    config, rng = replace(CONFIG, frames_per_scene=count), np.random.default_rng(seed)
    return list(samples_of_scene(Stripes(), config, rng, augment=False))


def test_what_is_remembered_of_an_object_is_it_only_where_it_still_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    first, second = samples_of(monkeypatch, 2)
    assert len(first.volume.labels) == first.volume.n_seen
    seen, remembered = np.split(second.volume.labels, [second.volume.n_seen])
    assert second.gt_id.tolist() == [1, 3] and set(seen.tolist()) == {1, 3}
    assert set(remembered.tolist()) == {0, UNKNOWN, 3}


def test_a_frame_that_is_no_sample_is_remembered_all_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    both, drawn = samples_of(monkeypatch, 2), set()
    for seed in range(6):
        (sample,) = samples_of(monkeypatch, 1, seed)
        place = int(len(sample.gt_id) == 2)
        drawn.add(place)
        np.testing.assert_array_equal(sample.volume.coords, both[place].volume.coords)
        np.testing.assert_array_equal(sample.volume.labels, both[place].volume.labels)
    assert drawn == {0, 1}


def test_everything_believes_the_same_wrong_floor(monkeypatch: pytest.MonkeyPatch) -> None:
    """Heights of the voxels, and of the floor under the boxes; what is in the grid stays."""
    monkeypatch.setattr(data, "walk", lambda *_: [0, 1])
    config, seen = replace(CONFIG, frames_per_scene=2), {}
    for wrong_m in (0.0, 0.03):
        monkeypatch.setattr(data, "WRONG_FLOOR_M", wrong_m)
        pairs = (samples_of_scene(Stripes(), config, np.random.default_rng(i)) for i in range(20))
        seen[wrong_m] = [sample for pair in pairs for sample in pair]
    height, errors = FEATURE_NAMES.index("height"), []
    for right, wrong in zip(*seen.values(), strict=True):
        batch, true = collate_samples([wrong]), collate_samples([right])
        error = float(true.volume.floor_z - batch.volume.floor_z)
        z = batch.volume.coords[:, 3] * batch.volume.voxel_size_m
        told = batch.volume.features.clone()
        torch.testing.assert_close(2 * told[:, height], z - batch.volume.floor_z)
        told[:, height] -= error / 2
        torch.testing.assert_close(told, true.volume.features)
        for name in ("center", "t", "R_grid_object", "voxel_object"):
            torch.testing.assert_close(getattr(batch, name), getattr(true, name))
        torch.testing.assert_close(batch.volume.T_camera_grid, true.volume.T_camera_grid)
        errors.append(error)
    assert abs(np.mean(errors)) < 0.02 and 0.02 < np.std(errors) < 0.04


@pytest.mark.parametrize("longest", [0.01, 1e6])
def test_long_gradients_are_cut_to_length(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, longest: float
) -> None:
    trainer = Trainer(replace(CONFIG, gradient_clip=longest), options(tmp_path), ALONE)
    told = trainer.step(collate_samples(samples_of(monkeypatch, 2)), 1e-3)["gradient_norm"]
    gradients = [p.grad.flatten() for p in trainer.module.parameters() if p.grad is not None]
    assert told > 0.1  # as long as they were
    assert float(torch.cat(gradients).norm()) == pytest.approx(min(told, longest), rel=1e-3)


def predicted(batch: TrainingBatch, grow: float = 1.0) -> ObjectFields:
    """Perfect predictions for the one object, in cells that are those of its occupancy; but its
    canonical coordinates are `grow` times what they should be."""
    crops = CropBatch(batch.frame, batch.center, batch.extents, torch.zeros(1))
    local = (crops.points(16) - batch.t[:, None]) @ batch.R_grid_object
    nocs = grow * local / batch.scale_m[:, None, None]
    solid = occupancy_in_crops(batch, crops, ROW, 32) > 0.5
    return ObjectFields(
        crops=crops,
        occupancy=torch.where(solid, 20.0, -20.0),
        nocs=nocs.transpose(1, 2).reshape(1, 3, 16, 16, 16),
        surface=torch.zeros_like(solid),
        heading_logits=torch.zeros(1, HEADING_BINS),
    )


@pytest.mark.parametrize("logit", [-1.0, 0.0, 2.0])
def test_the_cost_of_completion(logit: float) -> None:
    """Cross-entropy of every cell: where all are said to be as full, and where all are right."""
    batch = one_object(yaw=0.0)
    fields, full = predicted(batch), bumpy_block().mean()
    surprise_full, surprise_empty = np.log1p(np.exp(-logit)), np.log1p(np.exp(logit))
    same = replace(fields, occupancy=torch.full_like(fields.occupancy, logit))
    right = replace(fields, occupancy=logit * fields.occupancy.sign())
    for guess, cost in (
        (same, full * surprise_full + (1 - full) * surprise_empty),
        (right, surprise_full),
    ):
        losses, _ = object_losses(guess, batch, ROW)
        assert losses["completion"].item() == pytest.approx(cost, rel=1e-4)


@pytest.mark.parametrize("grow", [0.5, 1.0, 2.0])
def test_the_cost_of_a_wrong_scale(grow: float) -> None:
    """Metres by which the diagonal is off."""
    batch = one_object(yaw=0.0)
    losses, _ = object_losses(predicted(batch, grow), batch, ROW)
    off_m = abs(1 / grow - 1) * np.linalg.norm(EXTENTS)
    assert losses["scale"].item() == pytest.approx(off_m, abs=1e-4)


def test_an_object_of_four_times_the_voxels_counts_twice() -> None:
    """16 voxels of one object are wrong, 4 of another right."""
    batch = one_object()
    owner = torch.full((80,), -1)
    owner[40:56], owner[56:60] = 0, 1
    batch = replace(
        batch,
        frame=torch.tensor([1, 1]),
        voxel_object=owner,
        class_id=torch.tensor([4, 7]),
        center=batch.center.repeat(2, 1),
        extents=batch.extents.repeat(2, 1),
    )
    wrong = (owner == 0)[:, None]
    fields = VoxelFields(
        features=torch.zeros(80, 1),
        objectness=torch.where(owner >= 0, 20.0, -20.0),
        center_offset=batch.center[0] / SIZE_M - batch.volume.coords[:, 1:] + 3.0 * wrong,
        extents=batch.extents[0] / SIZE_M + 2.0 * wrong,
        class_logits=40.0 * ~wrong * torch.nn.functional.one_hot(torch.tensor(7), 10),
    )
    costs = {"center": 3 * 2.5, "extent": 3 * 1.5, "class": np.log(10)}  # of the wrong ones
    losses = detection_losses(fields, batch)
    for name, cost in costs.items():
        assert losses[name].item() == pytest.approx(2 / 3 * cost, rel=1e-5), name


def frame_of(places_m: list[float], pixels: list[int]) -> Sample:
    """Chairs along the world's x, each with as many visible pixels."""
    truths, seen = [], []
    for k, (x, visible) in enumerate(zip(places_m, pixels, strict=True), start=1):
        T = make_T(np.eye(3), np.array([x, 1.5, 0.6]))
        none = np.zeros((0, 3), np.float32)
        truths.append(ObjectTruth(k, 4, Symmetry.NONE, EXTENTS, bumpy_block(), none))
        seen.append(ObjectFrameTruth(k, T, Box(T[:3, 3], EXTENTS), visible, 0.7))
    return make_sample(volume_of(label=0), truths, seen)


def proposals_at(centers: Tensor, extents: Tensor, classes: list[int]) -> Proposals:
    probabilities = torch.nn.functional.one_hot(torch.tensor(classes), 10).float()
    sure = torch.ones(len(classes))
    return Proposals(centers, extents[:1].expand(len(classes), 3), probabilities, sure, sure)


@pytest.fixture
def network() -> ComposeNet:
    torch.manual_seed(0)
    return ComposeNet(TINY.network, TINY.volume)


def test_recall_precision_and_classes_by_hand(
    monkeypatch: pytest.MonkeyPatch, network: ComposeNet
) -> None:
    """Of four chairs with enough pixels one is found, one found by half (IoU 1/3) and taken for
    something else, two are only where another frame has a proposal; a fifth, which is too small
    to count, is found too. The first is proposed twice. Of two that overlap one proposal finds
    one."""
    batch = collate_samples(
        [
            frame_of([8.0], [500]),
            frame_of([0.0, 2.0, 4.0, 6.0], [500, 500, 150, 149]),
            frame_of([0.0, 0.05], [500, 500]),
        ]
    )
    other, exact, half, missed, small, near, _ = batch.center
    half = half + torch.tensor([0.0, 0.5, 0.0]) * batch.extents[0]
    far = exact + 50
    found = (
        proposals_at(missed[None], batch.extents, [4]),
        proposals_at(
            torch.stack([far, half, exact, other, small, exact]), batch.extents, [4, 2, 4, 4, 4, 4]
        ),
        proposals_at(near[None], batch.extents, [4]),
    )
    monkeypatch.setattr(validation, "propose", lambda *_: found)
    monkeypatch.setattr(validation, "second_look", lambda *given: given[3])
    figures = validate(network, [batch], CONFIG, torch.device("cpu"))
    expected = {"recall25": 3 / 6, "recall50": 2 / 6, "precision25": 3 / 7, "class_accuracy": 2 / 3}
    assert {name: figures[name] for name in expected} == pytest.approx(expected)


def test_costs_of_validation_are_means_and_pose_errors_medians(
    monkeypatch: pytest.MonkeyPatch, network: ComposeNet
) -> None:
    batch = collate_samples([frame_of([0.0], [500])])
    results = iter([(1.0, [10.0, 60.0]), (4.0, [20.0])])

    def told(*_: object) -> tuple[dict[str, Tensor], PoseErrors]:
        cost, values = next(results)
        errors = torch.tensor(values)
        return {"completion": torch.tensor(cost)}, PoseErrors(errors, errors / 100, errors / 100)

    monkeypatch.setattr(validation, "object_losses", told)
    figures = validate(network, [batch, batch], CONFIG, torch.device("cpu"))
    expected = {"completion": 2.5, "rotation_deg": 20, "translation_m": 0.2, "completion_iou": 0.3}
    assert {name: figures[name] for name in expected} == pytest.approx(expected)


def test_validation_leaves_the_network_as_it_was(network: ComposeNet) -> None:
    before = {name: value.clone() for name, value in network.state_dict().items()}
    batches = [collate_samples([frame_of([0.0], [500])])]
    first, again = (validate(network, batches, CONFIG, torch.device("cpu")) for _ in range(2))
    assert first == again and network.training
    assert all(torch.equal(value, before[name]) for name, value in network.state_dict().items())
