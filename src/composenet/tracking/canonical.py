"""The canonical model of a track: the running mean of its canonical reconstructions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from composenet.records import FloatArray
from composenet.tracking.affinity import COARSE_CELLS, coarse

OCCUPIED = 0.5
"""Coarse cells from this on are solid."""


def running_mean(old: FloatArray, new: FloatArray, weight: float) -> NDArray[np.float32]:
    """(weight * old + new) / (weight + 1); the paper's weight is 4 (Object Tracking)."""
    share = np.float32(1.0 / (weight + 1.0))
    return (old + (new - old) * share).astype(np.float32)


@dataclass(frozen=True)
class CanonicalModel:
    """mean: (64, 64, 64) float32 in 0..1, canonical space as in CONVENTIONS.md."""

    mean: NDArray[np.float32]

    def updated(self, reconstruction: FloatArray, weight: float) -> CanonicalModel:
        """The model after one more reconstruction, old : new = weight : 1."""
        return CanonicalModel(running_mean(self.mean, reconstruction, weight))

    @cached_property
    def coarse(self) -> NDArray[np.float32]:
        """(32, 32, 32) the mean, coarser."""
        return coarse(self.mean)

    @cached_property
    def surface(self) -> NDArray[np.float64]:
        """(P, 3) canonical coordinates of points on the surface, spaced 1/32; may be empty."""
        solid = self.coarse >= OCCUPIED
        padded = np.pad(solid, 1)
        inner = solid.copy()
        for axis in range(3):
            for shift in (-1, 1):
                inner &= np.roll(padded, shift, axis)[1:-1, 1:-1, 1:-1]
        return (np.argwhere(solid & ~inner) + 0.5) / COARSE_CELLS - 0.5
