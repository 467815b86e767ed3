"""What the tests of training share: a hand-made batch of one block without symmetry, runs of a
tiny network."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from composenet.geometry.transform import make_T, rotation_z
from composenet.records import Box, ObjectFrameTruth, ObjectTruth, Symmetry
from composenet.training.config import TrainingConfig
from composenet.training.data import samples_of_scene
from composenet.training.disk import disk_scene
from composenet.training.loop import RunOptions
from composenet.training.processes import Group
from composenet.training.targets import TrainingBatch, collate_samples, make_sample
from composenet.volume.memory import FreeSpace
from composenet.volume.voxels import FEATURE_NAMES, Volume
from conftest import TINY

SIZE_M = 0.05
EXTENTS = np.array([0.6, 0.9, 1.2])

CONFIG = TrainingConfig(
    model=TINY, frames_per_scene=3, max_crops=3, rate_warmup_steps=1, joint_from_step=2
)
ALONE = Group(0, 1, torch.device("cpu"))


def bumpy_block() -> np.ndarray:
    """(64, 64, 64) occupancy without any symmetry."""
    filled = np.zeros((64, 64, 64), bool)
    filled[:, :, :32] = True
    filled[40:, :20, :] = True
    return filled


def volume_of(label: int = 3, quarter: float = 1.0) -> Volume:
    """A grid turned by quarters and shifted; 40 voxels, the first 30 on object `label`."""
    rng = np.random.default_rng(0)
    return Volume(
        coords=rng.permutation(np.indices((16, 16, 16)).reshape(3, -1).T)[:40].astype(np.int32),
        features=np.zeros((40, len(FEATURE_NAMES)), np.float32),
        labels=np.where(np.arange(40) < 30, label, 0).astype(np.int32),
        n_seen=40,
        free=FreeSpace.nothing(),
        shape=(32, 32, 32),
        voxel_size_m=SIZE_M,
        T_world_grid=make_T(np.round(rotation_z(quarter * np.pi / 2)), np.array([2.0, 1.0, -0.2])),
        depth_m=np.zeros((4, 4), np.float32),
        K=np.eye(3),
        T_camera_grid=np.eye(4),
    )


def one_object(symmetry: Symmetry = Symmetry.NONE, yaw: float = 0.4) -> TrainingBatch:
    """Two frames, the object in the second one; the first holds nothing."""
    T = make_T(rotation_z(yaw), np.array([1.6, 1.7, 0.5]))
    box = Box(T[:3, 3], np.abs(T[:3, :3]) @ EXTENTS)
    truth = ObjectTruth(3, 4, symmetry, EXTENTS, bumpy_block(), np.zeros((0, 3), np.float32))
    seen = ObjectFrameTruth(3, T, box, 500, 0.7)
    return collate_samples(
        [make_sample(volume_of(), [], []), make_sample(volume_of(), [truth], [seen])]
    )


def no_object() -> TrainingBatch:
    """Two frames in which nothing is."""
    return collate_samples([make_sample(volume_of(), [], [])] * 2)


def options(out: Path, **changes: object) -> RunOptions:
    """A run of three steps in this process."""
    plain = RunOptions(out, 5.0, max_steps=3, workers=0, threads=1, validation_scenes=1)
    return replace(plain, device="cpu", **changes)


def batch_of(recordings: Path, config: TrainingConfig = CONFIG) -> TrainingBatch:
    """A frame of each of the recordings."""
    rng = np.random.default_rng(0)
    samples = [next(samples_of_scene(disk_scene(recordings, i), config, rng)) for i in range(2)]
    return collate_samples(samples)
