"""Channels that are off begin anew, for further training (ReDo, Sokar et al. 2023).

A channel that is off (silent, and zero after its ReLU) is given fresh weights. What reads it reads
nothing of it at first, so the network stays what it was. Backbone, completion and pose; not the
perceptrons.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor, nn

from composenet.network.model import ComposeNet
from composenet.network.sparse import Down, SubmanifoldConv, Up
from composenet.training.config import TrainingConfig
from composenet.training.silent import watched
from composenet.training.step import LossModule
from composenet.training.targets import TrainingBatch

Norm = nn.BatchNorm1d | nn.BatchNorm3d


def revive_silent(
    network: ComposeNet, config: TrainingConfig, batches: Sequence[TrainingBatch]
) -> dict[str, int]:
    """Begin the channels anew, in place, that are off on the batches; how many, by layer."""
    module = LossModule(config)
    module.network = network
    module.eval()
    with watched(network) as channels, torch.no_grad():
        for batch in batches:
            module(batch, False, torch.Generator().manual_seed(0))
    silent = channels.silent
    names = {module: name for name, module in network.named_modules()}
    links = [*backbone_links(network.backbone), *object_links(network.objects)]
    off = {}
    for link in links:
        rows = silent[names[link.norm]] & (link.norm.bias <= 0)
        for norm in link.beside:
            rows = rows & silent[names[norm]] & (norm.bias <= 0)
        off[link] = rows
    revive(off)
    settle(module, batches, off)
    return {names[link.norm]: int(rows.sum()) for link, rows in off.items()}


@dataclass(frozen=True)
class Link:
    """Channels made by a layer and normalised, and who reads them, from which input channel on.
    beside: norms whose channels are added to them before they are read."""

    maker: nn.Module
    norm: Norm
    readers: tuple[tuple[nn.Module, int], ...]
    beside: tuple[Norm, ...] = ()


def outputs(layer: nn.Module) -> Tensor:
    """A view of the layer's weights, output channels first."""
    weight = _weight(layer)
    if isinstance(layer, SubmanifoldConv):
        return weight.permute(2, 0, 1)
    if isinstance(layer, Up):
        return weight.view(8, layer.c_out, -1).transpose(0, 1)
    return weight.transpose(0, 1) if isinstance(layer, nn.ConvTranspose3d) else weight


def inputs(layer: nn.Module) -> Tensor:
    """A view of the layer's weights, input channels first."""
    weight = _weight(layer)
    if isinstance(layer, Down):
        return weight.view(len(weight), 8, -1).permute(2, 0, 1)
    return weight if isinstance(layer, nn.ConvTranspose3d) else weight.transpose(0, 1)


def _weight(layer: nn.Module) -> Tensor:
    weight: Any = (layer.linear if isinstance(layer, (Down, Up)) else layer).weight
    data: Tensor = weight.data
    return data


def backbone_links(net: Any) -> Iterator[Link]:
    """Of a Backbone: within blocks, down to the next resolution and up again."""
    stages = [*net.encoder, *net.decoder]
    for block in (block for stage in stages for block in stage):
        yield Link(block.conv1, block.norm1, ((block.conv2, 0),))
    last = len(net.down) - 1
    for i, (down, norm) in enumerate(zip(net.down, net.down_norm, strict=True)):
        stage = net.encoder[i + 1]
        on = [(net.up[i], 0)] if i == last else [(net.down[i + 1], 0), (net.merge[i + 1], 0)]
        readers = (*((block.conv1, 0) for block in stage), *on)
        yield Link(down, norm, readers, beside=tuple(block.norm2 for block in stage))
    for up, norm, merge in zip(net.up, net.up_norm, net.merge, strict=True):
        yield Link(up, norm, ((merge, norm.num_features),))


def object_links(net: Any) -> Iterator[Link]:
    """Of an ObjectNet: from one convolution to the next, and across to the decoder."""
    chain = [net.encode1, *net.encode2, *net.encode3, net.up2, *net.decode2, net.up1, net.decode1]
    readers = {unit: [(after[0], 0)] for unit, after in pairwise(chain)}
    readers[net.decode1] = [(net.completion[0], 0), (net.correspondence[0], 0)]
    for up, skip, joined in (
        (net.up2, net.encode2[-1], net.decode2[0]),
        (net.up1, net.encode1, net.decode1),
    ):
        readers[skip].append((joined[0], 0))
        readers[up] = [(joined[0], up[1].num_features)]
    for unit in chain:
        yield Link(unit[0], unit[1], tuple(readers[unit]))


@torch.no_grad()
def revive(off: Mapping[Link, Tensor]) -> None:
    """Fresh weights into the channels that are off, (C,) bool, and none out of them."""
    for link, rows in off.items():
        made = outputs(link.maker)
        made[rows] = torch.randn_like(made[rows]) * (2 / made[0].numel()) ** 0.5
        link.norm.weight[rows], link.norm.bias[rows] = 1.0, 0.0
    for link, rows in off.items():
        for reader, first in link.readers:
            inputs(reader)[first : first + len(rows)][rows] = 0.0


@torch.no_grad()
def settle(
    module: LossModule, batches: Sequence[TrainingBatch], off: Mapping[Link, Tensor]
) -> None:
    """Statistics of the channels that were off, from what passes through them now."""
    begun = {link.norm: rows for link, rows in off.items()}
    norms: list[Any] = [m for m in module.modules() if isinstance(m, Norm)]
    before = {norm: (norm.running_mean.clone(), norm.running_var.clone()) for norm in norms}
    module.train()
    for batch in batches:
        module(batch, False, torch.Generator().manual_seed(0))
    module.eval()
    for norm, (mean, var) in before.items():
        kept = ~begun.get(norm, torch.zeros_like(mean, dtype=torch.bool))
        norm.running_mean[kept], norm.running_var[kept] = mean[kept], var[kept]
