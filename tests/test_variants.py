"""Our tracker scored: what the scorer keeps of each frame is all that it needs."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np

from composenet.commands.variants import _Estimates, _Kept
from composenet.metrics.evaluate import posed_truths
from composenet.metrics.objects import score_objects
from composenet.pipeline import load_tracker
from composenet.sequences import open_sequence
from composenet.synth.sequence_folder import read_truth


def test_kept_estimates_score_as_whole_ones(recordings: Path, tiny_weights: Path) -> None:
    tracker = load_tracker(tiny_weights, device="cpu")
    folder = recordings / "val_00000"
    frames = list(open_sequence(folder))
    results = [tracker(frame) for frame in frames]
    kept = [_Kept.of(result) for result in results]
    assert any(result.estimates for result in results)
    present = posed_truths(read_truth(folder))
    whole = score_objects(present, [result.estimates for result in results], frames)
    slim = score_objects(present, _Estimates(kept), frames)
    assert whole.counted == slim.counted and len(whole.matched) == len(slim.matched)
    for one, other in zip(whole.classes, slim.classes, strict=True):
        for field in fields(one):
            a, b = getattr(one, field.name), getattr(other, field.name)
            np.testing.assert_array_equal(a.scores, b.scores)
            np.testing.assert_array_equal(a.correct, b.correct)
    bytes_kept = sum(bits.nbytes for item in kept for bits in item.occupied)
    assert bytes_kept * 32 == sum(e.canonical.nbytes for r in results for e in r.estimates)


def test_frames_that_gave_nothing_have_no_estimates() -> None:
    assert list(_Estimates([None, None])) == [(), ()]
