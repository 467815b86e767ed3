"""One sequence of DynSynth-open: a furnished room in which things and the camera move."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from composenet.errors import DataError
from composenet.geometry.box import aabb_of_points
from composenet.geometry.transform import apply_T, inverse_T, make_T, rotation_z
from composenet.records import (
    CLASS_NAMES,
    Box,
    Camera,
    FloatArray,
    Frame,
    ObjectFrameTruth,
    ObjectTruth,
    SequenceTruth,
    Symmetry,
)
from composenet.synth import cad, render
from composenet.synth.camera_path import move_camera
from composenet.synth.furnish import MakeShape, furnish
from composenet.synth.furniture import make_furniture
from composenet.synth.furniture.clutter import make_clutter, make_small_clutter
from composenet.synth.motion import move_items
from composenet.synth.occupancy import occupancy
from composenet.synth.placement import Layout
from composenet.synth.sensor import Sensor, measure, sample_sensor
from composenet.synth.shading import Light, shade
from composenet.synth.shape import Shape
from composenet.synth.unseen import as_cameras_fail

GENERATOR_VERSIONS = {"train": 6, "val": 3, "test": 3}
"""What is made of the numbers that are drawn."""
DRAWN_BY = {"train": 5, "val": 2, "test": 2}
"""Keys of these numbers: rooms, furniture and walks of val and test are fixed; what training draws
from has grown since."""
SPLITS = tuple(GENERATOR_VERSIONS)
LOW_SCALE, HIGH_SCALE = 0.85, 1.2
ODD_SHARE, ODD_LOW, ODD_HIGH = 0.15, 0.8, 1.4
"""Share of the training furniture that is smaller or larger as a whole, and how much."""


@dataclass(frozen=True)
class SceneOptions:
    """How sequences are made. image_size: width, height. cad_dir: folder of meshes
    (CLASS/*.obj ...). cad_share: share of the furniture taken from it; 1 takes all."""

    frames: int = 30
    image_size: tuple[int, int] = (320, 240)
    cad_dir: Path | None = None
    cad_share: float = 0.5


DEFAULT_OPTIONS = SceneOptions()


@dataclass(frozen=True)
class RenderedFrame:
    """frame: with the sensor's depth. ids: (H, W), gt_id or 0. clean_depth_m: (H, W) float32,
    without noise."""

    frame: Frame
    ids: NDArray[np.integer]
    clean_depth_m: NDArray[np.float32]


@dataclass(frozen=True)
class Scene:
    """A sequence, rendered on demand.

    T_world_camera: (F, 4, 4). shapes: N of them, the room first. gt_ids: (N,) uint16, 0 for
    what is no furniture. T_world_shape: (F, N, 4, 4). The floor is at z = 0. cad_share,
    cad_meshes: how much of the furniture is from meshes, and which (`cad.digest`).
    """

    name: str
    split: str
    index: int
    camera: Camera
    T_world_camera: NDArray[np.float64]
    shapes: tuple[Shape, ...]
    gt_ids: NDArray[np.uint16]
    T_world_shape: NDArray[np.float64]
    sensor: Sensor
    light: Light
    cad_share: float = 0.0
    cad_meshes: str = ""

    @property
    def n_frames(self) -> int:
        return len(self.T_world_camera)

    @cached_property
    def mesh(self) -> render.Mesh:
        return render.assemble(self.shapes)

    def shape_of(self, gt_id: int) -> Shape:
        """The shape of a piece of furniture. Raises DataError for an unknown id."""
        return self.shapes[self._slot(gt_id)]

    def render(self, i: int, *, color: bool = True, noise: bool = True) -> RenderedFrame:
        """Frame i: the same bytes at every call. Without noise its depth is the clean one."""
        T_camera_shape = inverse_T(self.T_world_camera[i]) @ self.T_world_shape[i]
        buffers = render.draw(self.mesh, T_camera_shape, self.camera)
        ids = np.where(
            buffers.face >= 0, self.gt_ids[self.mesh.face_instance[buffers.face]], 0
        ).astype(np.uint16)
        depth_m, rgb = buffers.depth_m, None
        rng = _rng(self.split, self.index, 1 + i)
        if noise:
            surface = render.surface(self.mesh, buffers, self.camera)
            depth_m = measure(self.sensor, buffers.depth_m, surface, self.camera, rng)
        if color:
            rgb = shade(
                self.mesh, buffers, T_camera_shape, self.T_world_camera[i], self.camera, self.light
            )
        frame = Frame(
            i, depth_m, self.camera, self.T_world_camera[i], rgb, timestamp_s=i / 10, name=str(i)
        )
        return RenderedFrame(frame, ids, buffers.depth_m)

    def frame_truth(
        self, i: int, ids: NDArray[np.integer], fractions: bool = True
    ) -> tuple[ObjectFrameTruth, ...]:
        """Every object in frame i, given that frame's id image. Without fractions, for which every
        object is drawn alone, visible_fraction is NaN."""
        visible = np.bincount(ids.ravel(), minlength=int(self.gt_ids.max()) + 1)
        return tuple(
            self._object_frame(i, int(gt_id), int(visible[gt_id]), fractions)
            for gt_id in self.gt_ids[self.gt_ids > 0]
        )

    def object_truth(self, gt_id: int, solid: bool = True) -> ObjectTruth:
        """What stays the same over the sequence; computed when first asked for. Not solid: all of
        it but the occupancy, which is empty then."""
        if (gt_id, solid) not in self._truths:
            shape = self.shape_of(gt_id)
            self._truths[gt_id, solid] = ObjectTruth(
                gt_id=gt_id,
                class_id=CLASS_NAMES.index(shape.class_name),
                symmetry=shape.symmetry,
                extents_m=shape.extents_m,
                occupancy=occupancy(shape) if solid else np.zeros((64,) * 3, np.bool_),
                hull=self._hull(self._slot(gt_id)).astype(np.float32),
                recipe=shape.style,
            )
        return self._truths[gt_id, solid]

    @cached_property
    def objects(self) -> tuple[ObjectTruth, ...]:
        """All objects, by gt_id."""
        return tuple(self.object_truth(int(g)) for g in self.gt_ids[self.gt_ids > 0])

    @cached_property
    def truth(self) -> SequenceTruth:
        """The whole truth; renders every frame once, without colour and noise."""
        frames = tuple(
            self.frame_truth(i, self.render(i, color=False, noise=False).ids)
            for i in range(self.n_frames)
        )
        return SequenceTruth(self.objects, frames, (self.camera.width, self.camera.height))

    def others(self, i: int) -> tuple[Box, ...]:
        """Boxes in frame i of the clutter: everything but the room and the furniture."""
        slots = range(1, len(self.shapes))
        return tuple(self._box(i, slot) for slot in slots if self.gt_ids[slot] == 0)

    def _box(self, i: int, slot: int) -> Box:
        return aabb_of_points(apply_T(self.T_world_shape[i, slot], self._hull(slot)))

    def _object_frame(self, i: int, gt_id: int, visible: int, fractions: bool) -> ObjectFrameTruth:
        slot = self._slot(gt_id)
        T_world_object = self.T_world_shape[i, slot]
        fraction = np.nan
        if fractions:
            T_camera_object = inverse_T(self.T_world_camera[i]) @ T_world_object
            fraction = render.share_seen(self.shapes[slot], T_camera_object, visible, self.camera)
        before = self.T_world_shape[max(i - 1, 0), slot]
        return ObjectFrameTruth(
            gt_id=gt_id,
            T_world_object=T_world_object,
            box=self._box(i, slot),
            visible_pixels=visible,
            visible_fraction=fraction,
            moving=not np.array_equal(before, T_world_object),
        )

    def _slot(self, gt_id: int) -> int:
        slots = np.flatnonzero(self.gt_ids == gt_id)
        if gt_id <= 0 or len(slots) == 0:
            raise DataError(
                f"{self.name}: no object {gt_id}, expected one of 1..{self.gt_ids.max()}"
            )
        return int(slots[0])

    def _hull(self, slot: int) -> NDArray[np.float64]:
        """(H, 3) vertices of the convex hull, the shape's own axes."""
        if slot not in self._hulls:
            vertices = self.shapes[slot].vertices
            self._hulls[slot] = vertices[ConvexHull(vertices).vertices].astype(np.float64)
        return self._hulls[slot]

    @cached_property
    def _truths(self) -> dict[tuple[int, bool], ObjectTruth]:
        return {}

    @cached_property
    def _hulls(self) -> dict[int, NDArray[np.float64]]:
        return {}


def generate_scene(split: str, index: int, options: SceneOptions = DEFAULT_OPTIONS) -> Scene:
    """The sequence number `index` of a split: the same one for everybody.

    Raises DataError for an unknown split, a negative index or a folder of meshes that is not
    as expected.
    """
    rng = _rng(split, index, 0)
    training = split == "train"
    make = _shape_source(rng, options, training)
    camera = _camera(rng, options.image_size)
    half_view = float(np.arctan(camera.width / 2 / camera.K[0, 0]))
    while True:
        layout = furnish(rng, make, options.cad_share if options.cad_dir else 0.0, training)
        paths = move_items(layout, options.frames)
        if paths is None:
            continue
        T_room_camera = move_camera(layout, paths, half_view, training)
        if not _runs_into(layout, paths, T_room_camera[:, :3, 3]):
            break
    T_world_room = make_T(rotation_z(rng.uniform(-np.pi, np.pi)), np.zeros(3))
    furniture = np.array([item.shape.class_name in CLASS_NAMES for item in layout.items])
    gt_ids = np.where(furniture, np.cumsum(furniture), 0)
    return Scene(
        name=f"{split}_{index:05d}",
        split=split,
        index=index,
        camera=camera,
        T_world_camera=T_world_room @ T_room_camera,
        shapes=(layout.room.shape, *(item.shape for item in layout.items)),
        gt_ids=np.concatenate([[0], gt_ids]).astype(np.uint16),
        T_world_shape=T_world_room @ _shape_poses(layout, paths),
        sensor=sample_sensor(rng),
        light=_light(rng, layout, T_world_room),
        cad_share=0.0 if options.cad_dir is None else options.cad_share,
        cad_meshes="" if options.cad_dir is None else cad.digest(options.cad_dir),
    )


def _rng(split: str, index: int, stream: int) -> np.random.Generator:
    """Independent numbers for every split, sequence and purpose."""
    if split not in SPLITS or index < 0:
        raise DataError(f"no sequence {split!r} {index}: expected {'/'.join(SPLITS)} and 0 or more")
    key, version = zlib.crc32(split.encode()), DRAWN_BY[split]
    return np.random.default_rng(np.random.SeedSequence([version, key, index, stream]))


def _runs_into(layout: Layout, paths: NDArray[np.float64], eyes: NDArray[np.float64]) -> np.bool_:
    """Whether the camera, (F, 3) in the room, is ever in the box of an item: what moves does not
    mind it."""
    away = eyes[:, None, :2] - paths[..., :2]
    c, s = np.cos(paths[..., 2]), np.sin(paths[..., 2])
    local = np.stack([c * away[..., 0] + s * away[..., 1], c * away[..., 1] - s * away[..., 0]], -1)
    half = np.array([item.footprint[3:] for item in layout.items])
    low, high = np.array([item.span_m for item in layout.items]).T
    height = eyes[:, None, 2]
    over = (height > low) & (height < high)
    return ((np.abs(local) < half).all(axis=-1) & over).any()


def _shape_source(rng: np.random.Generator, options: SceneOptions, training: bool) -> MakeShape:
    """Makes furniture (procedural or CAD, its size varied) and clutter."""
    library = cad.load_library(options.cad_dir) if options.cad_dir is not None else {}

    def make(class_name: str) -> Shape:
        if class_name == "clutter":
            return make_clutter(rng)
        if class_name == "small clutter":
            return make_small_clutter(rng)
        models = library.get(class_name, ())
        if models and rng.random() < options.cad_share:
            shape = cad.load_shape(models[int(rng.integers(len(models)))], class_name)
        else:
            shape = make_furniture(class_name, rng, further=training)
        odd = training and rng.random() < ODD_SHARE
        whole = np.exp(rng.uniform(np.log(ODD_LOW), np.log(ODD_HIGH))) if odd else 1.0
        return stretched(as_cameras_fail(shape, rng) if training else shape, rng, whole)

    return make


def stretched(shape: Shape, rng: np.random.Generator, whole: float = 1.0) -> Shape:
    """The shape with its length, width and height varied about `whole` times what they were; its
    symmetry is kept."""
    factors = whole * np.exp(rng.uniform(np.log(LOW_SCALE), np.log(HIGH_SCALE), 3))
    if shape.symmetry in (Symmetry.FOUR, Symmetry.INF):
        factors[1] = factors[0]
    return replace(
        shape,
        vertices=shape.vertices * factors.astype(np.float32),
        prototype=shape.prototype or shape,
    )


def _camera(rng: np.random.Generator, image_size: tuple[int, int]) -> Camera:
    width, height = image_size
    focal = width / 2 / np.tan(np.radians(rng.uniform(55, 75)) / 2)
    K = np.diag([focal, focal * rng.uniform(0.985, 1.015), 1.0])
    off = rng.uniform(-0.015, 0.015, 2) * width
    K[:2, 2] = (width - 1) / 2 + off[0], (height - 1) / 2 + off[1]
    return Camera(K, width, height)


def _shape_poses(layout: Layout, paths: NDArray[np.float64]) -> NDArray[np.float64]:
    """(F, 1 + N, 4, 4) T_room_shape: the room, then the items along their paths (F, N, 3)."""
    poses = np.tile(np.eye(4), (len(paths), 1 + len(layout.items), 1, 1))
    poses[:, 0, :3, 3] = layout.room.origin
    c, s = np.cos(paths[..., 2]), np.sin(paths[..., 2])
    poses[:, 1:, 0, 0], poses[:, 1:, 0, 1] = c, -s
    poses[:, 1:, 1, 0], poses[:, 1:, 1, 1] = s, c
    poses[:, 1:, :2, 3] = paths[..., :2]
    poses[:, 1:, 2, 3] = [item.xyz[2] for item in layout.items]
    return poses


def _light(rng: np.random.Generator, layout: Layout, T_world_room: FloatArray) -> Light:
    width, depth = layout.room.size_m
    lamp = [
        width * rng.uniform(0.3, 0.7),
        depth * rng.uniform(0.3, 0.7),
        layout.room.height_m - 0.3,
    ]
    sun = np.array([*rng.uniform(-1, 1, 2), rng.uniform(0.4, 1.0)])
    return Light(
        sun=sun / np.linalg.norm(sun),
        lamp=apply_T(T_world_room, np.array(lamp)),
        ambient=float(rng.uniform(0.35, 0.55)),
        sun_strength=float(rng.uniform(0.1, 0.5)),
        lamp_strength=float(rng.uniform(0.2, 0.6)),
    )
