"""Pose errors: symmetry, medians, recall and accuracy areas by hand."""

import numpy as np
import pytest

from composenet.geometry.transform import make_T, rotation_z
from composenet.metrics.pose import PoseError, area_under_accuracy, pose_error, pose_scores
from composenet.records import Similarity, Symmetry


@pytest.mark.parametrize(
    ("symmetry", "turn_deg", "expected_deg"),
    [
        (Symmetry.NONE, 0, 0),
        (Symmetry.NONE, 175, 175),
        (Symmetry.TWO, 175, 5),
        (Symmetry.TWO, 90, 90),
        (Symmetry.FOUR, 100, 10),
        (Symmetry.INF, 123, 3),
    ],
)
def test_rotation_error_is_least_over_symmetries(symmetry, turn_deg, expected_deg):
    true_pose = make_T(rotation_z(0.4), [1, 2, 3])
    R = rotation_z(0.4 + np.radians(turn_deg))
    error = pose_error(Similarity(1.5, R, np.array([1, 2.03, 3.04])), true_pose, symmetry)
    assert error.rotation_deg == pytest.approx(expected_deg, abs=1e-6)
    assert error.translation_cm == pytest.approx(5)


def test_scores_by_hand():
    scores = pose_scores([PoseError(0, 5), PoseError(10, 10), PoseError(90, 30)], counted=4)
    assert scores.rotation_deg_median == 10
    assert scores.translation_cm_median == 10
    assert scores.recall == pytest.approx(0.75)
    assert scores.rotation_auc == pytest.approx((1 + 0.5 + 0) / 4)
    assert scores.translation_auc == pytest.approx((0.8 + 0.6 + 0) / 4)


def test_nothing_found_and_nothing_there():
    silent = pose_scores([], counted=4)
    assert (silent.recall, silent.rotation_auc, silent.translation_auc) == (0, 0, 0)
    assert np.isnan(silent.rotation_deg_median)
    assert np.isnan(pose_scores([], counted=0).rotation_auc)


def test_area_against_many_thresholds():
    errors = np.random.default_rng(1).uniform(0, 40, 200)
    accuracy = [(errors < threshold).sum() / 250 for threshold in np.linspace(0, 20, 4001)]
    assert area_under_accuracy(errors, 250, 20) == pytest.approx(np.mean(accuracy), abs=1e-3)
