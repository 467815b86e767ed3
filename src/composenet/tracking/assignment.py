"""One-to-one matching with a gate."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment


def assign(
    affinity: NDArray[np.float64], admissible: NDArray[np.bool_]
) -> tuple[tuple[int, int], ...]:
    """Pairs (row, column) of the largest total affinity over admissible pairs, by row.

    affinity: (A, B), larger is better. admissible: (A, B). An inadmissible pair is never
    chosen, nor does it keep an admissible one from being chosen (it weighs as much as
    leaving both alone); the same holds for affinities that are not positive or NaN.
    """
    usable = admissible & (affinity > 0)
    rows, columns = linear_sum_assignment(np.where(usable, affinity, 0.0), maximize=True)
    return tuple(
        (int(row), int(column))
        for row, column in zip(rows, columns, strict=True)
        if usable[row, column]
    )
