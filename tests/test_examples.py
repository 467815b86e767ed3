"""The examples run as a user runs them."""

from __future__ import annotations

import json
import runpy
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from composenet.config import Config
from composenet.output import OutputWriter
from composenet.records import Frame
from composenet.sequences import open_sequence

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
