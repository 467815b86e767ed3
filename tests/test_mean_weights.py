"""The mean of weights: of every parameter, of one network only."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from mean_weights import main

from composenet.errors import WeightsError
from composenet.network.model import ComposeNet
from composenet.network.weights import load_weights, save_weights
from conftest import TINY


def test_the_mean_is_that_of_every_parameter(tmp_path: Path) -> None:
    paths, states = [], []
    for seed in range(3):
        torch.manual_seed(seed)
        paths.append(tmp_path / f"{seed}.safetensors")
        save_weights(ComposeNet(TINY.network, TINY.volume), TINY, paths[-1], {"seed": seed})
        states.append(load_weights(paths[-1])[0].state_dict())
    main(tuple(paths), tmp_path / "mean.safetensors")
    network, config, notes = load_weights(tmp_path / "mean.safetensors")
    assert config == TINY and notes == {"mean_of": [{"seed": 0}, {"seed": 1}, {"seed": 2}]}
    for name, value in network.state_dict().items():
        if value.is_floating_point():
            expected = (states[0][name] + states[1][name] + states[2][name]) / 3
            torch.testing.assert_close(value, expected, rtol=1e-3, atol=1e-4)  # stored in half


def test_of_one_network_only(tmp_path: Path, tiny_weights: Path) -> None:
    wider = replace(TINY, network=replace(TINY.network, object_channels=(4, 6, 10)))
    other = tmp_path / "other.safetensors"
    save_weights(ComposeNet(wider.network, wider.volume), wider, other)
    with pytest.raises(WeightsError, match=r"other\.safetensors: its configuration is not that of"):
        main((tiny_weights, other), tmp_path / "mean.safetensors")
    assert not (tmp_path / "mean.safetensors").exists()
