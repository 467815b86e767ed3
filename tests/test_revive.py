"""Channels that are off begin anew, and nothing else changes."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from composenet.network.model import ComposeNet
from composenet.training.revive import (
    backbone_links,
    inputs,
    object_links,
    revive,
    revive_silent,
    settle,
)
from composenet.training.step import LossModule
from conftest import TINY
from training_cases import CONFIG, batch_of


@pytest.fixture(scope="module")
def revived(recordings: Path):  # type: ignore[no-untyped-def]
    """A network with half of its channels off, its losses before and after, and the links."""
    torch.manual_seed(0)
    batch = batch_of(recordings)
    network = ComposeNet(TINY.network, TINY.volume)
    module = LossModule(CONFIG)
    module.network = network
    links = [*backbone_links(network.backbone), *object_links(network.objects)]
    off = {link: torch.arange(link.norm.num_features) % 2 == 0 for link in links}
    for block in (
        b for stage in (*network.backbone.encoder, *network.backbone.decoder) for b in stage
    ):
        torch.nn.init.ones_(block.norm2.weight)
    for link, rows in off.items():
        for norm, bias in ((link.norm, -0.1), *((norm, 0.0) for norm in link.beside)):
            norm.weight.data[rows], norm.bias.data[rows] = 0.0, bias

    def losses() -> dict[str, torch.Tensor]:
        module.eval()
        with torch.no_grad():
            return module(batch, True, torch.Generator().manual_seed(0))[0]

    before = losses()
    revive(off)
    settle(module, [batch], off)
    return module, batch, links, off, before, losses()


def test_the_network_stays_what_it_was(revived) -> None:  # type: ignore[no-untyped-def]
    *_, before, after = revived
    assert len(before) > 10
    for name, value in before.items():
        torch.testing.assert_close(after[name], value, rtol=1e-4, atol=1e-5)


def test_every_norm_with_a_relu_is_linked_once(revived) -> None:  # type: ignore[no-untyped-def]
    module, _, links, *_ = revived
    linked = [link.norm for link in links]
    assert len(set(linked)) == len(linked)
    parts = (module.network.backbone, module.network.objects)
    norms = {
        norm: name
        for part in parts
        for name, norm in part.named_modules()
        if isinstance(norm, (torch.nn.BatchNorm1d, torch.nn.BatchNorm3d))
    }
    rest = {name for norm, name in norms.items() if norm not in linked}
    assert {n for n in rest if not n.endswith("norm2") and "heading" not in n} == {"stem_norm"}


def test_what_began_anew_can_learn(revived) -> None:  # type: ignore[no-untyped-def]
    """Whoever reads a fresh channel gets a gradient for it in the first step."""
    module, batch, links, off, *_ = revived
    module.train()
    losses, _ = module(batch, True, torch.Generator().manual_seed(0))
    torch.stack(list(losses.values())).sum().backward()
    for link in links:
        rows = off[link]
        assert (link.norm.weight[rows] == 1).all() and (link.norm.running_var[rows] > 0).all()
        for reader, first in link.readers:
            assert inputs(reader)[first : first + len(rows)][rows].abs().max() == 0
    for parameter in module.parameters():
        if parameter.grad is not None:  # the views then show the gradients
            parameter.data.copy_(parameter.grad)
    for link in links:
        for reader, first in link.readers:
            assert inputs(reader)[first : first + len(off[link])][off[link]].abs().max() > 0


def test_only_what_is_off_begins_anew(recordings: Path) -> None:
    torch.manual_seed(0)
    network, batch = ComposeNet(TINY.network, TINY.volume), batch_of(recordings)
    norms = [network.backbone.encoder[2][0].norm1, network.objects.encode2[1][1]]
    for norm in norms:
        norm.weight.data[1], norm.bias.data[1] = 0.0, -1.0
        norm.weight.data[3], norm.bias.data[3] = 0.0, 1.0  # constant, but not off
    into, added = network.backbone.down_norm[1], network.backbone.encoder[2][0].norm2
    into.weight.data[:2], into.bias.data[:2] = 0.0, -1.0
    torch.nn.init.ones_(added.weight)
    added.weight.data[1] = 0.0  # into channel 0 it adds
    counts = revive_silent(network, CONFIG, [batch])
    assert counts["backbone.encoder.2.0.norm1"] == counts["objects.encode2.1.1"] == 1
    assert counts["backbone.down_norm.1"] == 1 and into.weight[:2].tolist() == [0, 1]
    assert all(norm.weight[1] == 1 and norm.weight[3] == 0 for norm in norms)
