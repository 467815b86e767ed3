"""Rotational symmetry about an object's up axis (+Z), Scan2CAD's four kinds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from composenet.records import Symmetry

ORDER = {Symmetry.NONE: 1, Symmetry.TWO: 2, Symmetry.FOUR: 4, Symmetry.INF: 36}
"""Turns that leave the object alike; infinite symmetry as 36 steps of 10 degrees."""


def turns(symmetry: Symmetry) -> NDArray[np.float64]:
    """(k, 3, 3) rotations about +Z that map the object onto itself, identity first."""
    angles = 2 * np.pi * np.arange(ORDER[symmetry]) / ORDER[symmetry]
    c, s, zero, one = np.cos(angles), np.sin(angles), np.zeros_like(angles), np.ones_like(angles)
    rows = [np.stack(r, -1) for r in ((c, -s, zero), (s, c, zero), (zero, zero, one))]
    return np.stack(rows, axis=1)
