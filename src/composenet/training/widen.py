"""A wider backbone that says what the narrow one said, for further training (Net2Net, Chen et al.
2016, with fresh channels in place of copies).

What is new reads everything and begins at random; nothing that was there reads what is new.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from operator import ge
from typing import Any

import torch
from torch import Tensor, nn

from composenet.config import Config
from composenet.errors import ConfigError
from composenet.network.model import ComposeNet
from composenet.network.sparse import Down, SubmanifoldConv, Up
from composenet.training.revive import outputs


@torch.no_grad()
def widened(
    network: ComposeNet, config: Config, channels: Sequence[int]
) -> tuple[ComposeNet, Config]:
    """The network with these `backbone_channels`, and its configuration.

    channels: of each resolution, finest first. The finest stays as it is, since all that follows
    the backbone reads it. Raises ConfigError where one is fewer than it was.
    """
    before = config.network.backbone_channels
    grows = len(channels) == len(before) and all(map(ge, channels, before))
    if not grows or channels[0] != before[0]:
        raise ConfigError(
            f"backbone_channels {tuple(channels)}: expected {len(before)} numbers, the first "
            f"{before[0]}, none lower than in {tuple(before)}"
        )
    config = replace(config, network=replace(config.network, backbone_channels=tuple(channels)))
    wide = ComposeNet(config.network, config.volume)
    shapes = {name: value.shape for name, value in wide.state_dict().items()}
    same = {k: v for k, v in network.state_dict().items() if v.shape == shapes[k]}
    wide.load_state_dict(same, strict=False)
    layers = dict(network.named_modules())
    for name, layer in wide.named_modules():
        if isinstance(layer, nn.BatchNorm1d):
            _copy_statistics(layers[name], layer)
        elif isinstance(layer, (SubmanifoldConv, Down, Up)):
            _copy_weights(_kernel(layers[name]), _kernel(layer))
    merges: Any = zip(network.backbone.merge, wide.backbone.merge, strict=True)
    for old, new in merges:
        halves = torch.arange(old.in_features).view(2, -1)
        halves[1] += (new.in_features - old.in_features) // 2
        _copy_weights(_kernel(old), _kernel(new), halves.flatten())
        new.bias.zero_()
        new.bias[: old.out_features] = old.bias
    return wide.eval(), config


def _kernel(layer: Any) -> Tensor:
    """(C_out, positions, C_in) view of the layer's weights."""
    weight = outputs(layer)
    c_in = layer.linear.in_features // 8 if isinstance(layer, Down) else weight.shape[-1]
    return weight if weight.dim() == 3 else weight.view(len(weight), -1, c_in)


def _copy_weights(old: Tensor, new: Tensor, read: Tensor | None = None) -> None:
    """In place. read: (C_in,) where the old layer's inputs are among the new one's."""
    made = len(old)
    read = torch.arange(old.shape[2]) if read is None else read
    new.normal_().mul_((2 / new[0].numel()) ** 0.5)
    new[:made] = 0
    new[:made, :, read] = old


def _copy_statistics(old: Any, new: nn.BatchNorm1d) -> None:
    """In place: scale, shift and statistics of the channels that were there."""
    kept = new.state_dict()
    for name, value in old.state_dict().items():
        if value.dim():
            kept[name][: len(value)] = value
