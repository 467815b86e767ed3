"""The training loop: learning, resuming, stopping, several processes, scenes."""

from __future__ import annotations

import itertools
import os
import signal
import socket
import subprocess
import sys
import time
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from composenet import cli
from composenet.config import dump
from composenet.errors import ConfigError, DataError, WeightsError
from composenet.files import held
from composenet.network.weights import load_weights, save_weights
from composenet.sequences import open_sequence
from composenet.synth.dataset import write_split
from composenet.synth.scene import SceneOptions, generate_scene
from composenet.training import data, loop
from composenet.training.checkpoint import load_checkpoint
from composenet.training.config import LossWeights, TrainingConfig
from composenet.training.data import (
    SceneSource,
    SceneStream,
    crop_view,
    random_window,
    samples_of_scene,
)
from composenet.training.disk import disk_scene
from composenet.training.loop import Trainer, learning_rate, train
from composenet.training.processes import StopRequest, leave_signals_to_parent
from composenet.training.targets import Sample
from composenet.volume.voxels import voxelize
from conftest import TINY
from training_cases import ALONE, CONFIG, batch_of, options

COMMAND = [sys.executable, "-m", "composenet", "train", "--device", "cpu", "--threads", "1"]


def test_one_batch_is_learned(recordings: Path, tmp_path: Path) -> None:
    config = replace(CONFIG, joint_from_step=30)
    trainer = Trainer(config, options(tmp_path), ALONE)
    batch = batch_of(recordings)
    values = [trainer.step(batch, 1e-2) for _ in range(33)]
    totals = [v["total"] for v in values]
    assert np.isfinite(totals).all()
    assert np.mean(totals[25:30]) < 0.7 * np.mean(totals[:3])
    assert ["rotation" in v for v in values] == [False] * 30 + [True] * 3  # the second stage
    assert trainer.progress.step == 33 and trainer.progress.frames == 66


def test_a_batch_that_is_not_finite_leaves_nothing_behind(recordings: Path, tmp_path: Path) -> None:
    trainer = Trainer(CONFIG, options(tmp_path), ALONE)
    good = batch_of(recordings)
    trainer.step(good, 1e-3)
    features = torch.full_like(good.volume.features, torch.nan)
    bad = replace(good, volume=replace(good.volume, features=features))
    assert np.isnan(trainer.step(bad, 1e-3)["gradient_norm"])
    for state in (trainer.module.network.state_dict(), trainer.averaged_network.state_dict()):
        assert all(torch.isfinite(value).all() for value in state.values())
    assert np.isfinite(trainer.step(good, 1e-3)["total"])


def test_a_run_that_learns_nothing_ends(
    recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    """Step 1 and from step 3 on."""
    real = loop.weighted_sum
    steps = itertools.count()
    monkeypatch.setattr(
        loop, "weighted_sum", lambda *a: real(*a) * (1.0 if next(steps) in (0, 2) else torch.nan)
    )
    monkeypatch.setattr(loop, "MOST_NOT_TAKEN", 3)
    run = options(tmp_path / "run", max_steps=20, validation_scenes=0)
    with pytest.raises(ConfigError, match=r"3 steps in a row.*lower learning_rate"):
        train(CONFIG, run, SceneSource(data_dir=recordings))
    told = capsys.readouterr().out
    assert [f"step {n} was not taken" in told for n in range(1, 7)] == [0, 1, 0, 1, 1, 1]
    network, _, _ = load_weights(run.out / "weights.safetensors")
    assert all(torch.isfinite(value).all() for value in network.state_dict().values())


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -1.0])
def test_losses_weigh_what_can_be_weighed(value: float) -> None:
    for make in (lambda: LossWeights(center=value), lambda: TrainingConfig(weight_decay=value)):
        with pytest.raises(ValueError, match=r"number|greater"):
            make()


def test_a_run_goes_on_where_it_stopped(recordings: Path, tmp_path: Path) -> None:
    source = SceneSource(data_dir=recordings)
    weights = train(CONFIG, options(tmp_path), source)
    first = load_checkpoint(tmp_path / "checkpoint.pt")
    assert first["config"] == CONFIG
    assert (first["progress"].step, first["progress"].frames) == (3, 6)
    train(CONFIG, options(tmp_path, max_steps=2), source)
    second = load_checkpoint(tmp_path / "checkpoint.pt")
    assert second["progress"].step == 5 and second["progress"].scenes > first["progress"].scenes
    moments = [v["step"] for v in second["optimizer"]["state"].values()]
    assert moments and max(float(step) for step in moments) == 5
    lines = (tmp_path / "steps.log").read_text().splitlines()
    steps = [line for line in lines if line.startswith("step=")]
    assert [line.split()[0] for line in steps] == [f"step={n}" for n in range(1, 6)]
    assert not any("nan" in line or "inf" in line.replace("instance", "") for line in steps)
    _, config, notes = load_weights(weights)
    assert config == TINY and notes["steps"] == 5


def test_a_run_goes_on_with_what_it_has_learned(recordings: Path, tmp_path: Path) -> None:
    """Network, moving average and optimiser are those that were saved, and the recipe, too, which
    need not be given again."""
    config = replace(CONFIG, seed=3, learning_rate=7e-4, weight_decay=1e-5)
    begun, batch = Trainer(config, options(tmp_path), ALONE), batch_of(recordings)
    for _ in range(3):
        begun.step(batch, 1e-2)
    begun.save()
    resumed = Trainer(None, options(tmp_path), ALONE)
    assert resumed.config == config and resumed.progress == begun.progress
    for a, b in ((resumed.module, begun.module), (resumed.average, begun.average)):
        states = a.state_dict(), b.state_dict()
        assert states[0].keys() == states[1].keys()
        assert all(torch.equal(states[0][name], states[1][name]) for name in states[0])
    values = []
    for trainer in (begun, resumed):
        trainer.generator.manual_seed(0)  # one that goes on moves its boxes otherwise
        values.append(trainer.step(batch, 1e-2)["total"])
    assert values[0] == pytest.approx(values[1], rel=1e-5)


def test_a_start_that_fails_leaves_no_run_behind(
    recordings: Path, tiny_weights: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    """Else the corrected command would go on from it, with its recipe and without its weights."""
    run = options(tmp_path / "run", start_from=tiny_weights, max_steps=1, validation_scenes=0)
    with pytest.raises(DataError):
        train(CONFIG, replace(run, start_from=None), SceneSource(data_dir=tmp_path / "none"))
    assert not (tmp_path / "run" / "checkpoint.pt").exists()
    train(CONFIG, run, SceneSource(data_dir=recordings))
    assert "--start-from" not in capsys.readouterr().out
    train(None, run, SceneSource(data_dir=recordings))  # the same again goes on
    assert "goes on from" in capsys.readouterr().out
    assert load_checkpoint(tmp_path / "run" / "checkpoint.pt")["progress"].step == 2


def test_a_run_that_another_process_is_at_is_left_alone(recordings: Path, tmp_path: Path) -> None:
    with held(tmp_path), pytest.raises(DataError, match="another run is writing here"):
        train(CONFIG, options(tmp_path), SceneSource(data_dir=recordings))
    assert not list(tmp_path.iterdir())


def test_weights_without_their_checkpoint_are_not_replaced(
    recordings: Path, tmp_path: Path
) -> None:
    weights = train(CONFIG, options(tmp_path), SceneSource(data_dir=recordings))
    (tmp_path / "checkpoint.pt").unlink()
    before = weights.read_bytes()
    with pytest.raises(WeightsError, match="--start-from"):
        train(CONFIG, options(tmp_path), SceneSource(data_dir=recordings))
    assert weights.read_bytes() == before


def test_a_run_without_a_step_leaves_nothing_to_go_on_from(
    recordings: Path, tmp_path: Path
) -> None:
    run = options(tmp_path, max_minutes=1e-9, max_steps=None, validation_scenes=0)
    assert not train(CONFIG, run, SceneSource(data_dir=recordings)).exists()
    assert not (tmp_path / "checkpoint.pt").exists()


def test_weights_bring_their_configuration(tmp_path: Path, tiny_weights: Path) -> None:
    network, config, notes = load_weights(tiny_weights)
    other = replace(config, volume=replace(config.volume, memory_frames=7))
    save_weights(network, other, tmp_path / "other.safetensors", notes)
    run = options(tmp_path / "run", start_from=tmp_path / "other.safetensors")
    begun = Trainer(None, run, ALONE)
    assert begun.config.model == other
    (note,) = begun.notes
    assert "up to step 3200 poses are not taught" in note and '"joint_from_step": 0' in note
    asked = Trainer(replace(CONFIG, joint_from_step=0), run, ALONE)
    assert asked.config.model == CONFIG.model
    (note,) = asked.notes
    assert "volume.memory_frames 7; this run has 900" in note


def test_a_run_that_goes_on_with_other_scenes_says_so(
    recordings: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture,
) -> None:
    monkeypatch.setattr(data, "POOL_FRAMES", 16)  # one step needs no more
    run = options(tmp_path, max_steps=1, validation_scenes=0)
    for _ in range(2):
        train(CONFIG, run, SceneSource(data_dir=recordings))
    assert "before, it learned from" not in capsys.readouterr().out
    train(CONFIG, run, SceneSource(data_dir=recordings / "."))  # the same
    train(CONFIG, run, SceneSource())
    said = capsys.readouterr().out
    assert said.count("before, it learned from") == 1
    assert (
        f"goes on with generated rooms; before, it learned from the sequences of {recordings}"
        in said
    )


def test_a_run_does_not_go_on_with_another_recipe(tmp_path: Path) -> None:
    Trainer(CONFIG, options(tmp_path), ALONE).save()
    weights = replace(CONFIG.weights, box=2.0)
    changed = {
        "parts": replace(CONFIG, parts="boxes"),
        "weights.box": replace(CONFIG, weights=weights),
    }
    for name, other in changed.items():
        with pytest.raises(
            WeightsError, match=rf"another configuration \({name} is .*--start-from"
        ):
            Trainer(other, options(tmp_path), ALONE)
    Trainer(replace(CONFIG), options(tmp_path), ALONE)  # the same is welcome


def test_the_last_steps_are_kept_before_they_are_validated(
    recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def killed(*_: object) -> None:
        assert load_checkpoint(tmp_path / "checkpoint.pt")["progress"].step == 2
        raise KeyboardInterrupt

    monkeypatch.setattr(loop, "validate", killed)
    with pytest.raises(KeyboardInterrupt):
        train(CONFIG, options(tmp_path, max_steps=2), SceneSource(data_dir=recordings))


def test_a_checkpoint_that_fails_does_not_end_the_run(
    recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    """The disk is full for a while."""
    real, asked = loop.save_checkpoint, []

    def save(path: Path, *rest: object) -> None:
        asked.append(path)
        if len(asked) == 1:
            raise DataError(f"{path}: cannot be written (No space left on device)")
        real(path, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(loop, "save_checkpoint", save)
    run = options(tmp_path, max_steps=3, save_every_minutes=0, validation_scenes=0)
    train(CONFIG, run, SceneSource(data_dir=recordings))
    assert capsys.readouterr().out.count("not saved") == 1
    assert load_checkpoint(tmp_path / "checkpoint.pt")["progress"].step == 3


@pytest.mark.parametrize("save_every_minutes", [0, 60])
def test_a_last_checkpoint_that_fails_is_told_of(
    recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, save_every_minutes: float
) -> None:
    def full(path: Path, *_: object) -> None:
        raise DataError(f"{path}: cannot be written (No space left on device)")

    monkeypatch.setattr(loop, "save_checkpoint", full)
    run = options(tmp_path, max_steps=1, save_every_minutes=save_every_minutes)
    with pytest.raises(DataError, match="No space"):
        train(CONFIG, run, SceneSource(data_dir=recordings))


def test_processes_draw_numbers_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(loop, "DistributedDataParallel", lambda module, **_: module)
    both = [Trainer(CONFIG, options(tmp_path), replace(ALONE, rank=r, size=2)) for r in (0, 1)]
    first, second = (torch.rand(5, generator=trainer.generator) for trainer in both)
    assert not torch.equal(first, second)


@pytest.mark.parametrize("frames", [6, 16, 20, 24, 32])
def test_scenes_are_never_counted_too_low(frames: int) -> None:
    """Of a walk in which every second frame is looked at there are fewer samples than asked for."""
    rng = np.random.default_rng(0)
    config = replace(CONFIG, frames_per_scene=frames)
    walks = [len(data.walk(30, frames, rng, data.LONG_WALKS)) for _ in range(300)]
    drawn = np.minimum(walks, frames).sum()
    assert loop._scenes_of(int(drawn), config, 1) >= len(walks)


def test_time_is_up(recordings: Path, tmp_path: Path) -> None:
    start = time.monotonic()
    run = options(tmp_path, max_steps=None, max_minutes=1 / 60, validation_scenes=0)
    train(CONFIG, run, SceneSource(data_dir=recordings))
    assert time.monotonic() - start < 60  # not for ever, however busy the machine
    assert load_checkpoint(tmp_path / "checkpoint.pt")["progress"].step > 0


def test_the_rate_warms_up_and_falls() -> None:
    config = replace(CONFIG, rate_warmup_steps=10, decay_share=0.5, learning_rate=1.0)
    assert learning_rate(config, 0, 0.0) == pytest.approx(0.1)
    assert learning_rate(config, 50, 0.5) == 1.0
    assert learning_rate(config, 50, 0.75) == pytest.approx(0.5)
    assert learning_rate(config, 50, 1.0) == pytest.approx(0.01)


def test_beginning_from_weights(tiny_weights: Path, tmp_path: Path) -> None:
    trainer = Trainer(CONFIG, options(tmp_path, start_from=tiny_weights), ALONE)
    given, _, _ = load_weights(tiny_weights)
    for name, value in given.state_dict().items():
        assert torch.equal(trainer.module.network.state_dict()[name], value)
        assert torch.equal(trainer.averaged_network.state_dict()[name], value)
    with pytest.raises(WeightsError, match="another configuration") as caught:
        Trainer(TrainingConfig(), options(tmp_path, start_from=tiny_weights), ALONE)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("damage", ["cut", "text", "foreign", "lacking"])
def test_a_corrupt_checkpoint(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "checkpoint.pt"
    Trainer(CONFIG, options(tmp_path), ALONE).save()
    stored = torch.load(path, weights_only=True)
    if damage == "cut":
        path.write_bytes(path.read_bytes()[:2000])
    elif damage == "text":
        path.write_text("hello")
    else:
        changed = {"format": "other/1"} if damage == "foreign" else {**stored}
        changed.pop("optimizer", None)
        torch.save(changed, path)
    with pytest.raises(WeightsError, match=r"checkpoint\.pt") as caught:
        Trainer(CONFIG, options(tmp_path), ALONE)
    assert "\n" not in str(caught.value)


def test_a_checkpoint_of_another_network(tmp_path: Path) -> None:
    Trainer(CONFIG, options(tmp_path), ALONE).save()
    with pytest.raises(WeightsError, match="another configuration") as caught:
        Trainer(TrainingConfig(), options(tmp_path), ALONE)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("workers", [0, 1])
def test_damaged_data_is_one_line(recordings: Path, tmp_path: Path, workers: int) -> None:
    folder = tmp_path / "data" / "val_00000"
    folder.parent.mkdir()
    subprocess.run(["cp", "-r", recordings / folder.name, folder], check=True)
    for path in (folder / "depth").iterdir():
        path.write_bytes(path.read_bytes()[:100])
    run = options(tmp_path, workers=workers, validation_scenes=0)
    with pytest.raises(DataError, match="val_00000, frame") as caught:
        train(CONFIG, run, SceneSource(data_dir=folder.parent))
    assert "\n" not in str(caught.value) and "DataError" not in str(caught.value)


def test_learning_from_what_is_measured_on_is_told_of(
    recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    monkeypatch.setattr(loop, "train", lambda *_: tmp_path / "weights.safetensors")
    arguments = ["composenet", "train", "--out", tmp_path / "out", "--data", recordings]
    monkeypatch.setattr(sys, "argv", [str(part) for part in arguments])
    with pytest.raises(SystemExit) as stop:
        cli.main()
    assert stop.value.code == 0 and "sequences of val" in capsys.readouterr().out
    monkeypatch.setattr(sys, "argv", [str(part) for part in (*arguments, "--cad", tmp_path)])
    with pytest.raises(SystemExit) as stop:
        cli.main()
    assert stop.value.code == 2 and "--cad is for generated scenes" in capsys.readouterr().err


def test_a_share_of_the_scenes_is_from_disk(recordings: Path) -> None:
    source = SceneSource(data_dir=recordings, data_share=0.3)
    kinds = [type(source.scene(index)).__name__ for index in range(40)]
    assert 5 <= kinds.count("DiskScene") <= 20
    assert kinds == [type(source.scene(index)).__name__ for index in range(40)]
    assert source.told == f"30% the sequences of {recordings.resolve()}, generated rooms"
    every = SceneSource(data_dir=recordings)
    assert {type(every.scene(index)).__name__ for index in range(10)} == {"DiskScene"}


def test_an_empty_folder_of_data(tmp_path: Path) -> None:
    run = options(tmp_path / "out", validation_scenes=0)
    with pytest.raises(DataError, match="no sequences here"):
        train(CONFIG, run, SceneSource(data_dir=tmp_path))


def test_a_scene_on_disk_is_the_generated_one(recordings: Path) -> None:
    scene = generate_scene("val", 1, SceneOptions(frames=6, image_size=(160, 120)))
    stored = disk_scene(recordings, 3)  # two of them, over and over
    alone = disk_scene(recordings / "val_00001", 5)  # the folder of a sequence is one, too
    assert alone.folder == stored.folder
    assert stored.n_frames == 6
    ours, theirs = stored.render(4), scene.render(4, color=False)
    np.testing.assert_array_equal(ours.frame.depth_m, theirs.frame.depth_m)
    np.testing.assert_array_equal(ours.ids, theirs.ids)
    np.testing.assert_array_equal(ours.frame.T_world_camera, theirs.frame.T_world_camera)
    for a, b in zip(stored.frame_truth(4, ours.ids), scene.frame_truth(4, theirs.ids), strict=True):
        assert (a.gt_id, a.visible_pixels) == (b.gt_id, b.visible_pixels)
    assert Image.open(stored.folder / "depth" / "4.png").size == (160, 120)


def test_wide_images_on_disk_are_seen_as_in_tracking(tmp_path: Path) -> None:
    write_split("val", 1, tmp_path, 0, SceneOptions(frames=2, image_size=(640, 480)))
    scene, sequence = disk_scene(tmp_path, 0), open_sequence(tmp_path / "val_00000")
    for i, frame in enumerate(sequence):
        ours = scene.render(i)
        np.testing.assert_array_equal(ours.frame.depth_m, frame.depth_m)
        np.testing.assert_allclose(ours.frame.camera.K, frame.camera.K)
        assert ours.ids.shape == frame.depth_m.shape == (240, 320)


def test_short_sequences_give_what_they_have(recordings: Path) -> None:
    many = replace(CONFIG, frames_per_scene=50)
    rng = np.random.default_rng(0)
    assert len(list(samples_of_scene(disk_scene(recordings, 0), many, rng))) == 6


def test_only_what_learns_occupancy_pays_for_it() -> None:
    source, both = SceneSource(), {}
    for parts in ("all", "detector"):
        config = replace(TrainingConfig(parts=parts), frames_per_scene=3)
        both[parts] = list(samples_of_scene(source.scene(3), config, np.random.default_rng(0)))
    assert len(both["all"]) == 3
    for whole, hollow in zip(both["all"], both["detector"], strict=True):
        for field in fields(Sample):
            if field.name not in ("volume", "occupancy"):
                ours, theirs = getattr(whole, field.name), getattr(hollow, field.name)
                np.testing.assert_array_equal(ours, theirs)
        np.testing.assert_array_equal(whole.volume.features, hollow.volume.features)
        assert whole.occupancy.any(axis=(1, 2, 3)).all() and not hollow.occupancy.any()


def test_validation_sees_the_same_frames_whatever_the_run() -> None:
    runs = [
        data.fixed_batches(SceneSource("val"), TrainingConfig(parts=parts, frames_per_scene=n), 1)
        for parts, n in (("detector", 3), ("objects", 12))
    ]
    ours, theirs = (torch.cat([b.occupancy for b in run]) for run in runs)
    assert torch.equal(ours, theirs) and ours.any()
    assert sum(batch.volume.size for batch in runs[0]) == 5


def test_walks_start_with_nothing_remembered_or_see_everything_or_come_back() -> None:
    rng = np.random.default_rng(0)
    walks = [data.walk(30, 6, rng, 0.6) for _ in range(400)]
    steps = [np.diff(times) for times in walks]
    assert all(min(times) >= 0 and max(times) < 30 for times in walks)
    assert all(len(set(np.abs(step))) == 1 and abs(step[0]) <= data.LONGEST_STEP for step in steps)
    short = [len(times) == 8 for times in walks]
    back = [bool((step < 0).any()) for step in steps]
    assert 0.3 < np.mean(short) < 0.5 and 0.2 < np.mean(back) < 0.4
    for times, returns in zip(walks, back, strict=True):
        if returns:  # to where it began, and nothing twice in a row
            assert times == times[::-1] and len(times) == 2 * len(set(times)) - 1


def test_a_walk_through_a_long_recording_is_a_part_of_it() -> None:
    rng = np.random.default_rng(0)
    walks = [data.walk(5000, 6, rng, 1.0) for _ in range(100)]
    assert max(len(set(times)) for times in walks) == data.LONGEST_WALK
    assert min(map(min, walks)) < 1000 and max(map(max, walks)) > 4000
    assert all(len(data.walk(5000, 6, rng, 0.0)) == 8 for _ in range(20))


def test_some_cameras_look_aside_in_training_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    scenes = [generate_scene("train", i) for i in range(6)]
    monkeypatch.setattr(data, "LOOKS_ASIDE", 0.5)
    turns = []
    for i, scene in enumerate(scenes):
        seen, again = SceneSource().scene(i), SceneSource().scene(i)
        np.testing.assert_array_equal(seen.T_world_camera, again.T_world_camera)
        turn = seen.T_world_camera[:, :3, :3] @ scene.T_world_camera[:, :3, :3].transpose(0, 2, 1)
        np.testing.assert_allclose(turn, np.broadcast_to(turn[0], turn.shape), atol=1e-12)
        np.testing.assert_allclose(turn[0, 2], [0, 0, 1], atol=1e-12)  # about the vertical
        np.testing.assert_array_equal(seen.T_world_camera[:, :3, 3], scene.T_world_camera[:, :3, 3])
        turns.append(round(float(np.degrees(np.arctan2(turn[0, 1, 0], turn[0, 0, 0]))), 3))
    assert 0 < turns.count(0.0) < 6 and len(set(turns)) == 7 - turns.count(0.0)
    monkeypatch.setattr(data, "LOOKS_ASIDE", 1.0)
    val = SceneSource("val").scene(0).T_world_camera
    np.testing.assert_array_equal(val, generate_scene("val", 0).T_world_camera)


def test_a_cropped_view_is_a_window_of_the_same_camera(recordings: Path) -> None:
    whole = disk_scene(recordings, 0).render(0)
    view, ids = crop_view(whole.frame, whole.ids, random_window(np.random.default_rng(0)))
    kept = view.depth_m > 0
    np.testing.assert_array_equal(ids[kept], whole.ids[kept])
    left = np.flatnonzero(kept.any(axis=0))
    assert ids.any() and not ids[:, : left[0]].any() and not ids[:, left[-1] + 1 :].any()
    assert 0 < kept.sum() < (whole.frame.depth_m > 0).sum()
    np.testing.assert_array_equal(view.depth_m[kept], whole.frame.depth_m[kept])
    np.testing.assert_array_equal(view.camera.K, whole.frame.camera.K)


@pytest.mark.parametrize("generated", [True, False])
def test_what_the_window_leaves_out_is_no_target(
    recordings: Path, monkeypatch: pytest.MonkeyPatch, generated: bool
) -> None:
    """Not even where earlier frames saw it."""
    scene = generate_scene("train", 3) if generated else disk_scene(recordings, 0)
    least, looked_at = CONFIG.min_visible_pixels, []

    def noted(frame, config, ids, memory):
        looked_at.append((frame.index, np.bincount(ids.ravel(), minlength=100)))
        return voxelize(frame, config, ids, memory)

    monkeypatch.setattr(data, "voxelize", noted)
    config, left_out = replace(CONFIG, frames_per_scene=6), 0
    for seed in range(4):
        looked_at.clear()
        samples = list(samples_of_scene(scene, config, np.random.default_rng(seed)))
        for sample, (index, pixels) in zip(samples, looked_at, strict=True):
            shown = set(np.flatnonzero(pixels >= least).tolist()) - {0}
            assert set(sample.gt_id.tolist()) == shown
            whole = scene.frame_truth(index, scene.render(index).ids)
            left_out += sum(t.visible_pixels >= least and t.gt_id not in shown for t in whole)
    assert left_out


class Drawn:
    """In place of scenes: notes which indices a stream draws; a batch is a list of them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.patch = monkeypatch
        monkeypatch.setattr(SceneSource, "scene", lambda _, index: index)
        monkeypatch.setattr(
            data, "samples_of_scene", lambda i, config, _: [i] * (config.frames_per_scene - 1)
        )
        monkeypatch.setattr(data, "collate_samples", lambda picked: picked)

    def batches(
        self, count: int, start: int, worker: int, workers: int, rank: int = 0, size: int = 1
    ) -> set[int]:
        """Scenes in the first batches of one worker of one process."""
        info = SimpleNamespace(id=worker, num_workers=workers)
        self.patch.setattr(data, "get_worker_info", lambda: info)
        stream = SceneStream(SceneSource(), TrainingConfig(), start, rank, size)
        return set(itertools.chain(*itertools.islice(iter(stream), count)))


def test_no_two_workers_or_processes_share_a_scene(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = Drawn(monkeypatch)
    sets = [drawn.batches(30, 7, w, 3, rank, 2) for rank in range(2) for w in range(3)]
    assert 7 <= min(set.union(*sets)) < 13
    assert sum(map(len, sets)) == len(set.union(*sets))


@pytest.mark.parametrize(("taken", "least", "most"), [(1, 1 / 8, 1 / 3), (800, 0.99, 1.01)])
def test_a_pool_that_fills_while_it_is_learned_from(
    monkeypatch: pytest.MonkeyPatch, taken: int, least: float, most: float
) -> None:
    """The first batch comes soon; later ones are mixed from dozens of scenes."""
    Drawn(monkeypatch)
    drawn: list[int] = []
    monkeypatch.setattr(SceneSource, "scene", lambda _, index: drawn.append(index) or index)
    config = TrainingConfig(batch_frames=2, frames_per_scene=6)
    batches = list(itertools.islice(iter(SceneStream(SceneSource(), config, 0)), taken))
    pool = 5 * len(drawn) - sum(map(len, batches))
    assert least <= pool / data.POOL_FRAMES <= most


@pytest.mark.parametrize("workers", [1, 4])
@pytest.mark.parametrize("steps", [1, 7, 60])
def test_a_resumed_run_sees_new_scenes(
    monkeypatch: pytest.MonkeyPatch, workers: int, steps: int, tmp_path: Path
) -> None:
    drawn = Drawn(monkeypatch)
    each = -(-steps // workers)
    used = set.union(*[drawn.batches(each, 0, w, workers) for w in range(workers)])
    monkeypatch.setattr(loop, "batches_of", lambda *_: itertools.repeat(None))
    trainer = Trainer(replace(TrainingConfig(), model=TINY), options(tmp_path), ALONE)
    next(loop._batches(trainer, options(tmp_path, workers=workers), SceneSource()))
    trainer.progress.scenes += steps * loop._scenes_per_step(trainer.config, 1)
    assert max(used) < trainer.progress.scenes


def test_runs_of_other_seeds_see_other_scenes(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Else a run that goes on from another's weights learns the same rooms by heart."""
    drawn = Drawn(monkeypatch)
    starts: list[int] = []
    monkeypatch.setattr(
        loop,
        "batches_of",
        lambda stream, _: starts.append(stream.start) or itertools.repeat(None),
    )
    for seed in (0, 1, 27):
        trainer = Trainer(TrainingConfig(model=TINY, seed=seed), options(tmp_path), ALONE)
        next(loop._batches(trainer, options(tmp_path), SceneSource()))
    seen = [drawn.batches(60, start, 0, 1) for start in starts]
    assert starts[0] == 0 and sum(map(len, seen)) == len(set.union(*seen))


def _one_of_two(rank: int, port: int, recordings: Path, out: Path) -> None:
    os.environ |= {"RANK": str(rank), "WORLD_SIZE": "2", "LOCAL_RANK": str(rank)}
    os.environ |= {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port)}
    # The rate falls with time from the start: processes that read their own clocks would part.
    config = replace(CONFIG, decay_share=1.0)
    states = []
    save = Trainer.save

    def keep(trainer: Trainer) -> None:
        save(trainer)
        states.append({k: v.clone() for k, v in trainer.module.named_parameters()})

    Trainer.save = keep  # type: ignore[method-assign]
    run = options(out, max_minutes=0.5, validation_scenes=0)
    train(config, run, SceneSource(data_dir=recordings))
    torch.save(states[-1], out / f"parameters{rank}.pt")


def test_two_processes_stay_equal(recordings: Path, tmp_path: Path) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    torch.multiprocessing.spawn(_one_of_two, (port, recordings, tmp_path), nprocs=2)
    first, second = (torch.load(tmp_path / f"parameters{rank}.pt") for rank in range(2))
    fresh = Trainer(CONFIG, options(tmp_path / "fresh"), ALONE).module
    assert list(first) == list(second)
    for name in first:
        assert torch.equal(first[name], second[name]), name
    assert any(not torch.equal(first[n], v) for n, v in fresh.named_parameters())
    progress = load_checkpoint(tmp_path / "checkpoint.pt")["progress"]
    assert (progress.step, progress.frames) == (3, 12)  # both processes' frames


@pytest.mark.parametrize("by", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_to_all_processes_stops_cleanly_and_keeps_a_checkpoint(
    recordings: Path, tmp_path: Path, by: signal.Signals
) -> None:
    dump(CONFIG, tmp_path / "config.json")
    arguments = ["--out", tmp_path / "run", "--config", tmp_path / "config.json"]
    arguments += ["--data", recordings, "--workers", "1", "--max-minutes", "5"]
    log = tmp_path / "run" / "steps.log"
    process = subprocess.Popen(
        [*COMMAND, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"},
    )
    try:
        assert process.stdout is not None
        assert "sequences of val" in process.stdout.readline()
        line = process.stdout.readline()  # the first step is done
        assert line.startswith("step "), line
        os.killpg(process.pid, by)
        _, errors = process.communicate(timeout=30)
    finally:
        process.kill()
    assert process.returncode == 0 and errors == ""
    assert load_checkpoint(tmp_path / "run" / "checkpoint.pt")["progress"].step >= 1
    assert "validation" not in log.read_text()  # no waiting for it
    load_weights(tmp_path / "run" / "weights.safetensors")


def test_a_worker_ends_only_by_a_later_signal(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not by one that torchrun passes on, which all processes were sent already."""
    handlers: dict[int, Any] = {}
    ended: list[int] = []
    monkeypatch.setattr(signal, "signal", handlers.__setitem__)
    monkeypatch.setattr(os, "_exit", ended.append)
    leave_signals_to_parent(0)
    assert handlers[signal.SIGINT] is signal.SIG_IGN
    for at_s, count in ((10.0, 0), (10.9, 0), (11.1, 1)):
        monkeypatch.setattr(time, "monotonic", lambda at_s=at_s: at_s)
        handlers[signal.SIGTERM](signal.SIGTERM, None)
        assert len(ended) == count


def test_only_a_later_ctrl_c_stops_at_once() -> None:
    before = signal.getsignal(signal.SIGINT)
    with StopRequest() as stop:
        signal.raise_signal(signal.SIGINT)
        assert stop.asked_at
        signal.raise_signal(signal.SIGINT)  # torchrun passes it on
        stop.asked_at -= 2
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before
