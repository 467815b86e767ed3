"""`track` while it runs: what it says when, and what is left when it cannot go on."""

from __future__ import annotations

import io
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from composenet.commands.track import track_recording
from composenet.pipeline import FrameResult, load_tracker
from composenet.predictions import read_predictions
from composenet.records import Frame
from composenet.sequences import open_sequence


class Watched:
    """A tracker of a network that has learned nothing; before each frame, counted from 1,
    something is done."""

    def __init__(self, weights: Path, before: Callable[[int], None]) -> None:
        self._tracker, self._before, self._count = load_tracker(weights, device="cpu"), before, 0

    def __call__(self, frame: Frame) -> FrameResult:
        self._count += 1
        self._before(self._count)
        return self._tracker(frame)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._tracker, name)


def spoil(folder: Path, number: int) -> None:
    """Make a depth image unreadable."""
    sorted((folder / "depth").iterdir())[number].write_bytes(b"no image")


def test_doubts_about_the_recording_are_said_before_it_is_tracked(
    recordings: Path, tiny_weights: Path, tmp_path: Path
) -> None:
    folder, out = tmp_path / "recording", tmp_path / "out"
    shutil.copytree(recordings / "val_00000", folder)
    spoil(folder, 1)
    said = io.StringIO()

    def before(count: int) -> None:
        if count == 1:
            assert "warning 1 frame skipped: depth" in said.getvalue()
        elif count == 2:
            assert any("1 frame skipped" in line for line in read_predictions(out).warnings)
            spoil(folder, 4)

    sequence, tracker = open_sequence(folder), Watched(tiny_weights, before)
    run = track_recording(sequence, tracker, out, Console(file=said))  # type: ignore[arg-type]
    assert len(run.frames) == 4
    assert [line.split(":")[0] for line in run.warnings if "skip" in line] == ["2 frames skipped"]
    lines = [line for line in said.getvalue().splitlines() if "skip" in line]
    assert [line.split(":")[0] for line in lines] == [
        "warning 1 frame skipped",
        "warning 2 frames skipped",
    ]
    assert set(sequence.warnings) <= set(run.warnings)
