"""Sparse encoder-decoder: bottleneck at 1/16, output at full resolution (paper section 4.1)."""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn

from composenet.network.sparse import Down, Level, SubmanifoldConv, Up


class _Block(nn.Module):
    """Residual block of two submanifold convolutions."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.conv1, self.norm1 = SubmanifoldConv(channels, channels), nn.BatchNorm1d(channels)
        self.conv2, self.norm2 = SubmanifoldConv(channels, channels), nn.BatchNorm1d(channels)
        nn.init.zeros_(self.norm2.weight)

    def forward(self, x: Tensor, level: Level) -> Tensor:
        y = torch.relu(self.norm1(self.conv1(x, level)))
        return torch.relu(x + self.norm2(self.conv2(y, level)))


class _Stage(nn.ModuleList):
    """Blocks of one resolution, one after the other."""

    def __init__(self, channels: int, blocks: int) -> None:
        super().__init__(_Block(channels) for _ in range(blocks))

    def forward(self, x: Tensor, level: Level) -> Tensor:
        for block in self:
            x = block(x, level)
        return x


class Backbone(nn.Module):
    """features (N, c_in) on the finest level -> (N, channels[0] * 2).

    channels, blocks: of each resolution, finest first; the decoder has as many blocks.
    """

    def __init__(self, c_in: int, channels: tuple[int, ...], blocks: tuple[int, ...]) -> None:
        super().__init__()
        self.c_out = 2 * channels[0]
        self.stem = SubmanifoldConv(c_in, channels[0])
        self.stem_norm = nn.BatchNorm1d(channels[0])
        self.encoder = nn.ModuleList(_Stage(c, n) for c, n in zip(channels, blocks, strict=True))
        pairs = list(pairwise(channels))
        self.down = nn.ModuleList(Down(a, b) for a, b in pairs)
        self.down_norm = nn.ModuleList(nn.BatchNorm1d(b) for _, b in pairs)
        self.up = nn.ModuleList(Up(b, a) for a, b in pairs)
        self.up_norm = nn.ModuleList(nn.BatchNorm1d(a) for a, _ in pairs)
        wide = [self.c_out, *channels[1:-1]]
        self.merge = nn.ModuleList(
            nn.Linear(2 * a, w) for (a, _), w in zip(pairs, wide, strict=True)
        )
        self.decoder = nn.ModuleList(_Stage(w, n) for w, n in zip(wide, blocks[:-1], strict=True))

    def forward(self, features: Tensor, levels: tuple[Level, ...]) -> Tensor:
        x = torch.relu(self.stem_norm(self.stem(features, levels[0])))
        skips = []
        for i, level in enumerate(levels):
            x = self.encoder[i](x, level)
            if i + 1 < len(levels):
                skips.append(x)
                x = self.down[i](x, level, len(levels[i + 1].coords))
                x = torch.relu(self.down_norm[i](x))
        for i in reversed(range(len(skips))):
            up = torch.relu(self.up_norm[i](self.up[i](x, levels[i])))
            x = self.merge[i](torch.cat([skips[i], up], dim=1))
            x = self.decoder[i](torch.relu(x), levels[i])
        return x
