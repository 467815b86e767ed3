"""Pair scores, assignment, the canonical model."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from composenet.tracking.affinity import (
    canonical_iou,
    center_distance_m,
    coarse,
    same_class,
)
from composenet.tracking.assignment import assign
from composenet.tracking.canonical import CanonicalModel, running_mean
from tracking_scenes import block, thing


def test_canonical_iou_equals_the_plain_one():
    rng = np.random.default_rng(0)
    grids = [coarse(rng.random((64, 64, 64), dtype=np.float32) ** p) for p in (0.5, 1, 2, 9)]
    plain = [[np.minimum(a, b).sum() / np.maximum(a, b).sum() for b in grids] for a in grids]
    np.testing.assert_allclose(canonical_iou(grids, grids), plain, rtol=1e-5)


def test_canonical_iou_of_solids_is_that_of_their_volumes():
    whole, half = np.ones((64, 64, 64), np.float32), np.zeros((64, 64, 64), np.float32)
    half[:32] = 1
    nothing = np.zeros((64, 64, 64), np.float32)
    shapes = [coarse(grid) for grid in (whole, half, nothing)]
    expected = [[1, 0.5, 0], [0.5, 1, 0], [0, 0, 0]]
    np.testing.assert_array_equal(canonical_iou(shapes, shapes), expected)
    unsure = [coarse(0.5 * half)]
    np.testing.assert_allclose(canonical_iou(unsure, shapes), [[0.25, 0.5, 0]])


def test_coarse_cells_hold_what_their_parts_hold():
    fine = np.zeros((64, 64, 64), np.float32)
    fine[5, 8, 63] = 0.7
    expected = np.zeros((32, 32, 32), np.float32)
    expected[2, 4, 31] = 0.7
    np.testing.assert_array_equal(coarse(fine), expected)


def test_empty_sides_have_empty_scores():
    assert canonical_iou([], []).shape == (0, 0)
    assert center_distance_m([], [thing(2, 0).box]).shape == (0, 1)
    assert same_class([1, 2], []).shape == (2, 0)
    assert assign(np.zeros((0, 3)), np.zeros((0, 3), bool)) == ()


@pytest.mark.parametrize(
    ("affinity", "gate", "pairs"),
    [
        pytest.param([[0.9, 0.1], [0.2, 0.8]], 0.3, {(0, 0), (1, 1)}, id="diagonal"),
        pytest.param([[0.6, 0.5], [0.5, 0.0]], 0.3, {(0, 1), (1, 0)}, id="total beats greedy"),
        pytest.param([[0.9, 0.29], [0.29, 0.2]], 0.3, {(0, 0)}, id="gated stays alone"),
        pytest.param([[0.4, 0.29], [0.29, 0.0]], 0.3, {(0, 0)}, id="gated sum cannot win"),
        pytest.param([[0.1, 0.2]], 0.3, set(), id="nothing admissible"),
        pytest.param([[0.5], [0.7], [0.6]], 0.3, {(1, 0)}, id="more rows than columns"),
        pytest.param([[np.nan, 0.4]], 0.3, {(0, 1)}, id="nan is no match"),
        pytest.param([[0.0]], 0.0, set(), id="no affinity is no match"),
    ],
)
def test_assignment_table(affinity, gate, pairs):
    scores = np.array(affinity)
    assert set(assign(scores, scores >= gate)) == pairs


@given(arrays(np.float64, (4, 3), elements=st.floats(0, 1), unique=True), st.floats(0.1, 0.9))
def test_assignment_is_the_best_of_all_and_ignores_order(scores, gate):
    admissible = scores >= gate
    chosen = assign(scores, admissible)
    total = sum(scores[pair] for pair in chosen)
    best = max(
        sum(scores[row, column] * admissible[row, column] for column, row in enumerate(rows))
        for rows in permutations(range(4), 3)
    )
    assert total == pytest.approx(best)
    assert all(admissible[pair] for pair in chosen)
    flipped = assign(scores[::-1, ::-1], admissible[::-1, ::-1])
    assert sum(scores[3 - row, 2 - column] for row, column in flipped) == pytest.approx(best)


def test_running_mean_is_four_to_one():
    old, new = np.full((64, 64, 64), 0.5, np.float32), np.ones((64, 64, 64), np.float32)
    np.testing.assert_allclose(running_mean(old, new, 4.0), 0.6, rtol=1e-6)
    model = CanonicalModel(np.zeros((64, 64, 64), np.float32))
    for _ in range(3):
        model = model.updated(new, 4.0)
    np.testing.assert_allclose(model.mean, 1 - 0.8**3, rtol=1e-5)
    np.testing.assert_array_equal(model.coarse, coarse(model.mean))


@given(st.floats(0.5, 8), st.floats(0, 1), st.floats(0, 1))
def test_running_mean_stays_between(weight, old, new):
    mean = running_mean(np.full(1, old, np.float32), np.full(1, new, np.float32), weight)[0]
    assert min(old, new) - 1e-6 <= mean <= max(old, new) + 1e-6


def test_surface_points_lie_on_the_block():
    size = np.array([0.6, 0.6, 0.9])
    points = CanonicalModel(block()).surface * np.linalg.norm(size)
    deepest = np.abs(points / (size / 2)).max(axis=1)
    assert len(points) > 500
    assert deepest.min() > 0.8
    assert deepest.max() < 1.15
    assert len(CanonicalModel(np.zeros((64, 64, 64), np.float32)).surface) == 0
