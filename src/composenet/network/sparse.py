"""Submanifold 3x3x3 convolution on sparse voxels, in plain torch, CPU and CUDA.

A voxel list keeps its sites (submanifold convolution, Graham et al. 2018). One neighbour table
serves all layers of a level. On the CPU each of the 27 offsets is gathered, multiplied and
added in place; on CUDA one gather feeds one matrix product, and the backward pass gathers
through the mirrored table, so it needs no atomics and is deterministic.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

OFFSETS = torch.stack(torch.meshgrid(*[torch.arange(-1, 2)] * 3, indexing="ij"), dim=-1).reshape(
    27, 3
)
"""(27, 3) neighbour offsets in the order of the weights; k mirrors 26 - k."""
CENTER = 13


@dataclass(frozen=True)
class Level:
    """Sites of one resolution.

    coords: (N, 4) int64 rows of (batch, x, y, z). table: (N, 27) int64, row of the neighbour at
    OFFSETS[k], or N where there is none. pairs: k, rows out and rows in for each offset but the
    centre that has any (CPU only, else empty). parent, octant: (N,) int64 into the next coarser
    level (empty on the coarsest).
    """

    coords: Tensor
    table: Tensor
    pairs: tuple[tuple[int, Tensor, Tensor], ...]
    parent: Tensor
    octant: Tensor


def neighbor_table(coords: Tensor, batch_size: int) -> Tensor:
    """(N, 27) rows of the neighbours, N where absent. coords: (N, 4) int64, unique, >= 0.

    One dense look-up table; the grid is padded by a voxel so that offsets cannot wrap.
    """
    n = len(coords)
    shape = (coords[:, 1:].amax(dim=0) + 3).tolist() if n else [3, 3, 3]
    stride = torch.tensor([shape[1] * shape[2], shape[2], 1], device=coords.device)
    volume = shape[0] * shape[1] * shape[2]
    keys = coords[:, 0] * volume + ((coords[:, 1:] + 1) * stride).sum(dim=1)
    lookup = torch.full((batch_size * volume,), n, dtype=torch.int32, device=coords.device)
    lookup[keys] = torch.arange(n, dtype=torch.int32, device=coords.device)
    steps = (OFFSETS.to(coords.device) * stride).sum(dim=1)
    return lookup[keys[:, None] + steps].long()


def build_pyramid(coords: Tensor, batch_size: int, n_levels: int) -> tuple[Level, ...]:
    """Levels at strides 1, 2, 4, ..., finest first. coords: (N, 4) int64, on the device wanted."""
    levels = []
    for index in range(n_levels):
        table = neighbor_table(coords, batch_size)
        pairs = _pairs(table) if coords.device.type == "cpu" else ()
        parent = octant = coords.new_empty(0)
        coarse = coords
        if index + 1 < n_levels:
            coarse, parent = unique_rows(torch.cat([coords[:, :1], coords[:, 1:] // 2], dim=1))
            odd = coords[:, 1:] % 2
            octant = odd[:, 0] * 4 + odd[:, 1] * 2 + odd[:, 2]
        levels.append(Level(coords, table, pairs, parent, octant))
        coords = coarse
    return tuple(levels)


def unique_rows(rows: Tensor) -> tuple[Tensor, Tensor]:
    """Sorted unique rows (N, K) int64 and each row's place among them, through one integer key a
    row; torch's own, over a dimension, is many times slower."""
    low = rows.amin(dim=0) if len(rows) else rows.new_zeros(rows.shape[1])
    base = rows.amax(dim=0) - low + 1 if len(rows) else torch.ones_like(low)
    key = rows[:, 0] - low[0]
    for axis in range(1, rows.shape[1]):
        key = key * base[axis] + rows[:, axis] - low[axis]
    unique, place = torch.unique(key, return_inverse=True)
    columns = []
    for axis in range(rows.shape[1] - 1, 0, -1):
        columns.append(unique % base[axis])
        unique = torch.div(unique, base[axis], rounding_mode="floor")
    return torch.stack([unique, *columns[::-1]], dim=1) + low, place


def _pairs(table: Tensor) -> tuple[tuple[int, Tensor, Tensor], ...]:
    """See `Level.pairs`."""
    n, pairs = len(table), []
    for k, column in enumerate(table.unbind(dim=1)):
        rows = torch.nonzero(column < n)[:, 0]
        if k != CENTER and len(rows):
            pairs.append((k, rows, column[rows]))
    return tuple(pairs)


class _PairwiseConv(torch.autograd.Function):
    """CPU: gather -> multiply -> add, one offset after the other."""

    @staticmethod
    def forward(ctx, features: Tensor, weight: Tensor, level: Level) -> Tensor:
        ctx.save_for_backward(features, weight)
        ctx.level = level
        weights = weight.unbind()
        out = features @ weights[CENTER]
        for k, rows_out, rows_in in level.pairs:
            out.index_add_(0, rows_out, features.index_select(0, rows_in) @ weights[k])
        return out

    @staticmethod
    def backward(ctx, grad: Tensor):  # type: ignore[override]
        features, weight = ctx.saved_tensors
        weights, grad_weight = weight.unbind(), torch.zeros_like(weight)
        grad_weights = grad_weight.unbind()
        grad_features = grad @ weights[CENTER].T
        torch.mm(features.T, grad, out=grad_weights[CENTER])
        for k, rows_out, rows_in in ctx.level.pairs:
            grad_part = grad.index_select(0, rows_out)
            torch.mm(features.index_select(0, rows_in).T, grad_part, out=grad_weights[k])
            grad_features.index_add_(0, rows_in, grad_part @ weights[k].T)
        return grad_features, grad_weight, None


class _GatherConv(torch.autograd.Function):
    """CUDA: one gather and one product; backward through the mirrored table."""

    @staticmethod
    def forward(ctx, features: Tensor, weight: Tensor, level: Level) -> Tensor:
        ctx.save_for_backward(features, weight)
        ctx.level = level
        return gather(features, level.table) @ weight.flatten(0, 1)

    @staticmethod
    def backward(ctx, grad: Tensor):  # type: ignore[override]
        features, weight = ctx.saved_tensors
        grad = grad.to(weight.dtype)
        mirrored = weight.flip(0).transpose(1, 2).flatten(0, 1)
        grad_features = gather(grad, ctx.level.table) @ mirrored
        grad_weight = gather(features, ctx.level.table).T @ grad
        return grad_features, grad_weight.view_as(weight), None


def gather(features: Tensor, table: Tensor) -> Tensor:
    """(N, 27 C): the rows that the table names, side by side; zeros where there is none.

    They are read 8 bytes past a multiple of 16: aligned rows are copied on CUDA by a block of
    threads each, which takes eight times as long, for rows this short, as a thread for 8 bytes.
    """
    n, channels = features.shape
    room = features.new_zeros((n + 1) * channels + 2)
    padded = room[2:].view(n + 1, channels)
    padded[:n] = features
    if channels % 2 == 0 and features.dtype == torch.float32:
        padded = padded.view(torch.complex64)
    return padded[table].view(features.dtype).flatten(1)


def submanifold_conv(features: Tensor, weight: Tensor, level: Level) -> Tensor:
    """(N, C_in) with weight (27, C_in, C_out) -> (N, C_out), zero where a neighbour is absent."""
    function = _PairwiseConv if features.device.type == "cpu" else _GatherConv
    return function.apply(features, weight, level)


class SubmanifoldConv(nn.Module):
    """3x3x3 submanifold convolution without bias (a normalisation follows)."""

    def __init__(self, c_in: int, c_out: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.randn(27, c_in, c_out) * (2 / (9 * c_in)) ** 0.5)

    def forward(self, features: Tensor, level: Level) -> Tensor:
        return submanifold_conv(features, self.weight, level)


class Down(nn.Module):
    """2x2x2 convolution with stride 2: children are laid into the parent's eight slots."""

    def __init__(self, c_in: int, c_out: int) -> None:
        super().__init__()
        self.linear = nn.Linear(8 * c_in, c_out, bias=False)

    def forward(self, features: Tensor, fine: Level, n_coarse: int) -> Tensor:
        slots = features.new_zeros(n_coarse * 8, features.shape[1])
        slots = slots.index_copy(0, fine.parent * 8 + fine.octant, features)
        return self.linear(slots.view(n_coarse, -1))


class Up(nn.Module):
    """Transposed counterpart of Down: each child reads its slot of the parent."""

    def __init__(self, c_in: int, c_out: int) -> None:
        super().__init__()
        self.linear = nn.Linear(c_in, 8 * c_out, bias=False)
        self.c_out = c_out

    def forward(self, features: Tensor, fine: Level) -> Tensor:
        slots = self.linear(features).view(-1, self.c_out)
        return slots.index_select(0, fine.parent * 8 + fine.octant)
