"""NMS and RoIAlign against slow references, and torchvision with or without compiled operators."""

from __future__ import annotations

import math
import sys
from importlib.machinery import ModuleSpec
from types import ModuleType

import numpy as np
import pytest
import torch

from composenet.baselines import torchvision_ops
from composenet.baselines.torchvision_ops import import_torchvision, nms, roi_align
from composenet.errors import WeightsError


def slow_nms(boxes: np.ndarray, scores: np.ndarray, threshold: float) -> list[int]:
    def iou(a: np.ndarray, b: np.ndarray) -> float:
        size = np.maximum(np.minimum(a[2:], b[2:]) - np.maximum(a[:2], b[:2]), 0)
        shared = size.prod()
        return float(shared / ((a[2:] - a[:2]).prod() + (b[2:] - b[:2]).prod() - shared))

    kept: list[int] = []
    for i in sorted(range(len(boxes)), key=lambda i: -scores[i]):
        if all(iou(boxes[i], boxes[j]) <= threshold for j in kept):
            kept.append(i)
    return kept


@pytest.mark.parametrize("n", [0, 1, 7, 120])
@pytest.mark.parametrize("threshold", [0.0, 0.3, 0.7])
def test_nms_is_the_slow_one(n: int, threshold: float) -> None:
    rng = np.random.default_rng(n)
    low = rng.uniform(0, 60, (n, 2))
    boxes = np.concatenate([low, low + rng.uniform(5, 40, (n, 2))], axis=1).astype(np.float32)
    scores = rng.permutation(n).astype(np.float32)
    kept = nms(torch.from_numpy(boxes), torch.from_numpy(scores), threshold)
    assert kept.dtype == torch.int64
    assert kept.tolist() == slow_nms(boxes.astype(np.float64), scores, threshold)


def test_nms_by_hand() -> None:
    boxes = torch.tensor([[0.0, 0, 10, 10], [0, 0, 10, 5], [20, 20, 30, 30], [0, 0, 10, 10]])
    scores = torch.tensor([0.5, 0.9, 0.1, 0.5])  # the second covers half of the first and fourth
    assert nms(boxes, scores, 0.5).tolist() == [1, 0, 2]
    assert nms(boxes, scores, 0.49).tolist() == [1, 2]


def sample(image: torch.Tensor, y: float, x: float) -> torch.Tensor:
    """(C,) bilinear by hand: 0 farther than a cell outside, else clamped to the border."""
    height, width = image.shape[1:]
    if not (-1 <= y <= height and -1 <= x <= width):
        return torch.zeros(len(image), dtype=image.dtype)
    y, x = min(max(y, 0.0), height - 1.0), min(max(x, 0.0), width - 1.0)
    y0, x0 = int(y), int(x)
    y1, x1 = min(y0 + 1, height - 1), min(x0 + 1, width - 1)
    upper = image[:, y0, x0] * (1 - (x - x0)) + image[:, y0, x1] * (x - x0)
    lower = image[:, y1, x0] * (1 - (x - x0)) + image[:, y1, x1] * (x - x0)
    return upper * (1 - (y - y0)) + lower * (y - y0)


def slow_roi_align(features, rois, scale, out_h, out_w, ratio, aligned):
    result = []
    for index, *box in rois.tolist():
        x0, y0, x1, y1 = (value * scale - (0.5 if aligned else 0) for value in box)
        w, h = x1 - x0, y1 - y0
        if not aligned:
            w, h = max(w, 1.0), max(h, 1.0)
        n_y = ratio if ratio > 0 else max(1, math.ceil(h / out_h))
        n_x = ratio if ratio > 0 else max(1, math.ceil(w / out_w))
        for i in range(out_h):
            for j in range(out_w):
                values = [
                    sample(
                        features[int(index)],
                        y0 + h / out_h * (i + (a + 0.5) / n_y),
                        x0 + w / out_w * (j + (b + 0.5) / n_x),
                    )
                    for a in range(n_y)
                    for b in range(n_x)
                ]
                result.append(torch.stack(values).mean(dim=0))
    cells = torch.stack(result).view(len(rois), out_h, out_w, features.shape[1])
    return cells.permute(0, 3, 1, 2)


ROIS = torch.tensor(
    [
        [0, 2.0, 3.0, 11.0, 17.0],
        [1, -6.0, -4.0, 9.0, 30.0],  # beyond the border on three sides
        [1, 5.2, 5.1, 5.3, 5.4],  # smaller than a cell
        [0, 0.0, 0.0, 24.0, 20.0],
    ],
    dtype=torch.float64,
)


@pytest.mark.parametrize("ratio", [2, 3, 0])
@pytest.mark.parametrize("aligned", [False, True])
@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_roi_align_and_its_gradient_are_the_slow_ones(
    ratio: int, aligned: bool, scale: float
) -> None:
    generator = torch.Generator().manual_seed(0)
    shape = (2, 3, int(20 * scale), int(24 * scale))
    features = torch.randn(shape, generator=generator, dtype=torch.float64, requires_grad=True)
    arguments = (features, ROIS, scale, 3, 4, ratio, aligned)
    fast, slow = roi_align(*arguments), slow_roi_align(*arguments)
    torch.testing.assert_close(fast, slow, rtol=1e-9, atol=1e-9)
    pull = torch.randn(fast.shape, generator=generator, dtype=torch.float64)
    gradients = [torch.autograd.grad(out, features, pull)[0] for out in (fast, slow)]
    torch.testing.assert_close(*gradients, rtol=1e-9, atol=1e-9)


def test_roi_align_of_nothing_and_of_one_cell() -> None:
    features = torch.ones(1, 2, 1, 1)
    assert roi_align(features, torch.zeros(0, 5), 1.0, 7, 7, 2, False).shape == (0, 2, 7, 7)
    out = roi_align(features, torch.tensor([[0.0, 0, 0, 1, 1]]), 1.0, 2, 2, 2, False)
    torch.testing.assert_close(out, torch.ones(1, 2, 2, 2))


def test_torchvision_gives_the_same_with_whichever_operators() -> None:
    import_or_skip()
    from torchvision import ops

    features = torch.randn(2, 3, 20, 24, requires_grad=True)
    rois = ROIS.float()
    out = ops.roi_align(features, rois, (3, 4), 1.0, 2)
    torch.testing.assert_close(out, roi_align(features, rois, 1.0, 3, 4, 2, False))
    out.sum().backward()
    assert features.grad is not None and float(features.grad.sum()) != 0
    boxes = torch.tensor([[0.0, 0, 10, 10], [0, 0, 10, 9], [20, 20, 30, 30]])
    scores, classes = torch.tensor([0.5, 0.9, 0.1]), torch.tensor([1, 1, 2])
    assert ops.batched_nms(boxes, scores, classes, 0.5).tolist() == [1, 2]


def import_or_skip() -> None:
    try:
        import_torchvision()
    except WeightsError as error:
        pytest.skip(str(error))


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torchvision_ops.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(WeightsError, match=r"torchvision: install it with .*baselines.*--no-deps"):
        import_torchvision()


def test_compiled_operators_are_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """A torchvision that imports at once is taken as it is."""
    module = ModuleType("torchvision")
    module.__spec__ = ModuleSpec("torchvision", None)
    monkeypatch.setitem(sys.modules, "torchvision", module)
    monkeypatch.setattr(torchvision_ops, "_define_operators", pytest.fail)
    assert import_torchvision() is module
