"""`composenet track`: a recording to completed, posed, tracked objects."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import Progress

from composenet.commands.device_errors import device_errors
from composenet.commands.progress import progress_bar, watched
from composenet.commands.terminal import say, warn
from composenet.config import load as load_config
from composenet.errors import DataError, DeviceError
from composenet.files import held
from composenet.predictions import PredictedSequence
from composenet.result_folder import claim
from composenet.sequences import RecordedSequence, SequenceOptions, formats, open_sequence

if TYPE_CHECKING:
    from composenet.pipeline import FrameResult, ObjectTracker
    from composenet.records import Frame

INTERRUPTED_EXIT_CODE = 130
NO_WAY_BACK = (
    "looking back needs camera poses: frames are looked at once and tracks only linked; "
    "--odometry finds poses"
)


def track_recording(
    sequence: RecordedSequence,
    tracker: ObjectTracker,
    out: Path,
    console: Console,
    *,
    save_every: int = 50,
    weights_id: str = "",
) -> PredictedSequence:
    """Track every frame and write the result folder; ctrl-C keeps what is done. A tracker that
    looks twice (tracking.offline) sees a recording with poses once more, backwards. Warnings are
    said as soon as they are known. Raises DataError where another run is writing to the folder,
    DeviceError where the device gives up, and then keeps what is done, too."""
    from composenet.metrics.report import source_commit
    from composenet.output import OutputWriter

    writer = OutputWriter(
        out,
        sequence.name,
        sequence.camera,
        tracker.config,
        commit=source_commit(),
        weights_id=weights_id,
        T_level_source=sequence.T_level_source if sequence.own_poses else None,
        save_every=save_every,
    )
    notes = [NO_WAY_BACK] if tracker.looks_twice and not sequence.has_poses else []
    told = [*sequence.warnings, *notes]
    for line in told:
        warn(console, line)
    with held(out), writer, _interruptible() as stop, progress_bar(console) as progress:
        writer.warn_of_recording(told, sequence.skipped_indices)
        name, count = sequence.name, len(sequence)

        def write(frame: Frame, result: FrameResult) -> None:
            writer.add_frame(frame, result.objects, result.timings_ms)
            if result.doubt:
                writer.warn(result.doubt)

        failure = _track_frames(name, iter(sequence), count, tracker, write, progress, stop)
        if failure is not None and not writer.frames_taken:
            raise failure
        tracks = tracker.tracks()
        if tracker.looks_twice and sequence.has_poses and not stop and failure is None:
            tracker.turn_back()
            back, again = reversed(sequence), f"{name}, backwards"
            failure = _track_frames(again, back, count, tracker, _leave, progress, stop)
            tracks = tracks if stop or failure else tracker.tracks()
        progress.update(progress.task_ids[-1], note="writing meshes and report")
        writer.warn_of_recording([*sequence.warnings, *notes], sequence.skipped_indices)
        run = writer.finish(tracks, complete=not stop and failure is None)
    for line in run.warnings:
        if line not in told:
            warn(console, line)
    if failure is not None:
        say(console, summary(run, out))
        raise failure
    return run


def _leave(*_: object) -> None:
    """What is said of a frame on the way back is in `tracks` at the end."""


def _track_frames(
    title: str,
    frames: Iterator[Frame],
    count: int,
    tracker: ObjectTracker,
    take: Callable[[Frame, FrameResult], None],
    progress: Progress,
    stop: list[bool],
) -> DeviceError | None:
    """`take` what is said of every frame, until there is something in `stop` or the device gives
    up; why it does."""
    task = progress.add_task(title, total=count, note="")
    seconds = 0.0
    for done, frame in enumerate(frames, start=1):
        try:
            with device_errors(frame.name):
                result = tracker.follow(tracker.look(frame))
        except DeviceError as error:
            return error
        take(frame, result)
        seconds += sum(result.timings_ms.values()) / 1e3
        note = f"{len(result.objects)} objects, {done / max(seconds, 1e-9):.1f} frames/s"
        progress.update(task, advance=1, note=note)
        if stop:
            break
    return None


def run_track(
    recording: Path,
    out: Path,
    *,
    weights: Path | None,
    config: Path | None,
    device: str,
    stride: int,
    max_frames: int | None,
    save_every: int,
    variant: dict[str, Any],
    reading: SequenceOptions,
) -> int:
    """The command. Returns the exit code. variant: fields of config.tracking to replace."""
    console = Console()
    if recording.is_dir() or formats.is_known(recording):  # else what is wrong with it comes first
        if out.exists() and out.samefile(recording):
            raise DataError(f"{out}: this is the recording itself; give another --out folder")
        claim(out)
    from composenet.network.weights import default_weights, weights_id
    from composenet.pipeline import load_tracker

    chosen = load_config(config) if config else None
    tracker = load_tracker(weights, device=device, config=chosen, **variant)
    name = weights_id(weights or default_weights())
    sequence = open_sequence(
        recording,
        stride=stride,
        max_frames=max_frames,
        options=reading,
        watch=lambda frames: watched(console, f"{recording.name}, odometry", frames),
    )
    run = track_recording(sequence, tracker, out, console, save_every=save_every, weights_id=name)
    say(console, summary(run, out))
    return 0 if run.complete else INTERRUPTED_EXIT_CODE


def summary(run: PredictedSequence, out: Path) -> str:
    """One line on what was found and where to look."""
    state = "" if run.complete else " (interrupted: what was done is kept)"
    return (
        f"{len(run.class_ids)} tracks in {len(run.frames)} frames{state}; "
        f"open {out / 'report.html'}"
    )


@contextmanager
def _interruptible() -> Iterator[list[bool]]:
    """A list that fills when ctrl-C is pressed or the process is told to end, so that the frame
    under way is finished; a second time stops at once."""
    asked: list[bool] = []

    def ask(*_: object) -> None:
        if asked:
            raise KeyboardInterrupt
        asked.append(True)

    before = {name: signal.signal(name, ask) for name in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield asked
    finally:
        for name, handler in before.items():
            signal.signal(name, handler)
