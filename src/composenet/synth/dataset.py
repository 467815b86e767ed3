"""Sequences on disk: the exported-ScanNet layout with annotations beside it.

DIR/color/N.jpg, depth/N.png (uint16, mm), pose/N.txt (camera to world), intrinsic/*.txt,
instance/N.png (uint16, gt_id), annotations.json, shapes/ID.npz (occupancy, hull) and
shapes/ID.ply (watertight, canonical: centred, box diagonal 1).
"""

from __future__ import annotations

import json
import os
import shutil
import socket
import zipfile
import zlib
from collections.abc import Callable, Iterator
from concurrent.futures import as_completed
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from composenet.errors import DataError
from composenet.process import worker_pool
from composenet.records import (
    CLASS_NAMES,
    Box,
    ObjectFrameTruth,
    ObjectTruth,
    SequenceTruth,
    Symmetry,
)
from composenet.synth import stats
from composenet.synth.cad import digest
from composenet.synth.scene import (
    DEFAULT_OPTIONS,
    GENERATOR_VERSIONS,
    Scene,
    SceneOptions,
    generate_scene,
)
from composenet.synth.solid import canonical_mesh

ANNOTATION_VERSION = 1
_PARTIAL = ".partial-"
_HERE = socket.gethostname()
_DAMAGED = (KeyError, TypeError, ValueError, OSError, EOFError, zlib.error, zipfile.BadZipFile)
Result = TypeVar("Result")


def write_split(
    split: str,
    count: int,
    out: Path,
    start: int = 0,
    options: SceneOptions = DEFAULT_OPTIONS,
    workers: int = 1,
) -> tuple[Path, ...]:
    """Write sequences start .. start + count - 1 of a split, each to a folder of `out`.

    What an earlier run finished is kept; an interrupted sequence leaves nothing behind. Shows
    progress with rate and remaining time. Returns the folders. Raises DataError.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(
            f"{out}: cannot write sequences here ({error.strerror}); give another --out folder"
        ) from None
    _remove_leftovers(out)
    work = partial(_write_one, split, out=out, options=options)
    return tuple(_map(work, range(start, start + count), workers, f"writing {split}"))


def measure_split(
    split: str,
    count: int,
    start: int = 0,
    options: SceneOptions = DEFAULT_OPTIONS,
    workers: int = 1,
) -> tuple[stats.SequenceDifficulty, ...]:
    """Difficulty of sequences start .. start + count - 1, generated anew, with progress."""
    work = partial(_measure_one, split, options=options)
    return tuple(_map(work, range(start, start + count), workers, f"measuring {split}"))


def write_sequence(scene: Scene, folder: Path) -> None:
    """Write one sequence to `folder`, which must not exist; it appears only when complete. Raises
    DataError where it cannot be written."""
    partial_folder = folder.with_name(f".{folder.name}{_PARTIAL}{_HERE}-{os.getpid()}")
    shutil.rmtree(partial_folder, ignore_errors=True)
    try:
        _write_files(scene, partial_folder)
        partial_folder.rename(folder)
    except OSError as error:
        raise DataError(f"{folder}: cannot be written ({error.strerror or error})") from None
    finally:
        shutil.rmtree(partial_folder, ignore_errors=True)


def _remove_leftovers(out: Path) -> None:
    """Unfinished sequences of processes of this machine that were killed."""
    for folder in out.glob(f".*{_PARTIAL}{_HERE}-*"):
        writer = folder.name.rpartition("-")[2]
        if writer.isdecimal() and not _is_running(int(writer)):
            shutil.rmtree(folder, ignore_errors=True)


def _is_running(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # another user's
        return True
    return True


def read_truth(folder: Path) -> SequenceTruth:
    """The ground truth of a written sequence, equal to the scene's own.

    Raises DataError where the annotations are missing, damaged or of another version.
    """
    data = _read_annotations(folder)
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


def _write_one(split: str, index: int, *, out: Path, options: SceneOptions) -> Path:
    folder = out / f"{split}_{index:05d}"
    if folder.exists():
        _check_same(folder, split, index, options)
        return folder
    scene = generate_scene(split, index, options)
    try:
        write_sequence(scene, folder)
    except DataError:
        if not folder.exists():
            raise
        _check_same(folder, split, index, options)  # another run was faster
    return folder


def _measure_one(split: str, index: int, *, options: SceneOptions) -> stats.SequenceDifficulty:
    scene = generate_scene(split, index, options)
    return stats.difficulty(scene.truth, scene.T_world_camera)


def _check_same(folder: Path, split: str, index: int, options: SceneOptions) -> None:
    """Raises DataError where an existing folder holds something else."""
    data = _read_annotations(folder)
    wanted = {
        "generator_version": GENERATOR_VERSIONS[split],
        "split": split,
        "index": index,
        "image_size": list(options.image_size),
        "n_frames": options.frames,
        "cad_share": 0.0 if options.cad_dir is None else options.cad_share,
        "cad_meshes": "" if options.cad_dir is None else digest(options.cad_dir),
    }
    data.setdefault("cad_meshes", wanted["cad_meshes"])  # earlier sequences do not tell
    for key, value in wanted.items():
        if data.get(key) != value:
            raise DataError(
                f"{folder}: holds a sequence with {key} {data.get(key)}, not {value}; "
                "remove it or choose another folder"
            )


def read_split(folder: Path) -> str:
    """The split that a written sequence is of. Raises DataError."""
    return str(_read_annotations(folder).get("split"))


def _read_annotations(folder: Path) -> dict[str, Any]:
    path = folder / "annotations.json"
    try:
        data = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: no readable annotations ({error})") from None
    version = data.get("version") if isinstance(data, dict) else None
    if version != ANNOTATION_VERSION:
        raise DataError(f"{path}: annotation version {version}, expected {ANNOTATION_VERSION}")
    return dict(data)


def _write_files(scene: Scene, folder: Path) -> None:
    for name in ("color", "depth", "pose", "intrinsic", "instance", "shapes"):
        (folder / name).mkdir(parents=True)
    frames = []
    for i in range(scene.n_frames):
        rendered = scene.render(i)
        frames.append(scene.frame_truth(i, rendered.ids))
        Image.fromarray(np.asarray(rendered.frame.color)).save(
            folder / f"color/{i}.jpg", quality=92
        )
        depth_mm = np.rint(rendered.frame.depth_m * 1000).astype(np.uint16)
        Image.fromarray(depth_mm).save(folder / f"depth/{i}.png", compress_level=3)
        Image.fromarray(rendered.ids).save(folder / f"instance/{i}.png", compress_level=3)
        _write_matrix(folder / f"pose/{i}.txt", scene.T_world_camera[i])
    intrinsic = np.eye(4)
    intrinsic[:3, :3] = scene.camera.K
    for kind in ("color", "depth"):
        _write_matrix(folder / f"intrinsic/intrinsic_{kind}.txt", intrinsic)
        _write_matrix(folder / f"intrinsic/extrinsic_{kind}.txt", np.eye(4))
    for truth in scene.objects:
        np.savez_compressed(
            folder / f"shapes/{truth.gt_id}.npz",
            occupancy=np.packbits(truth.occupancy),
            hull=truth.hull,
        )
        mesh = canonical_mesh(scene.shape_of(truth.gt_id), truth.occupancy)
        mesh.export(folder / f"shapes/{truth.gt_id}.ply")
    annotations = _annotations(scene, tuple(frames))
    (folder / "annotations.json").write_text(json.dumps(annotations) + "\n")


def _write_matrix(path: Path, matrix: NDArray[np.float64]) -> None:
    np.savetxt(path, matrix, fmt="%.17g")


def _annotations(scene: Scene, frames: tuple[tuple[ObjectFrameTruth, ...], ...]) -> dict[str, Any]:
    return {
        "version": ANNOTATION_VERSION,
        "generator_version": GENERATOR_VERSIONS[scene.split],
        "split": scene.split,
        "index": scene.index,
        "n_frames": scene.n_frames,
        "cad_share": scene.cad_share,
        "cad_meshes": scene.cad_meshes,
        "image_size": [scene.camera.width, scene.camera.height],
        "sensor": scene.sensor.kind.value,
        "objects": [
            {
                "id": truth.gt_id,
                "class": CLASS_NAMES[truth.class_id],
                "recipe": truth.recipe,
                "symmetry": truth.symmetry.value,
                "extents_m": truth.extents_m.tolist(),
                "canonical_extents": (truth.extents_m / np.linalg.norm(truth.extents_m)).tolist(),
            }
            for truth in scene.objects
        ],
        "frames": [[_object_frame(scene, entry) for entry in frame] for frame in frames],
    }


def _object_frame(scene: Scene, entry: ObjectFrameTruth) -> dict[str, Any]:
    extents_m = scene.shape_of(entry.gt_id).extents_m
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


class _Rate(ProgressColumn):
    """Finished pieces a second."""

    def render(self, task: Task) -> Text:
        return Text(f"{task.speed:.2f}/s" if task.speed else "-/s")


def _map(
    work: Callable[[int], Result], indices: range, workers: int, label: str
) -> Iterator[Result]:
    """work(index) for all, in order, in `workers` processes, with progress on stderr."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        _Rate(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as progress:
        task = progress.add_task(label, total=len(indices))
        if workers <= 1:
            for index in indices:
                yield work(index)
                progress.advance(task)
            return
        with worker_pool(workers) as pool:
            futures = [pool.submit(work, index) for index in indices]
            for done in as_completed(futures):
                done.result()  # what goes wrong is said at once
                progress.advance(task)
            yield from (future.result() for future in futures)
