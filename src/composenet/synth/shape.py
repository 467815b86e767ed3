"""A procedural or CAD shape: watertight parts in object axes (+X front, +Y left, +Z up)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import manifold3d as m3
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from composenet.records import Symmetry


@dataclass(frozen=True)
class Material:
    """color: base RGB in 0..1. pattern: plain | wood | fabric | checker | stripes, drawn in
    object coordinates with a period of pattern_m metres. shininess: 0 matt .. 1 mirror-like
    (shiny and dark surfaces return less depth); above that, up to 1.7, hardly any. glass: a pane.
    clear: images show what is behind it."""

    color: tuple[float, float, float]
    pattern: str = "plain"
    pattern_m: float = 0.1
    shininess: float = 0.1
    glass: bool = False
    clear: bool = False


@dataclass(frozen=True, eq=False)
class Shape:
    """One object, centred on its box. Two shapes are equal only where they are the same one.

    class_name: one of CLASS_NAMES or "clutter". vertices: (V, 3) float32, metres, object axes.
    faces: (F, 3) int32, counter-clockwise seen from outside. face_part: (F,) int32, the
    watertight part a face belongs to (parts may overlap; the solid is their union).
    face_material: (F,) int32 into materials. watertight: every part is closed.
    """

    class_name: str
    style: str
    symmetry: Symmetry
    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    face_part: NDArray[np.int32]
    face_material: NDArray[np.int32]
    materials: tuple[Material, ...]
    watertight: bool = True
    mount_m: float = 0.0
    prototype: Shape | None = None

    @cached_property
    def extents_m(self) -> NDArray[np.float64]:
        """(3,) full extents along the object axes, metres."""
        low, high = self.vertices.min(axis=0), self.vertices.max(axis=0)
        return (high - low).astype(np.float64)

    @cached_property
    def drawn(self) -> NDArray[np.bool_]:
        """(F,) the faces that images show."""
        return ~np.array([material.clear for material in self.materials])[self.face_material]


class ShapeBuilder:
    """Collects watertight manifolds (built standing on z = 0) into one Shape."""

    def __init__(self) -> None:
        self._parts: list[tuple[m3.Manifold, Material]] = []

    def add(self, part: m3.Manifold, material: Material) -> None:
        """Add one closed part. Empty parts are dropped."""
        if not part.is_empty():
            self._parts.append((part, material))

    @property
    def bounds(self) -> NDArray[np.float64]:
        """(2, 3) low and high corner of all parts. Raises ValueError when there are none."""
        boxes = np.array([part.bounding_box() for part, _ in self._parts]).reshape(-1, 2, 3)
        return np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])

    def build(self, class_name: str, style: str, symmetry: Symmetry, mount_m: float = 0.0) -> Shape:
        """All parts together, centred on their common box. symmetry: that of the recipe; what comes
        out alike from behind is twofold even if the recipe has none. Raises ValueError when
        empty."""
        if not self._parts:
            raise ValueError(f"{class_name}/{style}: a shape needs at least one part")
        materials = list(dict.fromkeys(material for _, material in self._parts))
        vertices, faces, part_ids, material_ids, offset = [], [], [], [], 0
        for index, (part, material) in enumerate(self._parts):
            mesh = part.to_mesh()
            vertices.append(np.asarray(mesh.vert_properties[:, :3], dtype=np.float32))
            faces.append(np.asarray(mesh.tri_verts, dtype=np.int32) + offset)
            part_ids.append(np.full(len(mesh.tri_verts), index, dtype=np.int32))
            slot = materials.index(material)
            material_ids.append(np.full(len(mesh.tri_verts), slot, dtype=np.int32))
            offset += len(vertices[-1])
        points = np.concatenate(vertices)
        points -= (points.min(axis=0) + points.max(axis=0)) / 2
        if symmetry is Symmetry.NONE and _alike_from_behind(points):
            symmetry = Symmetry.TWO
        return Shape(
            class_name=class_name,
            style=style,
            symmetry=symmetry,
            vertices=points,
            faces=np.concatenate(faces),
            face_part=np.concatenate(part_ids),
            face_material=np.concatenate(material_ids),
            materials=tuple(materials),
            mount_m=mount_m,
        )


def _alike_from_behind(points: NDArray[np.float32], within_m: float = 1e-3) -> bool:
    """Whether half a turn brings every corner (N, 3) to another one's place."""
    if np.abs(points[:, :2].mean(axis=0)).max() > within_m:  # nearly always
        return False
    away, _ = cKDTree(points).query(points * np.array([-1, -1, 1], np.float32))
    return bool(away.max() < within_m)
