"""Pose errors of matched objects, and accuracy over all objects that count."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from composenet.geometry.transform import rotation_error_deg
from composenet.records import FloatArray, Similarity, Symmetry

ROTATION_LIMIT_DEG = 20.0
TRANSLATION_LIMIT_CM = 25.0


@dataclass(frozen=True)
class PoseError:
    """One matched object. rotation_deg: minimum over the object's symmetries."""

    rotation_deg: float
    translation_cm: float


@dataclass(frozen=True)
class PoseScores:
    """Medians over the matched (NaN where none is); recall, the share of counted objects that
    are matched; and areas under the accuracy curves, 0..1, over all counted objects."""

    rotation_deg_median: float
    translation_cm_median: float
    recall: float
    rotation_auc: float
    translation_auc: float


def pose_error(estimate: Similarity, T_world_object: FloatArray, symmetry: Symmetry) -> PoseError:
    """How far an estimated pose is from the true one."""
    rotation = rotation_error_deg(estimate.R, T_world_object[:3, :3], symmetry)
    offset = np.linalg.norm(np.asarray(estimate.t) - T_world_object[:3, 3])
    return PoseError(rotation, 100 * float(offset))


def pose_scores(errors: Sequence[PoseError], counted: int) -> PoseScores:
    """Summary of matched objects among `counted` ones (matched or not)."""
    rotation = np.array([error.rotation_deg for error in errors])
    translation = np.array([error.translation_cm for error in errors])
    return PoseScores(
        rotation_deg_median=float(np.median(rotation)) if len(rotation) else float("nan"),
        translation_cm_median=float(np.median(translation)) if len(rotation) else float("nan"),
        recall=len(errors) / counted if counted else float("nan"),
        rotation_auc=area_under_accuracy(rotation, counted, ROTATION_LIMIT_DEG),
        translation_auc=area_under_accuracy(translation, counted, TRANSLATION_LIMIT_CM),
    )


def area_under_accuracy(errors: FloatArray, counted: int, limit: float) -> float:
    """Mean over thresholds 0..limit of the share of `counted` objects whose error is below.

    Exact: an error e is below the share 1 - e / limit of all thresholds. Objects without an
    error (not found) are below none, so silence never helps. NaN where nothing counts.
    """
    if counted == 0:
        return float("nan")
    return float(np.clip(1 - np.asarray(errors) / limit, 0, None).sum()) / counted
