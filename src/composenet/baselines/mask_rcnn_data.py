"""What Mask R-CNN learns from: rendered colour frames with the masks of their furniture."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import IterableDataset, get_worker_info

from composenet.baselines.mask_rcnn_network import FIRST_LABEL, image_tensor
from composenet.records import CLASS_NAMES
from composenet.synth.scene import Scene, SceneOptions, generate_scene

FRAMES_PER_SCENE = 8
POOL_FRAMES = 48
"""a worker mixes so many frames"""
MIN_PIXELS = 50
"""furniture with fewer is no target"""


@dataclass(frozen=True)
class MaskSample:
    """One image with its furniture. image: (4, H, W), `image_tensor`. boxes: (M, 4) float32 x0, y0,
    x1, y1, around the masks' pixels. labels: (M,) int64. masks: (M, H, W) uint8, 0 or 1."""

    image: Tensor
    boxes: Tensor
    labels: Tensor
    masks: Tensor

    def target(self, device: torch.device) -> dict[str, Tensor]:
        """As torchvision wants it."""
        parts = {"boxes": self.boxes, "labels": self.labels, "masks": self.masks}
        return {name: value.to(device) for name, value in parts.items()}


def make_sample(
    color: NDArray[np.uint8],
    depth_m: NDArray[np.float32],
    ids: NDArray[np.integer],
    class_ids: dict[int, int],
) -> MaskSample:
    """Of an image (H, W, 3) with depth and ids (H, W). class_ids: by gt_id."""
    gt_ids, counts = np.unique(ids, return_counts=True)
    gt_ids = gt_ids[(gt_ids > 0) & (counts >= MIN_PIXELS)]
    masks = ids[None] == gt_ids[:, None, None]
    boxes = np.array([_box(mask) for mask in masks], np.float32).reshape(-1, 4)
    labels = [class_ids[int(gt_id)] + FIRST_LABEL for gt_id in gt_ids]
    return MaskSample(
        image_tensor(color, depth_m),
        torch.from_numpy(boxes),
        torch.tensor(labels, dtype=torch.int64),
        torch.from_numpy(masks.astype(np.uint8)),
    )


def _box(mask: NDArray[np.bool_]) -> tuple[int, int, int, int]:
    columns, rows = np.flatnonzero(mask.any(axis=0)), np.flatnonzero(mask.any(axis=1))
    return columns[0], rows[0], columns[-1] + 1, rows[-1] + 1


def class_ids_of(scene: Scene) -> dict[int, int]:
    """By gt_id."""
    furniture = [int(gt_id) for gt_id in scene.gt_ids if gt_id]
    return {g: CLASS_NAMES.index(scene.shape_of(g).class_name) for g in furniture}


def samples_of_scene(scene: Scene, rng: np.random.Generator) -> Iterator[MaskSample]:
    """A few of its frames, in other light, half of them mirrored."""
    class_ids = class_ids_of(scene)
    count = min(FRAMES_PER_SCENE, scene.n_frames)
    for i in rng.choice(scene.n_frames, count, replace=False).tolist():
        rendered = scene.render(i)
        assert rendered.frame.color is not None
        color, depth_m, ids = rendered.frame.color, rendered.frame.depth_m, rendered.ids
        color = _relit(color, rng)
        if rng.random() < 0.5:
            color, depth_m, ids = color[:, ::-1], depth_m[:, ::-1], ids[:, ::-1]
        yield make_sample(color, depth_m, ids, class_ids)


def _relit(color: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """Another brightness, tint and contrast, and noise."""
    gain = rng.uniform(0.7, 1.3) * rng.uniform(0.9, 1.1, 3)
    noise = rng.normal(0, rng.uniform(0, 6), color.shape[:2])[..., None]
    bright = 255 * (color / 255) ** rng.uniform(0.8, 1.25)
    return np.clip(gain * bright + noise, 0, 255).astype(np.uint8)


class FrameStream(IterableDataset):
    """Endless batches of the `train` split. Worker w of n takes scenes start + k * n + w."""

    def __init__(
        self, batch_frames: int, start: int, seed: int, options: SceneOptions | None = None
    ) -> None:
        self.batch_frames, self.start, self.seed = batch_frames, start, seed
        self.options = options or SceneOptions()

    def __iter__(self) -> Iterator[list[MaskSample]]:
        info = get_worker_info()
        worker, n_workers = (info.id, info.num_workers) if info else (0, 1)
        index = self.start + worker
        rng = np.random.default_rng((self.seed, index))
        pool: list[MaskSample] = []
        while True:
            scene = generate_scene("train", index, self.options)
            pool.extend(samples_of_scene(scene, rng))
            index += n_workers
            while len(pool) >= max(POOL_FRAMES, self.batch_frames):
                yield [pool.pop(int(rng.integers(len(pool)))) for _ in range(self.batch_frames)]
