"""Volumes and surfaces of completed objects against closed forms and a slow reference."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from composenet.geometry.box import OrientedBox
from composenet.geometry.transform import make_T
from composenet.metrics.completion import (
    VOXEL_M,
    VoxelVolume,
    completion_error,
    seen_points,
    volume_iou,
    voxelize,
    voxelize_estimate,
    voxelize_truth,
)
from composenet.records import (
    Box,
    Camera,
    Frame,
    ObjectEstimate,
    ObjectTruth,
    Similarity,
    Symmetry,
)

FULL = np.ones((64, 64, 64), dtype=bool)


def block(center, extents, yaw=0.0, occupied=FULL) -> VoxelVolume:
    R = Rotation.from_euler("z", yaw).as_matrix()
    return voxelize(occupied, OrientedBox(np.array(center, float), R, np.array(extents, float)))


def test_aligned_block_is_exact():
    volume = block((0.5, 0.25, 1.0), (1.0, 0.5, 2.0))
    assert volume.first.tolist() == [0, 0, 0]
    assert volume.occupied.shape == (40, 20, 80)
    assert volume.occupied.all()


def test_lookup_one_cell_at_a_time():
    rng = np.random.default_rng(0)
    occupied = rng.random((6, 5, 4)) < 0.5
    R = Rotation.random(random_state=rng).as_matrix()
    box = OrientedBox(np.array([1.0, -2.0, 0.3]), R, np.array([0.4, 0.3, 0.5]))
    volume = voxelize(occupied, box)
    for i, j, k in np.ndindex(*volume.occupied.shape):
        world = (volume.first + (i, j, k) + 0.5) * VOXEL_M
        cell = np.floor((R.T @ (world - box.center) / box.extents + 0.5) * occupied.shape)
        inside = np.all(cell >= 0) and np.all(cell < occupied.shape)
        expected = bool(inside and occupied[tuple(cell.astype(int))])
        assert volume.occupied[i, j, k] == expected
    filled = volume.occupied.sum() * VOXEL_M**3
    assert filled == pytest.approx(occupied.mean() * 0.06, rel=0.05)


EMPTY, CUBOID = block((0, 0, 0), (1, 1, 1), 0, ~FULL), block((0, 0, 0), (1, 0.5, 1))
IOUS = {
    "same": (block((0.5, 0.5, 0.5), (1, 1, 1)), block((0.5, 0.5, 0.5), (1, 1, 1)), 1),
    "half": (block((0.5, 0.5, 0.5), (1, 1, 1)), block((1.0, 0.5, 0.5), (1, 1, 1)), 1 / 3),
    "apart": (block((0.5, 0.5, 0.5), (1, 1, 1)), block((5, 5, 0.5), (1, 1, 1)), 0),
    "inside": (block((0.5, 0.5, 0.5), (1, 1, 1)), block((0.5, 0.5, 0.25), (0.5, 0.5, 0.5)), 1 / 8),
    "quarter turn": (
        block((0, 0, 0), (1, 0.5, 1)),
        block((0, 0, 0), (1, 0.5, 1), np.pi / 2),
        1 / 3,
    ),
    "half a cell of nothing": (
        block((0, 0, 0), (1, 1, 1), 0, ~FULL),
        block((0, 0, 0), (1, 1, 1)),
        0,
    ),
    "both empty": (block((0, 0, 0), (1, 1, 1), 0, ~FULL), block((0, 0, 0), (1, 1, 1), 0, ~FULL), 0),
}


@pytest.mark.parametrize("name", IOUS)
def test_volume_iou(name):
    a, b, expected = IOUS[name]
    assert volume_iou(a, b) == pytest.approx(expected)
    assert volume_iou(b, a) == pytest.approx(expected)


def test_tilted_octagon():
    """Squares turned by 45 degrees share an octagon: IoU 1 / sqrt(2)."""
    a, b = block((0, 0, 0), (1, 1, 1)), block((0, 0, 0), (1, 1, 1), np.pi / 4)
    assert volume_iou(a, b) == pytest.approx(1 / np.sqrt(2), abs=0.01)


def test_truth_and_estimate_of_one_solid():
    """An L-shaped solid, once over its box (truth), once in canonical space (estimate)."""
    extents = np.array([1.2, 0.8, 0.6])
    diagonal = float(np.linalg.norm(extents))
    centres = (np.arange(64) + 0.5) / 64 - 0.5
    x, y, z = np.meshgrid(centres, centres, centres, indexing="ij")
    occupancy = (x < 0) | (z < 0)
    R, t = Rotation.from_euler("z", 0.7).as_matrix(), np.array([3.0, 1.0, 0.3])
    truth = ObjectTruth(1, 4, Symmetry.NONE, extents, occupancy, np.zeros((0, 3)))
    half = extents / diagonal / 2
    inside = (abs(x) <= half[0]) & (abs(y) <= half[1]) & (abs(z) <= half[2])
    canonical = (inside & ((x < 0) | (z < 0))).astype(np.float32)
    estimate = ObjectEstimate(
        np.eye(10)[4], 0.9, Box(t, extents), Similarity(diagonal, R, t), True, extents,
        np.zeros((0, 3)), canonical,
    )  # fmt: skip
    error = completion_error(voxelize_truth(truth, make_T(R, t)), voxelize_estimate(estimate))
    assert error.volume_iou > 0.9
    assert error.chamfer_cm < 1


def cells(*indices) -> VoxelVolume:
    """A volume of the given cells of the world grid."""
    indices = np.array(indices)
    first = indices.min(axis=0)
    occupied = np.zeros(np.ptp(indices, axis=0) + 1, dtype=bool)
    occupied[tuple((indices - first).T)] = True
    return VoxelVolume(first, occupied)


def test_chamfer_by_hand():
    """Cells of 2.5 cm: one cell 4 cells away; then a second one at the truth's own place."""
    assert completion_error(cells((0, 0, 0)), cells((4, 0, 0))).chamfer_cm == pytest.approx(10)
    both = completion_error(cells((0, 0, 0)), cells((4, 0, 0), (0, 0, 0)))
    assert both.chamfer_cm == pytest.approx((0 + (10 + 0) / 2) / 2)
    assert both.volume_iou == pytest.approx(1 / 2)


def test_chamfer_against_all_pairs():
    a, b = block((0, 0, 0), (0.4, 0.3, 0.5)), block((0.1, 0, 0), (0.4, 0.5, 0.5), 0.5)
    distance = np.linalg.norm(a.surface()[:, None] - b.surface(), axis=-1)
    expected = 50 * (distance.min(axis=0).mean() + distance.min(axis=1).mean())
    assert completion_error(a, b).chamfer_cm == pytest.approx(expected)
    assert completion_error(a, a).chamfer_cm == 0


def test_surface_is_the_shell():
    volume = block((0.5, 0.5, 0.5), (1, 1, 1))
    assert len(volume.surface()) == 40**3 - 38**3


def test_no_surface_no_distance():
    error = completion_error(CUBOID, EMPTY)
    assert error.volume_iou == 0
    assert np.isnan(error.chamfer_cm)


def looking_along_x(depth: float) -> Frame:
    """Camera at the origin, looking along world x, a wall `depth` metres away."""
    R_world_camera = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    K = np.array([[100.0, 0, 79.5], [0, 100, 59.5], [0, 0, 1]])
    image = np.full((120, 160), depth, dtype=np.float32)
    return Frame(0, image, Camera(K, 160, 120), make_T(R_world_camera, np.zeros(3)))


def test_seen_points():
    points = np.array([[2.0, 0, 0], [2.04, 0, 0], [2.1, 0, 0], [-2, 0, 0], [2, 5, 0], [1, 0, 0]])
    assert seen_points(points, looking_along_x(2.0)).tolist() == [
        True,
        True,
        False,
        False,
        False,
        True,
    ]
    assert not seen_points(points, looking_along_x(0.0)).any()


def test_errors_split_into_seen_and_unseen():
    """A block of 1 m seen from its front; the prediction lacks the rear half."""
    truth, prediction = block((2.5, 0, 0), (1, 1, 1)), block((2.25, 0, 0), (0.5, 1, 1))
    error = completion_error(truth, prediction, looking_along_x(2.0))
    assert error.seen_cm == pytest.approx(0, abs=0.1)
    assert error.unseen_cm > 15
