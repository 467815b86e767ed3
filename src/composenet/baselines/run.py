"""One comparison system over one sequence."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

from composenet.baselines.records import Cameras, ComparisonSystem, MaskSource
from composenet.records import Frame, TrackedObject


@dataclass(frozen=True)
class Run:
    """What a system said of each frame, by frame index, and the seconds each took: masks and
    tracking, not the reading of the frame."""

    tracked: dict[int, tuple[TrackedObject, ...]]
    seconds: tuple[float, ...]


def run_system(
    system: ComparisonSystem, masks: MaskSource, frames: Iterable[Frame], cameras: Cameras
) -> Run:
    """The system over all frames, in order."""
    tracked, seconds = {}, []
    for frame in shown_poses(frames, cameras):
        start = time.perf_counter()
        tracked[frame.index] = system(frame, masks(frame))
        seconds.append(time.perf_counter() - start)
    return Run(tracked, tuple(seconds))


def shown_poses(frames: Iterable[Frame], cameras: Cameras) -> Iterator[Frame]:
    """The frames with the camera poses that a system may see (see `records`)."""
    first = None
    for frame in frames:
        first = frame.T_world_camera if first is None else first
        hidden = cameras is Cameras.ESTIMATED
        yield replace(frame, T_world_camera=first) if hidden else frame
