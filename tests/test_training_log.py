"""What a training run says while it runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from composenet.training.checkpoint import Progress
from composenet.training.log import StepLog


@pytest.mark.parametrize(
    ("learned", "said", "unsaid"),
    [
        ({}, [], ["iou", "rotation"]),
        ({"completion_iou": 0.5}, ["iou 0.50"], ["rotation"]),
        ({"completion_iou": 0.5, "rotation_deg": 12.0}, ["iou 0.50", "rotation 12 deg"], []),
    ],
)
def test_says_only_what_is_learned(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    learned: dict[str, float],
    said: list[str],
    unsaid: list[str],
) -> None:
    log = StepLog(tmp_path, minutes=10, quiet=False)
    progress = Progress(step=3, frames=12, seconds=4.0)
    log.step(progress, {"total": 1.25} | learned, rate=1e-3, waited=0.1, took=0.4, share=0.5)
    log.close()
    line = capsys.readouterr().out
    for part in ("step 3", "loss 1.250", "3.0 frames/s", "waiting 25%", "up to 5 min left", *said):
        assert part in line
    assert not any(word in line for word in unsaid)
    assert "total=1.25" in (tmp_path / "steps.log").read_text()


def test_one_step_that_is_not_finite_does_not_spoil_what_is_said(tmp_path: Path) -> None:
    log = StepLog(tmp_path, minutes=10, quiet=False)
    for loss in (float("nan"), 2.0, float("inf"), 2.0):
        log.step(Progress(step=1), {"total": loss}, rate=1e-3, waited=0.1, took=0.4, share=0.5)
    log.close()
    assert log.mean["total"] == 2.0
