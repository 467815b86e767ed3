"""The speeds of a device: every one is measured, and noted with what it was measured on."""

from __future__ import annotations

import json
from pathlib import Path

import device_speed
import torch


def test_the_speeds_of_a_cpu(tmp_path: Path) -> None:
    out = tmp_path / "speed.json"
    device_speed.main("cpu", batch_frames=2, batches=1, training=("apart",), frames=5, out=out)
    found = json.loads(out.read_text())
    assert found["distance_field_ms"] > 0 and found["hardware"] and found["torch"]
    one = found["convolution_ms"]
    assert 0 < one["forward"] < one["forward and backward"]
    stages = {"volume", "backbone", "proposals", "boxes", "objects", "association", "frame"}
    assert set(found["tracking_ms"]) == stages and min(found["tracking_ms"].values()) > 0
    step = found["training_ms"]["apart"]
    assert step["frames_per_second"] > 0
    assert abs(step["step"] * step["frames_per_second"] / 1e3 - 2) < 0.05


def test_a_gather_takes_longer_on_more_voxels() -> None:
    few, many = (device_speed.gather_ms(torch.device("cpu"), side) for side in (10, 100))
    assert 0 < few < many
