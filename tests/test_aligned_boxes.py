"""IoU of box tensors against the reference."""

from __future__ import annotations

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from composenet.geometry import box as reference
from composenet.geometry.aligned_boxes import paired_iou, pairwise_iou
from composenet.records import Box

boxes_strategy = st.lists(
    st.tuples(*[st.floats(-1, 1)] * 3, *[st.floats(0.1, 2)] * 3), min_size=1, max_size=4
)


@settings(max_examples=50)
@given(boxes_strategy, boxes_strategy)
def test_box_iou_equals_the_reference(a: list[tuple], b: list[tuple]) -> None:
    A, B = np.array(a), np.array(b)
    tensors = [torch.from_numpy(x) for x in (A[:, :3], A[:, 3:], B[:, :3], B[:, 3:])]
    slow = reference.pairwise_iou(
        [Box(row[:3], row[3:]) for row in A], [Box(row[:3], row[3:]) for row in B]
    )
    ours = pairwise_iou(*tensors)
    np.testing.assert_allclose(ours, slow, atol=1e-9)
    n = min(len(A), len(B))
    assert torch.equal(paired_iou(*(x[:n] for x in tensors)), ours[:n, :n].diagonal())


def test_box_iou_is_differentiable() -> None:
    boxes = [
        torch.tensor(rows, dtype=torch.float64, requires_grad=True)
        for rows in ([[0.0, 0, 0], [1, 2, 3]], [[1.0, 2, 1], [1, 1, 1]])
    ]
    others = [torch.tensor([0.2, 0.3, -0.3]).double(), torch.tensor([0.8, 1.5, 1.2]).double()]
    assert torch.autograd.gradcheck(lambda *a: paired_iou(*a, *others), boxes)
    assert paired_iou(*boxes, *others)[1] == 0  # apart
