"""One sequence with ground truth on disk: the exported-ScanNet layout with annotations beside it.

DIR/color/N.jpg, depth/N.png (uint16, mm), pose/N.txt (camera to world), intrinsic/*.txt,
instance/N.png (uint16: gt_id, 0 for what is no furniture, 65535 for what nobody can tell),
annotations.json, shapes/ID.npz (occupancy, hull) and
shapes/ID.ply (watertight, canonical: centred, box diagonal 1). The world is levelled.
"""

from __future__ import annotations

import json
import os
import shutil
import socket
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image

from composenet.errors import DataError
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

ANNOTATION_VERSION = 1
UNTOLD = 2**16 - 1
"""In an image of ids: nothing is learned from such a pixel."""
_PARTIAL = ".partial-"
_HERE = socket.gethostname()
_DAMAGED = (KeyError, TypeError, ValueError, OSError, EOFError, zlib.error, zipfile.BadZipFile)
_FOLDERS = ("color", "depth", "pose", "intrinsic", "instance", "shapes")


class SequenceFolder:
    """Writes a sequence frame by frame, to a folder that must not exist and appears only when
    `finish` has been called; left before that, nothing stays. Raises DataError where it is there,
    or cannot be written."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        name = f".{folder.name}{_PARTIAL}{_HERE}-{os.getpid()}"
        self._partial = folder.with_name(name)
        self._camera: Camera | None = None
        self._frames: list[tuple[ObjectFrameTruth, ...]] = []

    def __enter__(self) -> SequenceFolder:
        self._remove()
        with self._told():
            if self.folder.exists():
                raise DataError(
                    f"{self.folder}: is there already; remove it or choose another name"
                )
            for name in _FOLDERS:
                (self._partial / name).mkdir(parents=True)
        self._camera, self._frames = None, []
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._remove()

    def __len__(self) -> int:
        """Frames so far."""
        return len(self._frames)

    def add(
        self, frame: Frame, ids: NDArray[np.integer], truth: tuple[ObjectFrameTruth, ...]
    ) -> None:
        """Write the next frame. ids: (H, W), gt_id or 0. truth: of every object. Raises DataError
        where its camera is another than the first frame's."""
        here, i = self._partial, len(self._frames)
        self._camera = self._camera or frame.camera
        if not _same_camera(self._camera, frame.camera):
            raise DataError(f"{self.folder}: frame {i} is of another camera; one a sequence")
        depth_mm = np.rint(frame.depth_m * 1000).astype(np.uint16)
        with self._told():
            if frame.color is not None:
                Image.fromarray(np.asarray(frame.color)).save(here / f"color/{i}.jpg", quality=92)
            Image.fromarray(depth_mm).save(here / f"depth/{i}.png", compress_level=3)
            Image.fromarray(ids.astype(np.uint16)).save(
                here / f"instance/{i}.png", compress_level=3
            )
            _write_matrix(here / f"pose/{i}.txt", frame.T_world_camera)
        self._frames.append(truth)

    def finish(
        self,
        objects: Sequence[tuple[ObjectTruth, trimesh.Trimesh]],
        about: Mapping[str, Any],
    ) -> None:
        """Write what is constant, and let the folder appear. objects: each with its canonical
        mesh. about: what else annotations.json is to tell."""
        camera = self._camera
        assert camera is not None
        extents = {truth.gt_id: truth.extents_m for truth, _ in objects}
        annotations = {
            "version": ANNOTATION_VERSION,
            **about,
            "n_frames": len(self._frames),
            "image_size": [camera.width, camera.height],
            "objects": [_object_entry(truth) for truth, _ in objects],
            "frames": [
                [_frame_entry(entry, extents[entry.gt_id]) for entry in frame]
                for frame in self._frames
            ],
        }
        with self._told():
            self._write_camera(camera)
            for truth, mesh in objects:
                self._write_shape(truth, mesh)
            (self._partial / "annotations.json").write_text(json.dumps(annotations) + "\n")
            self._partial.rename(self.folder)

    def _write_camera(self, camera: Camera) -> None:
        intrinsic = np.eye(4)
        intrinsic[:3, :3] = camera.K
        for kind in ("color", "depth"):
            _write_matrix(self._partial / f"intrinsic/intrinsic_{kind}.txt", intrinsic)
            _write_matrix(self._partial / f"intrinsic/extrinsic_{kind}.txt", np.eye(4))

    def _write_shape(self, truth: ObjectTruth, mesh: trimesh.Trimesh) -> None:
        path = self._partial / f"shapes/{truth.gt_id}"
        bits = np.packbits(truth.occupancy)
        np.savez_compressed(path.with_suffix(".npz"), occupancy=bits, hull=truth.hull)
        mesh.export(path.with_suffix(".ply"))

    def _remove(self) -> None:
        shutil.rmtree(self._partial, ignore_errors=True)

    @contextmanager
    def _told(self) -> Iterator[None]:
        """What the disk refuses, as DataError."""
        try:
            yield
        except OSError as error:
            self._remove()
            raise DataError(
                f"{self.folder}: cannot be written ({error.strerror or error})"
            ) from None


def remove_leftovers(out: Path) -> None:
    """Unfinished sequences in `out` of processes of this machine that were killed."""
    for folder in out.glob(f".*{_PARTIAL}{_HERE}-*"):
        writer = folder.name.rpartition("-")[2]
        if writer.isdecimal() and not _is_running(int(writer)):
            shutil.rmtree(folder, ignore_errors=True)


def annotated_folders(data: Path) -> list[Path]:
    """The sequences of a folder, in name order; or the folder itself, where it is one."""
    if (data / "annotations.json").exists():
        return [Path(os.path.abspath(data))]  # `.` has no name
    return sorted(path.parent for path in data.glob("*/annotations.json"))


def read_truth(folder: Path) -> SequenceTruth:
    """The ground truth of a written sequence, equal to what was written.

    Raises DataError where the annotations are missing, damaged or of another version.
    """
    data = read_annotations(folder)
    try:
        return SequenceTruth(
            objects=tuple(_object_from(entry, folder) for entry in data["objects"]),
            frames=tuple(
                tuple(_object_frame_from(entry) for entry in frame) for frame in data["frames"]
            ),
            image_size=(int(data["image_size"][0]), int(data["image_size"][1])),
        )
    except _DAMAGED as error:
        raise DataError(
            f"{folder / 'annotations.json'}: damaged annotations ({error!r}); write it again"
        ) from None


def read_split(folder: Path) -> str:
    """The split that a written sequence is of. Raises DataError."""
    return str(read_annotations(folder).get("split"))


def read_annotations(folder: Path) -> dict[str, Any]:
    """All of annotations.json. Raises DataError where it is missing or of another version."""
    path = folder / "annotations.json"
    try:
        data = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: no readable annotations ({error})") from None
    version = data.get("version") if isinstance(data, dict) else None
    if version != ANNOTATION_VERSION:
        raise DataError(f"{path}: annotation version {version}, expected {ANNOTATION_VERSION}")
    return dict(data)


def _is_running(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # another user's
        return True
    return True


def _same_camera(a: Camera, b: Camera) -> bool:
    return (a.width, a.height) == (b.width, b.height) and np.array_equal(a.K, b.K)


def _write_matrix(path: Path, matrix: FloatArray) -> None:
    np.savetxt(path, matrix, fmt="%.17g")


def _object_entry(truth: ObjectTruth) -> dict[str, Any]:
    return {
        "id": truth.gt_id,
        "class": CLASS_NAMES[truth.class_id],
        "recipe": truth.recipe,
        "symmetry": truth.symmetry.value,
        "extents_m": truth.extents_m.tolist(),
        "canonical_extents": (truth.extents_m / np.linalg.norm(truth.extents_m)).tolist(),
    }


def _frame_entry(entry: ObjectFrameTruth, extents_m: FloatArray) -> dict[str, Any]:
    T = entry.T_world_object
    return {
        "id": entry.gt_id,
        "T_world_object": T.tolist(),
        "scale_m": float(np.linalg.norm(extents_m)),
        "axis_aligned_box": {
            "center": entry.box.center.tolist(),
            "extents": entry.box.extents.tolist(),
        },
        "oriented_box": {
            "center": T[:3, 3].tolist(),
            "extents": extents_m.tolist(),
            "yaw_rad": float(np.arctan2(T[1, 0], T[0, 0])),
        },
        "visible_pixels": entry.visible_pixels,
        "visible_fraction": entry.visible_fraction,
        "moving": entry.moving,
    }


def _object_from(entry: dict[str, Any], folder: Path) -> ObjectTruth:
    with np.load(folder / f"shapes/{int(entry['id'])}.npz") as stored:
        bits = np.unpackbits(stored["occupancy"])
        hull = stored["hull"]
    return ObjectTruth(
        gt_id=int(entry["id"]),
        class_id=CLASS_NAMES.index(entry["class"]),
        symmetry=Symmetry(entry["symmetry"]),
        extents_m=np.array(entry["extents_m"], dtype=np.float64),
        occupancy=bits.reshape(64, 64, 64).astype(bool),
        hull=hull,
        recipe=str(entry["recipe"]),
    )


def _object_frame_from(entry: dict[str, Any]) -> ObjectFrameTruth:
    box = entry["axis_aligned_box"]
    return ObjectFrameTruth(
        gt_id=int(entry["id"]),
        T_world_object=np.array(entry["T_world_object"], dtype=np.float64).reshape(4, 4),
        box=Box(np.array(box["center"], dtype=float), np.array(box["extents"], dtype=float)),
        visible_pixels=int(entry["visible_pixels"]),
        visible_fraction=float(entry["visible_fraction"]),
        moving=bool(entry["moving"]),
    )
