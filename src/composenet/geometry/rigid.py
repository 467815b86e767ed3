"""What a pose must be; apart from `transform`, for the records ask for it, too."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def is_rigid(T: NDArray[np.floating]) -> bool:
    """Whether a (4, 4) of finite numbers is a rotation, within 1 %, and a translation."""
    R = T[:3, :3]
    rotates = np.abs(R).max() < 2 and np.allclose(R.T @ R, np.eye(3), atol=0.02)
    return bool(rotates and np.linalg.det(R) > 0 and np.allclose(T[3], [0, 0, 0, 1], atol=1e-6))
