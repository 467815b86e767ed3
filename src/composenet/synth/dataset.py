"""Splits of DynSynth-open on disk: sequences written or measured, in several processes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import as_completed
from functools import partial
from pathlib import Path
from typing import TypeVar

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
from composenet.synth import stats
from composenet.synth.cad import digest
from composenet.synth.scene import (
    DEFAULT_OPTIONS,
    GENERATOR_VERSIONS,
    Scene,
    SceneOptions,
    generate_scene,
)
from composenet.synth.sequence_folder import SequenceFolder, read_annotations, remove_leftovers
from composenet.synth.solid import canonical_mesh

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
    remove_leftovers(out)
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
    about = {
        "generator_version": GENERATOR_VERSIONS[scene.split],
        "split": scene.split,
        "index": scene.index,
        "cad_share": scene.cad_share,
        "cad_meshes": scene.cad_meshes,
        "sensor": scene.sensor.kind.value,
    }
    with SequenceFolder(folder) as written:
        for i in range(scene.n_frames):
            rendered = scene.render(i)
            written.add(rendered.frame, rendered.ids, scene.frame_truth(i, rendered.ids))
        shapes = [(o, canonical_mesh(scene.shape_of(o.gt_id), o.occupancy)) for o in scene.objects]
        written.finish(shapes, about)


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
    data = read_annotations(folder)
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
