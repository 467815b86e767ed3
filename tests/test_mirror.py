"""The scene and its mirror image: what they say of each other."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from composenet.config import Config, NetworkConfig
from composenet.detection import propose, second_look
from composenet.network.batch import VolumeBatch
from composenet.network.mirror import Mirror
from composenet.network.model import ComposeNet
from composenet.volume.memory import FREE_CELL_M
from composenet.volume.voxels import FEATURE_NAMES

SIZE_M = 0.05
SIDEWAYS = [FEATURE_NAMES.index(name) for name in ("offset_y", "normal_y", "view_y")]


@pytest.fixture(scope="module")
def network() -> ComposeNet:
    torch.manual_seed(0)
    sizes = NetworkConfig(backbone_channels=(4, 4, 6, 6, 8), object_channels=(4, 6, 8))
    network = ComposeNet(sizes, Config().volume).eval()
    for parameter in network.boxes.box.parameters():  # its last layer starts at zero
        torch.nn.init.normal_(parameter, std=0.1)
    return network


def scene() -> VolumeBatch:
    """Voxels of two frames, scattered over 32 x 31 x 20 of them; a camera at the edge that looks
    along x."""
    g = torch.Generator().manual_seed(0)
    sites = torch.rand(600, 4, generator=g) * torch.tensor([2, 32, 31, 20])
    edges = torch.tensor([[0, 0, 0, 0], [0, 31, 30, 19], [1, 0, 0, 0], [1, 31, 30, 19]])
    coords = torch.unique(torch.cat([sites.long(), edges]), dim=0)
    T_camera_grid = torch.tensor([[0.0, -1, 0, 0.7], [0, 0, -1, 0.5], [1, 0, 0, 0.1], [0, 0, 0, 1]])
    K = torch.tensor([[3.0, 0, 2.5], [0, 3.0, 2.5], [0, 0, 1]])
    return VolumeBatch(
        coords=coords,
        features=torch.randn(len(coords), len(FEATURE_NAMES), generator=g),
        remembered=torch.zeros(len(coords), dtype=torch.bool),
        free=torch.rand(2, 17, 13, 9, generator=g) < 0.5,
        free_low=torch.rand(2, 3, generator=g) - 0.7,
        depth_m=2 * torch.rand(2, 6, 6, generator=g),
        K=K.expand(2, 3, 3),
        T_camera_grid=T_camera_grid.expand(2, 4, 4),
        floor_z=torch.tensor([-0.1, 0.2]),
        voxel_size_m=SIZE_M,
    )


def mirrored(batch: VolumeBatch) -> VolumeBatch:
    """The scene in a mirror, same rows."""
    coords, features = batch.coords.clone(), batch.features.clone()
    coords[:, 2] = 30 - coords[:, 2]
    features[:, SIDEWAYS] = -features[:, SIDEWAYS]
    image = torch.diag(torch.tensor([1.0, -1.0, 1.0, 1.0]))
    image[1, 3] = 30 * SIZE_M
    low = batch.free_low.clone()
    low[:, 1] = 30 * SIZE_M - low[:, 1] - 13 * FREE_CELL_M
    return replace(
        batch, coords=coords, features=features, free=batch.free.flip(2), free_low=low,
        T_camera_grid=batch.T_camera_grid @ image,
    )  # fmt: skip


def flip(points: torch.Tensor, width: float) -> torch.Tensor:
    return torch.stack([points[:, 0], width - points[:, 1], points[:, 2]], dim=1)


@torch.no_grad()
def test_a_mirrored_scene_gets_mirrored_answers(network: ComposeNet) -> None:
    found = []
    centers = torch.tensor([[0.8, 0.4, 0.3], [0.3, 1.1, 0.6], [1.2, 0.7, 0.5]])
    extents, frame = torch.full((3, 3), 0.6), torch.tensor([0, 1, 1])
    for batch, at in ((scene(), centers), (mirrored(scene()), flip(centers, 30 * SIZE_M))):
        alone = network.voxel_fields(batch)
        fields, mirror = Mirror.of(network, batch).agreed(alone)
        assert not torch.allclose(alone.objectness, fields.objectness, atol=1e-4)
        torch.testing.assert_close(fields.features, alone.features)
        boxes = mirror.box_fields(network, at, extents, frame)
        own = network.box_fields(fields, batch, at, extents, frame)
        found.append((fields, own, boxes))
    (fields, own, image), (other_fields, other_own, other_image) = found
    torch.testing.assert_close(fields.objectness, other_fields.objectness)
    torch.testing.assert_close(fields.center_offset, flip(other_fields.center_offset, 0.0))
    torch.testing.assert_close(fields.class_logits, other_fields.class_logits)
    # The image's look at a box of the scene is the mirrored scene's own look at its image.
    torch.testing.assert_close(image.center, flip(other_own.center, 30 * SIZE_M))
    torch.testing.assert_close(own.center, flip(other_image.center, 30 * SIZE_M))
    torch.testing.assert_close(image.quality, other_own.quality)
    assert not torch.allclose(own.center, image.center, atol=1e-4)


@torch.no_grad()
def test_proposals_of_a_mirrored_scene_are_mirrored(network: ComposeNet) -> None:
    config = replace(
        Config().detection,
        objectness_threshold=0.0,
        min_score=0.0,
        min_cluster_voxels=1,
        duplicate_iou=1.0,  # which of two is dropped may hang on the last digit
    )
    found = []
    for batch in (scene(), mirrored(scene())):
        fields, mirror = Mirror.of(network, batch).agreed(network.voxel_fields(batch))
        spread = replace(fields, center_offset=0.2 * fields.center_offset)
        voted = propose(spread, batch, config)
        found.append(second_look(network, fields, batch, voted, config, mirror))
    for one, other in zip(*found, strict=True):
        assert len(one.center) and len(other.center)
        # Bins of the mean shift are not symmetric, so compare what both found.
        gap = torch.cdist(one.center, flip(other.center, 30 * SIZE_M)).amin(dim=1)
        assert gap.median() < 0.1
