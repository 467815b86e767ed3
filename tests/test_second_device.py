"""The whole path on another device than the CPU: a stand-in everywhere, CUDA where there is one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from composenet.geometry.procrustes import fit_similarity
from composenet.network.box_head import pool_by_box
from composenet.network.sparse import build_pyramid, submanifold_conv
from composenet.network.weights import default_weights, load_weights
from composenet.pipeline import ObjectTracker
from composenet.sequences import open_sequence
from composenet.training.loop import Trainer
from composenet.training.processes import Group
from composenet.volume.tsdf import dense_tsdf
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


def agree(near: Sequence[torch.Tensor], far: Sequence[torch.Tensor], share: float = 1e-4) -> None:
    """Equal but for rounding, as a share of the largest value."""
    for one, another in zip(near, far, strict=True):
        largest = float(one.abs().max())
        torch.testing.assert_close(another.cpu(), one, rtol=0, atol=share * largest)


def test_sparse_convolution_as_on_the_cpu_and_the_same_twice(other: torch.device) -> None:
    g = torch.Generator().manual_seed(0)
    sites = torch.randint(0, 24, (6000, 3), generator=g)
    coords = torch.unique(torch.cat([sites[:, :1] % 2, sites], dim=1), dim=0)
    features = torch.randn(len(coords), 16, generator=g)
    weight, probe = (torch.randn(*n, generator=g) for n in ((27, 16, 24), (len(coords), 24)))

    def run(device: torch.device) -> list[torch.Tensor]:
        level = build_pyramid(coords.to(device), 2, 2)[0]
        f, w = (x.clone().requires_grad_(True) for x in (features, weight))
        out = submanifold_conv(f.to(device), w.to(device), level)
        (out * probe.to(device)).sum().backward()
        assert f.grad is not None and w.grad is not None
        return [out.detach(), f.grad, w.grad]

    far = run(other)
    agree(run(CPU), far)
    for one, again in zip(far, run(other), strict=True):
        assert torch.equal(one.cpu(), again.cpu())


def test_pooling_as_on_the_cpu(other: torch.device) -> None:
    g = torch.Generator().manual_seed(0)
    values, weight = torch.randn(500, 8, generator=g), torch.rand(500, 1, generator=g)
    box = torch.randint(0, 40, (500,), generator=g).sort().values
    box = torch.where(box == 7, 6, box)  # one is empty

    def run(device: torch.device) -> list[torch.Tensor]:
        v, w = (x.clone().requires_grad_(True) for x in (values, weight))
        pooled = pool_by_box(v.to(device), box.to(device), w.to(device), 40)
        (pooled * torch.linspace(0, 1, 16).to(device)).sum().backward()
        assert v.grad is not None and w.grad is not None
        return [pooled.detach(), v.grad, w.grad]

    agree(run(CPU), run(other))


def test_the_distance_field_as_on_the_cpu(other: torch.device, recordings: Path) -> None:
    frame = next(iter(open_sequence(recordings / "val_00000")))
    T_camera_grid = torch.eye(4)
    T_camera_grid[:3, 3] = torch.tensor([-2.4, -2.4, 0.2])

    def run(device: torch.device) -> list[torch.Tensor]:
        given = [
            torch.from_numpy(np.asarray(x, np.float32)) for x in (frame.depth_m, frame.camera.K)
        ]
        depth, K, T = (x.to(device) for x in (*given, T_camera_grid))
        return list(dense_tsdf(depth, K, T, (96, 96, 48), 0.05, 0.15))

    (near, known), (far, far_known) = run(CPU), run(other)
    assert known.any()
    # where rounding sends a point to the next pixel, the field may be another's
    same = (near - far.cpu()).abs() < 1e-4
    assert same.float().mean() > 0.999
    assert (known == far_known.cpu()).float().mean() > 0.999


def test_similarity_fits_as_on_the_cpu(other: torch.device) -> None:
    g = torch.Generator().manual_seed(0)
    source, target = (torch.randn(12, 50, 3, generator=g) for _ in range(2))
    target = target * 0.05 + 1.7 * source

    def run(device: torch.device) -> list[torch.Tensor]:
        s = source.clone().requires_grad_(True)
        fit = fit_similarity(s.to(device), target.to(device))
        (fit.R[:, 0].sum() + fit.scale.sum() + fit.t.square().sum()).backward()
        assert s.grad is not None and bool(fit.observable.all())
        return [fit.R.detach(), fit.scale.detach(), fit.t.detach(), s.grad]

    agree(run(CPU), run(other), share=1e-3)


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
