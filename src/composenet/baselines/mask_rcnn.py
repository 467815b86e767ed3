"""Masks as Mask R-CNN sees them in colour and depth, for the baselines that are told nothing."""

from __future__ import annotations

from functools import cache
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from composenet.baselines.association import mask_iou
from composenet.baselines.records import InstanceMasks
from composenet.errors import DataError, WeightsError
from composenet.records import Frame

if TYPE_CHECKING:
    from torchvision.models.detection import MaskRCNN

NAME = "mask_rcnn.safetensors"
MIN_SCORE = 0.5
"""weaker detections are no furniture; what starts a track is up to the systems"""
DUPLICATE_IOU = 0.5
"""of two masks that overlap more than this, whatever their classes, the weaker is dropped:
torchvision suppresses doubles of one class only"""
MASK_THRESHOLD = 0.5


def mask_rcnn_weights() -> Path:
    """The weights shipped in the package. Raises WeightsError where they, or the optional package
    that runs them, are missing."""
    path = Path(str(resources.files("composenet") / "weights" / NAME))
    if not path.is_file():
        raise WeightsError(
            f"{path}: no Mask R-CNN weights; make them: python benchmarks/train_mask_rcnn.py "
            f"--out runs/mask_rcnn --max-minutes 60, then copy runs/mask_rcnn/{NAME} there "
            "(needs `pip install 'composenet[baselines]'`)"
        )
    from composenet.baselines.torchvision_ops import import_torchvision

    import_torchvision()
    return path


class MaskRcnnMasks:
    """The network as a source of masks. device: torch's name of it. Raises
    WeightsError where the weights cannot be used."""

    def __init__(self, weights: Path | None = None, *, device: str = "cpu") -> None:
        self._network = _network(weights or mask_rcnn_weights(), device)

    def __call__(self, frame: Frame) -> InstanceMasks:
        """What the systems are given, strongest first. Raises DataError for a frame without
        colour."""
        return distinct(self.detections(frame))

    def detections(self, frame: Frame) -> InstanceMasks:
        """All that the network says, strongest first. Raises DataError."""
        from composenet.baselines.mask_rcnn_network import FIRST_LABEL, detect, image_tensor

        if frame.color is None:
            raise DataError(
                f"frame {frame.name or frame.index}: Mask R-CNN needs colour images, "
                "this recording has none; choose other --methods"
            )
        found = detect(self._network, image_tensor(frame.color, frame.depth_m))
        return InstanceMasks(
            masks=(found["masks"][:, 0] > MASK_THRESHOLD).numpy(),
            class_ids=found["labels"].numpy() - FIRST_LABEL,
            scores=found["scores"].numpy(),
        )


def mask_rcnn_masks(_folder: Path, device: str) -> MaskRcnnMasks:
    """The shipped network, whatever the sequence."""
    return MaskRcnnMasks(device=device)


def distinct(found: InstanceMasks) -> InstanceMasks:
    """The certain masks that show something no stronger one shows, strongest first."""
    overlap = mask_iou(found.masks, found.masks)
    kept: list[int] = []
    for i in np.argsort(-found.scores, kind="stable").tolist():
        certain = found.scores[i] >= MIN_SCORE and found.masks[i].any()
        if certain and not (overlap[i, kept] > DUPLICATE_IOU).any():
            kept.append(i)
    return InstanceMasks(found.masks[kept], found.class_ids[kept], found.scores[kept])


def frames_learned() -> int:
    """How many frames the weights shipped in the package have learned from."""
    from composenet.baselines.mask_rcnn_network import load_network

    return int(load_network(mask_rcnn_weights())[1]["frames"])


@cache
def _network(weights: Path, device: str) -> MaskRCNN:
    """Read once a process, with one thread on the CPU: sequences run in parallel processes."""
    import torch

    from composenet.baselines.mask_rcnn_network import load_network

    torch.set_num_threads(1)
    return load_network(weights, device)[0]
