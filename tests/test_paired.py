"""Differences of scores, sequence by sequence."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from paired import difference

A, B, C, D = (Path(name) for name in "abcd")


def test_a_difference_by_hand() -> None:
    mean, error = difference({A: 10, B: 20, C: 30}, {A: 9, B: 17, C: 28, D: 99})
    assert mean == 2  # of 1, 3 and 2
    np.testing.assert_allclose(error, 1 / 3**0.5)
    same = {A: 1.0, B: 2.0}
    assert difference(same, same) == (0, 0)


def test_sequences_without_a_score_have_no_say() -> None:
    nan = float("nan")
    assert difference({A: 4, B: 2, C: nan}, {A: 1, B: 1, C: 3})[0] == 2
    assert np.isnan(difference({A: 4}, {A: 1})).all()
