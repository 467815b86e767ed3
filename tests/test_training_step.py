"""One training step: which parts of the network learn, and what they are taught."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from composenet.detection import Proposals
from composenet.training import step
from composenet.training.loop import Trainer
from composenet.training.losses import OBJECT_LOSSES
from training_cases import ALONE, CONFIG, batch_of, options


def state_of(trainer: Trainer) -> dict[str, torch.Tensor]:
    return {name: value.clone() for name, value in trainer.module.network.state_dict().items()}


def changed(before: dict[str, torch.Tensor], after: dict[str, torch.Tensor]) -> dict[str, set[str]]:
    """Names of the parameters and statistics that are others now, by part of the network."""
    parts: dict[str, set[str]] = {"backbone": set(), "detection": set(), "boxes": set()}
    for name, value in before.items():
        part, own = name.split(".", 1)
        if not torch.equal(value, after[name]):
            parts.setdefault(part, set()).add(own)
    return parts


SAME_FOR_ALL_BINS = {"heading.score.3.bias"}  # a softmax does not feel it: its gradient is rounding
BOX_LOSSES = {"box", "place", "box_class", "quality"}
DETECTOR_LOSSES = {"objectness", "center", "extent", "class"} | BOX_LOSSES


@pytest.mark.parametrize("joint", [False, True])
def test_only_the_object_network_learns(recordings: Path, tmp_path: Path, joint: bool) -> None:
    config = replace(CONFIG, parts="objects", joint_from_step=0 if joint else 9)
    trainer = Trainer(config, options(tmp_path), ALONE)
    before, batch = state_of(trainer), batch_of(recordings)
    values = [trainer.step(batch, 1e-2) for _ in range(2)]
    parts = changed(before, state_of(trainer))
    assert not parts["backbone"] and not parts["detection"] and not parts["boxes"]
    learned = {name for name, _ in trainer.module.network.objects.named_parameters()}
    learned -= SAME_FOR_ALL_BINS
    assert learned < parts["objects"]  # and the running statistics
    assert not DETECTOR_LOSSES & set(values[0])
    assert (set(OBJECT_LOSSES) <= set(values[0])) == joint


@pytest.mark.parametrize("joint", [False, True])
def test_only_the_detector_learns(recordings: Path, tmp_path: Path, joint: bool) -> None:
    config = replace(CONFIG, parts="detector", joint_from_step=0 if joint else 9)
    trainer = Trainer(config, options(tmp_path), ALONE)
    before, batch = state_of(trainer), batch_of(recordings)
    values = [trainer.step(batch, 1e-2) for _ in range(2)]
    parts = changed(before, state_of(trainer))
    assert "objects" not in parts
    for part in ("backbone", "detection", "boxes"):
        learned = {name for name, _ in getattr(trainer.module.network, part).named_parameters()}
        assert learned <= parts[part], part
    assert set(values[0]) == DETECTOR_LOSSES | {"total", "gradient_norm"}


def test_only_the_second_look_learns(recordings: Path, tmp_path: Path) -> None:
    trainer = Trainer(replace(CONFIG, parts="boxes"), options(tmp_path), ALONE)
    before, batch = state_of(trainer), batch_of(recordings)
    values = [trainer.step(batch, 1e-2) for _ in range(2)]
    parts = changed(before, state_of(trainer))
    assert not parts["backbone"] and not parts["detection"] and "objects" not in parts
    learned = {name for name, _ in trainer.module.network.boxes.named_parameters()}
    assert learned == parts["boxes"]
    assert set(values[0]) == BOX_LOSSES | {"total", "gradient_norm"}


def test_all_parts_learn(recordings: Path, tmp_path: Path) -> None:
    trainer = Trainer(replace(CONFIG, joint_from_step=0), options(tmp_path), ALONE)
    before, batch = state_of(trainer), batch_of(recordings)
    values = [trainer.step(batch, 1e-2) for _ in range(2)]
    parts = changed(before, state_of(trainer))
    for part, names in parts.items():
        learned = {name for name, _ in getattr(trainer.module.network, part).named_parameters()}
        assert learned <= names, part
    assert len(parts) == 4 and DETECTOR_LOSSES | set(OBJECT_LOSSES) <= set(values[0])


def test_apart_the_voxels_learn_nothing_from_the_objects(recordings: Path, tmp_path: Path) -> None:
    batch, moved = batch_of(recordings), []
    for name, weight in (("apart", 4.0), ("apart", 0.0), ("all", 4.0)):
        weights = replace(CONFIG.weights, **dict.fromkeys(OBJECT_LOSSES, weight))
        config = replace(CONFIG, parts=name, joint_from_step=0, weights=weights)
        trainer = Trainer(replace(config, gradient_clip=1e9), options(tmp_path), ALONE)
        before = state_of(trainer)
        values = trainer.step(batch, 1e-3)
        assert DETECTOR_LOSSES | set(OBJECT_LOSSES) <= set(values)
        learned = {n for n, _ in trainer.module.network.objects.named_parameters()}
        learned &= changed(before, state_of(trainer))["objects"]
        assert bool(learned) == (weight > 0)
        moved.append(trainer.module.network.backbone.state_dict())
    one, silent, together = moved
    assert all(torch.equal(one[name], silent[name]) for name in one)
    assert any(not torch.equal(one[name], together[name]) for name in one)


@pytest.mark.parametrize("parts", ["all", "apart", "detector", "boxes", "objects"])
def test_frames_without_objects_do_no_harm(recordings: Path, tmp_path: Path, parts: str) -> None:
    config = replace(CONFIG, parts=parts, joint_from_step=1, min_visible_pixels=10**6)
    trainer, batch = Trainer(config, options(tmp_path), ALONE), batch_of(recordings, config)
    assert len(batch.frame) == 0
    values = [trainer.step(batch, 1e-2) for _ in range(2)]
    assert all(np.isfinite(list(v.values())).all() for v in values)
    assert all(torch.isfinite(value).all() for value in state_of(trainer).values())


def test_each_step_proposes_with_one_of_the_radii_and_a_random_objectness(
    recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sure: list[float] = []
    drawn: set[float] = set()
    propose = step.propose

    def noted(fields, batch, config) -> tuple[Proposals, ...]:
        drawn.add(config.mean_shift_radius_voxels)
        sure.append(config.objectness_threshold)
        assert config.min_score <= config.objectness_threshold  # else the unsure ones are dropped
        return propose(fields, batch, config)

    monkeypatch.setattr(step, "propose", noted)
    detection = replace(CONFIG.model.detection, objectness_threshold=0.5)
    model = replace(CONFIG.model, detection=detection)
    trainer = Trainer(replace(CONFIG, parts="detector", model=model), options(tmp_path), ALONE)
    batch = batch_of(recordings)
    for _ in range(16):
        trainer.step(batch, 1e-3)
    assert drawn == {detection.mean_shift_radius_voxels, *step.OTHER_RADII_VOXELS}
    assert step.LOWEST_OBJECTNESS <= min(sure) < 0.3 < 0.4 < max(sure)
    assert max(sure) <= detection.objectness_threshold
