import pytest
import torch
from torch import nn

from composenet.network.backbone import Backbone
from composenet.network.sparse import (
    OFFSETS,
    Down,
    Up,
    _GatherConv,
    build_pyramid,
    gather,
    neighbor_table,
    submanifold_conv,
    unique_rows,
)


def random_sites(n=150, extent=10, batch=2, seed=0):
    g = torch.Generator().manual_seed(seed)
    raw = torch.randint(0, extent, (n, 3), generator=g)
    rows = torch.cat([torch.randint(0, batch, (n, 1), generator=g), raw], dim=1)
    return torch.unique(rows, dim=0)


def dense(features, coords, extent, batch):
    grid = features.new_zeros(batch, features.shape[1], extent, extent, extent)
    b, x, y, z = coords.T
    out = grid.permute(0, 2, 3, 4, 1).clone()
    out = out.index_put((b, x, y, z), features)
    return out.permute(0, 4, 1, 2, 3)


def reference_conv(features, weight, coords, extent=12, batch=2):
    """The same layer as a dense convolution, read off at the sites."""
    kernel = weight.view(3, 3, 3, *weight.shape[1:]).permute(4, 3, 0, 1, 2)
    out = nn.functional.conv3d(dense(features, coords, extent, batch), kernel, padding=1)
    b, x, y, z = coords.T
    return out[b, :, x, y, z]


def test_neighbor_table_against_a_dictionary():
    coords = random_sites()
    table = neighbor_table(coords, 2)
    rows = {tuple(c.tolist()): i for i, c in enumerate(coords)}
    for i, (b, x, y, z) in enumerate(coords.tolist()):
        for k, (dx, dy, dz) in enumerate(OFFSETS.tolist()):
            assert table[i, k].item() == rows.get((b, x + dx, y + dy, z + dz), len(coords))


@pytest.mark.parametrize("channels", [4, 5])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_gathered_rows_are_those_of_the_table(channels, dtype):
    coords = random_sites()
    table = build_pyramid(coords, 2, 1)[0].table
    features = torch.randn(
        len(coords), channels, dtype=dtype, generator=torch.Generator().manual_seed(3)
    )
    with_zeros = torch.cat([features, torch.zeros(1, channels, dtype=dtype)])
    found = gather(features, table)
    assert found.is_contiguous()
    assert torch.equal(found, with_zeros[table].flatten(1))


@pytest.mark.parametrize("path", ["pairs", "gather"])
def test_convolution_and_gradients_equal_dense(path):
    coords = random_sites()
    level = build_pyramid(coords, 2, 1)[0]
    g = torch.Generator().manual_seed(1)
    features = torch.randn(len(coords), 5, dtype=torch.float64, generator=g)
    weight = torch.randn(27, 5, 7, dtype=torch.float64, generator=g)
    probe = torch.randn(len(coords), 7, dtype=torch.float64, generator=g)
    results = []
    for conv in (
        (lambda f, w: submanifold_conv(f, w, level))
        if path == "pairs"
        else (lambda f, w: _GatherConv.apply(f, w, level)),
        lambda f, w: reference_conv(f, w, coords),
    ):
        f, w = features.clone().requires_grad_(True), weight.clone().requires_grad_(True)
        out = conv(f, w)
        (out * probe).sum().backward()
        results.append((out.detach(), f.grad, w.grad))
    for ours, reference in zip(*results, strict=True):
        torch.testing.assert_close(ours, reference)


def test_down_and_up_equal_strided_dense_convolutions():
    coords = random_sites()
    fine, coarse = build_pyramid(coords, 2, 2)
    g = torch.Generator().manual_seed(2)
    features = torch.randn(len(coords), 4, generator=g)
    down, up = Down(4, 6), Up(6, 3)
    kernel = down.linear.weight.view(6, 2, 2, 2, 4).permute(0, 4, 1, 2, 3)
    expected = nn.functional.conv3d(dense(features, coords, 12, 2), kernel, stride=2)
    b, x, y, z = coarse.coords.T
    out = down(features, fine, len(coarse.coords))
    torch.testing.assert_close(out, expected[b, :, x, y, z])

    kernel = up.linear.weight.view(2, 2, 2, 3, 6).permute(4, 3, 0, 1, 2)
    lifted = nn.functional.conv_transpose3d(dense(out, coarse.coords, 6, 2), kernel, stride=2)
    b, x, y, z = coords.T
    torch.testing.assert_close(up(out, fine), lifted[b, :, x, y, z])


def test_backbone_is_equivariant_to_shifts_by_its_stride():
    torch.manual_seed(0)
    net = Backbone(3, (4, 6, 8, 8, 8), (1, 1, 2, 1, 2)).eval()
    coords = random_sites(300, extent=32)
    features = torch.randn(len(coords), 3)
    shifted = coords + torch.tensor([0, 16, 32, 16])
    a = net(features, build_pyramid(coords, 2, 5))
    b = net(features, build_pyramid(shifted, 2, 5))
    torch.testing.assert_close(a, b)


def test_batches_do_not_mix():
    torch.manual_seed(0)
    net = Backbone(3, (4, 6, 8, 8, 8), (1, 1, 2, 1, 2)).eval()
    coords = random_sites(300, extent=20)
    features = torch.randn(len(coords), 3)
    both = net(features, build_pyramid(coords, 2, 5))
    second = coords[:, 0] == 1
    alone = coords[second] - torch.tensor([1, 0, 0, 0])
    torch.testing.assert_close(net(features[second], build_pyramid(alone, 1, 5)), both[second])


@pytest.mark.parametrize("shape", [(0, 4), (1, 4), (300, 4), (300, 2), (40, 1)])
@pytest.mark.parametrize("low", [0, -7, -(10**4)])
def test_unique_rows_are_those_of_torch(shape, low):
    g = torch.Generator().manual_seed(shape[0])
    rows = torch.randint(low, low + 5, shape, generator=g)
    unique, place = unique_rows(rows)
    assert unique.dtype == torch.int64
    if len(rows):  # torch refuses none
        expected, expected_place = torch.unique(rows, dim=0, return_inverse=True)
        assert torch.equal(unique, expected) and torch.equal(place, expected_place)
    else:
        assert unique.shape == shape and place.shape == (0,)
    assert torch.equal(unique[place], rows)
