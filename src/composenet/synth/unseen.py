"""Furniture that depth cameras see badly: they look through glass, and gloss returns nothing.

Only what images show changes; shape, boxes and occupancy are those of the whole piece. Training
alone holds such furniture.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from composenet.synth.shape import Material, Shape

_CLEAR_SHARE = 0.6
"""Of the pieces of furniture with glass. The rest of it is seen as if it were painted."""
_TOPS = {"table": (0.08, 0.08), "desk": (0.04, 0.06)}
"""Of how many the top is clear glass, of how many it is glossy."""
_GLOSS = (1.55, 1.7)
"""Shininess of which a camera sees patches, and nothing."""
_THICK_M = 0.09


def as_cameras_fail(shape: Shape, rng: np.random.Generator) -> Shape:
    """The shape, most glass in it clear, and the tops of some tables and desks without depth."""
    share, kind = rng.random(2)
    gloss = float(rng.uniform(*_GLOSS))
    if share < _CLEAR_SHARE and any(material.glass for material in shape.materials):
        return replace(shape, materials=tuple(_clear(m) for m in shape.materials))
    clear, glossy = _TOPS.get(shape.class_name, (0.0, 0.0))
    if kind > clear + glossy:
        return shape
    top = np.flatnonzero(top_faces(shape))
    if len(top) == 0:
        return shape
    before = shape.materials[shape.face_material[top[0]]]
    after = replace(before, clear=True) if kind < clear else replace(before, shininess=gloss)
    face_material = shape.face_material.copy()
    face_material[top] = len(shape.materials)
    return replace(shape, face_material=face_material, materials=(*shape.materials, after))


def _clear(material: Material) -> Material:
    return replace(material, clear=material.glass)


def top_faces(shape: Shape) -> NDArray[np.bool_]:
    """(F,) the faces of the largest board, and of all that end at its height."""
    parts = np.unique(shape.face_part)
    corners = [
        shape.vertices[shape.faces[shape.face_part == part]].reshape(-1, 3) for part in parts
    ]
    low = np.array([points.min(axis=0) for points in corners])
    high = np.array([points.max(axis=0) for points in corners])
    size = high - low
    boards = size[:, 2] < _THICK_M
    if not boards.any():
        return np.zeros(len(shape.faces), np.bool_)
    height = high[np.argmax(size[:, 0] * size[:, 1] * boards), 2]
    chosen = boards & (np.abs(high[:, 2] - height) < 0.005)
    return np.isin(shape.face_part, parts[chosen])
