"""Recordings of one's own with annotated objects, as sequences to train on and to be scored on.

>>> things = {1: AnnotatedObject("chair", trimesh.load("chair.ply", force="mesh"))}
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
from scipy.spatial import ConvexHull, QhullError

from composenet.errors import DataError
from composenet.geometry.box import aabb_of_points
from composenet.geometry.camera import back_project
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
from composenet.synth.sequence_folder import UNTOLD, SequenceFolder, remove_leftovers
from composenet.synth.shape import Material, Shape
from composenet.synth.solid import canonical_mesh

MOST_TILT_DEG = 10.0
"""Of an object; what is learned is upright."""
NEAR_M, NEAR_PER_M2 = 0.05, 0.005
"""Pixels whose depth is as near to a posed mesh, and as much more as its depth squared, show it;
what is up to three times as far may or may not."""
LOWEST_M, AROUND_M, LEAST_INSIDE = -0.3, 0.15, 0.5
"""No object reaches lower; its pixels lie in its box or as near to it, at least this share."""
MOVES_M = 0.002
"""An entry of a pose that changes by less has not moved."""
_GREY = Material((0.5, 0.5, 0.5))


@dataclass(frozen=True, eq=False)
class AnnotatedObject:
    """One object of a recording. class_name: one of CLASS_NAMES. mesh: metres, in its own axes
    (x front, y left, z up), about any origin; closed, if it can be. symmetry: about z (none, two,
    four, inf); measured on the mesh where it is not given."""

    class_name: str
    mesh: trimesh.Trimesh
    symmetry: Symmetry | str | None = None


class AnnotatedWriter:
    """Writes a recording and what is known of its objects to a folder that must not exist; it
    appears when `finish` is called, and nothing stays if that is not.

    objects: by id, 1 to 65534; all furniture of the ten classes that is seen, for what is none of
    these is learned as background. Raises DataError for what cannot be learned from: an unknown
    class, a mesh that is not in metres, flat or empty.
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
        self._entered = False

    def __enter__(self) -> AnnotatedWriter:
        remove_leftovers(self._folder.folder.parent)
        self._folder.__enter__()
        self._before: dict[int, NDArray[np.float64]] = {}
        self._pixels = dict.fromkeys(self._shapes, 0)
        self._inside = dict.fromkeys(self._shapes, 0)
        self._entered = True
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._entered = False
        self._folder.__exit__(kind, error, trace)

    def add(
        self,
        frame: Frame,
        T_world_objects: Mapping[int, FloatArray],
        ids: NDArray[np.integer] | None = None,
    ) -> None:
        """Write the next frame, in a levelled world with its floor at z = 0 (`open_sequence` gives
        such). T_world_objects: (4, 4) of every object, seen or not, of the axes of its mesh.
        ids: (H, W), the object each depth pixel shows, 0 for none, UNTOLD where nobody can tell;
        without them, that whose posed mesh is near its depth. Raises DataError for poses or ids
        that cannot be."""
        what = f"{self._folder.folder}, frame {len(self._folder)}"
        if not self._entered:
            raise DataError(f"{what}: use the writer in a `with` statement")
        if not frame.pose_known:
            raise DataError(f"{what}: has no camera pose; annotations need one world")
        poses = {k: self._pose(what, k, T_world_objects) for k in self._shapes}
        if ids is None:
            shown = self._ids_by_depth(frame, poses)
        else:
            shown = _usable_ids(what, ids, frame.depth_m.shape, self._shapes)
        pixels = np.bincount(shown.ravel(), minlength=max(self._shapes) + 1)
        self._count(frame, shown, poses)
        truth = [self._object_frame(frame, k, T, int(pixels[k])) for k, T in poses.items()]
        self._folder.add(frame, shown, tuple(truth))
        self._before = poses

    def finish(self) -> dict[int, int]:
        """Let the folder appear. Returns in how many pixels of all frames each object was seen.
        Raises DataError where no frame was added, or poses and images do not belong together."""
        if not self._entered or len(self._folder) == 0:
            raise DataError(f"{self._folder.folder}: no frame was added")
        astray = [k for k, n in self._pixels.items() if self._inside[k] < LEAST_INSIDE * n]
        if astray or not any(self._pixels.values()):
            what = f"object {astray[0]} is not where its pixels are" if astray else "no object seen"
            raise DataError(
                f"{self._folder.folder}: {what}; are poses in the frames' world (T_level_source @ "
                "T_source_object), of these frames (frame.index), and in metres?"
            )
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
        return dict(self._pixels)

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
                "in a world whose z is up can be learned (is y up in its mesh?)"
            )
        T = T @ make_T(np.eye(3), self._middles[gt_id])
        if (low := apply_T(T, self._hulls[gt_id])[:, 2].min()) < LOWEST_M:
            raise DataError(
                f"{what}: object {gt_id} reaches {-low:.1f} m below the floor; its pose belongs in "
                "the frames' world, whose floor is at z = 0 (T_level_source @ T_source_object)"
            )
        return T

    def _ids_by_depth(self, frame: Frame, poses: Mapping[int, FloatArray]) -> NDArray[np.uint16]:
        T_camera_world = inverse_T(frame.T_world_camera)
        drawn = render.draw(
            self._mesh, np.stack([T_camera_world @ T for T in poses.values()]), frame.camera
        )
        off = np.abs(drawn.depth_m - frame.depth_m)
        off[(drawn.face < 0) | (frame.depth_m <= 0)] = np.inf
        near = NEAR_M + NEAR_PER_M2 * drawn.depth_m**2
        shown = np.array(list(poses))[self._mesh.face_instance[drawn.face]]
        return np.select([off < near, off < 3 * near], [shown, UNTOLD], 0).astype(np.uint16)

    def _count(
        self, frame: Frame, ids: NDArray[np.uint16], poses: Mapping[int, FloatArray]
    ) -> None:
        """Pixels of each object, and those of them that lie about its box."""
        points = apply_T(frame.T_world_camera, back_project(frame.depth_m, frame.camera))
        measured = frame.depth_m > 0
        for gt_id, T_world_object in poses.items():
            own = points[measured & (ids == gt_id)]
            reach = self._shapes[gt_id].extents_m / 2 + AROUND_M
            inside = (np.abs(apply_T(inverse_T(T_world_object), own)) < reach).all(axis=-1)
            self._pixels[gt_id] += len(own)
            self._inside[gt_id] += int(inside.sum())

    def _object_frame(
        self, frame: Frame, gt_id: int, T_world_object: FloatArray, visible: int
    ) -> ObjectFrameTruth:
        T_camera_object = inverse_T(frame.T_world_camera) @ T_world_object
        shape = self._shapes[gt_id]
        before = self._before.get(gt_id, T_world_object)
        return ObjectFrameTruth(
            gt_id=gt_id,
            T_world_object=T_world_object,
            box=aabb_of_points(apply_T(T_world_object, self._hulls[gt_id])),
            visible_pixels=visible,
            visible_fraction=render.share_seen(shape, T_camera_object, visible, frame.camera),
            moving=bool(np.abs(before - T_world_object).max() > MOVES_M),
        )


def _shape(gt_id: int, item: AnnotatedObject) -> tuple[Shape, NDArray[np.float64]]:
    what = f"object {gt_id}"
    if not 1 <= gt_id < UNTOLD:
        raise DataError(f"{what}: expected ids from 1 to {UNTOLD - 1}")
    if item.class_name not in CLASS_NAMES:
        raise DataError(f"{what}: class {item.class_name!r}; expected {', '.join(CLASS_NAMES)}")
    if not isinstance(item.mesh, trimesh.Trimesh) or len(item.mesh.faces) == 0:
        raise DataError(f'{what}: no mesh with faces; expected trimesh.load(FILE, force="mesh")')
    mesh = cleaned(trimesh.Trimesh(item.mesh.vertices, item.mesh.faces, process=False))
    shape, middle = shape_of_mesh(mesh, item.class_name, "annotated", what, _GREY)
    try:
        symmetry = shape.symmetry if item.symmetry is None else Symmetry(item.symmetry)
        _hull(shape)
    except QhullError:
        raise DataError(f"{what}: its mesh is flat; expected a solid piece of furniture") from None
    except ValueError:
        raise DataError(
            f"{what}: symmetry {item.symmetry!r}; expected {', '.join(Symmetry)}"
        ) from None
    return replace(shape, symmetry=symmetry), middle


def _hull(shape: Shape) -> NDArray[np.float64]:
    """(H, 3) vertices of the convex hull, the shape's own axes."""
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
    unknown = sorted(set(np.unique(given).tolist()) - {0, UNTOLD, *known})
    if unknown:
        raise DataError(
            f"{what}: ids hold {unknown[0]}, which is no object; 0 is none, {UNTOLD} untold"
        )
    return given.astype(np.uint16)
