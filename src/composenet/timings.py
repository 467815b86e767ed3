"""Times of stages, summarised the same way wherever they are reported."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

WHOLE_FRAME = "frame"
"""name of the sum over the stages of a frame"""


@dataclass(frozen=True)
class StageTiming:
    """Median and 95th percentile of a stage's time in milliseconds over n frames."""

    stage: str
    median_ms: float
    p95_ms: float
    n: int


def summarise_timings(frames: Iterable[Mapping[str, float]]) -> tuple[StageTiming, ...]:
    """Timings of every stage in order of appearance, then of the whole frame.

    frames: milliseconds by stage, one mapping a frame; a stage may be absent from some.
    """
    by_stage: dict[str, list[float]] = {}
    sums: list[float] = []
    for frame in frames:
        for stage, milliseconds in frame.items():
            by_stage.setdefault(stage, []).append(milliseconds)
        if frame:
            sums.append(sum(frame.values()))
    if sums:
        by_stage[WHOLE_FRAME] = sums
    return tuple(
        StageTiming(stage, float(np.median(ms)), float(np.percentile(ms, 95)), len(ms))
        for stage, ms in by_stage.items()
    )
