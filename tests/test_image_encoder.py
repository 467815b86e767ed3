"""What the images say of voxels: the right pixels, mirror images, what cannot be seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from camera_cases import EYE, looking_along_x, painted, wall
from composenet.network.batch import VolumeBatch
from composenet.network.image_encoder import CELL_PIXELS, ImageEncoder, image_inputs, places
from composenet.network.model import ComposeNet
from composenet.volume.voxels import FEATURE_NAMES
from conftest import TINY


def with_voxels(batch: VolumeBatch, coords: torch.Tensor) -> VolumeBatch:
    """The batch with voxels at rows of (frame, x, y, z)."""
    none = torch.zeros(len(coords), dtype=torch.bool)
    features = torch.zeros(len(coords), len(FEATURE_NAMES))
    return replace(batch, coords=coords, features=features, remembered=none)


def scattered(batch: VolumeBatch, count: int = 200, seed: int = 0) -> VolumeBatch:
    """With voxels anywhere in a room 4 m wide and deep."""
    g = torch.Generator().manual_seed(seed)
    coords = torch.rand(count, 4, generator=g) * torch.tensor([batch.size, 80, 80, 50])
    return with_voxels(batch, torch.unique(coords.long(), dim=0))


def voxel_at(point: list[float], size_m: float = 0.05) -> torch.Tensor:
    return torch.tensor([[0, *(round(x / size_m) for x in point)]])


@pytest.mark.parametrize("width", [320, 640, 641])
def test_a_voxel_takes_what_its_pixel_shows(width: int) -> None:
    batch = looking_along_x(wall(2.0, width))
    batch = with_voxels(batch, voxel_at([2.2, 1.0, 1.5]))  # half a metre right of the eye and up
    step = width // 320
    focal = width / 2 / np.tan(np.radians(30))
    u, v = ((width - 1) / 2 + focal / 4, (width * 3 // 4 - 1) / 2 - focal / 4)
    at = places(batch, width // step)[0]
    expected = [(u + 0.5) / step - 0.5, (v + 0.5) / step - 0.5]
    torch.testing.assert_close(at, torch.tensor(expected).float(), atol=1e-3, rtol=0)


def test_features_are_lifted_between_cells() -> None:
    """Features that are columns and rows of the image are where the voxels lie."""
    batch = scattered(looking_along_x(wall()))
    v, u = torch.meshgrid(torch.arange(60.0), torch.arange(80.0), indexing="ij")
    lifted = ImageEncoder()._lifted(CELL_PIXELS * torch.stack([u, v])[None], batch, 320)
    at = places(batch, 320)
    inside = (at >= 0).all(dim=1) & (at <= torch.tensor([316, 236])).all(dim=1)
    inside &= batch.coords[:, 1] * 0.05 > EYE[0]
    assert 20 < inside.sum() < len(at)
    torch.testing.assert_close(lifted[inside], at[inside], atol=1e-2, rtol=0)


def test_what_the_inputs_are() -> None:
    batch = painted(looking_along_x(wall()))
    expected = batch.color.permute(0, 3, 1, 2) / 127.5 - 1
    torch.testing.assert_close(image_inputs(batch), expected)
    assert image_inputs(looking_along_x(wall())).abs().amax() < 0.01
    larger = painted(looking_along_x(wall(2.0, 640)))
    means = larger.color.view(1, 240, 2, 320, 2, 3).float().mean(dim=(2, 4)).permute(0, 3, 1, 2)
    torch.testing.assert_close(image_inputs(larger), means / 127.5 - 1)


def in_a_mirror(batch: VolumeBatch) -> VolumeBatch:
    """The same voxels and images, seen as an image in a mirror across y."""
    image = torch.diag(torch.tensor([1.0, -1.0, 1.0, 1.0]))
    image[1, 3] = 4.0
    coords = batch.coords.clone()
    coords[:, 2] = 80 - coords[:, 2]
    return replace(batch, coords=coords, T_camera_grid=batch.T_camera_grid @ image)


def turned_round(batch: VolumeBatch) -> VolumeBatch:
    """What a camera films of a room that is a mirror image across y."""
    across = torch.diag(torch.tensor([-1.0, 1.0, 1.0, 1.0]))  # the principal point is central
    image = in_a_mirror(batch)
    return replace(
        image,
        T_camera_grid=across @ image.T_camera_grid,
        depth_m=batch.depth_m.flip(2),
        color=batch.color.flip(2),
    )


@torch.no_grad()
def test_a_mirror_image_is_seen_as_if_it_had_been_filmed() -> None:
    torch.manual_seed(0)
    depth = np.concatenate([wall(), wall(3.0)])
    depth[:, 100:, 50:90] = 1.2
    batch = scattered(painted(looking_along_x(depth)))
    encoder = ImageEncoder()
    filmed = encoder(turned_round(batch))
    assert filmed.std() > 0.1
    torch.testing.assert_close(encoder(in_a_mirror(batch)), filmed, atol=1e-4, rtol=1e-4)


@torch.no_grad()
def test_frames_do_not_disturb_each_other_and_memories_have_no_pixels() -> None:
    torch.manual_seed(0)
    batch = scattered(painted(looking_along_x(np.concatenate([wall(), wall(3.0)]))))
    remembered = torch.arange(len(batch.coords)) % 3 == 0
    batch = replace(batch, remembered=remembered)
    encoder = ImageEncoder()
    together = encoder(batch)
    assert (together[remembered] == 0).all() and (together[~remembered].abs().sum(dim=1) > 0).all()
    for i in (0, 1):
        rows = batch.coords[:, 0] == i
        coords = batch.coords[rows].clone()
        coords[:, 0] = 0
        names = ("depth_m", "color", "K", "T_camera_grid", "free", "free_low", "floor_z")
        one = {name: getattr(batch, name)[i : i + 1] for name in names}
        alone = replace(with_voxels(batch, coords), remembered=remembered[rows], **one)
        torch.testing.assert_close(encoder(alone), together[rows], atol=1e-5, rtol=1e-5)


@given(st.integers(3, 40), st.integers(3, 40), st.integers(0, 99))
def test_any_image_gives_numbers(height: int, width: int, seed: int) -> None:
    """Tiny images, no depth, voxels behind the camera."""
    depth = np.random.default_rng(seed).uniform(-1, 3, (1, height, width)).clip(0)
    batch = scattered(looking_along_x(depth), 30, seed)
    assert torch.isfinite(ImageEncoder()(batch)).all()


def test_gradients_reach_every_layer() -> None:
    torch.manual_seed(0)
    encoder = ImageEncoder()
    said = encoder(scattered(painted(looking_along_x(wall()))))
    (said * torch.randn(encoder.c_out)).sum().backward()
    gradients = [parameter.grad for parameter in encoder.parameters()]
    assert all(g is not None and torch.isfinite(g).all() and g.abs().sum() > 0 for g in gradients)


@torch.no_grad()
def test_every_voxel_hears_of_the_images() -> None:
    torch.manual_seed(0)
    network = ComposeNet(TINY.network, TINY.volume).eval()
    batch = scattered(painted(looking_along_x(wall())))
    other = replace(batch, color=batch.color.flip(2))
    said, elsewise = (network.voxel_fields(b).class_logits for b in (batch, other))
    assert ((said - elsewise).abs().amax(dim=1) > 0).float().mean() > 0.9
    for layer in (network.backbone.image_in, network.backbone.image_out):
        assert layer is not None
        layer.weight.zero_()
    torch.testing.assert_close(*(network.voxel_fields(b).class_logits for b in (batch, other)))
