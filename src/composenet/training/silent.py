"""Channels that say nothing: capacity that a training has lost (dormant units, Sokar et al. 2023).

Weight decay inside Adam's gradient does it: where the loss hardly asks for a channel, the decay is
all that is left of its gradient, and Adam takes it for a reason to take whole steps towards zero.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import torch
from torch import Tensor, nn

SILENT = 0.01
"""A channel is silent whose output varies by less than this share of the layer's liveliest."""

_WATCHED = (nn.BatchNorm1d, nn.BatchNorm3d, nn.GroupNorm, nn.LayerNorm, nn.ReLU, nn.LeakyReLU)


class Channels:
    """Count, sum and sum of squares of every channel of every watched layer, by its name."""

    def __init__(self) -> None:
        self._moments: dict[str, Tensor] = {}

    def add(self, layer: str, output: Tensor) -> None:
        """Note what a layer gave: (N, C) or (N, C, ...)."""
        values = output.detach().transpose(0, 1).flatten(1).double()
        new = torch.stack(
            [torch.full_like(values[:, 0], values.shape[1]), values.sum(1), values.square().sum(1)]
        )
        self._moments[layer] = self._moments.get(layer, torch.zeros_like(new)) + new

    @property
    def silent(self) -> Mapping[str, Tensor]:
        """(C,) bool by layer: the silent channels."""
        result = {}
        for layer, (count, total, squares) in self._moments.items():
            deviation = (squares / count - (total / count).square()).clamp_min(0).sqrt()
            result[layer] = deviation <= SILENT * deviation.max()
        return result

    def share(self, part: str = "") -> float:
        """Silent share of all channels of the layers whose names begin so, 0..1."""
        found = [rows for layer, rows in self.silent.items() if layer.startswith(part)]
        return float(torch.cat(found).double().mean()) if found else float("nan")


@contextmanager
def watched(network: nn.Module) -> Iterator[Channels]:
    """The channels of a network while it runs."""
    channels = Channels()

    def hook(layer: str):  # type: ignore[no-untyped-def]
        return lambda module, inputs, output: channels.add(layer, output) if len(output) else None

    hooks = [
        module.register_forward_hook(hook(name))
        for name, module in network.named_modules()
        if isinstance(module, _WATCHED)
    ]
    try:
        yield channels
    finally:
        for each in hooks:
            each.remove()
