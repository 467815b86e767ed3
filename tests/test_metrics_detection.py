"""Average precision: hand-computed examples, ignored truth, a slow reference, laws."""

import numpy as np
import pytest

from composenet.metrics.detection import (
    DetectionOutcomes,
    average_precision,
    concatenate,
    match_greedily,
    mean_over_classes,
    outcomes,
)
from composenet.metrics.records import ScoredFrame


def frame(similarity, scores, ignored=None) -> ScoredFrame:
    scores = np.array(scores, dtype=float)
    similarity = np.array(similarity, dtype=float).reshape(-1, len(scores))
    if ignored is None:
        ignored = [False] * len(similarity)
    return ScoredFrame(similarity, scores, np.array(ignored, dtype=bool))


def result(correct, truths, scores=None) -> DetectionOutcomes:
    scores = np.linspace(0.9, 0.1, len(correct)) if scores is None else np.array(scores)
    return DetectionOutcomes(scores, np.array(correct, dtype=bool), truths)


PRECISIONS = {  # name: outcomes strongest first, truths, AP
    "perfect": ([1, 1, 1], 3, 1),
    "nothing found": ([], 3, 0),
    "all wrong": ([0, 0], 3, 0),
    "half found, no errors": ([1, 1], 4, 0.5),
    "an error after all": ([1, 1, 0, 0], 2, 1),
    "an error first": ([0, 1], 1, 0.5),
    # recall steps of 1/4 at precisions 1, 2/3, 3/5; the last truth is never found
    "mixed": ([1, 0, 1, 0, 1], 4, (1 + 2 / 3 + 3 / 5) / 4),
    # precisions 1/2, 2/3, 3/4: each is raised to the best that follows, 3/4
    "rising precision": ([0, 1, 1, 1], 3, 3 / 4),
}


@pytest.mark.parametrize("name", PRECISIONS)
def test_average_precision(name):
    correct, truths, expected = PRECISIONS[name]
    assert average_precision(result(correct, truths)) == pytest.approx(expected)


def test_classes_without_truth_are_undefined_and_left_out():
    assert np.isnan(average_precision(result([0, 0], 0)))
    assert mean_over_classes([0.2, float("nan"), 0.4]) == pytest.approx(0.3)
    assert np.isnan(mean_over_classes([float("nan")]))


def test_equal_scores_enter_together():
    for correct in ([1, 0], [0, 1]):
        assert average_precision(result(correct, 1, [0.5, 0.5])) == pytest.approx(0.5)


MATCHES = {  # similarity (truths x detections), scores, ignored, threshold, taken
    "at the threshold": ([[0.5]], [0.9], [0], 0.5, [0]),
    "below": ([[0.49]], [0.9], [0], 0.5, [-1]),
    "a duplicate is wrong": ([[0.9, 0.8]], [0.6, 0.7], [0], 0.5, [-1, 0]),
    "the stronger takes the more similar": (
        [[0.8, 0.7], [0.6, 0.9]],
        [0.9, 0.8],
        [0, 0],
        0.5,
        [0, 1],
    ),
    "second choice": ([[0.9, 0.8], [0.0, 0.6]], [0.9, 0.8], [0, 0], 0.5, [0, 1]),
    "counted before ignored": ([[0.9], [0.6]], [0.9], [1, 0], 0.5, [1]),
    "ignored when nothing else": ([[0.9], [0.4]], [0.9], [1, 0], 0.5, [0]),
    "no truth": ([], [0.9], [], 0.5, [-1]),
    "no detection": ([[], []], [], [0, 0], 0.5, []),
}


@pytest.mark.parametrize("name", MATCHES)
def test_matching(name):
    similarity, scores, ignored, threshold, taken = MATCHES[name]
    ignored = np.array(ignored, dtype=bool)
    shaped = np.array(similarity, dtype=float).reshape(len(ignored), len(scores))
    assert (
        match_greedily(ScoredFrame(shaped, np.array(scores), ignored), threshold).tolist() == taken
    )


def test_detections_of_ignored_truth_are_dropped():
    one = outcomes([frame([[0.9, 0.8, 0.0]], [0.9, 0.8, 0.7], [True])], 0.5)
    assert one.truths == 0
    assert one.scores.tolist() == [0.8, 0.7]  # a duplicate, and one that meets nothing
    assert not one.correct.any()


def test_frames_pool_before_precision():
    """Strong error in the second frame comes before the weak hit of the first."""
    frames = [frame([[0.6]], [0.3]), frame([[0.0, 0.7]], [0.5, 0.9])]
    both = outcomes(frames, 0.5)
    assert both.truths == 2
    assert average_precision(both) == pytest.approx((1 + 2 / 3) / 2)
    parts = concatenate([outcomes([f], 0.5) for f in frames])
    assert average_precision(parts) == average_precision(both)
    assert average_precision(outcomes(reversed(frames), 0.5)) == average_precision(both)


def slow_average_precision(found: DetectionOutcomes) -> float:
    """Best precision at or beyond each recall, summed over the truths."""
    points = []
    for cut in np.unique(found.scores):
        kept = found.correct[found.scores >= cut]
        points.append((kept.sum(), kept.mean()))
    best = [
        max([precision for tp, precision in points if tp >= n], default=0)
        for n in range(1, found.truths + 1)
    ]
    return sum(best) / found.truths


@pytest.mark.parametrize("seed", range(20))
def test_against_slow_reference(seed):
    rng = np.random.default_rng(seed)
    correct = rng.random(30) < 0.5
    found = DetectionOutcomes(rng.integers(0, 12, 30) / 12, correct, int(correct.sum()) + 3)
    assert average_precision(found) == pytest.approx(slow_average_precision(found))
    order = rng.permutation(30)
    shuffled = DetectionOutcomes(found.scores[order], correct[order], found.truths)
    assert average_precision(shuffled) == pytest.approx(average_precision(found))
