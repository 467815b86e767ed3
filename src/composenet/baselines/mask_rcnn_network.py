"""The Mask R-CNN of the comparison systems, of torchvision's parts, and its weights file.

He et al., ICCV 2017, with a feature pyramid (Lin et al., CVPR 2017). What differs from
torchvision's `maskrcnn_resnet50_fpn`, so that it can be trained from nothing on one core:

- a narrow ResNet of 18 layers, its stem without pooling's 7x7, group normalisation throughout
  (batches are small); pyramid from stride 8 on, 64 channels;
- beside the colours it is given disparity, of which a plane is a linear function: with colour alone
  far more frames are needed to learn where objects end (the systems' papers give it colour alone,
  so this is to their advantage);
- anchors for images of 320x240, fewer proposals, two mask convolutions instead of four.
"""

from __future__ import annotations

import json
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import ConfigDict
from pydantic.dataclasses import dataclass
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor, nn

from composenet.baselines.torchvision_ops import import_torchvision
from composenet.config import Count, from_dict, to_dict
from composenet.errors import ComposenetError, WeightsError
from composenet.files import write_atomic
from composenet.records import CLASS_NAMES

import_torchvision()

from torchvision.models.detection import MaskRCNN  # noqa: E402
from torchvision.models.detection.anchor_utils import AnchorGenerator  # noqa: E402
from torchvision.models.detection.backbone_utils import BackboneWithFPN  # noqa: E402
from torchvision.models.detection.faster_rcnn import FastRCNNPredictor, TwoMLPHead  # noqa: E402
from torchvision.models.detection.mask_rcnn import MaskRCNNHeads, MaskRCNNPredictor  # noqa: E402
from torchvision.models.resnet import BasicBlock  # noqa: E402
from torchvision.ops import MultiScaleRoIAlign  # noqa: E402
from torchvision.ops.feature_pyramid_network import LastLevelMaxPool  # noqa: E402

FORMAT = "composenet.mask_rcnn/2"
ANCHORS_PX = ((16, 26), (40, 60), (90, 130), (180, 260))
"""sides, at strides 8, 16, 32 and 64"""
FINEST_STRIDE = 8
"""of the pyramid"""
NEAREST_M = 0.5
FIRST_LABEL = 1
"""torchvision's label of class 0; label 0 is no furniture"""


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class MaskRcnnConfig:
    """Sizes of the network."""

    channels: tuple[Count, Count, Count, Count] = (32, 64, 128, 192)
    """of the residual stages at strides 4, 8, 16, 32; multiples of 8"""
    pyramid_channels: Count = 64
    box_channels: Count = 256
    image_size: tuple[Count, Count] = (320, 240)
    """width, height: what images are resized to, their shape kept"""


def make_network(config: MaskRcnnConfig) -> MaskRCNN:
    """The network, untrained. It takes a list of (4, H, W) images (see `image_tensor`) and, in
    training, a list of targets; see torchvision's `MaskRCNN`."""
    n_classes = FIRST_LABEL + len(CLASS_NAMES)
    pyramid, width = config.pyramid_channels, config.box_channels
    levels = ["0", "1", "2"]
    return MaskRCNN(
        _backbone(config),
        min_size=min(config.image_size),
        max_size=max(config.image_size),
        image_mean=[0.45, 0.45, 0.45, 0.2],
        image_std=[0.25, 0.25, 0.25, 0.15],
        rpn_anchor_generator=AnchorGenerator(ANCHORS_PX, ((0.5, 1.0, 2.0),) * len(ANCHORS_PX)),
        rpn_pre_nms_top_n_train=400,
        rpn_pre_nms_top_n_test=400,
        rpn_post_nms_top_n_train=200,
        rpn_post_nms_top_n_test=150,
        box_roi_pool=MultiScaleRoIAlign(levels, 7, 2, canonical_scale=112),
        box_head=TwoMLPHead(pyramid * 49, width),
        box_predictor=FastRCNNPredictor(width, n_classes),
        box_batch_size_per_image=48,
        box_positive_fraction=0.33,
        box_detections_per_img=30,
        mask_roi_pool=MultiScaleRoIAlign(levels, 14, 2),
        mask_head=MaskRCNNHeads(pyramid, (pyramid, pyramid), 1),
        mask_predictor=MaskRCNNPredictor(pyramid, pyramid, n_classes),
    )


def _backbone(config: MaskRcnnConfig) -> BackboneWithFPN:
    """A ResNet of two blocks a stage under a pyramid."""
    a, b, c, d = config.channels
    stem = nn.Sequential(
        nn.Conv2d(4, a // 2, 3, stride=2, padding=1, bias=False),
        _norm(a // 2),
        nn.ReLU(inplace=True),
    )
    stages: OrderedDict[str, nn.Module] = OrderedDict(
        stem=stem,
        stride4=_stage(a // 2, a),
        stride8=_stage(a, b),
        stride16=_stage(b, c),
        stride32=_stage(c, d),
    )
    return BackboneWithFPN(
        nn.Sequential(stages),
        {"stride8": "0", "stride16": "1", "stride32": "2"},
        [b, c, d],
        config.pyramid_channels,
        LastLevelMaxPool(),
    )


def _stage(n_in: int, n_out: int) -> nn.Sequential:
    """Two residual blocks, the first of stride 2."""
    shortcut = nn.Sequential(nn.Conv2d(n_in, n_out, 1, stride=2, bias=False), _norm(n_out))
    return nn.Sequential(
        BasicBlock(n_in, n_out, 2, shortcut, norm_layer=_norm),
        BasicBlock(n_out, n_out, norm_layer=_norm),
    )


def _norm(channels: int) -> nn.GroupNorm:
    return nn.GroupNorm(max(1, channels // 8), channels)


def image_tensor(color: NDArray[np.uint8], depth_m: NDArray[np.float32]) -> Tensor:
    """(4, H, W) float32 in 0..1: red, green, blue, and disparity, which is 1 up to NEAREST_M and 0
    where no depth is. color: (H, W, 3). depth_m: (H, W), 0 where unknown."""
    known = depth_m > 0
    disparity = np.where(known, NEAREST_M / np.where(known, depth_m, 1.0), 0.0).clip(0, 1)
    channels = np.dstack([color.astype(np.float32) / 255, disparity.astype(np.float32)])
    return torch.from_numpy(np.ascontiguousarray(channels.transpose(2, 0, 1)))


@torch.inference_mode()
def detect(network: MaskRCNN, image: Tensor) -> dict[str, Tensor]:
    """torchvision's detections in one image (see `image_tensor`), strongest first: boxes (M, 4),
    labels and scores (M,), masks (M, 1, H, W) in 0..1. On the CPU."""
    found = network([image.to(next(network.parameters()).device)])[0]
    return {name: value.cpu() for name, value in found.items()}


def save_network(
    network: MaskRCNN, config: MaskRcnnConfig, path: Path, notes: dict[str, Any]
) -> None:
    """Write atomically, in half precision, with the configuration inside."""
    tensors = {
        name: value.detach().cpu().half().contiguous()
        for name, value in network.state_dict().items()
    }
    metadata = {
        "format": FORMAT,
        "config": json.dumps(to_dict(config)),
        "notes": json.dumps(notes),
    }
    write_atomic(path, save(tensors, metadata))


def load_network(path: Path, device: torch.device | str = "cpu") -> tuple[MaskRCNN, dict[str, Any]]:
    """Network (evaluation mode) and notes. Raises WeightsError where the file is missing, corrupt,
    foreign, or does not fit."""
    if not path.is_file():
        raise WeightsError(f"{path}: no such weights file")
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name).float() for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError, ValueError) as error:
        raise WeightsError(f"{path}: not a readable safetensors file ({error})") from None
    if metadata.get("format") != FORMAT:
        found = metadata.get("format")
        raise WeightsError(f"{path}: expected {FORMAT!r} weights, found {found!r}")
    try:
        network = make_network(from_dict(json.loads(metadata["config"]), MaskRcnnConfig))
        network.load_state_dict(tensors)
        notes = json.loads(metadata["notes"])
    except (KeyError, ValueError, RuntimeError, ComposenetError) as error:
        reason = " ".join(str(error).split())[:200]
        raise WeightsError(
            f"{path}: the weights do not fit their configuration ({reason})"
        ) from None
    return network.to(device).eval(), notes
