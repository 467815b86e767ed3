"""`track` while it runs: what it says when, and what is left when it cannot go on."""

from __future__ import annotations

import io
import json
import os
import shutil
import signal
import subprocess
import sys
import warnings
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from rich.console import Console

from composenet import cli
from composenet import config as configuration
from composenet.commands import track
from composenet.commands.track import track_recording
from composenet.errors import DataError, DeviceError
from composenet.pipeline import ObjectTracker, Sight, load_tracker
from composenet.predictions import read_predictions
from composenet.records import Frame
from composenet.sequences import open_sequence
from composenet.tracking.tracker import Tracker


class Watched:
    """A tracker of a network that has learned nothing; before each frame, counted from 1,
    something is done."""

    def __init__(self, weights: Path, before: Callable[[int], None], **tracking: Any) -> None:
        self._tracker = load_tracker(weights, device="cpu", **tracking)
        self._before, self._count = before, 0

    def look(self, frame: Frame) -> Sight:
        self._count += 1
        self._before(self._count)
        return self._tracker.look(frame)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._tracker, name)


def spoil(folder: Path, number: int) -> None:
    """Make a depth image unreadable."""
    sorted((folder / "depth").iterdir())[number].write_bytes(b"no image")


def program(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    """Exit code of `composenet track`."""
    monkeypatch.setattr(sys, "argv", ["composenet", "track", *map(str, arguments)])
    with pytest.raises(SystemExit) as stop:
        cli.main()
    return stop.value.code if isinstance(stop.value.code, int) else 0


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


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2 GiB"), "out of memory"),
        (RuntimeError("DefaultCPUAllocator: can't allocate memory: 9 bytes"), "out of memory"),
        (MemoryError(), "out of memory"),
        (RuntimeError("CUDA error: device-side assert\nCompile with"), "assert; try --device cpu"),
    ],
)
def test_a_device_that_gives_up_leaves_what_is_done(
    capsys, monkeypatch, recordings: Path, tiny_weights: Path, tmp_path: Path,
    error: Exception, reason: str,
) -> None:  # fmt: skip
    look, seen = ObjectTracker.look, []

    def failing(self: ObjectTracker, frame: Frame) -> Sight:
        seen.append(frame)
        if len(seen) == 3:
            raise error
        return look(self, frame)

    monkeypatch.setattr(ObjectTracker, "look", failing)
    options = ["--out", tmp_path, "--weights", tiny_weights]
    assert program(monkeypatch, recordings / "val_00000", *options) == 2
    said = capsys.readouterr()
    assert said.err.startswith(f"composenet: frame {seen[2].name}: ") and said.err.count("\n") == 1
    assert reason in said.err and "--device cpu" in said.err
    assert "in 2 frames (interrupted" in said.out
    result = read_predictions(tmp_path)
    assert not result.complete and len(result.frames) == 2 and result.mesh_files
    assert (tmp_path / "report.html").is_file()


def test_a_device_that_gives_up_at_once_changes_nothing(
    recordings: Path, tiny_weights: Path, tmp_path: Path
) -> None:
    def fail(_: int) -> None:
        raise torch.OutOfMemoryError("CUDA out of memory")

    sequence, console = open_sequence(recordings / "val_00000"), Console(file=io.StringIO())
    track_recording(sequence, Watched(tiny_weights, lambda _: None), tmp_path, console)  # type: ignore[arg-type]
    before = (tmp_path / "tracks.json").read_text()
    with pytest.raises(DeviceError, match="out of memory"):
        track_recording(sequence, Watched(tiny_weights, fail), tmp_path, console)  # type: ignore[arg-type]
    assert (tmp_path / "tracks.json").read_text() == before


def test_a_second_run_does_not_write_into_the_first_ones_folder(
    recordings: Path, tiny_weights: Path, tmp_path: Path
) -> None:
    console = Console(file=io.StringIO())

    def begin_another(count: int) -> None:
        if count == 3:
            again = open_sequence(recordings / "val_00001")
            with pytest.raises(DataError, match="another run is writing here"):
                track_recording(again, Watched(tiny_weights, begin_another), tmp_path, console)  # type: ignore[arg-type]

    sequence = open_sequence(recordings / "val_00000")
    run = track_recording(sequence, Watched(tiny_weights, begin_another), tmp_path, console)  # type: ignore[arg-type]
    assert run.complete and read_predictions(tmp_path).sequence == "val_00000"


def test_other_errors_stay_what_they_are(
    recordings: Path, tiny_weights: Path, tmp_path: Path
) -> None:
    def fail(_: int) -> None:
        raise RuntimeError("shapes do not match")

    sequence, console = open_sequence(recordings / "val_00000"), Console(file=io.StringIO())
    with pytest.raises(RuntimeError, match="shapes"):
        track_recording(sequence, Watched(tiny_weights, fail), tmp_path, console)  # type: ignore[arg-type]


def test_a_configuration_can_be_passed_back_in(
    monkeypatch, recordings: Path, tiny_weights: Path, tmp_path: Path
) -> None:
    first, again = tmp_path / "first", tmp_path / "again"
    options = [recordings / "val_00000", "--max-frames", "1", "--weights", tiny_weights]
    asked = ["--variant", "no-compl", "--offline"]
    assert program(monkeypatch, *options, *asked, "--out", first) == 0
    text = (first / "config.json").read_text()
    changed = tmp_path / "changed.json"
    changed.write_text(text.replace('"lost_decay": 0.9', '"lost_decay": 0.7'))
    assert program(monkeypatch, *options, "--config", changed, "--out", again) == 0
    tracking = configuration.load(str(again / "config.json")).tracking
    assert tracking.lost_decay == 0.7 and tracking.offline and not tracking.use_completion
    whole = ["--config", changed, "--variant", "full", "--out", tmp_path / "whole"]
    assert program(monkeypatch, *options, *whole) == 0  # what is typed comes first
    tracking = configuration.load(str(tmp_path / "whole" / "config.json")).tracking
    assert tracking.use_completion and tracking.use_correspondences
    changed.write_text(text.replace('"voxel_size_m": 0.15', '"voxel_size_m": 0.1'))
    assert program(monkeypatch, *options, "--config", changed, "--out", again) == 2


def test_a_floor_elsewhere_is_told_of_in_the_result(
    recordings: Path, tiny_weights: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Once, as any other doubt, and not by a line of Python's. A generated world is taken as it
    is."""
    folder, out = tmp_path / "recording", tmp_path / "out"
    shutil.copytree(recordings / "val_00000", folder)
    for path in (folder / "pose").iterdir():
        T = np.loadtxt(path)
        T[2, 3] -= 1.5
        np.savetxt(path, T)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert program(monkeypatch, folder, "--out", out, "--weights", tiny_weights) == 0
    told = [line for line in read_predictions(out).warnings if "below the floor" in line]
    assert len(told) == 1


def test_a_recordings_name_may_be_in_no_known_encoding(
    recordings: Path, tiny_weights: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "K\udcfcche"
    shutil.copytree(recordings / "val_00000", folder)
    command = [sys.executable, "-m", "composenet", "track", folder, "--out", tmp_path / "out"]
    options = ["--weights", tiny_weights, "--max-frames", "1"]
    strict = {**os.environ, "PYTHONIOENCODING": "utf-8:strict"}
    done = subprocess.run([*command, *options], env=strict, capture_output=True)
    assert done.returncode == 0, done.stderr.decode()
    assert read_predictions(tmp_path / "out").complete


def test_looking_back_without_poses_is_told_of(
    monkeypatch, capsys, recordings: Path, tiny_weights: Path, tmp_path: Path
) -> None:
    recording = tmp_path / "recording"
    shutil.copytree(recordings / "val_00000", recording)
    shutil.rmtree(recording / "pose")
    options = ["--weights", tiny_weights, "--offline", "--max-frames", "2"]
    assert program(monkeypatch, recording, *options, "--out", tmp_path / "out") == 0
    assert "looking back needs camera poses" in " ".join(capsys.readouterr().out.split())
    told = json.loads((tmp_path / "out" / "tracks.json").read_text())["meta"]["warnings"]
    assert sum("looking back needs camera poses" in line for line in told) == 1


@pytest.mark.parametrize("wrong", ["out", "weights", "config", "device"])
def test_what_is_wrong_is_said_before_the_recording_is_read(
    monkeypatch, capsys, recordings: Path, tiny_weights: Path, tmp_path: Path, wrong: str
) -> None:
    """Odometry takes its time."""

    def read(*_: object, **__: object) -> None:
        raise AssertionError("read")

    monkeypatch.setattr(track, "open_sequence", read)
    (tmp_path / "file").write_text("{")
    given = {"out": tmp_path / "out", "weights": tiny_weights, "device": "cpu"}
    given[wrong] = "cuda:99" if wrong == "device" else tmp_path / "file"
    options = [part for name, value in given.items() for part in (f"--{name}", value)]
    assert program(monkeypatch, recordings / "val_00000", *options, "--odometry") == 2
    assert str(given[wrong]) in capsys.readouterr().err


def test_a_recording_looked_back_on_is_seen_twice(
    recordings: Path, tiny_weights: Path, tmp_path: Path
) -> None:
    sequence, seen = open_sequence(recordings / "val_00000"), []
    tracker = Watched(tiny_weights, seen.append, offline=True)
    run = track_recording(sequence, tracker, tmp_path, Console(file=io.StringIO()))  # type: ignore[arg-type]
    assert seen == [*range(1, 2 * len(run.frames) + 1)] and run.complete
    assert [frame.index for frame in run.frames] == [frame.index for frame in sequence]


def test_results_can_be_taken_back_to_the_recordings_own_world(
    recordings: Path, tiny_weights: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of SLAM systems z is seldom up."""
    folder, out = tmp_path / "recording", tmp_path / "out"
    shutil.copytree(recordings / "val_00000", folder)
    (folder / "annotations.json").unlink()
    T_source_true = np.array([[1, 0, 0, 2.0], [0, 0, -1, 0.5], [0, 1, 0, -0.7], [0, 0, 0, 1]])
    own = {}
    for path in sorted((folder / "pose").iterdir()):
        own[path.stem] = T_source_true @ np.loadtxt(path)
        np.savetxt(path, own[path.stem])
    assert program(monkeypatch, folder, "--out", out, "--weights", tiny_weights) == 0
    run = read_predictions(out)
    assert run.T_level_source is not None and len(run.frames) == len(own)
    for frame in run.frames:
        back = np.linalg.inv(run.T_level_source) @ frame.T_world_camera
        np.testing.assert_allclose(back, own[frame.name], atol=1e-6)
        assert abs(frame.T_world_camera[2, 2]) < 0.9  # z is up again: no camera looks along it


def test_association_is_told_of_all_surface_that_is_known(
    recordings: Path, tiny_weights: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    update, told = Tracker.update, []

    def noted(self: Tracker, frame: Frame, estimates: Any, surface: Any) -> Any:
        told.append({tuple(point) for point in surface.round(6)})
        return update(self, frame, estimates, surface)

    monkeypatch.setattr(Tracker, "update", noted)
    frames = list(open_sequence(recordings / "val_00000"))
    tracker = load_tracker(tiny_weights, device="cpu")
    for frame in frames:
        tracker(frame)
    for frame in frames:
        tracker.restart()(frame)  # remembers nothing
    together, alone = told[: len(frames)], told[len(frames) :]
    assert all(own and own <= known for own, known in zip(alone, together, strict=True))
    assert together[0] == alone[0] and len(together[-1]) > len(alone[-1])


@pytest.mark.parametrize("by", [signal.SIGINT, signal.SIGTERM, None])
def test_what_stops_on_the_way_back_leaves_the_way_there(
    recordings: Path, tiny_weights: Path, tmp_path: Path, by: signal.Signals | None
) -> None:
    sequence, console = open_sequence(recordings / "val_00000"), Console(file=io.StringIO())
    there = load_tracker(tiny_weights, device="cpu", offline=True)
    for frame in sequence:
        there(frame)

    def stop(count: int) -> None:
        if count == len(sequence) + 2:
            if by is None:
                raise torch.OutOfMemoryError("CUDA out of memory")
            signal.raise_signal(by)

    tracker = Watched(tiny_weights, stop, offline=True)
    with nullcontext() if by else pytest.raises(DeviceError):
        track_recording(sequence, tracker, tmp_path, console)  # type: ignore[arg-type]
    kept = read_predictions(tmp_path)
    assert not kept.complete and len(kept.frames) == len(sequence)
    expected = [(track.track_id, len(track.history)) for track in there.tracks()]
    assert expected
    assert [(track.track_id, len(track.history)) for track in kept.tracks] == expected


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('{"volumes": {}}', "odd.json: configuration field 'volumes'"),
        ("none", "odd.json: not a readable JSON"),
        ("{}", "does not fit the weights"),
    ],
)
def test_a_configuration_that_does_not_fit(
    capsys, monkeypatch, recordings: Path, tiny_weights: Path, tmp_path: Path, text: str, words: str
) -> None:
    path, options = tmp_path / "odd.json", ["--weights", tiny_weights, "--out", tmp_path / "out"]
    path.write_text(text)
    assert program(monkeypatch, recordings / "val_00000", "--config", path, *options) == 2
    said = capsys.readouterr().err
    assert words in said and said.count("\n") == 1
