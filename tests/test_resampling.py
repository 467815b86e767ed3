"""Cubes read through affine maps: the loop against torch's sampler, and laws of both."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from composenet.geometry.resampling import resampled, sampled

WAYS = [resampled, sampled]


def cubes(seed: int, count: int, size: int) -> torch.Tensor:
    return torch.rand(count, size, size, size, generator=torch.Generator().manual_seed(seed))


def maps(seed: int, count: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Turns, scales and shifts, some of them out of the cube."""
    draw = np.random.default_rng(seed)
    turns = [Rotation.random(random_state=draw).as_matrix() for _ in range(count)]
    A = np.reshape(turns, (count, 3, 3)) * draw.uniform(0.3, 3, (count, 1, 3))
    return torch.from_numpy(A).float(), torch.from_numpy(
        draw.uniform(-0.3, 1.3, (count, 3))
    ).float()


@given(
    seed=st.integers(0, 10**6),
    count=st.integers(0, 3),
    size=st.sampled_from([1, 2, 7, 16]),
    cells=st.sampled_from([1, 5, 16]),
)
@settings(max_examples=50, deadline=None)
def test_the_loop_reads_what_torch_reads(seed: int, count: int, size: int, cells: int) -> None:
    values, (A, b) = cubes(seed, count, size), maps(seed, count)
    found = resampled(values, A, b, cells)
    assert found.dtype == torch.float32 and found.shape == (count, cells, cells, cells)
    torch.testing.assert_close(found, sampled(values, A, b, cells, False), rtol=0, atol=1e-4)
    nearest = resampled(values, A, b, cells, nearest=True)
    unlike = nearest != sampled(values, A, b, cells, True)
    assert unlike.sum() <= 0.002 * unlike.numel() + 1  # half way between two cells


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("nearest", [False, True])
def test_the_identity_keeps_every_value(way, nearest: bool) -> None:
    values = cubes(1, 2, 8)
    A, b = torch.eye(3).expand(2, 3, 3).contiguous(), torch.full((2, 3), 0.5)
    torch.testing.assert_close(way(values, A, b, 8, nearest), values, rtol=0, atol=1e-5)


@pytest.mark.parametrize("way", WAYS)
def test_a_quarter_turn_turns_the_cube(way) -> None:
    values = cubes(2, 1, 6)
    A, b = torch.tensor([[[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]]), torch.full((1, 3), 0.5)
    found = way(values, A, b, 6, False)[0]
    torch.testing.assert_close(found, torch.rot90(values[0], -1, (0, 1)), rtol=0, atol=1e-5)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("nearest", [False, True])
def test_nothing_is_beyond_the_cube(way, nearest: bool) -> None:
    values = torch.ones(1, 8, 8, 8)
    found = way(values, 2 * torch.eye(3)[None], torch.full((1, 3), 0.5), 16, nearest)[0]
    assert found[4:12, 4:12, 4:12].min() == 1
    outside = torch.ones(16, 16, 16, dtype=torch.bool)
    outside[3:13, 3:13, 3:13] = False
    assert not found[outside].any()


@pytest.mark.parametrize("nearest", [False, True])
@pytest.mark.parametrize("wrong", [torch.nan, torch.inf, -torch.inf, 1e30])
def test_a_map_to_nowhere_reads_nothing(wrong: float, nearest: bool) -> None:
    A = torch.eye(3)[None] * wrong
    assert not resampled(torch.ones(1, 8, 8, 8), A, torch.full((1, 3), 0.5), 8, nearest).any()


def test_linear_values_stay_linear() -> None:
    steps = torch.arange(12.0)
    values = (steps[:, None, None] + 2 * steps[:, None] - 3 * steps)[None]
    A, b = torch.tensor(Rotation.from_euler("xyz", [20, -35, 50], degrees=True).as_matrix()), 0.5
    found = resampled(values, 0.5 * A.float()[None], torch.full((1, 3), b), 10)[0]
    centers = (torch.arange(10) + 0.5) / 10 - 0.5
    cells = torch.stack(torch.meshgrid(centers, centers, centers, indexing="ij"), -1)
    x, y, z = (12 * (cells @ (0.5 * A.float()).T + b) - 0.5).unbind(-1)
    torch.testing.assert_close(found, x + 2 * y - 3 * z, rtol=0, atol=1e-4)
