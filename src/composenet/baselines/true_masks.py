"""The true masks and identities of a generated sequence, for the baselines whose name says GT."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from composenet.baselines.records import InstanceMasks
from composenet.errors import DataError
from composenet.geometry.camera import subsampled
from composenet.records import Frame
from composenet.synth.sequence_folder import read_truth


class TrueMasks:
    """Reads `instance/NAME.png` of a sequence folder, a frame at a time. Raises DataError."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._class_ids = {item.gt_id: item.class_id for item in read_truth(folder).objects}

    def __call__(self, frame: Frame) -> InstanceMasks:
        """One mask for every object that has a pixel in the frame, by gt_id."""
        ids = self._read(frame)
        gt_ids = np.array([i for i in np.unique(ids).tolist() if i in self._class_ids], np.int64)
        return InstanceMasks(
            masks=ids[None] == gt_ids[:, None, None],
            class_ids=np.array([self._class_ids[i] for i in gt_ids.tolist()], dtype=np.int64),
            scores=np.ones(len(gt_ids), dtype=np.float32),
            gt_ids=gt_ids,
        )

    def _read(self, frame: Frame) -> NDArray[np.int64]:
        """(H, W) ids at the pixels of the frame's depth image."""
        path = self._folder / "instance" / f"{frame.name}.png"
        try:
            with Image.open(path) as image:
                ids = np.array(image).astype(np.int64)
        except OSError as error:
            raise DataError(f"{path}: no readable instance image ({error})") from None
        factor = max(1, round(ids.shape[1] / frame.camera.width))
        ids = subsampled(ids, factor)
        if ids.shape != frame.depth_m.shape:
            raise DataError(
                f"{path}: {ids.shape[1]}x{ids.shape[0]} ids for depth of "
                f"{frame.camera.width}x{frame.camera.height}; write the sequence again"
            )
        return ids


def true_masks(folder: Path, _device: str) -> TrueMasks:
    """For a row: no network, so no device."""
    return TrueMasks(folder)
