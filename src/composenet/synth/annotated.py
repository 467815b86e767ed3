"""Recordings of one's own with annotated objects, as sequences to train on and to be scored on.

>>> things = {1: AnnotatedObject("chair", trimesh.load("chair.ply"))}
>>> with AnnotatedWriter("data/office", things) as writer:
...     for frame in composenet.open_sequence("office"):
...         writer.add(frame, {1: T_world_chair})
...     writer.finish()
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from composenet.errors import DataError
from composenet.geometry.box import aabb_of_points
from composenet.geometry.rigid import is_rigid
from composenet.geometry.transform import apply_T, inverse_T, make_T
from composenet.records import (
    CLASS_NAMES,
    FloatArray,
    Frame,
    ObjectFrameTruth,
    ObjectTruth,
    Symmetry,
)
from composenet.synth import render
from composenet.synth.cad import cleaned, shape_of_mesh
from composenet.synth.occupancy import occupancy
from composenet.synth.sequence_folder import SequenceFolder
from composenet.synth.shape import Material, Shape
from composenet.synth.solid import canonical_mesh

MOST_TILT_DEG = 10.0
"""Of an object; what is learned is upright."""
NEAR_SURFACE_M = 0.05
"""Pixels whose depth is as near to a posed mesh show it."""
_GREY = Material((0.5, 0.5, 0.5))


@dataclass(frozen=True, eq=False)
class AnnotatedObject:
    """One object of a recording. class_name: one of CLASS_NAMES. mesh: metres, in its own axes
    (x front, y left, z up), about any origin; closed, if it can be. symmetry: about z; measured on
    the mesh where it is not given."""

    class_name: str
    mesh: trimesh.Trimesh
    symmetry: Symmetry | None = None


class AnnotatedWriter:
    """Writes a recording and what is known of its objects to a folder that must not exist; it
    appears when `finish` is called, and nothing stays if that is not.

    objects: by id, 1 to 65535. Raises DataError for what cannot be learned from: an unknown class,
    a mesh that is not in metres, flat or empty.
    """

    def __init__(self, folder: Path | str, objects: Mapping[int, AnnotatedObject]) -> None:
        self._folder = SequenceFolder(Path(folder).absolute())
        if not objects:
            raise DataError(f"{folder}: no object; expected at least one, by its id")
        self._shapes, self._middles = {}, {}
        for gt_id, item in objects.items():
            self._shapes[gt_id], self._middles[gt_id] = _shape(gt_id, item)
        self._mesh = render.assemble(list(self._shapes.values()))
        self._hulls = {k: _hull(shape) for k, shape in self._shapes.items()}
        self._before: dict[int, NDArray[np.float64]] = {}

    def __enter__(self) -> AnnotatedWriter:
        self._folder.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._folder.__exit__(kind, error, trace)

    def add(
        self,
        frame: Frame,
        T_world_objects: Mapping[int, FloatArray],
        ids: NDArray[np.integer] | None = None,
    ) -> None:
        """Write the next frame, in a levelled world with its floor at z = 0 (`open_sequence` gives
        such). T_world_objects: (4, 4) of every object, seen or not, of the axes of its mesh.
        ids: (H, W), the object each depth pixel shows, 0 for none; without them, that whose posed
        mesh is within NEAR_SURFACE_M of its depth. Raises DataError for poses or ids that cannot
        be."""
        what = f"{self._folder.folder}, frame {len(self._folder)}"
        if not frame.pose_known:
            raise DataError(f"{what}: has no camera pose; annotations need one world")
        poses = {k: self._pose(what, k, T_world_objects) for k in self._shapes}
        if ids is None:
            shown = self._ids_by_depth(frame, poses)
        else:
            shown = _usable_ids(what, ids, frame.depth_m.shape, self._shapes)
        pixels = np.bincount(shown.ravel(), minlength=max(self._shapes) + 1)
        truth = [self._object_frame(frame, k, T, int(pixels[k])) for k, T in poses.items()]
        self._folder.add(frame, shown, tuple(truth))
        self._before = poses

    def finish(self) -> None:
        """Let the folder appear. Raises DataError where no frame was added, or it is there."""
        if len(self._folder) == 0:
            raise DataError(f"{self._folder.folder}: no frame was added")
        objects = []
        for gt_id, shape in self._shapes.items():
            truth = ObjectTruth(
                gt_id=gt_id,
                class_id=CLASS_NAMES.index(shape.class_name),
                symmetry=shape.symmetry,
                extents_m=shape.extents_m,
                occupancy=occupancy(shape),
                hull=self._hulls[gt_id].astype(np.float32),
                recipe=shape.style,
            )
            objects.append((truth, canonical_mesh(shape, truth.occupancy)))
        self._folder.finish(objects, {"split": "annotated", "levelled": True})

    def _pose(
        self, what: str, gt_id: int, T_world_objects: Mapping[int, FloatArray]
    ) -> NDArray[np.float64]:
        """(4, 4) of the middle of the object's box."""
        if gt_id not in T_world_objects:
            raise DataError(f"{what}: no pose of object {gt_id}; expected one of every object")
        T = np.array(T_world_objects[gt_id], dtype=np.float64)
        if T.shape != (4, 4) or not np.isfinite(T).all() or not is_rigid(T):
            raise DataError(
                f"{what}: the pose of object {gt_id} is no rigid motion (4, 4); a scale belongs "
                "into its mesh"
            )
        tilt = np.degrees(np.arccos(np.clip(T[2, 2], -1, 1)))
        if tilt > MOST_TILT_DEG:
            raise DataError(
                f"{what}: object {gt_id} is tilted by {tilt:.0f} degrees; only what stands upright "
                "in a world whose z is up can be learned"
            )
        return T @ make_T(np.eye(3), self._middles[gt_id])

    def _ids_by_depth(self, frame: Frame, poses: Mapping[int, FloatArray]) -> NDArray[np.uint16]:
        T_camera_world = inverse_T(frame.T_world_camera)
        drawn = render.draw(
            self._mesh, np.stack([T_camera_world @ T for T in poses.values()]), frame.camera
        )
        near = np.abs(drawn.depth_m - frame.depth_m) < NEAR_SURFACE_M
        there = (drawn.face >= 0) & (frame.depth_m > 0) & near
        slots = self._mesh.face_instance[drawn.face]
        return np.where(there, np.array(list(poses))[slots], 0).astype(np.uint16)

    def _object_frame(
        self, frame: Frame, gt_id: int, T_world_object: FloatArray, visible: int
    ) -> ObjectFrameTruth:
        shape, fraction = self._shapes[gt_id], 0.0
        if visible:
            T_camera_object = inverse_T(frame.T_world_camera) @ T_world_object
            points = apply_T(T_camera_object, shape.vertices.astype(np.float64))
            whole = render.silhouette_pixels(points, shape.faces, frame.camera)
            fraction = min(1.0, visible / max(whole, visible))
        before = self._before.get(gt_id, T_world_object)
        return ObjectFrameTruth(
            gt_id=gt_id,
            T_world_object=T_world_object,
            box=aabb_of_points(apply_T(T_world_object, self._hulls[gt_id])),
            visible_pixels=visible,
            visible_fraction=fraction,
            moving=not np.array_equal(before, T_world_object),
        )


def _shape(gt_id: int, item: AnnotatedObject) -> tuple[Shape, NDArray[np.float64]]:
    what = f"object {gt_id}"
    if not 1 <= gt_id < 2**16:
        raise DataError(f"{what}: expected ids from 1 to 65535")
    if item.class_name not in CLASS_NAMES:
        raise DataError(f"{what}: class {item.class_name!r}; expected {', '.join(CLASS_NAMES)}")
    if len(item.mesh.faces) == 0:
        raise DataError(f"{what}: its mesh has no faces")
    mesh = cleaned(trimesh.Trimesh(item.mesh.vertices, item.mesh.faces, process=False))
    shape, middle = shape_of_mesh(mesh, item.class_name, "annotated", what, _GREY)
    return replace(shape, symmetry=item.symmetry or shape.symmetry), middle


def _hull(shape: Shape) -> NDArray[np.float64]:
    return shape.vertices[ConvexHull(shape.vertices).vertices].astype(np.float64)


def _usable_ids(
    what: str, ids: NDArray[np.integer], size: tuple[int, ...], known: Mapping[int, Shape]
) -> NDArray[np.uint16]:
    given = np.asarray(ids)
    if given.shape != size or not np.issubdtype(given.dtype, np.integer):
        raise DataError(
            f"{what}: ids are {given.dtype} of shape {given.shape}; expected whole numbers of the "
            f"depth image's shape {size}"
        )
    unknown = sorted(set(np.unique(given).tolist()) - {0, *known})
    if unknown:
        raise DataError(f"{what}: ids hold {unknown[0]}, which is no object; 0 is none")
    return given.astype(np.uint16)
