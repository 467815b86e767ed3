"""A wider backbone says what the narrow one said, and learns with what it has gained."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import nn

from composenet.errors import ConfigError
from composenet.network.model import ComposeNet
from composenet.training.step import LossModule, weighted_sum
from composenet.training.widen import widened
from conftest import TINY
from training_cases import CONFIG, batch_of


@pytest.mark.parametrize("channels", [(4, 4, 6, 6, 8), (4, 6, 6, 9, 8), (4, 5, 8, 10, 12)])
def test_a_wider_network_says_the_same_and_learns_everywhere(
    recordings: Path, channels: tuple[int, ...]
) -> None:
    torch.manual_seed(0)
    batch = batch_of(recordings)
    narrow = ComposeNet(TINY.network, TINY.volume)
    for norm in narrow.modules():
        if isinstance(norm, nn.BatchNorm1d):
            nn.init.uniform_(norm.weight, 0.5, 1.5)
            nn.init.normal_(norm.running_mean)
    narrow.eval()
    wide, config = widened(narrow, TINY, channels)
    assert config == replace(TINY, network=replace(TINY.network, backbone_channels=channels))
    ours, theirs = (net.voxel_fields(batch.volume) for net in (wide, narrow))
    torch.testing.assert_close(ours.features, theirs.features, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(ours.objectness, theirs.objectness, rtol=1e-4, atol=1e-5)
    module = LossModule(replace(CONFIG, model=config, parts="detector"))
    module.network = wide.train()
    optimizer = torch.optim.SGD(wide.backbone.parameters(), lr=1e-3)
    for _ in range(3):  # what reads a new channel, what gates it, then what makes it
        optimizer.zero_grad()
        losses, _ = module(batch, False, torch.Generator().manual_seed(0))
        weighted_sum(losses, module.config).backward()
        optimizer.step()
    for name, parameter in wide.backbone.named_parameters():
        assert parameter.grad is not None and parameter.grad.abs().sum() > 0, name


@pytest.mark.parametrize("channels", [(4, 4, 6, 6, 7), (4, 4, 6, 6), (5, 5, 6, 6, 8), ()])
def test_channels_that_cannot_be(channels: tuple[int, ...]) -> None:
    with pytest.raises(ConfigError, match="expected 5 numbers, the first 4, none lower"):
        widened(ComposeNet(TINY.network, TINY.volume), TINY, channels)
