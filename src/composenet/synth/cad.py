"""Furniture meshes from a folder: `DIR/CLASS/*.{obj,ply,off,stl,glb}`.

Files hold +Y up, front +Z, metres; they map by `p_object = p_cad[[2, 0, 1]]`.
"""

from __future__ import annotations

import hashlib
import zlib
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy import ndimage

from composenet.errors import DataError
from composenet.geometry.transform import rotation_z
from composenet.records import CLASS_NAMES, Symmetry
from composenet.synth.occupancy import occupancy
from composenet.synth.shape import Material, Shape

SUFFIXES = (".obj", ".ply", ".off", ".stl", ".glb")
SYMMETRY_SHARE = 0.98
THINNEST_M = 0.01
LONGEST_M = 5.0
READ_AS = 3
"""Counts changes of what is made of a mesh."""
_SYMMETRY_CELLS = 64


@lru_cache(maxsize=8)
def load_library(folder: Path) -> dict[str, tuple[Path, ...]]:
    """class name -> its mesh files, sorted.

    Raises DataError where the folder holds no class folders with meshes.
    """
    if not folder.is_dir():
        raise DataError(f"{folder}: no such folder; expected DIR/CLASS/*.obj, CLASS e.g. chair")
    library = {
        name: tuple(sorted(filter(_is_mesh, (folder / name).iterdir())))
        for name in CLASS_NAMES
        if (folder / name).is_dir()
    }
    library = {name: files for name, files in library.items() if files}
    if not library:
        raise DataError(
            f"{folder}: no meshes found; expected CLASS/*.{{obj,ply,off,stl,glb}} "
            f"with CLASS one of {', '.join(CLASS_NAMES)}"
        )
    return library


def left_out(folder: Path) -> list[str]:
    """Folders of meshes beside those of the ten classes, which nothing is made of."""
    others = [p for p in folder.iterdir() if p.is_dir() and p.name not in CLASS_NAMES]
    return sorted(p.name for p in others if any(map(_is_mesh, p.iterdir())))


def _is_mesh(path: Path) -> bool:
    """Hidden files (`._chair.obj`, which some file systems keep beside `chair.obj`) are none."""
    return path.suffix.lower() in SUFFIXES and not path.name.startswith(".")


def digest(folder: Path) -> str:
    """What meshes a folder holds, by their names and sizes, and how they are read. Raises DataError
    (`load_library`)."""
    files = [path for paths in load_library(folder).values() for path in paths]
    names = [f"{path.relative_to(folder).as_posix()} {path.stat().st_size}" for path in files]
    text = "\n".join([f"read as {READ_AS}", *names])
    return hashlib.sha256(text.encode(errors="surrogateescape")).hexdigest()[:12]


@lru_cache(maxsize=512)
def load_shape(path: Path, class_name: str) -> Shape:
    """One mesh in object axes, centred, without faces that lie on each other and with closed parts
    turned outwards. Its symmetry is measured on its occupancy.

    Raises DataError where the file is no mesh, or is not in metres.
    """
    style = f"cad:{path.parent.name}/{path.name}"
    mesh = _load_mesh(path)
    mesh.vertices = np.asarray(mesh.vertices, dtype=np.float64)[:, [2, 0, 1]]
    return shape_of_mesh(mesh, class_name, style, str(path), _material(path))[0]


def shape_of_mesh(
    mesh: trimesh.Trimesh, class_name: str, style: str, what: str, material: Material
) -> tuple[Shape, NDArray[np.float64]]:
    """The shape of a cleaned mesh in object axes, and where the middle of its box was, (3,). what:
    it is, in messages. Raises DataError where it is not in metres or flat."""
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    low, high = np.min(vertices, axis=0), np.max(vertices, axis=0)
    longest = float((high - low).max())
    if not 0.1 <= longest <= LONGEST_M:
        raise DataError(f"{what}: {longest:.3g} m long; expected furniture in metres")
    if (thinnest := float((high - low).min())) < THINNEST_M:
        raise DataError(f"{what}: only {thinnest:.3g} m thick; expected a solid piece of furniture")
    shape = Shape(
        class_name=class_name,
        style=style,
        symmetry=Symmetry.NONE,
        vertices=(vertices - (low + high) / 2).astype(np.float32),
        faces=np.asarray(mesh.faces, dtype=np.int32),
        face_part=_parts(mesh),
        face_material=np.zeros(len(mesh.faces), dtype=np.int32),
        materials=(material,),
        watertight=bool(mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0),
    )
    return replace(shape, symmetry=symmetry_of(shape)), (low + high) / 2


def _load_mesh(path: Path) -> trimesh.Trimesh:
    try:
        mesh = trimesh.load(path, force="mesh", process=False)
    except Exception as error:  # the readers raise whatever they like
        raise DataError(f"{path}: not a readable mesh ({error})") from None
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise DataError(f"{path}: expected a triangle mesh, found no faces")
    return cleaned(mesh)


def cleaned(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh itself, without faces that lie on each other and with closed parts turned
    outwards."""
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    mesh.update_faces(mesh.unique_faces())  # a face and its back count for nothing
    if mesh.is_watertight:
        mesh.fix_normals(multibody=True)
    return mesh


def symmetry_of(shape: Shape) -> Symmetry:
    """The highest symmetry about the up axis under which the solid stays within a cell of itself,
    nearly all of it."""
    solid = occupancy(shape, _SYMMETRY_CELLS)
    points = ((np.argwhere(solid) + 0.5) / _SYMMETRY_CELLS - 0.5) * shape.extents_m
    grown = ndimage.binary_dilation(np.pad(solid, 1))
    cell = shape.extents_m / float(_SYMMETRY_CELLS)

    def alike(*turns_deg: int) -> bool:
        return all(_share_within(points, grown, cell, turn) > SYMMETRY_SHARE for turn in turns_deg)

    if alike(*range(10, 90, 10)):
        return Symmetry.INF
    if alike(90):
        return Symmetry.FOUR
    return Symmetry.TWO if alike(180) else Symmetry.NONE


def _share_within(
    points: NDArray[np.float64], grown: NDArray[np.bool_], cell: NDArray[np.float64], degrees: int
) -> float:
    """Share of the points (N, 3) that lie in filled cells when turned about z by as much."""
    turned = points @ rotation_z(np.radians(degrees)).T
    index = np.floor(turned / cell + np.array(grown.shape) / 2).astype(np.intp)
    inside = ((index >= 0) & (index < grown.shape)).all(axis=1)
    return np.count_nonzero(grown[tuple(index[inside].T)]) / max(len(points), 1)


def _parts(mesh: trimesh.Trimesh) -> NDArray[np.int32]:
    """(F,) connected component of each face."""
    labels = trimesh.graph.connected_component_labels(
        mesh.face_adjacency, node_count=len(mesh.faces)
    )
    return np.asarray(labels, dtype=np.int32)


def _material(path: Path) -> Material:
    """A colour that depends on the file's name only."""
    rng = np.random.default_rng(zlib.crc32(path.name.encode(errors="surrogateescape")))
    color = rng.uniform(0.2, 0.9, 3)
    pattern = str(rng.choice(["plain", "wood", "fabric"]))
    rgb = (float(color[0]), float(color[1]), float(color[2]))
    return Material(rgb, pattern, float(rng.uniform(0.05, 0.2)), float(rng.uniform(0.05, 0.4)))
