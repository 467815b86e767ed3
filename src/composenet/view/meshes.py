"""Canonical reconstructions to closed metric meshes in the world."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import manifold3d as m3
import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy import ndimage
from skimage.measure import marching_cubes
from trimesh.visual import ColorVisuals, TextureVisuals
from trimesh.visual.material import PBRMaterial

from composenet.files import write_atomic
from composenet.records import FloatArray, Similarity, Track, TrackedObject

SURE = 0.5
"""a cell at least this share as sure as the surest one is inside. The paper binarises at 0.5; of
thin shapes seen seldom no cell may get so far"""
FAINT = 0.15
"""a cell less sure than this is never inside; between the two one is where it stands out"""
STANDS_OUT = 1.3
"""from its surroundings: so many times as sure as their weighted mean. Where a chair's legs are is
seldom sure, but surer than that they are beside it"""
AROUND_CELLS = 1.5
"""standard deviation of the surroundings' Gaussian weights"""
MIN_COMPONENT_SHARE = 0.005
"""separate pieces smaller than this share of the largest one are dropped"""

_Z_UP_TO_Y_UP = np.array(
    [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)


def canonical_mesh(canonical: FloatArray, faint: float = FAINT) -> trimesh.Trimesh | None:
    """Closed surface of a canonical reconstruction, in canonical coordinates.

    Its level differs from cell to cell (faint to SURE): legs are kept and flat parts do not swell.

    canonical: (N, N, N) in 0..1 over [-0.5, 0.5]^3. The grid is padded by one empty cell, so
    shapes that touch its edge are closed there. None when all cells are 0.
    """
    if not canonical.any():
        return None
    canonical = canonical / canonical.max()
    around = ndimage.gaussian_filter(canonical, AROUND_CELLS)
    level = np.clip(STANDS_OUT * around, faint, SURE)
    field = np.minimum(canonical * (SURE / level), 1.0)
    inside = _large_components(field >= SURE)
    closed = np.where(inside, np.maximum(field, 0.52), np.minimum(field, 0.48))
    closed[~inside & (field >= SURE)] = 0.0
    mesh = _marching_cubes(closed)
    if not mesh.is_watertight:  # cells that touch along an edge only: halve them
        mesh = _marching_cubes(np.kron(inside, np.ones((2, 2, 2))))
    return mesh


def _marching_cubes(field: FloatArray) -> trimesh.Trimesh:
    cells = field.shape[0]
    padded = np.pad(np.asarray(field, dtype=np.float32), 1)
    vertices, faces, _, _ = marching_cubes(padded, SURE)
    mesh = trimesh.Trimesh((vertices - 0.5) / cells - 0.5, faces)
    if mesh.volume < 0:
        mesh.invert()
    return mesh


def _large_components(inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    labels, count = ndimage.label(inside)
    if count < 2:
        return inside
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    return (sizes >= MIN_COMPONENT_SHARE * sizes.max())[labels] & inside


def place(mesh: trimesh.Trimesh, S_world_canonical: Similarity) -> trimesh.Trimesh:
    """Copy of a canonical mesh in the world, metres."""
    S = S_world_canonical
    placed: trimesh.Trimesh = mesh.copy()
    placed.vertices = S.scale_m * mesh.vertices @ np.asarray(S.R).T + S.t
    return placed


def last_observed(history: Sequence[TrackedObject]) -> TrackedObject:
    """The last entry that a detection contributed to; the last one where none did."""
    return next((entry for entry in reversed(history) if entry.observed), history[-1])


def track_mesh(track: Track) -> trimesh.Trimesh | None:
    """Watertight mesh of a track at its last observed pose: world frame, metres.

    None when the track has no history or its reconstruction is empty.
    """
    mesh = object_mesh(track)
    return mesh.apply_transform(last_observed(track.history).T_world_object) if mesh else None


def object_mesh(track: Track) -> trimesh.Trimesh | None:
    """Watertight mesh of a track in its own axes (x front, y left, z up), metres: of the size it
    had when last observed. `T_world_object` of an entry moves it to where it was in that frame.

    None when the track has no history or its reconstruction is empty.
    """
    mesh = canonical_mesh(track.canonical) if track.history else None
    return (
        mesh.apply_scale(last_observed(track.history).S_world_canonical.scale_m) if mesh else None
    )


def simplified(mesh: trimesh.Trimesh, tolerance: float) -> trimesh.Trimesh:
    """Closed mesh with fewer faces, moved by at most `tolerance` (in the mesh's own unit)."""
    solid = m3.Manifold(
        m3.Mesh(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32))
    ).simplify(tolerance)
    if solid.is_empty():
        return mesh
    out = solid.to_mesh()
    return trimesh.Trimesh(out.vert_properties[:, :3], out.tri_verts, process=False)


def save_mesh(mesh: trimesh.Trimesh, color: NDArray[np.uint8], stem: Path) -> tuple[Path, Path]:
    """Write stem.ply (world frame, z up, vertex colours) and stem.glb (glTF's y up: one node
    turns the world's z to y, so that the object stands upright in any viewer).

    color: (3,) uint8. Files appear whole or not at all.
    """
    rgba = np.append(color, 255).astype(np.uint8)
    plain = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    plain.visual = ColorVisuals(plain, vertex_colors=np.tile(rgba, (len(plain.vertices), 1)))
    ply = write_atomic(stem.with_suffix(".ply"), _bytes(plain.export(file_type="ply")))
    material = PBRMaterial(baseColorFactor=_linear(rgba), metallicFactor=0.0, roughnessFactor=0.8)
    plain.visual = TextureVisuals(material=material)
    scene = trimesh.Scene()
    scene.add_geometry(plain, node_name=stem.name, transform=_Z_UP_TO_Y_UP)
    return write_atomic(stem.with_suffix(".glb"), _bytes(scene.export(file_type="glb"))), ply


def _linear(rgba: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A colour in linear light, as glTF wants its factors, from sRGB."""
    share = rgba[:3] / 255
    light = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return np.append(np.rint(255 * light), rgba[3]).astype(np.uint8)


def _bytes(exported: object) -> bytes:
    assert isinstance(exported, bytes)
    return exported
