"""What the depth image shows of a box: places, relief, boxes it cannot see."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from composenet.network.batch import VolumeBatch
from composenet.network.box_view import N_VIEW_CHANNELS, VIEW_PIXELS, BoxView, view_inputs
from composenet.volume.voxels import FEATURE_NAMES

EYE = torch.tensor([0.2, 1.5, 1.0])
PLACE, INSIDE, KNOWN, RELIEF, DEPTH = slice(0, 3), 3, 4, 5, 6


def looking_along_x(depth_m: np.ndarray) -> VolumeBatch:
    """Frames (B, H, W) of a camera at EYE that looks along the grid's x, 60 degrees wide."""
    depth = torch.as_tensor(depth_m, dtype=torch.float32)
    count, height, width = depth.shape
    focal = width / 2 / np.tan(np.radians(30))
    K = torch.tensor([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1.0]])
    T = torch.eye(4)
    T[:3, :3] = torch.tensor([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
    T[:3, 3] = -T[:3, :3] @ EYE
    return VolumeBatch(
        coords=torch.zeros(1, 4, dtype=torch.long),
        features=torch.zeros(1, len(FEATURE_NAMES)),
        remembered=torch.zeros(1, dtype=torch.bool),
        free=torch.zeros(count, 1, 1, 1, dtype=torch.bool),
        free_low=torch.zeros(count, 3),
        depth_m=depth,
        K=K.float().expand(count, 3, 3),
        T_camera_grid=T.expand(count, 4, 4),
        floor_z=torch.zeros(count),
        voxel_size_m=0.05,
    )


def wall(distance_m: float = 2.0, width: int = 320) -> np.ndarray:
    """(1, H, W) depth of a wall the camera faces."""
    return np.full((1, width * 3 // 4, width), distance_m, np.float32)


def look(
    batch: VolumeBatch, center: list[float], extents: list[float], frame: int = 0
) -> torch.Tensor:
    """The view of one box."""
    boxes = (torch.tensor([frame]), torch.tensor([center]), torch.tensor([extents]))
    return view_inputs(batch, *boxes)[0]


def test_a_pixel_knows_its_place_in_the_box() -> None:
    # A box half a metre deep whose front lies in the wall, centred on the line of sight.
    seen = look(looking_along_x(wall()), [2.2 + 0.25, 1.5, 1.0], [0.5, 0.6, 0.6])
    assert seen.shape == (N_VIEW_CHANNELS, VIEW_PIXELS, VIEW_PIXELS)
    torch.testing.assert_close(seen[0], torch.full_like(seen[0], -1.0))  # the front side
    left, right = seen[1, :, 0].mean(), seen[1, :, -1].mean()  # +y is to the left of +x
    assert left > 1.0 > -1.0 > right and abs(left + right) < 0.05
    top, bottom = seen[2, 0].mean(), seen[2, -1].mean()
    assert top > 1.0 > -1.0 > bottom and abs(top + bottom) < 0.05
    assert (seen[INSIDE] == (seen[PLACE].abs() <= 1.1).all(dim=0)).all()
    assert 0.4 < seen[INSIDE].mean() < 1.0
    assert (seen[KNOWN] == 1).all() and torch.allclose(seen[DEPTH], torch.tensor(0.5))
    assert (seen[RELIEF].abs() < 1e-4).all()


def test_what_stands_out_by_a_centimetre_is_seen() -> None:
    depth = wall()
    depth[:, 100:140, 150:170] -= 0.012  # a door or a handle
    seen = look(looking_along_x(depth), [2.3, 1.5, 1.0], [0.3, 0.8, 0.8])
    middle = seen[RELIEF][13:19, 14:18]
    assert middle.amin() < -0.08  # nearer than its surroundings
    assert seen[RELIEF][:, :6].abs().amax() < 1e-4


def test_the_resolution_of_the_image_hardly_matters() -> None:
    def step(width: int) -> np.ndarray:
        depth = wall(2.0, width)
        depth[:, :, : width // 2] = 2.3
        return depth

    views = [
        look(looking_along_x(step(width)), [2.4, 1.55, 1.0], [0.6, 0.8, 0.7])
        for width in (320, 640)
    ]
    assert (views[0] - views[1]).abs().mean() < 0.02


def test_each_box_is_seen_in_its_own_frame() -> None:
    batch = looking_along_x(np.concatenate([wall(2.0), wall(3.0)]))
    near, far = (look(batch, [2.4, 1.5, 1.0], [0.5, 0.5, 0.5], frame) for frame in (0, 1))
    assert torch.allclose(near[DEPTH], torch.tensor(0.5))
    assert torch.allclose(far[DEPTH], torch.tensor(0.75))


def test_without_depth_nothing_is_known() -> None:
    seen = look(looking_along_x(wall(0.0)), [2.4, 1.5, 1.0], [0.5, 0.5, 0.5])
    assert (seen == 0).all()


@given(st.lists(st.floats(-6, 6), min_size=3, max_size=3), st.floats(0.15, 5.0))
def test_any_box_gives_numbers(center: list[float], side: float) -> None:
    """Behind the camera, around it, beside the image: finite, and inside only what is inside."""
    seen = look(looking_along_x(wall(2.0, 64)), center, [side, side, side])
    assert torch.isfinite(seen).all()
    assert (seen[PLACE].abs() <= 2).all() and (seen[RELIEF].abs() <= 1).all()
    if center[0] + side < 1.0:  # the wall is at x = 2.2
        assert not seen[INSIDE].any()


def test_boxes_do_not_disturb_each_other() -> None:
    torch.manual_seed(0)
    net = BoxView(16)
    batch = looking_along_x(wall())
    centers, extents = torch.rand(5, 3) + torch.tensor([1.8, 1.0, 0.5]), torch.rand(5, 3) + 0.2
    frame = torch.zeros(5, dtype=torch.long)
    together = net(batch, frame, centers, extents)
    assert together.shape == (5, 16)
    for i in range(5):
        alone = net(batch, frame[i : i + 1], centers[i : i + 1], extents[i : i + 1])
        torch.testing.assert_close(together[i : i + 1], alone, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("count", [0, 3])
def test_gradients_reach_every_layer(count: int) -> None:
    torch.manual_seed(0)
    net = BoxView(8)
    where = torch.tensor([[2.3, 1.5, 1.0], [2.2, 1.2, 0.9], [2.6, 1.9, 1.2]])[:count]
    frame = torch.zeros(count, dtype=torch.long)
    seen = net(looking_along_x(wall()), frame, where, torch.full((count, 3), 0.6))
    (seen * torch.randn(8)).sum().backward()
    gradients = [parameter.grad for parameter in net.parameters()]
    assert all(g is not None and torch.isfinite(g).all() for g in gradients)
    assert count == 0 or all(g.abs().sum() > 0 for g in gradients if g is not None)
