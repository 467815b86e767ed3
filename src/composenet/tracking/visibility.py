"""What of a track the current depth image should show, and what it shows instead.

An unseen track is `occluded` where most of its surface is hidden or outside the view, and
`lost` where it should have been seen: that is decided here, from the depth image alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from composenet.geometry.camera import project
from composenet.geometry.transform import apply_T, inverse_T
from composenet.records import Box, FloatArray, Frame, Similarity
from composenet.tracking.affinity import COARSE_CELLS

NEAR_M = 0.05
"""Points nearer to the camera plane cannot be seen."""
TOLERANCE_M = 0.1
"""A measured depth within this of a surface point agrees with it: completion is not exact."""
CLOSED = 2.0
"""Cells of the object's own z-buffer are this many point spacings wide, to have no holes."""


@dataclass(frozen=True)
class Visibility:
    """Shares of the surface that faces the camera; the rest is hidden or outside the view.

    agreeing: the depth image has a surface there. seen_through: it looks at something behind.
    """

    agreeing: float
    seen_through: float

    @property
    def expected(self) -> float:
        """Share that would be seen if the object were there, 0..1."""
        return self.agreeing + self.seen_through

    @property
    def still_there(self) -> bool:
        """The place is in view and holds a surface where the object's should be."""
        return self.agreeing > max(self.seen_through, 0.1)


def surface_in_world(
    surface_canonical: FloatArray, S_world_canonical: Similarity, box: Box
) -> tuple[NDArray[np.float64], float]:
    """(P, 3) points of an object's surface in the world and their spacing, metres.

    surface_canonical: (P, 3), `CanonicalModel.surface`; without any, the points are
    those of the box.
    """
    S = S_world_canonical
    if len(surface_canonical):
        points = S.scale_m * surface_canonical @ np.asarray(S.R).T + S.t
        return points, S.scale_m / COARSE_CELLS
    steps = np.linspace(-0.5, 0.5, 12)
    cube = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    shell = cube[np.abs(cube).max(axis=1) == 0.5]
    return shell * box.extents + box.center, float(np.max(box.extents)) / 11


def visibility(
    points_world: FloatArray, spacing_m: float, frame: Frame, max_depth_m: float
) -> Visibility:
    """How a surface of points stands against the depth image.

    points_world: (P, 3) spaced by spacing_m. Of the points, those behind the object's own
    front are left out. Points where nothing was measured, or beyond max_depth_m, count as
    not visible. No points: nothing is visible.
    """
    camera = frame.camera
    points = apply_T(inverse_T(frame.T_world_camera), points_world)
    ahead = points[:, 2] > NEAR_M
    behind_count = int((~ahead).sum())
    points = points[ahead]
    if len(points) == 0:
        return Visibility(0.0, 0.0)
    pixels, z = project(points, camera), points[:, 2]
    columns, rows = np.rint(pixels).T
    height, width = frame.depth_m.shape
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    inside &= z <= max_depth_m
    if not inside.any():
        return Visibility(0.0, 0.0)
    cell_px = max(1.0, CLOSED * camera.K[0, 0] * spacing_m / float(np.median(z)))
    front = _front(pixels, z, cell_px)
    total, inside = int(front.sum()) + behind_count, inside & front
    columns, rows, z = columns[inside].astype(int), rows[inside].astype(int), z[inside]
    measured = frame.depth_m[rows, columns]
    ahead_m = measured - z
    agreeing = (measured > 0) & (np.abs(ahead_m) <= TOLERANCE_M)
    seen_through = (measured > 0) & (ahead_m > TOLERANCE_M)
    return Visibility(float(agreeing.sum()) / total, float(seen_through.sum()) / total)


def _front(
    pixels: NDArray[np.float64], z: NDArray[np.float64], cell_px: float
) -> NDArray[np.bool_]:
    """(P,) points that no other of the object's own points hides: a coarse z-buffer."""
    column, row = np.floor(pixels / cell_px).astype(np.int64).T
    _, cell = np.unique(column * (1 << 32) + row, return_inverse=True)
    nearest = np.full(cell.max() + 1, np.inf)
    np.minimum.at(nearest, cell, z)
    return z <= nearest[cell] + TOLERANCE_M
