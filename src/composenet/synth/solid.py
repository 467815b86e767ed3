"""Watertight canonical meshes of shapes."""

from __future__ import annotations

import manifold3d as m3
import numpy as np
import trimesh
from numpy.typing import NDArray
from skimage.measure import marching_cubes

from composenet.synth.shape import Shape

_DETAIL_M = 2e-4  # finer details of a union are rounding


def canonical_mesh(shape: Shape, occupancy: NDArray[np.bool_]) -> trimesh.Trimesh:
    """The shape's solid as one closed surface, scaled so that its box has diagonal 1.

    The union of the parts; where these are not closed, the surface of its occupancy
    (64, 64, 64).
    """
    solid = union_of(shape) if shape.watertight else None
    if solid is None:
        vertices, faces = _voxel_surface(occupancy, shape.extents_m)
    else:
        mesh = solid.to_mesh()
        vertices, faces = np.asarray(mesh.vert_properties[:, :3]), np.asarray(mesh.tri_verts)
    scale = float(np.linalg.norm(shape.extents_m))
    return trimesh.Trimesh(vertices / scale, faces, process=False)


def union_of(shape: Shape) -> m3.Manifold | None:
    """The solid of all parts; None where a part is none (then the union is unknown)."""
    parts = []
    for part in np.unique(shape.face_part):
        used, faces = np.unique(shape.faces[shape.face_part == part], return_inverse=True)
        solid = m3.Manifold(m3.Mesh(shape.vertices[used], faces.reshape(-1, 3).astype(np.uint32)))
        if solid.status() != m3.Error.NoError or solid.volume() <= 0:
            return None
        parts.append(solid)
    return m3.Manifold.batch_boolean(parts, m3.OpType.Add).simplify(_DETAIL_M)


def _voxel_surface(
    occupancy: NDArray[np.bool_], extents_m: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    cells = occupancy.shape[0]
    padded = np.pad(occupancy, 1).astype(np.float32)
    vertices, faces, _, _ = marching_cubes(padded, 0.5)
    # Padded index i is the centre of cell i - 1.
    return ((vertices - 0.5) / cells - 0.5) * extents_m, np.flip(faces, axis=1).astype(np.int64)
