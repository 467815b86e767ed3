"""Rigid transforms and rotations. All arrays float64; names as in CONVENTIONS.md.

scipy's rotations are imported where they are used: they take half a second to load.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from composenet.geometry.symmetry import turns
from composenet.records import FloatArray, Symmetry


def make_T(R: ArrayLike, t: ArrayLike) -> NDArray[np.float64]:
    """(4, 4) rigid transform `p -> R @ p + t` from R (3, 3) and t (3,)."""
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = t
    return T


def inverse_T(T_a_b: FloatArray) -> NDArray[np.float64]:
    """`T_b_a` of a rigid (4, 4) `T_a_b`, without solving a system."""
    R, t = T_a_b[:3, :3], T_a_b[:3, 3]
    return make_T(R.T, -R.T @ t)


def rigid_T(T: FloatArray) -> NDArray[np.float64]:
    """The rigid (4, 4) transform nearest to one whose rotation is not quite one."""
    U, _, Vt = np.linalg.svd(T[:3, :3])
    return make_T(U @ Vt, T[:3, 3])


def apply_T(T_a_b: FloatArray, points_b: FloatArray) -> NDArray[np.float64]:
    """Points (..., 3) of frame b, in frame a."""
    return np.asarray(points_b @ T_a_b[:3, :3].T + T_a_b[:3, 3])


def rotation_z(angle_rad: float) -> NDArray[np.float64]:
    """(3, 3) rotation about +z, counter-clockwise seen from above."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def rotation_onto(source: ArrayLike, target: ArrayLike) -> NDArray[np.float64]:
    """The smallest rotation (3, 3) that turns direction `source` onto `target`, both (3,).

    Opposite directions turn by 180 degrees about an arbitrary axis normal to them.
    Raises ValueError for a direction of length zero.
    """
    from scipy.spatial.transform import Rotation

    a, b = (np.asarray(v, dtype=np.float64) for v in (source, target))
    if not (np.linalg.norm(a) > 0 and np.linalg.norm(b) > 0):
        raise ValueError("a direction of length zero cannot be turned")
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    axis, cosine = np.cross(a, b), float(a @ b)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12:
        helper = np.eye(3)[np.argmin(np.abs(a))]
        axis, sine = np.cross(a, helper), 0.0
    axis = axis / np.linalg.norm(axis)
    return Rotation.from_rotvec(axis * np.arctan2(sine, cosine)).as_matrix()


def angle_between_deg(R_a: FloatArray, R_b: FloatArray) -> float:
    """Angle of the rotation `R_a^T @ R_b`, degrees in 0..180 (exact near both ends)."""
    return float(_angles_deg(R_a.T @ R_b))


def rotation_error_deg(
    R_a: FloatArray, R_b: FloatArray, symmetry: Symmetry = Symmetry.NONE
) -> float:
    """Smallest angle in degrees between R_a and `R_b @ turn` over the symmetry's turns.

    Both are `R_world_object`. A continuous symmetry is tested in 36 steps of 10 degrees
    (Scan2CAD), so its error about the axis is at most 5 degrees.
    """
    return float(_angles_deg(R_a.T @ R_b @ turns(symmetry)).min())


def _angles_deg(R: FloatArray) -> NDArray[np.float64]:
    """(...) rotation angles of R (..., 3, 3), from sine and cosine both."""
    antisymmetric = R - np.swapaxes(R, -1, -2)
    twice_sine = np.linalg.norm(antisymmetric, axis=(-1, -2)) / np.sqrt(2)
    twice_cosine = np.trace(R, axis1=-2, axis2=-1) - 1
    return np.degrees(np.arctan2(twice_sine, twice_cosine))


def quaternion_from_rotation(R: FloatArray) -> NDArray[np.float64]:
    """Unit quaternion (w, x, y, z) with w >= 0 of R (3, 3)."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(R).as_quat(canonical=True, scalar_first=True)


def rotation_from_quaternion(wxyz: ArrayLike) -> NDArray[np.float64]:
    """R (3, 3) of a quaternion (w, x, y, z) of any length but zero (ValueError)."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(np.asarray(wxyz, dtype=np.float64), scalar_first=True).as_matrix()
