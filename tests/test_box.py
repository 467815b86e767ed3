"""Boxes: IoU against published vectors, closed forms, sampling, and laws."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from composenet.geometry.box import (
    OrientedBox,
    aabb_of_oriented,
    aabb_of_points,
    corners,
    inside,
    iou,
    oriented_intersection_m3,
    oriented_iou,
    pairwise_iou,
    pairwise_oriented_iou,
)
from composenet.records import Box

VECTORS = Path(__file__).resolve().parents[2] / "shared" / "vectors" / "iou3d_vectors.json"


def box(center, extents) -> Box:
    return Box(np.array(center, dtype=float), np.array(extents, dtype=float))


def turned(center, extents, rotvec=(0, 0, 0)) -> OrientedBox:
    R = Rotation.from_rotvec(rotvec).as_matrix()
    return OrientedBox(np.array(center, dtype=float), R, np.array(extents, dtype=float))


def random_box(rng) -> OrientedBox:
    R = Rotation.random(random_state=rng).as_matrix()
    return OrientedBox(rng.uniform(-0.4, 0.4, 3), R, rng.uniform(0.3, 1.5, 3))


def from_corners(points) -> OrientedBox:
    """Inverse of `corners`: 0-3 bottom ring, 4-7 top ring."""
    points = np.array(points)
    edges = points[[1, 3, 4]] - points[0]
    extents = np.linalg.norm(edges, axis=1)
    return OrientedBox(points.mean(axis=0), (edges / extents[:, None]).T, extents)


def contains(box: OrientedBox, points):
    return np.all(np.abs((points - box.center) @ box.R) <= box.extents / 2, axis=1)


UNIT = turned((0.5, 0.5, 0.5), (1, 1, 1))
PUBLISHED = {  # from the tests of pytorch3d's box3d_overlap, and closed forms
    "same": (UNIT, UNIT, 1, 1),
    "shift_y_0.3": (UNIT, turned((0.5, 0.8, 0.5), (1, 1, 1)), 0.7, 0.7 / 1.3),
    "shift_xyz": (UNIT, turned((0.6, 0.7, 0.9), (1, 1, 1)), 0.432, 0.2755102040816326),
    "disjoint": (UNIT, turned((0.5, 100.5, 0.5), (1, 1, 1)), 0, 0),
    "touching": (UNIT, turned((1.5, 0.5, 0.5), (1, 1, 1)), 0, 0),
    "edge_share": (turned((0, 0, 0), (2, 2, 2)), turned((-1, 1, 0), (2, 2, 2)), 2, 1 / 7),
    "yaw_45": (
        turned((0, 0, 0), (1, 1, 1)),
        turned((0, 0, 0), (1, 1, 1), (0, 0, np.pi / 4)),
        2 * (np.sqrt(2) - 1),
        1 / np.sqrt(2),
    ),
    "inside": (turned((0, 0, 0), (4, 4, 4)), turned((1, 0, 0), (1, 1, 1), (1, 2, 3)), 1, 1 / 64),
}


@pytest.mark.parametrize("name", PUBLISHED)
def test_oriented_iou_closed_forms(name):
    a, b, intersection, expected = PUBLISHED[name]
    assert oriented_intersection_m3(a, b) == pytest.approx(intersection, abs=1e-9)
    assert oriented_iou(a, b) == pytest.approx(expected, abs=1e-9)


def test_oriented_iou_published_file():
    if not VECTORS.exists():
        pytest.skip("shared/vectors is not beside this checkout")
    for vector in json.loads(VECTORS.read_text())["vectors"]:
        a, b = from_corners(vector["corners1"]), from_corners(vector["corners2"])
        assert np.allclose(corners(a), vector["corners1"], atol=1e-9), vector["name"]
        assert oriented_iou(a, b) == pytest.approx(vector["expected_iou"], abs=1e-9)


def test_oriented_intersection_against_sampling():
    rng = np.random.default_rng(3)
    for _ in range(8):
        a, b = random_box(rng), random_box(rng)
        samples = (rng.random((200_000, 3)) - 0.5) * a.extents @ a.R.T + a.center
        sampled = contains(b, samples).mean() * np.prod(a.extents)
        assert oriented_intersection_m3(a, b) == pytest.approx(sampled, abs=0.012)


@pytest.mark.parametrize("seed", range(10))
def test_oriented_iou_laws(seed):
    rng = np.random.default_rng(seed)
    a, b = random_box(rng), random_box(rng)
    value = oriented_iou(a, b)
    assert 0 <= value <= 1
    assert oriented_iou(b, a) == pytest.approx(value, abs=1e-9)
    assert oriented_iou(a, a) == pytest.approx(1, abs=1e-9)
    R, t = Rotation.random(random_state=rng).as_matrix(), rng.uniform(-500, 500, 3)
    moved = [OrientedBox(R @ x.center + t, R @ x.R, x.extents) for x in (a, b)]
    assert oriented_iou(*moved) == pytest.approx(value, abs=1e-9)
    assert np.allclose(pairwise_oriented_iou([a], [a, b]), [[1, value]])


@pytest.mark.parametrize(
    ("a", "b", "expected"),
    [
        (box((0, 0, 0), (0.3, 0.2, 0.1)), box((0.02, 0, 0), (0.3, 0.2, 0.1)), 0.875),
        (box((0, 0, 0), (1, 1, 1)), box((0, 0, 0), (1, 1, 1)), 1),
        (box((0, 0, 0), (2, 2, 2)), box((1, 1, 1), (2, 2, 2)), 1 / 15),
        (box((0, 0, 0), (1, 1, 1)), box((1, 0, 0), (1, 1, 1)), 0),
        (box((0, 0, 0), (1, 1, 1)), box((9, 9, 0), (1, 1, 1)), 0),  # two negative sides
        (box((0, 0, 0), (0, 0, 0)), box((0, 0, 0), (0, 0, 0)), 0),
    ],
)
def test_axis_aligned_iou_table(a, b, expected):
    assert iou(a, b) == pytest.approx(expected)
    assert oriented_iou(*(OrientedBox(x.center, np.eye(3), x.extents) for x in (a, b))) == (
        pytest.approx(expected)
    )


coordinate = st.floats(-3, 3)
size = st.floats(0.05, 4)
boxes = st.builds(lambda c, e: box(c, e), st.tuples(*[coordinate] * 3), st.tuples(*[size] * 3))


@settings(max_examples=50)
@given(st.lists(boxes, max_size=4), st.lists(boxes, max_size=4))
def test_pairwise_equals_one_by_one(first, second):
    together = pairwise_iou(first, second)
    assert together.shape == (len(first), len(second))
    for i, a in enumerate(first):
        for j, b in enumerate(second):
            assert together[i, j] == pytest.approx(iou(b, a))
            assert 0 <= together[i, j] <= 1 + 1e-12


def test_corners_bounds_and_points():
    tilted = turned((1, 2, 3), (0.4, 1.0, 2.0), (0.3, -0.2, 1.1))
    points = corners(tilted)
    assert points[:4] @ tilted.R[:, 2] == pytest.approx(np.full(4, (points @ tilted.R[:, 2]).min()))
    around, expected = aabb_of_oriented(tilted), aabb_of_points(points)
    assert np.allclose(around.center, expected.center)
    assert np.allclose(around.extents, expected.extents)
    upright = box((1, 2, 3), (1, 2, 4))
    assert np.allclose(corners(upright)[0], (0.5, 1, 1))
    assert np.allclose(corners(upright)[6], (1.5, 3, 5))


@given(boxes)
def test_a_box_holds_what_its_corners_enclose(b):
    outline = corners(b) - b.center
    assert inside(b.center + 0.999 * outline, b).all()
    assert not inside(b.center + 1.001 * outline, b).any()
    assert inside(np.zeros((0, 3)), b).shape == (0,)


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.zeros((4, 2)), np.zeros(3)])
def test_no_box_around_nothing(points):
    with pytest.raises(ValueError, match="shape"):
        aabb_of_points(points)
