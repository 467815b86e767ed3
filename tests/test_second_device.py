"""The whole path on another device than the CPU: a stand-in everywhere, CUDA where there is one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from composenet.network.weights import default_weights, load_weights
from composenet.pipeline import ObjectTracker
from composenet.sequences import open_sequence
from composenet.training.loop import Trainer
from composenet.training.processes import Group
from second_device import SECOND, FarTensor, second_device
from training_cases import CONFIG, batch_of, options

CPU = torch.device("cpu")
CUDA = torch.device("cuda:0")
NO_CUDA = pytest.mark.skipif(not torch.cuda.is_available(), reason="torch sees no CUDA device")


@pytest.fixture(params=[SECOND, pytest.param(CUDA, marks=NO_CUDA)], ids=["stand-in", "cuda"])
def other(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> Iterator[torch.device]:
    """The device that is set against the CPU; float32 there too."""
    monkeypatch.setattr(torch.backends.cudnn, "allow_tf32", False)
    with second_device() if request.param == SECOND else nullcontext():
        yield request.param


def test_the_second_device_refuses_what_cuda_refuses() -> None:
    with second_device():
        there, here = torch.ones(3, device=SECOND), torch.arange(3.0)
        assert isinstance(there, FarTensor) and there.device == SECOND
        both = there + here.to(SECOND)
        assert both.device == SECOND and both.cpu().tolist() == [1, 2, 3]
        assert there.sum().item() == 3 and (there + 1).tolist() == [2, 2, 2]
        with pytest.raises(RuntimeError, match="second device"):
            there + here
        with pytest.raises(RuntimeError, match="second device"):
            torch.cat([there, here])
        with pytest.raises((TypeError, RuntimeError)):
            there.numpy()
        part = there[1:]
        part += 4
        assert there.tolist() == [1, 5, 5]
        np.testing.assert_array_equal(there[torch.tensor([1])].cpu().numpy(), [5])
        w = torch.ones(3, device=SECOND, requires_grad=True)
        (w * both).sum().backward()
        assert w.grad is not None and w.grad.cpu().tolist() == [1, 2, 3]


@pytest.mark.parametrize("joint", [False, True])
def test_training_steps_as_on_the_cpu(
    other: torch.device, recordings: Path, tmp_path: Path, joint: bool
) -> None:
    """Losses, and where the optimiser moves the parameters; float32 sums in another order."""
    config = replace(CONFIG, joint_from_step=0 if joint else 9)
    values, moves = [], []
    for device in (CPU, other):
        (tmp_path / device.type).mkdir()
        trainer = Trainer(config, options(tmp_path / device.type), Group(0, 1, device))
        before = parameters_of(trainer)
        values.append([trainer.step(batch_of(recordings), 1e-3) for _ in range(2)])
        assert {p.device for p in trainer.module.parameters()} == {device}
        moves.append(parameters_of(trainer) - before)
        trainer.save()
        load_weights(tmp_path / device.type / "weights.safetensors")
    for one, other in zip(*values, strict=True):
        assert one.keys() == other.keys()
        np.testing.assert_allclose(list(other.values()), list(one.values()), rtol=2e-3, atol=2e-4)
    near, far = moves
    assert np.abs(near).max() > 1e-3
    # Adam moves a parameter by its gradient's sign, which rounding turns where there is hardly any.
    assert near @ far > 0.99 * np.linalg.norm(near) * np.linalg.norm(far)
    np.testing.assert_allclose(np.linalg.norm(far), np.linalg.norm(near), rtol=1e-2)


def parameters_of(trainer: Trainer) -> np.ndarray:
    """All of the network's, one after the other."""
    tensors = trainer.module.network.parameters()
    return np.concatenate([p.detach().cpu().numpy().astype(np.float64).ravel() for p in tensors])


def test_a_recording_is_tracked_as_on_the_cpu(other: torch.device, recordings: Path) -> None:
    """The fields agree to rounding. Of proposals nearly alike rounding decides which is looked
    at, so the boxes may differ a little."""
    frames = list(open_sequence(recordings / "val_00000"))[:4]
    fields, told = [], []
    for device in (CPU, other):
        network, config, _ = load_weights(default_weights())
        tracker = ObjectTracker(network.to(device), config, device)
        scene = tracker.restart().look(frames[0]).scene
        assert scene is not None and scene.fields.features.device == device
        fields.append([value.cpu().numpy() for value in vars(scene.fields).values()])
        told.append([tracker(frame) for frame in frames])
    for near, far in zip(*fields, strict=True):
        np.testing.assert_allclose(far, near, rtol=1e-3, atol=1e-3)
    sure = [e for result in told[0] for e in result.estimates if e.score > 0.5]
    assert len(sure) > 3
    for near, far in zip(*told, strict=True):
        for one in (e for e in near.estimates if e.score > 0.5):
            gaps = [
                np.linalg.norm(its.box.center - one.box.center)
                for its in far.estimates
                if its.class_id == one.class_id
            ]
            assert min(gaps) < 0.1
        assert [o.track_id for o in near.objects] == [o.track_id for o in far.objects]
