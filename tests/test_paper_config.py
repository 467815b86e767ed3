"""`composenet train --config paper`: what the paper states of its training and tracking."""

from __future__ import annotations

import dataclasses
import json
from importlib import resources
from pathlib import Path

import pytest

from composenet.config import TrackingConfig, flat, to_dict
from composenet.errors import ConfigError
from composenet.training.config import TrainingConfig, training_config
from composenet.training.loop import Trainer, learning_rate
from conftest import TINY
from training_cases import ALONE, batch_of, options

STATED = {
    "batch_frames": 2,
    "learning_rate": 1e-3,
    "weight_decay": 1e-5,
    "max_crops": 10,
    "joint_from_step": 100_000,
    "weights.center": 0.1,
    "weights.extent": 0.1,
    "weights.completion": 4.0,
    "weights.correspondence": 4.0,
    "weights.rotation": 0.2,
    "weights.translation": 0.1,
    "weights.scale": 0.1,
    "model.detection.mean_shift_steps": 20,
    "model.detection.mean_shift_radius_voxels": 8.0,
    "model.detection.min_cluster_voxels": 50,
    "model.tracking.box_iou_gate": 0.3,
    "model.tracking.same_class_iou_gate": 0.3,
    "model.tracking.kept_place_share": 0.0,
    "model.tracking.canonical_iou_gate": 0.3,
    "model.tracking.running_mean_weight": 4.0,
    "model.tracking.offline": True,
}
NOT_THE_PAPERS = {
    "weights.overlap": 0.0,
    "weights.fit_place": 0.0,
    "ema_decay": 0.0,
    "decay_share": 0.0,
    "model.volume.memory_frames": 0,
    "model.detection.min_score": 0.0,
    "model.tracking.min_confidence": 0.0,
    "model.tracking.still_share": 0.0,
}


def test_it_says_what_the_paper_says() -> None:
    paper, ours = flat(to_dict(training_config(Path("paper")))), flat(to_dict(TrainingConfig()))
    assert {name: paper[name] for name in STATED} == STATED
    assert {name: paper[name] for name in NOT_THE_PAPERS} == NOT_THE_PAPERS
    assert all(ours[name] != value for name, value in NOT_THE_PAPERS.items())


def test_what_the_paper_leaves_open_is_our_default() -> None:
    file = resources.files("composenet") / "configs" / "paper.json"
    set_here = flat(json.loads(file.read_text()))
    paper, ours = flat(to_dict(training_config(Path("paper")))), flat(to_dict(TrainingConfig()))
    changed = {name for name, value in paper.items() if value != ours[name]}
    assert changed <= set(set_here) and "model.volume.voxel_size_m" not in set_here


def test_the_rate_stays_the_papers() -> None:
    paper = training_config(Path("paper"))
    assert {learning_rate(paper, step, share) for step in (0, 9) for share in (0, 1)} == {1e-3}


def test_without_a_name_it_is_our_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.json").write_text('{"batch_frames": 3}')
    assert training_config(Path("own.json")).batch_frames == 3
    (tmp_path / "paper").mkdir()  # a run's folder of that name does not hide it
    assert training_config(Path("paper")).max_crops == 10
    with pytest.raises(ConfigError, match="papers"):
        training_config(Path("papers"))


def test_both_stages_take_a_step(recordings: Path, tmp_path: Path) -> None:
    paper = training_config(Path("paper"))
    model = dataclasses.replace(
        paper.model,
        network=dataclasses.replace(TINY.network, crop_margin=paper.model.network.crop_margin),
        volume=dataclasses.replace(TINY.volume, memory_frames=0),
        detection=dataclasses.replace(paper.model.detection, min_cluster_voxels=5),
    )
    config = dataclasses.replace(paper, model=model)
    trainer = Trainer(config, options(tmp_path), ALONE)
    first = trainer.step(batch_of(recordings, config), 1e-3)
    assert "completion" in first and "rotation" not in first
    trainer.progress.step = paper.joint_from_step
    second = trainer.step(batch_of(recordings, config), 1e-3)
    assert "rotation" in second
    for mean, own in zip(
        trainer.average.module.parameters(), trainer.module.network.parameters(), strict=True
    ):
        assert mean.equal(own)  # no moving average


def test_its_tracks_never_end_and_go_anywhere() -> None:
    tracking = training_config(Path("paper")).model.tracking
    assert tracking.end_after_frames > 10_000 and tracking.end_after_visible_misses > 10_000
    assert tracking.max_reach_m > 100 and TrackingConfig().max_reach_m < 10
