"""Training samples: streamed from the generator in worker processes, or read from disk."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from torch.utils.data import IterableDataset, get_worker_info

from composenet.geometry.transform import make_T, rotation_z
from composenet.records import Camera, Frame
from composenet.synth.scene import Scene, SceneOptions, generate_scene
from composenet.training.config import TrainingConfig
from composenet.training.disk import DiskScene, disk_scene
from composenet.training.targets import (
    Sample,
    TrainingBatch,
    collate_samples,
    forget_moved,
    make_sample,
)
from composenet.volume.memory import Memory
from composenet.volume.voxels import FEATURE_NAMES, Volume, remember, voxelize

LONGEST_STEP = 4
"""Frames between one look and the next, at most."""
SKIPPED = 2
"""Frames of a short walk that are looked at and remembered, but no sample."""
LONG_WALKS = 0.6
"""Share of the scenes that are walked from end to end, half of them there and back."""
LONGEST_WALK = 30
"""Frames one way; of a longer recording a random part is walked through."""
LOOKS_ASIDE = 0.1
"""Share of the generated scenes in which the camera is turned by any angle all along, whatever it
was meant to look at: what it sees is mostly bare walls, corners and pieces of furniture."""
NARROW_FRAMES = 0.3
"""Share of the frames of which a window is seen."""
WRONG_FLOOR_M = 0.03
"""Standard deviation of the floor's height that a frame is told: none is known exactly."""
POOL_FRAMES = 512
"""A worker mixes so many frames, of dozens of scenes, once its pool is full; half a gigabyte."""


@dataclass(frozen=True)
class SceneSource:
    """Which scenes: a split of the generator, optionally with CAD, and sequences on disk."""

    split: str = "train"
    cad_dir: Path | None = None
    cad_share: float = 0.5
    data_dir: Path | None = None
    """sequences on disk, all of them, over and over"""
    data_share: float = 1.0
    """of the scenes, that are from there"""

    @property
    def told(self) -> str:
        """In words."""
        if self.data_dir is None:
            return self._generated
        own = f"the sequences of {self.data_dir.resolve()}"
        return f"{self.data_share:.0%} {own}, {self._generated}" if self.data_share < 1 else own

    @property
    def _generated(self) -> str:
        if self.cad_dir is None:
            return "generated rooms"
        folder = self.cad_dir.resolve()
        return f"generated rooms, {self.cad_share:.0%} of their furniture from {folder}"

    def scene(self, index: int) -> Scene | DiskScene:
        """Scene `index`."""
        from_disk = np.random.default_rng((index, 2)).random() < self.data_share
        if self.data_dir is not None and from_disk:
            return disk_scene(self.data_dir, index)
        options = SceneOptions(cad_dir=self.cad_dir, cad_share=self.cad_share)
        scene = generate_scene(self.split, index, options)
        rng = np.random.default_rng((index, 1))
        if self.split == "train" and rng.random() < LOOKS_ASIDE:
            return turned_aside(scene, float(rng.uniform(0, 2 * np.pi)))
        return scene


def samples_of_scene(
    scene: Scene | DiskScene, config: TrainingConfig, rng: np.random.Generator, augment: bool = True
) -> Iterator[Sample]:
    """At most frames_per_scene samples of a walk through the scene, every one with what the frames
    before it on the walk saw; each believes the floor to be slightly elsewhere. Occupancy is empty
    where the parts in training do not learn from it; validation, not augmented, always has it."""
    solids = not augment or config.parts in ("all", "apart", "objects")
    remembers = config.model.volume.memory_frames > 0
    times = walk(scene.n_frames, config.frames_per_scene, rng, LONG_WALKS * remembers)
    count = min(config.frames_per_scene, len(times))
    taken = set(rng.choice(len(times), count, replace=False).tolist())
    memory = Memory(config.model.volume.memory_frames)
    for place, i in enumerate(times):
        rendered = scene.render(i, color=False)
        frame, ids = rendered.frame, rendered.ids
        if augment:
            frame = replace(frame, T_world_camera=frame.T_world_camera @ small_motion(rng))
            if rng.random() < NARROW_FRAMES:
                frame, ids = crop_view(frame, ids, random_window(rng))
        if place not in taken:
            remember(frame, config.model.volume, ids, memory)
            continue
        volume = voxelize(frame, config.model.volume, ids, memory)
        if volume is None:
            continue
        pixels = dict(zip(*np.unique(ids, return_counts=True), strict=True))
        truth = scene.frame_truth(i, rendered.ids, fractions=False)
        seen = [t for t in truth if pixels.get(t.gt_id, 0) >= config.min_visible_pixels]
        truths = [scene.object_truth(t.gt_id, solids) for t in seen]
        pairs = zip(truths, seen, strict=True)
        forget_moved(volume, {now.gt_id: (item, now) for item, now in pairs})
        sample = make_sample(volume, truths, seen, scene.others(i))
        if augment:
            raise_grid(volume, rng.normal(0, WRONG_FLOOR_M))
        yield sample


def raise_grid(volume: Volume, metres: float) -> None:
    """Place a grid higher above the floor than it is, in place. What is in it stays as it was."""
    volume.T_world_grid[2, 3] += metres
    volume.features[:, FEATURE_NAMES.index("height")] += metres / 2


def turned_aside(scene: Scene, yaw: float) -> Scene:
    """The scene as a camera sees it that is turned about the vertical by yaw, radians, where it
    stands."""
    poses = scene.T_world_camera.copy()
    poses[:, :3, :3] = rotation_z(yaw) @ poses[:, :3, :3]
    return replace(scene, T_world_camera=poses)


def walk(n_frames: int, n_samples: int, rng: np.random.Generator, long_share: float) -> list[int]:
    """Frames of a recording in the order in which they are looked at, in steps of random length:
    a few from a random one on, where little is remembered yet, or nearly all (the given share),
    where it is much, half of these and then back, as when the recording is looked at twice."""
    length = n_samples + SKIPPED
    if rng.random() >= long_share:
        step = int(rng.integers(1, max(1, min(LONGEST_STEP, n_frames // length)) + 1))
        start = int(rng.integers(0, max(1, n_frames - step * (length - 1))))
        return list(range(start, n_frames, step)[:length])
    back = rng.random() < 0.5
    step = int(rng.integers(1, 3)) + back
    start = int(rng.integers(0, max(step, n_frames - step * LONGEST_WALK + 1)))
    there = list(range(start, n_frames, step)[:LONGEST_WALK])
    return there + there[-2::-1] if back else there


def small_motion(rng: np.random.Generator) -> NDArray[np.float64]:
    """(4, 4): how wrong a camera pose may be, about a centimetre and a quarter of a degree."""
    turn = Rotation.from_rotvec(np.radians(0.25) * rng.standard_normal(3)).as_matrix()
    return make_T(turn, 0.008 * rng.standard_normal(3))


Window = tuple[float, float, float, float]
"""Left, top, width and height, as shares of an image's."""


def random_window(rng: np.random.Generator) -> Window:
    """At least half as wide and half as high as the image."""
    w, h = rng.uniform(0.5, 0.95, 2)
    u, v = rng.uniform(0, 1 - w), rng.uniform(0, 1 - h)
    return float(u), float(v), float(w), float(h)


def crop_view(frame: Frame, ids: np.ndarray, window: Window) -> tuple[Frame, np.ndarray]:
    """Blank depth and ids outside a window: a narrower view, objects cut by its border, and
    some that are not seen at all."""
    height, width = frame.depth_m.shape
    u, v, w, h = (np.array(window) * (width, height, width, height)).round().astype(int)
    inside = np.s_[v : v + h, u : u + w]
    depth, left = np.zeros_like(frame.depth_m), np.zeros_like(ids)
    depth[inside], left[inside] = frame.depth_m[inside], ids[inside]
    camera = Camera(frame.camera.K, width, height)
    return replace(frame, depth_m=depth, camera=camera), left


class SceneStream(IterableDataset):
    """Endless batches. Each worker draws its own scenes: worker w of n in process r of R takes
    scenes start + k * n * R + r * n + w, so no two ever share one."""

    def __init__(
        self,
        source: SceneSource,
        config: TrainingConfig,
        start: int,
        rank: int = 0,
        world_size: int = 1,
    ) -> None:
        self.source, self.config, self.start = source, config, start
        self.rank, self.world_size = rank, world_size

    def __iter__(self) -> Iterator[TrainingBatch]:
        info = get_worker_info()
        worker, n_workers = (info.id, info.num_workers) if info else (0, 1)
        step = n_workers * self.world_size
        index = self.start + self.rank * n_workers + worker
        pool: list[Sample] = []
        rng = np.random.default_rng((self.config.seed, index))
        kept = POOL_FRAMES // 8  # the first batch does not wait for a full pool
        while True:
            pool.extend(samples_of_scene(self.source.scene(index), self.config, rng))
            index += step
            kept = min(POOL_FRAMES, kept + self.config.frames_per_scene // 2)
            while len(pool) >= max(kept, self.config.batch_frames):
                picked = [
                    pool.pop(int(rng.integers(len(pool)))) for _ in range(self.config.batch_frames)
                ]
                yield collate_samples(picked)


def fixed_batches(
    source: SceneSource, config: TrainingConfig, n_scenes: int, start: int = 0, frames: int = 5
) -> list[TrainingBatch]:
    """The same validation batches every time, however many frames of a scene are learned from:
    so many frames of n_scenes scenes."""
    config = replace(config, frames_per_scene=frames)
    rng = np.random.default_rng(1)
    samples: list[Sample] = []
    for index in range(start, start + n_scenes):
        samples.extend(samples_of_scene(source.scene(index), config, rng, augment=False))
    size = config.batch_frames
    return [collate_samples(samples[i : i + size]) for i in range(0, len(samples), size)]
