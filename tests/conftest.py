"""What several test files share: short sequences on disk and a network too small to be good."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
from hypothesis import settings

from composenet.config import Config, DetectionConfig, NetworkConfig, TrackingConfig, VolumeConfig

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before torch comes in: others compute, too
settings.register_profile("any machine", deadline=None)  # a busy machine is no wrong answer
settings.load_profile("any machine")
signal.signal(signal.SIGINT, signal.default_int_handler)  # shells ignore it for what runs behind

TINY = Config(
    volume=VolumeConfig(voxel_size_m=0.15),
    network=NetworkConfig(
        backbone_channels=(4, 4, 6, 6, 8),
        object_channels=(4, 6, 8),
        crop_cells=16,
        occupancy_threshold=0.05,
    ),
    detection=DetectionConfig(
        min_cluster_voxels=5, objectness_threshold=0.1, min_score=0.1, max_proposals=3
    ),
    tracking=TrackingConfig(  # tracks that break, so that looking back has something to join
        min_score=0.0,
        min_birth_score=0.0,
        min_confidence=0.0,
        keep_confidence=0.0,
        same_class_iou_gate=0.3,
    ),
)


@pytest.fixture(scope="session")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of two generated sequences of 6 frames, 160x120."""
    from composenet.synth.dataset import write_split
    from composenet.synth.scene import SceneOptions

    out = tmp_path_factory.mktemp("recordings")
    write_split("val", 2, out, 0, SceneOptions(frames=6, image_size=(160, 120)))
    return out


@pytest.fixture(scope="session")
def tiny_weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Weights of a tiny network that has learned nothing."""
    import torch

    from composenet.network.model import ComposeNet
    from composenet.network.weights import save_weights

    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("weights") / "tiny.safetensors"
    save_weights(ComposeNet(TINY.network, TINY.volume), TINY, path, {"steps": 0})
    return path
