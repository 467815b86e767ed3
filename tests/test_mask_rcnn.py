"""Mask R-CNN of the comparison systems: samples, training, weights, masks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from composenet.baselines import mask_rcnn, registry, torchvision_ops
from composenet.baselines.mask_rcnn import MaskRcnnMasks, distinct, mask_rcnn_weights
from composenet.baselines.records import InstanceMasks
from composenet.baselines.torchvision_ops import import_torchvision
from composenet.errors import DataError, WeightsError
from composenet.records import CLASS_NAMES, Camera, Frame
from composenet.synth.scene import SceneOptions, generate_scene

try:
    import_torchvision()
except WeightsError as error:
    pytest.skip(str(error), allow_module_level=True)

import train_mask_rcnn

from composenet.baselines import mask_rcnn_data, mask_rcnn_network
from composenet.baselines.mask_rcnn_data import FrameStream, make_sample, samples_of_scene
from composenet.baselines.mask_rcnn_network import (
    MaskRcnnConfig,
    detect,
    image_tensor,
    load_network,
    make_network,
    save_network,
)
from composenet.baselines.mask_rcnn_training import (
    SemanticLoss,
    Trainer,
    TrainingOptions,
    train,
)


@pytest.fixture(autouse=True)
def few_frames_ahead(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mask_rcnn_data, "POOL_FRAMES", 4)


TINY = MaskRcnnConfig((8, 8, 16, 16), pyramid_channels=8, box_channels=16, image_size=(96, 72))
SCENES = SceneOptions(frames=3, image_size=(96, 72))


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a tiny network that has learned nothing."""
    torch.manual_seed(1)
    path = tmp_path_factory.mktemp("mask_rcnn") / "tiny.safetensors"
    save_network(make_network(TINY), TINY, path, {"steps": 0})
    return path


def frame(color: np.ndarray | None) -> Frame:
    camera = Camera(np.array([[90.0, 0, 47.5], [0, 90, 35.5], [0, 0, 1]]), 96, 72)
    return Frame(0, np.ones((72, 96), np.float32), camera, np.eye(4), color)


def test_a_sample_by_hand() -> None:
    ids = np.zeros((20, 30), np.uint16)
    ids[2:12, 5:15] = 7  # 100 pixels
    ids[13:19, 20:30] = 2  # 60
    ids[0, :] = 5  # 30: too few
    color = np.full((20, 30, 3), 51, np.uint8)
    depth_m = np.full((20, 30), 2.0, np.float32)
    depth_m[0] = 0.0
    depth_m[1] = 0.4
    sample = make_sample(color, depth_m, ids, {2: 0, 5: 1, 7: 9})
    assert sample.labels.tolist() == [1, 10]  # by gt_id; 0 is the background
    assert sample.boxes.tolist() == [[20, 13, 30, 19], [5, 2, 15, 12]]
    assert sample.masks.sum((1, 2)).tolist() == [60, 100]
    torch.testing.assert_close(sample.image[:3], torch.full((3, 20, 30), 0.2))
    assert (sample.image[3, 0] == 0).all() and (sample.image[3, 1] == 1).all()
    assert (sample.image[3, 2:] == 0.25).all()  # half a metre over two
    empty = make_sample(color, depth_m, 0 * ids, {})
    assert empty.boxes.shape == (0, 4) and empty.masks.shape == (0, 20, 30)


def test_samples_show_the_furniture_of_their_scene() -> None:
    scene = generate_scene("train", 1, SCENES)
    first, again = (list(samples_of_scene(scene, np.random.default_rng(0))) for _ in range(2))
    assert len(first) == 3
    for a, b in zip(first, again, strict=True):
        assert torch.equal(a.image, b.image) and torch.equal(a.masks, b.masks)
    names = {scene.shape_of(int(g)).class_name for g in scene.gt_ids if g}
    labels = torch.cat([sample.labels for sample in first]).tolist()
    assert labels and {CLASS_NAMES[label - 1] for label in labels} <= names
    frames = [scene.render(i, noise=False).ids for i in range(3)]
    sizes = [set(np.unique(ids, return_counts=True)[1].tolist()) for ids in frames]
    for sample in first:  # mirrored or not, the masks have the sizes of one of the frames
        seen = set(sample.masks.sum((1, 2)).tolist())
        assert any(seen <= of_frame for of_frame in sizes)
        for box, mask in zip(sample.boxes.int().tolist(), sample.masks, strict=True):
            assert mask[box[1] : box[3], box[0] : box[2]].sum() == mask.sum()


def test_the_stream_goes_on_from_any_scene() -> None:
    one, other = (next(iter(FrameStream(2, start, 0, SCENES))) for start in (0, 0))
    later = next(iter(FrameStream(2, 40, 0, SCENES)))
    assert len(one) == 2 and torch.equal(one[0].image, other[0].image)
    assert not torch.equal(one[0].image, later[0].image)


def options(out: Path, **changed) -> TrainingOptions:
    return replace(TrainingOptions(out, max_steps=2, workers=0, device="cpu"), **changed)


def test_a_run_goes_on_where_it_stopped(tmp_path: Path) -> None:
    with pytest.raises(WeightsError, match="no checkpoint to go on from"):
        train(TINY, options(tmp_path, resume=True), SCENES)
    path = train(TINY, options(tmp_path), SCENES)
    network, notes = load_network(path)
    assert (notes["steps"], notes["frames"]) == (2, 4) and not network.training
    with pytest.raises(WeightsError, match="--resume"):
        train(TINY, options(tmp_path), SCENES)
    resumed = Trainer(MaskRcnnConfig(), options(tmp_path, resume=True))
    assert resumed.config == TINY and resumed.progress.scenes > 0
    for name, value in resumed.network.state_dict().items():
        torch.testing.assert_close(value, network.state_dict()[name], rtol=1e-3, atol=1e-3)
    train(TINY, options(tmp_path, resume=True), SCENES)
    again = Trainer(TINY, options(tmp_path, resume=True))
    assert again.progress.step == 4 and again.progress.scenes > resumed.progress.scenes
    assert len((tmp_path / "steps.log").read_text().splitlines()) == 4
    (tmp_path / "checkpoint.pt").write_bytes(b"torn")
    with pytest.raises(WeightsError, match="not a readable checkpoint"):
        train(TINY, options(tmp_path, resume=True), SCENES)


def test_the_command(tmp_path: Path, capsys) -> None:
    arguments = {"max_steps": 1, "batch_frames": 1, "workers": 1, "device": "cpu"}
    train_mask_rcnn.main(tmp_path, image_size=(96, 72), **arguments)
    assert "wrote" in capsys.readouterr().out and load_network(tmp_path / mask_rcnn.NAME)
    with pytest.raises(SystemExit, match=r"train_mask_rcnn: .*--resume"):
        train_mask_rcnn.main(tmp_path, **arguments)


def test_one_frame_is_learned(tmp_path: Path) -> None:
    trainer = Trainer(TINY, options(tmp_path))
    batch = next(iter(FrameStream(1, 0, 0, SCENES)))
    totals = [trainer.step(batch, 3e-3)["total"] for _ in range(20)]
    assert np.isfinite(totals).all() and np.mean(totals[-3:]) < 0.75 * np.mean(totals[:3])


@pytest.fixture
def semantic() -> SemanticLoss:
    """That has seen two frames, 72 pixels high and padded to 96: the second is half furniture of
    label 3, its left half."""
    network = make_network(TINY).train()
    loss = SemanticLoss(network, TINY)
    half = torch.zeros(1, 72, 96, dtype=torch.uint8)
    half[..., :48] = 1
    box = {"boxes": torch.tensor([[0.0, 0, 48, 72]]), "labels": torch.tensor([3]), "masks": half}
    nothing = {
        "boxes": torch.zeros(0, 4),
        "labels": torch.zeros(0, dtype=torch.int64),
        "masks": torch.zeros(0, 72, 96, dtype=torch.uint8),
    }
    network([torch.rand(4, 72, 96), torch.rand(4, 72, 96)], [nothing, box])
    return loss


def test_the_loss_of_pixels_counts_them_once_and_no_padding(semantic: SemanticLoss) -> None:
    with torch.no_grad():
        semantic.classify.weight.zero_()
        semantic.classify.bias.copy_(torch.arange(11) / 4)
    cost = -torch.log_softmax(torch.arange(11) / 4, 0)
    torch.testing.assert_close(semantic(), cost[0] * 0.75 + cost[3] * 0.25)


def test_the_loss_of_pixels_is_small_where_the_pyramid_is_right(semantic: SemanticLoss) -> None:
    finest = torch.zeros_like(semantic._finest)
    finest[:, 0] = 40
    left = finest.shape[-1] // 2
    finest[1, 0, :, :left], finest[1, 1, :, :left] = 0, 40
    with torch.no_grad():
        semantic.classify.weight.zero_()
        semantic.classify.bias.zero_()
        semantic.classify.weight[0, 0] = semantic.classify.weight[3, 1] = 1
    semantic._finest = finest
    right = semantic()
    semantic._finest = finest.flip(-1)
    assert right < 0.25 < 10 < semantic()  # a seam of four pixels is blurred


def test_weights_come_back_and_others_are_refused(weights: Path, tmp_path: Path) -> None:
    network, notes = load_network(weights)
    assert notes == {"steps": 0}
    color = np.random.default_rng(0).integers(0, 255, (72, 96, 3)).astype(np.uint8)
    found = detect(network, image_tensor(color, np.ones(color.shape[:2], np.float32)))
    assert found["masks"].shape == (len(found["scores"]), 1, 72, 96)
    with pytest.raises(WeightsError, match="no such weights file"):
        load_network(tmp_path / "none")
    (tmp_path / "torn").write_bytes(b"torn")
    with pytest.raises(WeightsError, match="not a readable safetensors"):
        load_network(tmp_path / "torn")
    wide = replace(TINY, box_channels=24)
    save_network(make_network(TINY), wide, tmp_path / "wide", {})
    with pytest.raises(WeightsError, match="do not fit"):
        load_network(tmp_path / "wide")


def test_the_default_network_is_small_enough_to_ship() -> None:
    n_values = sum(value.numel() for value in make_network(MaskRcnnConfig()).parameters())
    assert 2 * n_values < 16e6


def test_masks_of_a_frame(weights: Path) -> None:
    color = np.random.default_rng(0).integers(0, 255, (72, 96, 3)).astype(np.uint8)
    source = MaskRcnnMasks(weights)
    for masks in (source(frame(color)), source.detections(frame(color))):
        assert masks.masks.shape == (len(masks.scores), 72, 96) and masks.masks.dtype == bool
        assert masks.gt_ids is None and masks.class_ids.dtype == np.int64
        assert set(masks.class_ids.tolist()) <= set(range(len(CLASS_NAMES)))
    with pytest.raises(DataError, match="needs colour"):
        source(frame(None))


def test_masks_come_from_the_device_that_is_asked_for(
    weights: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def note(path: Path, device: str) -> tuple[None, dict]:
        asked.append((path, device))
        return None, {}

    monkeypatch.setattr(mask_rcnn, "mask_rcnn_weights", lambda: weights)
    monkeypatch.setattr(mask_rcnn_network, "load_network", note)
    for device in ("cuda:1", "cuda:2"):  # once a process and device, for all rows
        for name in ("f2f-mask-rcnn", "maskfusion", "midfusion"):
            registry.ROWS[name].masks(Path("any"), device)
    assert asked == [(weights, "cuda:1"), (weights, "cuda:2")]


def test_what_is_shown_twice_or_uncertain_is_dropped() -> None:
    masks = np.zeros((5, 10, 10), bool)
    masks[0, :5] = True
    masks[1, :4] = True  # IoU 0.8 with the first
    masks[2, 4:7] = True  # IoU 0.14
    masks[3, 8:] = True  # uncertain
    found = InstanceMasks(
        masks,  # the fifth is empty
        np.array([1, 2, 3, 4, 5]),
        np.array([0.6, 0.9, 0.5, 0.1, 0.8], np.float32),
    )
    assert distinct(found).class_ids.tolist() == [2, 3]
    nothing = InstanceMasks(masks[:0], np.zeros(0, np.int64), np.zeros(0, np.float32))
    assert len(distinct(nothing).masks) == 0


def test_what_is_missing_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mask_rcnn.resources, "files", lambda package: tmp_path)
    with pytest.raises(WeightsError, match=r"train_mask_rcnn.py --out .*composenet\[baselines\]"):
        mask_rcnn_weights()
    (tmp_path / "weights").mkdir()
    (tmp_path / "weights" / mask_rcnn.NAME).touch()
    assert mask_rcnn_weights().parent == tmp_path / "weights"
    monkeypatch.setattr(torchvision_ops.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(WeightsError, match=r"torchvision.*composenet\[baselines\]"):
        mask_rcnn_weights()
