"""Is a training better? Equal weights are equal, and those that lack a part are worse."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch
import validation_loss
from validation_loss import main

from composenet.errors import DataError
from composenet.network.model import ComposeNet
from composenet.network.weights import default_weights, load_weights, save_weights


@pytest.mark.parametrize("parts", ["detector", "objects"])
def test_equal_weights_differ_by_nothing_and_others_by_what_they_lack(
    tmp_path: Path, parts: validation_loss.Parts
) -> None:
    torch.manual_seed(0)
    network, config, _ = load_weights(default_weights())
    learned, fresh = network.state_dict(), ComposeNet(config.network, config.volume).state_dict()
    lacking = "boxes." if parts == "detector" else "objects."
    network.load_state_dict(learned | {k: v for k, v in fresh.items() if k.startswith(lacking)})
    lack, out = tmp_path / "lack.safetensors", tmp_path / "loss.json"
    save_weights(network, config, lack)
    main((default_weights(), lack), scenes=2, parts=parts, out=out)
    written = json.loads(out.read_text())
    shipped, same, worse = written["losses"]
    assert same == shipped | {"difference": 0.0, "standard_error": 0.0}
    assert worse["difference"] > 0.2 and worse["difference"] > 2 * worse["standard_error"]
    assert f"--parts {parts}" in written["command"]


def test_weights_that_want_other_volumes_are_refused(tmp_path: Path) -> None:
    network, config, _ = load_weights(default_weights())
    coarse = replace(config, volume=replace(config.volume, voxel_size_m=0.08))
    path = tmp_path / "coarse.safetensors"
    save_weights(network, coarse, path)
    with pytest.raises(DataError, match=r"coarse\.safetensors: made for other volumes"):
        validation_loss.losses_of(path, [], "detector")
