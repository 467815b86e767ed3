"""Silent channels are counted, whatever the layers are, and weight decay inside Adam makes them."""

from __future__ import annotations

import pytest
import torch
from torch import nn

from composenet.training.silent import SILENT, watched


def small_network() -> nn.Sequential:
    return nn.Sequential(
        nn.Conv3d(3, 8, 1), nn.BatchNorm3d(8), nn.ReLU(), nn.Flatten(),
        nn.Linear(64, 6), nn.LayerNorm(6), nn.ReLU(),
    )  # fmt: skip


def test_channels_are_counted_over_all_runs() -> None:
    torch.manual_seed(0)
    network = small_network().eval()
    network[1].weight.data[:] = torch.tensor([1, 1, 0, 1, 1e-4, 1, 0.5, 1])
    network[5].weight.data[2], network[5].bias.data[4] = 0.0, -100.0
    with watched(network) as channels, torch.no_grad():
        outputs = [network[:3](x) for x in torch.randn(5, 4, 3, 2, 2, 2)]
        for x in torch.randn(3, 4, 3, 2, 2, 2):
            network(x)
    assert channels.silent["1"].nonzero()[:, 0].tolist() == [2, 4]
    assert channels.silent["5"].nonzero()[:, 0].tolist() == [2]  # a constant beside zero varies
    assert channels.silent["6"].nonzero()[:, 0].tolist() == [2, 4]
    assert channels.share("6") == pytest.approx(2 / 6)
    counts = [len(rows) for rows in channels.silent.values()]
    silent = sum(int(rows.sum()) for rows in channels.silent.values())
    assert channels.share() == pytest.approx(silent / sum(counts))
    # the same from all outputs at once
    values = torch.cat([y.transpose(0, 1).flatten(1) for y in outputs], dim=1)
    assert values.shape[0] == len(channels.silent["2"])
    # nobody watches any more
    before = dict(channels.silent)
    network(torch.randn(4, 3, 2, 2, 2))
    assert all(torch.equal(before[name], rows) for name, rows in channels.silent.items())


def test_nothing_watched_has_no_share() -> None:
    with watched(nn.Linear(2, 2)) as channels:
        pass
    assert channels.share() != channels.share()  # NaN


def test_a_reference_of_the_deviation() -> None:
    torch.manual_seed(1)
    layer = nn.BatchNorm1d(5).eval()
    layer.weight.data[:] = torch.tensor([1.0, 0.5, 2 * SILENT, SILENT / 2, 0.0])
    x = torch.randn(200, 5)
    with watched(layer) as channels, torch.no_grad():
        whole = layer(x)
        channels.add("halves", whole[:77])
        channels.add("halves", whole[77:])
    deviation = whole.std(dim=0, correction=0)
    expected = deviation <= SILENT * deviation.max()
    assert torch.equal(channels.silent[""], expected)
    assert torch.equal(channels.silent["halves"], expected)
    assert int(expected.sum()) == 2


@pytest.mark.parametrize(("weight_decay", "silent"), [(2e-4, True), (0.0, False)])
def test_decay_inside_adam_silences_what_the_loss_hardly_asks_for(
    weight_decay: float, silent: bool
) -> None:
    """Noise keeps nothing alive against a decay five times smaller."""
    torch.manual_seed(0)
    gain = nn.Parameter(torch.ones(2))
    optimizer = torch.optim.Adam([gain], lr=3e-3, weight_decay=weight_decay)
    for _ in range(4000):
        pull = 0.1 * (gain[0] - 1)  # the loss asks for the first gain only
        gain.grad = torch.stack([pull, torch.zeros(())]).detach() + 1e-3 * torch.randn(2)
        optimizer.step()
    assert abs(float(gain[0].detach()) - 1) < 0.2
    assert (abs(float(gain[1].detach())) < 0.3) == silent
