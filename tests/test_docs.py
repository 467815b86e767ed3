"""The Python of the pages runs as it stands there."""

import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from composenet.errors import SequenceError
from composenet.geometry.transform import make_T
from composenet.network.weights import default_weights, load_weights
from tracking_scenes import LOOK_ALONG_X

ROOT = Path(__file__).resolve().parents[1]
DEPTH_MM = np.full((480, 640), 2000, np.uint16)


def code_of(page):
    """Each piece of it."""
    codes = re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(), re.DOTALL)
    return [compile(code, page, "exec") for code in codes]


@pytest.fixture
def recording(tmp_path):
    (tmp_path / "recording/depth").mkdir(parents=True)
    for i in range(2):
        Image.fromarray(DEPTH_MM).save(tmp_path / f"recording/depth/{i}.png")
    K = "585 0 320\n0 585 240\n0 0 1\n"
    (tmp_path / "recording/camera-intrinsics.txt").write_text(K)


def test_readme(recording, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    seen = {}
    (code,) = code_of("README.md")
    exec(code, seen)
    assert [frame.name for frame in seen["sequence"]] == ["0", "1"]


def test_live_camera():
    T_world_camera = make_T(LOOK_ALONG_X, [0, 0, 1.2])
    seen = {"driver": [(DEPTH_MM, T_world_camera)] * 2}
    exec(code_of("docs/recordings.md")[1], seen)
    assert seen["index"] == 1 and seen["result"].timings_ms["backbone"] > 0
    seen |= {"driver": [seen["depth_m"]] * 3, "tracker": seen["tracker"].restart()}
    exec(code_of("docs/recordings.md")[2], seen)
    assert seen["index"] == 2 and seen["T_world_camera"] is not None


def test_reading_options(recording, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    exec(code_of("docs/recordings.md")[0], {})
    assert capsys.readouterr().out.startswith("2 [[")


def test_results_written_read_and_taken_back(recording, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    back, read, write = code_of("docs/output.md")
    exec(write, {})
    seen = {}
    exec(read, seen)
    assert [frame.name for frame in seen["run"].frames] == ["0", "1"]
    path = tmp_path / "result/tracks.json"
    T_level_source = make_T(np.eye(3), [1, 2, 3])
    path.write_text(
        path.read_text().replace(
            '"T_level_source": null', f'"T_level_source": {T_level_source.tolist()}'
        )
    )
    exec(back, seen)
    np.testing.assert_array_equal(seen["T_source_level"][:3, 3], [-1, -2, -3])


def test_looking_twice(recording, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "recording/pose").mkdir()
    for i in range(2):
        np.savetxt(f"recording/pose/{i}.txt", make_T(LOOK_ALONG_X, [0, 0, 1.2]))
    seen = {}
    exec(code_of("docs/recordings.md")[3], seen)
    assert seen["frame"].index == 0  # the last one that it looked at
    with pytest.raises(SequenceError, match="twice"):
        seen["tracker"].turn_back()
    histories = [[e.frame_index for e in track.history] for track in seen["tracker"].tracks()]
    assert all(frames == sorted(set(frames)) for frames in histories)


def test_thresholds_are_those_of_the_shipped_weights():
    _, config, _ = load_weights(default_weights())
    said = re.findall(r"`(\w+)` \(([\d.]+)\)", (ROOT / "docs/output.md").read_text())
    assert {name for name, _ in said} == {"min_confidence", "keep_confidence"}
    for name, value in said:
        assert getattr(config.tracking, name) == float(value), name
