"""Several trainings beside each other, and the mean of what they learned."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch
import train_together
from train_together import main

from composenet import cli
from composenet.config import dump
from composenet.errors import DataError
from composenet.network.weights import default_weights, load_weights
from composenet.training import data, loop
from composenet.training.checkpoint import load_checkpoint
from composenet.training.config import TrainingConfig, training_config
from training_cases import CONFIG


class Here:
    """A command as it is run, in this process."""

    def __init__(self, command: list[str], **_: object) -> None:
        assert command[:3] == [sys.executable, "-m", "composenet"]
        with pytest.MonkeyPatch.context() as patch, pytest.raises(SystemExit) as end:
            patch.setattr(sys, "argv", command[2:])
            cli.main()
        self.code = end.value.code

    def wait(self) -> object:
        return self.code


def test_each_alone_and_then_their_mean(
    tiny_weights: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(train_together.subprocess, "Popen", Here)
    monkeypatch.setattr(data, "POOL_FRAMES", 16)  # one step needs no more
    monkeypatch.setattr(loop, "fixed_batches", lambda *_: [])
    dump(replace(CONFIG, batch_frames=1, frames_per_scene=2), tmp_path / "config.json")
    out = tmp_path / "out"
    common = {"config": tmp_path / "config.json", "workers": 0, "max_steps": 1, "device": "cpu"}
    for steps in (1, 2):  # the same command once more goes on
        assert main(tiny_weights, out, (3, 4), **common) == 0  # type: ignore[arg-type]
        for seed in (3, 4):
            checkpoint = load_checkpoint(out / str(seed) / "checkpoint.pt")
            assert checkpoint["progress"].step == steps and checkpoint["config"].seed == seed
    first, second, mean = (
        load_weights(path)[0].state_dict()
        for path in (*(out / s / "weights.safetensors" for s in "34"), out / "mean.safetensors")
    )
    assert not all(torch.equal(first[name], second[name]) for name in first)
    for name, value in mean.items():
        if value.is_floating_point():
            between = (first[name] + second[name]) / 2
            torch.testing.assert_close(value, between, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("seeds", [(), (3, 3)])
def test_seeds_that_are_no_seeds(tiny_weights: Path, tmp_path: Path, seeds: tuple) -> None:
    with pytest.raises(DataError, match="--seeds"):
        main(tiny_weights, tmp_path, seeds)


def test_a_training_that_fails_is_told_of(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"3: .*no\.safetensors"):
        main(tmp_path / "no.safetensors", tmp_path, (3,), max_steps=1, device="cpu")


def test_without_the_service_nothing_begins(
    tiny_weights: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(DataError, match="leave --mps out"):
        main(tiny_weights, tmp_path / "out", (3,), mps=True)
    assert not list((tmp_path / "out").glob("*.log"))


def test_going_on_teaches_all_parts_from_the_first_step() -> None:
    further = training_config(Path("further"))
    assert further.parts == "apart" and further.joint_from_step == 0
    own = load_weights(default_weights())[1]
    assert further.model == own == TrainingConfig().model
