"""Weights come back as they were, or are refused in one line."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from composenet.config import Config, from_dict, to_dict
from composenet.errors import ConfigError, SequenceError, WeightsError
from composenet.network.model import ComposeNet
from composenet.network.weights import FORMAT, load_weights, save_weights
from composenet.pipeline import load_tracker, select_device
from composenet.records import Box
from conftest import TINY
from tracking_scenes import frame

BOX = Box(np.array([2.5, 0.3, 0.45]), np.array([0.6, 0.8, 0.9]))


def metadata_of(path: Path) -> dict[str, str]:
    with safe_open(path, framework="pt") as file:
        return dict(file.metadata())


def rewritten(path: Path, to: Path, **metadata: str | None) -> Path:
    """A copy with other metadata; None removes an entry."""
    changed = {**metadata_of(path), **metadata}
    save_file(load_file(path), to, {k: v for k, v in changed.items() if v is not None})
    return to


def refused(path: Path) -> str:
    with pytest.raises(WeightsError) as caught:
        load_weights(path)
    text = str(caught.value)
    assert str(path) in text and "\n" not in text and len(text) < 600
    return text


def test_round_trip(tmp_path: Path) -> None:
    torch.manual_seed(1)
    network = ComposeNet(TINY.network, TINY.volume)
    network.backbone.stem_norm.running_mean.fill_(1 / 3)
    network.backbone.stem_norm.num_batches_tracked.fill_(70_000)
    path = tmp_path / "w.safetensors"
    save_weights(network, TINY, path, {"steps": 7})
    loaded, config, notes = load_weights(path)
    assert config == TINY and notes == {"steps": 7} and not loaded.training
    before, after = network.state_dict(), loaded.state_dict()
    assert list(before) == list(after)
    for name, value in before.items():
        exact = "running_" in name or not value.is_floating_point()
        assert after[name].dtype == value.dtype
        torch.testing.assert_close(after[name], value if exact else value.half().float())
    assert [p.name for p in tmp_path.iterdir()] == ["w.safetensors"]  # nothing half written


def test_the_file_holds_its_configuration_and_no_code(tiny_weights: Path) -> None:
    metadata = metadata_of(tiny_weights)
    assert metadata["format"] == FORMAT
    assert from_dict(json.loads(metadata["config"])) == TINY
    assert tiny_weights.read_bytes()[8:9] == b"{"  # a JSON header, then plain numbers


def test_others_may_read_the_file_as_any_other(tmp_path: Path, tiny_weights: Path) -> None:
    (tmp_path / "any").write_bytes(b"")
    assert tiny_weights.stat().st_mode == (tmp_path / "any").stat().st_mode


def test_missing_empty_and_foreign_files(tmp_path: Path, tiny_weights: Path) -> None:
    assert "no such weights" in refused(tmp_path / "none.safetensors")
    path = tmp_path / "w.safetensors"
    for content in (b"", b"not safetensors at all", tiny_weights.read_bytes()[:5000]):
        path.write_bytes(content)
        assert "not a readable safetensors" in refused(path)
    save_file({"x": torch.zeros(3)}, path)
    assert FORMAT in refused(path)
    save_file({"x": torch.zeros(3)}, path, {"format": "somebody.else/3"})
    assert "somebody.else/3" in refused(path)


@pytest.mark.parametrize(
    "config", [None, "", "[]", "null", '{"network": {"crop_cells": 7}}', '{"colour": 1}']
)
def test_a_damaged_configuration(tmp_path: Path, tiny_weights: Path, config: str | None) -> None:
    assert "configuration" in refused(rewritten(tiny_weights, tmp_path / "w", config=config))
    assert "configuration" in refused(rewritten(tiny_weights, tmp_path / "w", notes="{"))


def test_tensors_of_another_network(tmp_path: Path, tiny_weights: Path) -> None:
    for change, reason in (
        ({"backbone_channels": (8, 8, 8, 8, 8)}, "size mismatch"),
        ({"backbone_blocks": (1, 1, 1, 1, 1)}, "Unexpected key"),
        ({"backbone_blocks": (1, 1, 2, 2, 3)}, "Missing key"),
        ({"backbone_blocks": (1, 1, 2)}, "one entry a stride"),
    ):
        other = replace(TINY, network=replace(TINY.network, **change))
        text = json.dumps(to_dict(other))
        assert reason in refused(rewritten(tiny_weights, tmp_path / "w", config=text))
    tensors, metadata = load_file(tiny_weights), metadata_of(tiny_weights)
    missing = {k: v for k, v in tensors.items() if k != "backbone.stem.weight"}
    save_file(missing, tmp_path / "w", metadata)
    assert "backbone.stem.weight" in refused(tmp_path / "w")
    save_file({**tensors, "extra": torch.zeros(1)}, tmp_path / "w", metadata)
    assert "extra" in refused(tmp_path / "w")


def test_tracker_options(tiny_weights: Path) -> None:
    tracker = load_tracker(tiny_weights, device="cpu", use_completion=False)
    assert not tracker.config.tracking.use_completion and tracker.config.volume == TINY.volume
    deeper = replace(TINY, network=replace(TINY.network, backbone_blocks=(1, 1, 2, 2, 3)))
    wider = replace(TINY, network=replace(TINY.network, crop_margin=2.0))
    blunter = replace(TINY, volume=replace(TINY.volume, truncation_m=0.4))
    for config in (Config(), deeper, wider, blunter):
        with pytest.raises(ConfigError, match="not fit"):
            load_tracker(tiny_weights, device="cpu", config=config)
    for wrong in ({"box_iou_gate": 7.0}, {"colour": True}):
        with pytest.raises(ConfigError, match=next(iter(wrong))) as caught:
            load_tracker(tiny_weights, device="cpu", **wrong)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["gpu", "cuda:", "cuda:99", "meta", "", "cpu:x"])
def test_unknown_devices(name: str) -> None:
    with pytest.raises(ConfigError, match="--device"):
        select_device(name)
    assert select_device("cpu") == torch.device("cpu")


def test_a_tracker_starts_anew(tiny_weights: Path) -> None:
    tracker = load_tracker(tiny_weights, device="cpu", min_score=0.0)
    first = [tracker(frame(i, [BOX])) for i in range(2)]
    again = tracker.restart()
    second = [again(frame(i, [BOX])) for i in range(2)]
    assert again.network is tracker.network
    assert first[0].estimates and first[0].objects
    for a, b in zip(first, second, strict=True):
        assert [o.track_id for o in a.objects] == [o.track_id for o in b.objects]
        for p, q in zip(a.estimates, b.estimates, strict=True):
            np.testing.assert_array_equal(p.canonical, q.canonical)
    stages = ["volume", "backbone", "proposals", "boxes", "objects", "association"]
    assert list(first[0].timings_ms) == stages


def test_a_frame_out_of_turn_leaves_nothing_behind(tiny_weights: Path) -> None:
    tracker = load_tracker(tiny_weights, device="cpu")
    tracker(frame(5, [BOX]))
    known = tracker.look(frame(6, [BOX])).surface
    for index in (3, 5):
        with pytest.raises(SequenceError, match=f"frame {index} came after frame 5"):
            tracker(frame(index, [], yaw=np.pi))
    np.testing.assert_array_equal(tracker.look(frame(6, [BOX])).surface, known)


@pytest.mark.parametrize("known", [True, False])
def test_frames_of_a_world_and_frames_without_are_not_mixed(
    tiny_weights: Path, known: bool
) -> None:
    tracker = load_tracker(tiny_weights, device="cpu")
    tracker(replace(frame(0, [BOX]), pose_known=known))
    with pytest.raises(SequenceError, match=f"frame 1: pose_known is {not known}, but {known}"):
        tracker(replace(frame(1, [BOX]), pose_known=not known))
    tracker(replace(frame(2, [BOX]), pose_known=known))
    tracker.restart()(replace(frame(0, [BOX]), pose_known=not known))
