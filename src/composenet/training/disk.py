"""Sequences written by `composenet synth`, with the interface of a generated scene."""

from __future__ import annotations

import math
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from composenet.errors import DataError
from composenet.geometry.camera import subsample_camera, subsampled
from composenet.records import Box, Camera, Frame, ObjectFrameTruth, ObjectTruth, SequenceTruth
from composenet.sequences.options import SequenceOptions
from composenet.synth.scene import SPLITS, RenderedFrame
from composenet.synth.sequence_folder import UNTOLD, annotated_folders, read_split, read_truth
from composenet.training.targets import UNKNOWN


class DiskScene:
    """One sequence folder. Reads a frame when asked for it. Raises DataError."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @cached_property
    def truth(self) -> SequenceTruth:
        """All of the ground truth."""
        return read_truth(self.folder)

    @property
    def n_frames(self) -> int:
        """Length of the sequence."""
        return len(self.truth.frames)

    def render(self, i: int, *, color: bool = False) -> RenderedFrame:
        """Frame i as tracking sees it: subsampled where it is wide (colour is not read: the network
        does not use it). Its ids are UNKNOWN where nobody can tell."""
        try:
            depth_m = np.asarray(Image.open(self.folder / "depth" / f"{i}.png")) / np.float32(1000)
            ids = np.asarray(Image.open(self.folder / "instance" / f"{i}.png")).astype(np.int32)
            T_world_camera = np.loadtxt(self.folder / "pose" / f"{i}.txt")
            K = np.loadtxt(self.folder / "intrinsic" / "intrinsic_depth.txt")[:3, :3]
        except (OSError, ValueError) as error:
            raise DataError(f"{self.folder}, frame {i}: cannot be read ({error})") from None
        ids = np.where(ids == UNTOLD, UNKNOWN, ids)
        camera = Camera(K, depth_m.shape[1], depth_m.shape[0])
        factor = math.ceil(camera.width / SequenceOptions.max_width)
        depth_m, ids = subsampled(depth_m, factor), subsampled(ids, factor)
        camera = subsample_camera(camera, factor)
        frame = Frame(i, depth_m.astype(np.float32), camera, T_world_camera)
        return RenderedFrame(frame, ids, frame.depth_m)

    def frame_truth(
        self, i: int, ids: NDArray[np.integer], fractions: bool = True
    ) -> tuple[ObjectFrameTruth, ...]:
        """Ground truth of frame i, as it was written."""
        return self.truth.frames[i]

    def others(self, i: int) -> tuple[Box, ...]:
        """None: nothing on disk tells of what is no furniture."""
        return ()

    def object_truth(self, gt_id: int, solid: bool = True) -> ObjectTruth:
        """Ground truth of one object, as it was written."""
        return next(item for item in self.truth.objects if item.gt_id == gt_id)


def other_splits(data_dir: Path) -> list[str]:
    """Splits of the generator, but for `train`, that sequences of a folder are of: what is learned
    from them cannot be measured on them. Raises DataError."""
    found = {read_split(path) for path in annotated_folders(data_dir)}
    return sorted(found & {*SPLITS} - {"train"})


def disk_scene(data_dir: Path, index: int) -> DiskScene:
    """Sequence `index` of a folder, endlessly repeated; what was read of the last few is kept.
    Raises DataError for an empty folder."""
    folders = annotated_folders(data_dir)
    if not folders:
        raise DataError(f"{data_dir}: no sequences here; write some with `composenet synth`")
    return _kept(folders[index % len(folders)])


_kept = lru_cache(maxsize=16)(DiskScene)
