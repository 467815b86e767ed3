import json
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from composenet.geometry.procrustes import fit_similarity

SHARED = Path(__file__).resolve().parents[2] / "shared"


def random_rotation(generator):
    Q, _ = torch.linalg.qr(torch.randn(3, 3, dtype=torch.float64, generator=generator))
    return Q * torch.det(Q).sign()


def test_umeyama_1991_example():
    """The example of the 1991 article: the plain SVD solution would be a reflection."""
    source = torch.tensor([[[0, 0], [1, 0], [0, 2]]], dtype=torch.float64)
    target = torch.tensor([[[0, 0], [-1, 0], [0, 2]]], dtype=torch.float64)
    fit = fit_similarity(source, target)
    expected_R = [
        [0.8320502943378437, 0.5547001962252291],
        [-0.5547001962252291, 0.8320502943378437],
    ]
    np.testing.assert_allclose(fit.R[0], expected_R, atol=1e-12)
    np.testing.assert_allclose(fit.t[0], [-0.8, 0.4], atol=1e-12)
    assert fit.scale[0].item() == pytest.approx(0.7211102550927978, abs=1e-12)
    assert fit.observable[0]


@pytest.mark.skipif(not SHARED.exists(), reason="shared test vectors are not here")
def test_published_vectors():
    for vector in json.loads((SHARED / "vectors/umeyama_vectors.json").read_text())["vectors"]:
        fit = fit_similarity(
            torch.tensor([vector["src"]], dtype=torch.float64),
            torch.tensor([vector["dst"]], dtype=torch.float64),
        )
        if not fit.observable[0]:
            assert (
                "R" not in vector or "degenerate" in str(vector).lower() or len(vector["src"]) < 3
            )
            continue
        np.testing.assert_allclose(fit.R[0], vector["R"], atol=1e-8, err_msg=vector["name"])
        np.testing.assert_allclose(fit.t[0], vector["t"], atol=1e-8, err_msg=vector["name"])
        np.testing.assert_allclose(fit.scale[0], vector["scale"], atol=1e-8)


@given(st.integers(0, 10_000), st.floats(0.05, 20), st.integers(4, 40))
@settings(max_examples=40)
def test_recovers_a_known_similarity(seed, scale, n):
    g = torch.Generator().manual_seed(seed)
    R, t = random_rotation(g), torch.randn(3, dtype=torch.float64, generator=g)
    source = torch.randn(1, n, 3, dtype=torch.float64, generator=g)
    fit = fit_similarity(source, scale * source @ R.T + t)
    if fit.observable[0]:
        np.testing.assert_allclose(fit.R[0], R, atol=1e-6)
        assert fit.scale[0].item() == pytest.approx(scale, rel=1e-6)


@given(st.integers(0, 10_000))
@settings(max_examples=25)
def test_equivariant_under_similarities_of_the_target(seed):
    g = torch.Generator().manual_seed(seed)
    source = torch.randn(1, 12, 3, dtype=torch.float64, generator=g)
    target = source + 0.2 * torch.randn(1, 12, 3, dtype=torch.float64, generator=g)
    Q, shift = random_rotation(g), torch.randn(3, dtype=torch.float64, generator=g)
    a = fit_similarity(source, target)
    b = fit_similarity(source, 2.5 * target @ Q.T + shift)
    np.testing.assert_allclose(b.R[0], Q @ a.R[0], atol=1e-7)
    np.testing.assert_allclose(b.scale[0], 2.5 * a.scale[0], rtol=1e-8)
    np.testing.assert_allclose(b.t[0], 2.5 * Q @ a.t[0] + shift, atol=1e-7)


def _inputs(case):
    g = torch.Generator().manual_seed(3)
    source = torch.randn(1, 8, 3, dtype=torch.float64, generator=g)
    target = torch.randn(1, 8, 3, dtype=torch.float64, generator=g)
    if case == "planar":
        source[..., 2] = 0
        target = source + 0.1 * target
    elif case == "reflected":
        target = source * torch.tensor([1.0, 1.0, -0.4]) + 0.01 * target
    elif case == "repeated":  # an octahedron: three equal singular values
        eye = torch.eye(3, dtype=torch.float64)
        source = torch.cat([eye, -eye])[None]
        target = source.clone()
    return source, target


@pytest.mark.parametrize("case", ["generic", "planar", "reflected", "repeated"])
def test_gradient_against_finite_differences(case):
    source, target = _inputs(case)
    weights = torch.linspace(0.5, 1.5, source.shape[1], dtype=torch.float64)[None]
    if case == "repeated":
        weights = torch.ones_like(weights)

    def pose(s, t, w):
        fit = fit_similarity(s, t, w)
        assert fit.observable.all()
        return fit.R, fit.scale, fit.t

    for x in (source, target, weights):
        x.requires_grad_(True)
    assert torch.autograd.gradcheck(pose, (source, target, weights), atol=1e-6)


@pytest.mark.parametrize(
    "points",
    [
        torch.zeros(1, 6, 3),
        torch.linspace(0, 1, 6)[None, :, None] * torch.tensor([1.0, 2.0, 3.0]),
        torch.randn(1, 2, 3, generator=torch.Generator().manual_seed(0)),
        torch.full((1, 6, 3), float("nan")),
    ],
    ids=["one point", "collinear", "two points", "not a number"],
)
def test_degenerate_sets_are_flagged_without_nan(points):
    source = points.clone().requires_grad_(True)
    fit = fit_similarity(source, points.clone())
    assert not fit.observable[0]
    if torch.isfinite(points).all():
        (fit.R.sum() + fit.scale.sum() + fit.t.sum()).backward()
        assert torch.isfinite(source.grad).all()
        assert torch.isfinite(fit.t).all()
    assert torch.equal(fit.R[0], torch.eye(3))


def test_planar_points_give_a_rotation():
    source, target = _inputs("planar")
    fit = fit_similarity(source, target)
    assert fit.observable[0]
    assert torch.det(fit.R[0]).item() == pytest.approx(1)


def test_zero_weights_drop_outliers():
    g = torch.Generator().manual_seed(1)
    source = torch.randn(1, 20, 3, dtype=torch.float64, generator=g)
    R = random_rotation(g)
    target = 0.7 * source @ R.T
    target[0, :5] = 100
    weights = torch.ones(1, 20, dtype=torch.float64)
    weights[0, :5] = 0
    np.testing.assert_allclose(fit_similarity(source, target, weights).R[0], R, atol=1e-9)


def turn(angle):
    c, s = np.cos(angle), np.sin(angle)
    return torch.tensor([[c, -s, 0], [s, c, 0], [0, 0, 1]], dtype=torch.float64)


@given(st.integers(0, 10_000), st.floats(-3.1, 3.1), st.floats(0.05, 20))
@settings(max_examples=40)
def test_upright_a_known_turn_is_recovered(seed, angle, scale):
    g = torch.Generator().manual_seed(seed)
    source, t = torch.randn(1, 9, 3, dtype=torch.float64, generator=g), torch.ones(3)
    fit = fit_similarity(source, scale * source @ turn(angle).T + t, upright=True)
    assert fit.observable[0]
    np.testing.assert_allclose(fit.R[0], turn(angle), atol=1e-9)
    np.testing.assert_allclose(fit.t[0], t, atol=1e-8 * max(scale, 1))
    assert fit.scale[0].item() == pytest.approx(scale, rel=1e-9)


@given(st.integers(0, 10_000))
@settings(max_examples=25)
def test_upright_no_other_turn_fits_better(seed):
    """Also where the target is tilted and noisy; and the free fit fits at least as well."""
    g = torch.Generator().manual_seed(seed)
    source = torch.randn(1, 12, 3, dtype=torch.float64, generator=g)
    target = source @ random_rotation(g).T + 0.3 * torch.randn_like(source)
    weights = torch.rand(1, 12, dtype=torch.float64, generator=g)

    def left_over(R, scale, t):
        gaps = scale * source[0] @ R.T + t - target[0]
        return float((weights[0] * gaps.square().sum(dim=1)).sum())

    fit = fit_similarity(source, target, weights, upright=True)
    free = fit_similarity(source, target, weights)
    own = left_over(fit.R[0], fit.scale[0], fit.t[0])
    share = weights[0] / weights[0].sum()
    mean_s, mean_t = share @ source[0], share @ target[0]
    spread = float(share @ (source[0] - mean_s).square().sum(dim=1))
    for angle in np.linspace(-np.pi, np.pi, 73):
        turned = (source[0] - mean_s) @ turn(angle).T
        scale = float(share @ (turned * (target[0] - mean_t)).sum(dim=1)) / spread
        t = mean_t - scale * turn(angle) @ mean_s
        assert own <= left_over(turn(angle), scale, t) + 1e-9 or scale < 0
    if free.observable[0]:
        assert left_over(free.R[0], free.scale[0], free.t[0]) <= own + 1e-9


def test_upright_a_vertical_line_fixes_no_turn_and_a_wall_does():
    heights = torch.linspace(0, 1, 6, dtype=torch.float64)
    line = torch.stack([0 * heights, 0 * heights, heights], dim=1)[None]
    wall = torch.stack([heights, 0 * heights, heights.flip(0) ** 2], dim=1)[None]
    assert not fit_similarity(line, line, upright=True).observable[0]
    assert fit_similarity(wall, wall @ turn(0.7).T, upright=True).observable[0]
    upside_down = wall * torch.tensor([0.2, 1.0, -1.0])
    fit = fit_similarity(wall, upside_down, upright=True)
    assert not fit.observable[0] and fit.scale[0] > 0
    nowhere = fit_similarity(wall, wall, torch.zeros(1, 6), upright=True)
    assert not nowhere.observable[0] and torch.isfinite(nowhere.t).all()
