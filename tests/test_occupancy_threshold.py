"""Completion by the probability from which cells count as filled."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import torch
from hypothesis import given
from hypothesis import strategies as st
from occupancy_threshold import scores_by_level

from composenet.network.object_net import stretched
from composenet.records import CLASS_NAMES, Frame, ObjectEstimate, Similarity
from composenet.synth.scene import Scene, SceneOptions, generate_scene

SURE, UNSURE = 0.8, 0.3


class Oracle:
    """In place of a tracker: finds every object where it is. Sure of its cells, and less sure of
    all others in its canonical cube."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene

    def __call__(self, frame: Frame) -> SimpleNamespace:
        placed = self.scene.truth.frames[frame.index]
        return SimpleNamespace(estimates=[self._estimate(p.gt_id, p) for p in placed])

    def _estimate(self, gt_id: int, placed) -> ObjectEstimate:
        truth, n = self.scene.object_truth(gt_id), 64
        scale_m = float(np.linalg.norm(truth.extents_m))
        steps = ((np.arange(n) + 0.5) / n - 0.5) * scale_m
        at = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), -1) / truth.extents_m + 0.5
        inside = ((at >= 0) & (at < 1)).all(axis=-1)
        cell = np.where(inside[..., None], at * n, 0).astype(int)
        solid = inside & truth.occupancy[tuple(np.moveaxis(cell, -1, 0))]
        T = placed.T_world_object
        return ObjectEstimate(
            class_probabilities=np.eye(len(CLASS_NAMES))[truth.class_id],
            score=0.9,
            box=placed.box,
            S_world_canonical=Similarity(scale_m, T[:3, :3], T[:3, 3]),
            pose_observable=True,
            extents_m=truth.extents_m,
            points_world=np.zeros((0, 3), np.float32),
            canonical=np.where(solid, SURE, UNSURE).astype(np.float32),
        )


def test_too_low_fills_the_cube_and_too_high_nothing() -> None:
    scene = generate_scene("val", 3, SceneOptions(frames=1, image_size=(160, 120)))
    low, right, high = scores_by_level(scene, Oracle(scene), (0.2, 0.5, 0.9))  # type: ignore[arg-type]
    ious = [np.mean([m.completion.volume_iou for m in s.objects.matched]) for s in (low, right)]
    assert ious[1] > 0.6 > 2 * ious[0] > 0
    assert all(m.completion.volume_iou == 0 for m in high.objects.matched)


@given(st.floats(0.01, 0.99), st.floats(0, 1), st.floats(0, 1))
def test_stretching_puts_the_threshold_in_the_middle(threshold: float, a: float, b: float) -> None:
    ends = stretched(torch.tensor([0.0, threshold, 1.0], dtype=torch.float64), threshold)
    np.testing.assert_allclose(ends, [0, 0.5, 1], atol=1e-12)
    low, high = stretched(torch.tensor(sorted([a, b]), dtype=torch.float64), threshold).tolist()
    assert low <= high + 1e-12
