"""The examples run as a user runs them."""

from __future__ import annotations

import importlib.util
import json
import runpy
import shutil
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

import composenet
from composenet.config import Config
from composenet.output import OutputWriter
from composenet.records import Frame
from composenet.sequences import open_sequence

LIVE = Path(__file__).parents[1] / "examples" / "live.py"
PICTURES = Path(__file__).parents[1] / "examples" / "pictures.py"


def pictures(*arguments: object) -> subprocess.CompletedProcess:
    command = [sys.executable, str(PICTURES), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True)


def written(recording: Path, out: Path, first: int, count: int) -> Path:
    """An interrupted result of `count` frames in which nothing was found."""
    sequence = open_sequence(recording)
    with OutputWriter(out, sequence.name, sequence.camera, Config(), replay=False) as writer:
        for frame in list(sequence)[first : first + count]:
            writer.add_frame(frame, [], {})
        writer.finish([], complete=False)
    return out


def shortened(recording: Path, to: Path) -> Path:
    """A copy without its last image."""
    shutil.copytree(recording, to)
    sorted((to / "depth").iterdir())[-1].unlink()
    return to


def test_pictures_of_an_interrupted_result(recordings: Path, tmp_path: Path) -> None:
    recording, out = recordings / "val_00000", tmp_path / "picture.png"
    result = written(recording, tmp_path / "result", 0, 2)
    done = pictures(recording, result, "--out", out, "--frames", "2", "--columns", "1")
    assert done.returncode == 0, done.stderr
    assert Image.open(out).height > 300


@pytest.mark.parametrize(
    ("name", "words"),
    [("empty", "no tracked frame"), ("none", "no such file"), ("later", "none of the frames")],
)
def test_pictures_of_nothing_are_one_line(
    recordings: Path, tmp_path: Path, name: str, words: str
) -> None:
    recording = recordings / "val_00000"
    if name == "empty":
        written(recording, tmp_path / name, 0, 0)
    elif name == "later":
        written(recording, tmp_path / name, 5, 1)
        recording = shortened(recording, tmp_path / "shortened")
    done = pictures(recording, tmp_path / name)
    assert done.returncode == 1 and done.stderr.count("\n") == 1
    assert done.stderr.startswith("pictures: ") and words in done.stderr


def test_pictures_are_drawn_in_the_world_of_the_result(
    recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """That of a part of the recording, or of its odometry, is another than that of the whole."""
    result = written(recordings / "val_00000", tmp_path / "result", 0, 2)
    data = json.loads((result / "tracks.json").read_text())
    for entry in data["frames"]:
        entry["T_world_camera"][0][3] += 0.5
    (result / "tracks.json").write_text(json.dumps(data))
    example = runpy.run_path(str(PICTURES))
    drawn, real = [], example["overlay"]

    def overlay(frame: Frame, *others: object) -> object:
        drawn.append(frame.T_world_camera)
        return real(frame, *others)

    monkeypatch.setitem(example["main"].__globals__, "overlay", overlay)
    example["main"](recordings / "val_00000", result, tmp_path / "picture.png", frames=2)
    expected = [entry["T_world_camera"] for entry in data["frames"]]
    np.testing.assert_allclose(drawn, expected)


def test_a_picture_of_no_known_kind_is_one_line(recordings: Path, tmp_path: Path) -> None:
    result = written(recordings / "val_00000", tmp_path / "result", 0, 1)
    done = pictures(recordings / "val_00000", result, "--out", tmp_path / "picture")
    assert done.returncode == 1 and "extension" in done.stderr and done.stderr.count("\n") == 1


def test_a_recording_is_tracked_as_a_live_camera(recordings: Path) -> None:
    pytest.importorskip("small_gicp", reason="odometry is not installed")
    command = [sys.executable, str(LIVE), str(recordings / "val_00000"), "--rate-hz", "3"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "world 0, frame 0, " in done.stdout and done.stderr == ""


@pytest.mark.parametrize(
    ("arguments", "words"), [(["nowhere"], "nowhere: no such folder"), ([], "pyrealsense2")]
)
def test_without_a_camera_one_line_says_so(arguments: list[str], words: str) -> None:
    if not arguments and importlib.util.find_spec("pyrealsense2"):
        pytest.skip("there may be a camera")
    done = subprocess.run(
        [sys.executable, str(LIVE), *arguments], capture_output=True, text=True, timeout=100
    )
    assert done.returncode == 1 and done.stderr.count("\n") == 1
    assert done.stderr.startswith("live: ") and words in done.stderr


def test_what_nobody_took_is_replaced_and_errors_arrive() -> None:
    newest = runpy.run_path(str(LIVE))["Newest"]()
    newest.put("old")
    newest.put("new")
    assert newest.take() == "new"
    threading.Timer(0.1, newest.put, ["late"]).start()
    assert newest.take() == "late"
    newest.put("last")
    newest.end(RuntimeError("unplugged"))
    assert newest.take() == "last"
    with pytest.raises(RuntimeError, match="unplugged"):
        newest.take()


def test_a_lost_camera_begins_a_new_world(monkeypatch: pytest.MonkeyPatch) -> None:
    """After `LOST_S` seconds, three images here; until then what it sees is left out."""
    live = runpy.run_path(str(LIVE))
    step_s = live["LOST_S"] / 3
    found: dict[float, bool] = {0: True, 1: True, 2: False, 3: False, 4: False, 5: False, 6: True}

    class Odometry:
        def __call__(self, depth_m: float, *_: object) -> np.ndarray | None:
            return np.eye(4) if found[depth_m] else None

    monkeypatch.setattr(composenet, "Odometry", Odometry, raising=False)
    seen, stop = [], threading.Event()

    class Box:
        def put(self, item: object) -> None:
            seen.append((item.image.depth_m, item.world))  # type: ignore[attr-defined]

        def end(self, error: Exception | None = None) -> None:
            seen.append(("end", error))

    images = [live["Image"](float(t), None, None, step_s * t) for t in range(7)]
    monkeypatch.setattr(live["time"], "monotonic", lambda: 0.0)
    live["follow"]((image for image in images), Box(), stop)
    assert seen == [(0.0, 0), (1.0, 0), (6.0, 1), ("end", None)]


def test_without_odometry_the_tracking_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing() -> None:
        raise composenet.ComposenetError("install it")

    monkeypatch.setattr(composenet, "Odometry", missing, raising=False)
    live = runpy.run_path(str(LIVE))
    newest = live["Newest"]()
    live["follow"]((image for image in ()), newest, threading.Event())
    with pytest.raises(composenet.ComposenetError, match="install it"):
        newest.take()


def test_images_of_a_realsense(monkeypatch: pytest.MonkeyPatch) -> None:
    """Depth in metres, colour as it is, both halved with the lens; the camera is let go."""
    depth = np.arange(480 * 640, dtype=np.uint16).reshape(480, 640)
    color = np.arange(480 * 640 * 3, dtype=np.uint8).reshape(480, 640, 3)
    camera = fake_realsense(depth, color)
    monkeypatch.setitem(sys.modules, "pyrealsense2", camera)
    images = runpy.run_path(str(LIVE))["realsense"]()
    image = next(images)
    np.testing.assert_allclose(image.depth_m, depth[::2, ::2] * np.float32(0.0001))
    np.testing.assert_array_equal(image.color, color[::2, ::2])
    assert (image.camera.width, image.camera.height) == (320, 240)
    np.testing.assert_allclose(image.camera.K, [[300, 0, 160], [0, 305, 120], [0, 0, 1]])
    images.close()
    assert camera.stopped == [True]


def fake_realsense(depth: np.ndarray, color: np.ndarray) -> Any:
    """The part of the library's interface that the example uses."""
    stopped: list[bool] = []
    lens = SimpleNamespace(fx=600, fy=610, ppx=320, ppy=240, width=640, height=480)
    video = SimpleNamespace(get_intrinsics=lambda: lens)
    profile = SimpleNamespace(
        get_device=lambda: SimpleNamespace(
            first_depth_sensor=lambda: SimpleNamespace(get_depth_scale=lambda: 0.0001)
        ),
        get_stream=lambda _: SimpleNamespace(as_video_stream_profile=lambda: video),
    )
    frames = SimpleNamespace(
        get_depth_frame=lambda: SimpleNamespace(get_data=lambda: depth),
        get_color_frame=lambda: SimpleNamespace(get_data=lambda: color),
    )
    return SimpleNamespace(
        stopped=stopped,
        pipeline=lambda: SimpleNamespace(
            start=lambda _: profile,
            wait_for_frames=lambda: frames,
            stop=lambda: stopped.append(True),
        ),
        config=lambda: SimpleNamespace(enable_stream=lambda *_: None),
        stream=SimpleNamespace(depth=0, color=1),
        format=SimpleNamespace(z16=0, rgb8=1),
        align=lambda _: SimpleNamespace(process=lambda given: given),
    )
