"""The result folder: complete, readable, exact, and readable after an interruption."""

from __future__ import annotations

import csv
import dataclasses
import json
import shutil
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from composenet import config as configuration
from composenet.config import Config, VolumeConfig
from composenet.errors import DataError
from composenet.geometry.transform import rotation_from_quaternion
from composenet.output import OutputWriter, read_predictions
from composenet.records import CLASS_NAMES, Camera, Track, TrackedObject, TrackState
from composenet.timings import summarise_timings
from composenet.tracks_file import TEXT_HEADER
from fake_tracks import CAMERA, box_grid, make_frame, make_object

FRAMES = 7
TIMINGS_MS = {"volume": 10.0, "network": 200.0}
LEVEL = np.array([[0, -1, 0, 0.5], [1, 0, 0, 0], [0, 0, 1, 1.25], [0, 0, 0, 1]])


def entries(n: int) -> list[TrackedObject]:
    """Track 1 moves and vanishes after frame 4; track 2 stands still from frame 2 on."""
    hidden = n > 4
    state = TrackState.OCCLUDED if hidden else TrackState.TRACKED
    first = make_object(1, n, state, center=(3.0 + 0.1 * min(n, 4), 0.0, 1.0))
    second = make_object(2, n, center=(2.5, 1.0, 0.4), yaw=-2.0)
    return [first, second] if n >= 2 else [first]


def tracks(count: int = FRAMES) -> list[Track]:
    histories: dict[int, list[TrackedObject]] = {}
    for n in range(count):
        for entry in entries(n):
            histories.setdefault(entry.track_id, []).append(entry)
    return [
        Track(i, h[0].class_id, tuple(h), box_grid(h[0].extents_m)) for i, h in histories.items()
    ]


def feed(writer: OutputWriter, count: int = FRAMES) -> None:
    for n in range(count):
        writer.add_frame(make_frame(n), entries(n), {**TIMINGS_MS, "tracking": float(n)})


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run."""
    out = tmp_path_factory.mktemp("result") / "run"
    config = Config(volume=VolumeConfig(voxel_size_m=0.04))
    notes = {"commit": "abc", "weights_id": "w1", "T_level_source": LEVEL}
    with OutputWriter(out, "kit<chen", CAMERA, config, **notes) as writer:
        feed(writer)
        writer.warn("2 frames without a pose were skipped")
        writer.finish(tracks())
    return out


def same(a: TrackedObject, b: TrackedObject) -> None:
    np.testing.assert_allclose(a.S_world_canonical.R, b.S_world_canonical.R, atol=1e-14)
    for left, right in (
        (a.box.center, b.box.center),
        (a.box.extents, b.box.extents),
        (a.S_world_canonical.t, b.S_world_canonical.t),
        (a.extents_m, b.extents_m),
    ):
        np.testing.assert_array_equal(left, right)
    assert a.S_world_canonical.scale_m == b.S_world_canonical.scale_m
    for name in ("track_id", "frame_index", "class_id", "state", "confidence", "observed"):
        assert getattr(a, name) == getattr(b, name)


def test_round_trip(folder: Path) -> None:
    run = read_predictions(folder)
    assert (run.sequence, run.commit, run.weights_id) == ("kit<chen", "abc", "w1")
    assert run.complete and "2 frames without a pose were skipped" in run.warnings
    np.testing.assert_array_equal(run.camera.K, CAMERA.K)
    np.testing.assert_array_equal(run.T_level_source, LEVEL)
    assert (run.camera.width, run.camera.height) == (CAMERA.width, CAMERA.height)
    assert len(run.frames) == FRAMES
    for n, frame in enumerate(run.frames):
        source = make_frame(n)
        assert (frame.index, frame.name, frame.timestamp_s) == (n, source.name, source.timestamp_s)
        np.testing.assert_array_equal(frame.T_world_camera, source.T_world_camera)
        for got, expected in zip(frame.objects, entries(n), strict=True):
            same(got, expected)
    for got, expected in zip(run.tracks, tracks(), strict=True):
        assert (got.track_id, got.class_id) == (expected.track_id, expected.class_id)
        assert len(got.history) == len(expected.history)
        np.testing.assert_array_equal(got.canonical, expected.canonical)
        assert got.canonical.dtype == np.float32


def test_tracks_json_says_what_docs_say(folder: Path) -> None:
    data = json.loads((folder / "tracks.json").read_text())
    assert data["schema"] == "composenet.tracks/1"
    assert data["meta"]["classes"] == list(CLASS_NAMES) and "z up" in data["meta"]["axes"]
    first, second = data["tracks"]
    assert (first["id"], first["first_frame"], first["last_frame"]) == (1, 0, 6)
    assert first["observed_frames"] == 5 and second["first_frame"] == 2
    for kind in ("ply", "glb"):
        assert (folder / first["meshes"][kind]).is_file()


def test_text_export_has_the_columns_of_the_format(folder: Path) -> None:
    lines = (folder / "tracks.txt").read_text().splitlines()
    assert lines[0] == TEXT_HEADER
    rows = list(csv.DictReader(lines))
    expected = [entry for n in range(FRAMES) for entry in entries(n)]
    assert len(rows) == len(expected)
    for row, entry in zip(rows, expected, strict=True):
        assert (int(row["frame"]), int(row["track_id"])) == (entry.frame_index, entry.track_id)
        assert row["class"] == CLASS_NAMES[entry.class_id] and row["state"] == entry.state.value
        center = [float(row[key]) for key in ("cx", "cy", "cz")]
        extents = [float(row[key]) for key in ("ex", "ey", "ez")]
        R = rotation_from_quaternion([float(row[key]) for key in ("qw", "qx", "qy", "qz")])
        np.testing.assert_allclose(center, entry.box.center, atol=1e-6)
        np.testing.assert_allclose(extents, entry.box.extents, atol=1e-6)
        np.testing.assert_allclose(R, entry.S_world_canonical.R, atol=1e-5)
        assert float(row["scale"]) == pytest.approx(entry.S_world_canonical.scale_m, abs=1e-6)
        assert 0 <= float(row["score"]) <= 1


def test_mesh_lies_at_the_last_observed_pose(folder: Path) -> None:
    seen = entries(4)[0]
    mesh = trimesh.load(folder / "meshes" / "track_1.ply", force="mesh")
    assert mesh.is_watertight
    cell_m = seen.S_world_canonical.scale_m / 64
    np.testing.assert_allclose(mesh.bounds.mean(axis=0), seen.box.center, atol=cell_m)
    np.testing.assert_allclose(mesh.extents, seen.box.extents, atol=2 * cell_m)


def test_configuration_and_timings(folder: Path) -> None:
    assert configuration.load(folder / "config.json").volume.voxel_size_m == 0.04
    stages = json.loads((folder / "timings.json").read_text())["stages"]
    assert stages["network"] == {"median_ms": 200.0, "p95_ms": 200.0, "n": FRAMES}
    assert stages["tracking"]["median_ms"] == 3.0
    assert stages["frame"]["median_ms"] == 213.0


def test_timings_by_hand() -> None:
    table = summarise_timings([{"a": 1.0, "b": 10.0}, {"a": 3.0}, {}])
    assert [(t.stage, t.median_ms, t.n) for t in table] == [
        ("a", 2.0, 2),
        ("b", 10.0, 1),
        ("frame", 7.0, 2),
    ]
    assert summarise_timings([]) == ()


class Page(HTMLParser):
    """Collects tags, ids and what would be fetched from elsewhere."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: set[str] = set()
        self.fetched: list[str] = []
        self.data = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        self.ids.add(found.get("id") or "")
        if tag in ("script", "img", "link") and (found.get("src") or found.get("href")):
            self.fetched.append(tag)
        if tag not in ("meta", "input", "img", "br", "link"):
            self.open.append("run-data" if found.get("id") == "run-data" else tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.ids.add(dict(attrs).get("id") or "")

    def handle_endtag(self, tag: str) -> None:
        top = self.open.pop()
        assert tag == ("script" if top == "run-data" else top)

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] == "run-data":
            self.data += data


def test_report_is_one_whole_page(folder: Path) -> None:
    text = (folder / "report.html").read_text()
    assert len(text) < 8_000_000
    page = Page()
    page.feed(text)
    page.close()
    assert not page.open and not page.fetched
    assert {"picture", "slider", "timeline", "cursor", "eye", "scene", "run-data"} <= page.ids
    assert "kit&lt;chen" in text and "<h1>kit<chen" not in text
    for words in ("Tracks over time", "From above", "Completed furniture", "Time by stage"):
        assert words in text
    assert "2 frames without a pose were skipped" in text
    pictures = json.loads(page.data)["pictures"]
    assert len(pictures) == FRAMES and pictures[3]["frame"] == 3
    assert "1 bed tracked" in pictures[0]["alt"]
    assert "1 bed: occluded, frames 5 to 6" in text


def test_interrupted_run_keeps_what_was_done(tmp_path: Path) -> None:
    with (
        pytest.raises(KeyboardInterrupt),
        OutputWriter(tmp_path, "s", CAMERA, Config(), replay=False) as writer,
    ):
        feed(writer, 3)
        raise KeyboardInterrupt
    run = read_predictions(tmp_path)
    assert not run.complete and len(run.frames) == 3 and run.tracks == ()
    same(run.frames[2].objects[1], entries(2)[1])
    assert len((tmp_path / "tracks.txt").read_text().splitlines()) == 1 + 4
    assert not list(tmp_path.rglob("*.part"))


def test_frames_of_another_camera_are_told_of(tmp_path: Path) -> None:
    frame = make_frame(0)
    other = Camera(CAMERA.K + np.diag([1.0, 1.0, 0]), CAMERA.width, CAMERA.height)
    with OutputWriter(tmp_path, "s", CAMERA, Config(), replay=False) as writer:
        writer.add_frame(frame, (), {})
        assert writer.finish(()).warnings == ()
    with OutputWriter(tmp_path, "s", CAMERA, Config(), replay=False) as writer:
        writer.add_frame(dataclasses.replace(frame, camera=other), (), {})
        assert "another camera" in writer.finish(()).warnings[0]


def test_interrupted_run_can_be_finished(tmp_path: Path) -> None:
    with OutputWriter(tmp_path, "s", CAMERA, Config(), replay=False) as writer:
        feed(writer, 3)
        writer.finish(tracks(3), complete=False)
    run = read_predictions(tmp_path)
    assert not run.complete and len(run.tracks) == 2
    assert "interrupted" in (tmp_path / "report.html").read_text()


def test_saves_periodically(tmp_path: Path) -> None:
    writer = OutputWriter(tmp_path, "s", CAMERA, Config(), save_every=3, replay=False)
    feed(writer, 5)  # the process dies here
    assert len(read_predictions(tmp_path).frames) == 3


def test_long_recordings_are_saved_less_often(tmp_path: Path, monkeypatch) -> None:
    """Files are written whole: every so many frames would take ever longer."""
    saved = []
    monkeypatch.setattr(OutputWriter, "_save", lambda self, run: saved.append(len(run.frames)))
    writer = OutputWriter(tmp_path, "s", CAMERA, Config(), save_every=2, replay=False)
    for n in range(200):
        writer.add_frame(make_frame(n), [], TIMINGS_MS)
    assert saved[:4] == [0, 2, 4, 6]
    late = [frames for frames in saved if frames > 100]
    assert all(5 <= b - a <= 10 for a, b in pairwise(late)) and late[-1] > 190


def test_offline_histories_replace_the_online_ones(tmp_path: Path) -> None:
    merged = [dataclasses.replace(entry, track_id=9) for n in range(3) for entry in entries(n)[:1]]
    track = Track(9, 1, tuple(merged), box_grid(merged[0].extents_m))
    with OutputWriter(tmp_path, "s", CAMERA, Config(), replay=False) as writer:
        feed(writer, 3)
        writer.finish([track])
    run = read_predictions(tmp_path)
    assert {e.track_id for frame in run.frames for e in frame.objects} == {9}
    assert set(run.class_ids) == {9}


def test_no_frames_no_tracks_and_empty_reconstruction(tmp_path: Path) -> None:
    with OutputWriter(tmp_path / "empty", "s", CAMERA, Config(), replay=False) as writer:
        writer.finish([])
    assert read_predictions(tmp_path / "empty").tracks == ()
    hollow = dataclasses.replace(tracks(3)[0], canonical=np.zeros((64, 64, 64), dtype=np.float32))
    with OutputWriter(tmp_path / "hollow", "s", CAMERA, Config(), replay=False) as writer:
        feed(writer, 3)
        writer.finish([hollow])
    run = read_predictions(tmp_path / "hollow")
    assert run.mesh_files == {} and "track 1 has an empty reconstruction" in run.warnings[0]


def test_a_driver_may_fill_its_arrays_anew(tmp_path: Path) -> None:
    """The report's pictures are of the frames as they were when they were given."""
    pages = []
    for reused in (False, True):
        color, depth = np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8), make_frame(0).depth_m
        depth = depth.copy()
        with OutputWriter(tmp_path / str(reused), "s", CAMERA, Config(), replay=False) as writer:
            for n in range(FRAMES):
                color[:], depth[:] = 30 * n, make_frame(n).depth_m
                given = (depth, color) if reused else (depth.copy(), color.copy())
                frame = dataclasses.replace(make_frame(n), depth_m=given[0], color=given[1])
                writer.add_frame(frame, entries(n), TIMINGS_MS)
            writer.finish(tracks())
        pages.append((tmp_path / str(reused) / "report.html").read_text())
    assert pages[0] == pages[1]


def test_what_cannot_be_written_costs_no_earlier_result(folder: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(folder, copy)
    before = sorted(path.name for path in copy.rglob("*"))
    no_text: Any = Path("other")
    with pytest.raises(TypeError):
        OutputWriter(copy, no_text, CAMERA, Config()).add_frame(make_frame(0), (), {})
    assert sorted(path.name for path in copy.rglob("*")) == before
    assert read_predictions(copy).tracks


def test_a_name_that_is_no_text_is_no_obstacle(tmp_path: Path) -> None:
    with OutputWriter(tmp_path, "K\udcfcche", CAMERA, Config(), replay=False) as writer:
        feed(writer)
        writer.finish(tracks())
    assert read_predictions(tmp_path).complete and (tmp_path / "report.html").exists()


def test_an_earlier_run_is_replaced_but_other_files_stay(tmp_path: Path) -> None:
    with OutputWriter(tmp_path, "s", CAMERA, Config(), replay=False) as writer:
        feed(writer, 3)
        writer.finish(tracks(3))
    (tmp_path / "notes.txt").write_text("mine")
    with OutputWriter(tmp_path, "s", CAMERA, Config(), replay=False) as writer:
        assert len(read_predictions(tmp_path).tracks) == 2  # until there is a frame
    assert len(read_predictions(tmp_path).tracks) == 2
    writer = OutputWriter(tmp_path, "s", CAMERA, Config(), replay=False)
    feed(writer, 1)  # the process dies here
    left = sorted(p.name for p in tmp_path.rglob("*") if p.is_file())
    assert left == ["config.json", "notes.txt", "timings.json", "tracks.json", "tracks.txt"]
    OutputWriter(tmp_path, "s", CAMERA, Config(), replay=False)  # that is a result, too


def test_folder_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match=r"file.*--out"):
        OutputWriter(tmp_path / "file", "s", CAMERA, Config())


def edit(data: dict, path: str, value: object) -> None:
    *parents, last = path.split("/")
    for key in parents:
        data = data[int(key) if key.isdigit() else key]
    data[last] = value


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("schema", "composenet.tracks/9", "tracks/9"),
        ("meta/camera", {"K": [[1]], "width": 4, "height": 3}, "meta"),
        ("meta/T_level_source", [[1.0]], "meta"),
        ("frames/1/objects/0/class", "lamp", r"frames\[1\].*lamp"),
        ("frames/2/objects/0/state", "happy", r"frames\[2\].*happy"),
        ("frames/2/objects/1/box", {"center": [0, 0, 0]}, r"frames\[2\] lacks 'extents'"),
        ("frames/0/T_world_camera", [[float("nan")] * 4] * 4, r"frames\[0\].*finite"),
        ("frames/0/objects/0/S_world_canonical/quaternion_wxyz", [0, 0, 0, 0], r"frames\[0\]"),
        ("frames/0/objects/0/id", 77, "track 77"),
        ("frames", None, "frames"),
        ("tracks", [3], "tracks"),
    ],
)
def test_broken_tracks_json(
    folder: Path, tmp_path: Path, path: str, value: object, words: str
) -> None:
    data = json.loads((folder / "tracks.json").read_text())
    edit(data, path, value)
    (tmp_path / "tracks.json").write_text(json.dumps(data))
    with pytest.raises(DataError, match=words) as caught:
        read_predictions(tmp_path)
    assert "tracks.json" in str(caught.value) and "\n" not in str(caught.value)


def test_broken_folders(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"tracks\.json: no such file"):
        read_predictions(tmp_path)
    text = (folder / "tracks.json").read_text()
    (tmp_path / "tracks.json").write_text(text[:100])
    with pytest.raises(DataError, match="not readable as JSON"):
        read_predictions(tmp_path)
    (tmp_path / "tracks.json").write_text(text)
    with pytest.raises(DataError, match=r"canonical\.npz"):
        read_predictions(tmp_path)
    (tmp_path / "canonical.npz").write_bytes((folder / "canonical.npz").read_bytes()[:300])
    with pytest.raises(DataError, match=r"canonical\.npz"):
        read_predictions(tmp_path)
    whole = bytearray((folder / "canonical.npz").read_bytes())
    for start in range(60, 300, 12):
        damaged = bytearray(whole)
        damaged[start : start + 6] = b"damage"
        (tmp_path / "canonical.npz").write_bytes(damaged)
        with pytest.raises(DataError, match=r"canonical\.npz"):
            read_predictions(tmp_path)
    with (tmp_path / "canonical.npz").open("wb") as file:
        np.save(file, np.zeros(3))  # one array, not several
    with pytest.raises(DataError, match=r"canonical\.npz"):
        read_predictions(tmp_path)
    flat = json.loads(text)
    flat["meta"]["camera"]["K"][0][0] = 0
    (tmp_path / "tracks.json").write_text(json.dumps(flat))
    with pytest.raises(DataError, match=r"tracks\.json"):
        read_predictions(tmp_path)
    (tmp_path / "tracks.json").write_text(text)
    np.savez(tmp_path / "canonical.npz", track_1=np.zeros((2, 2, 2)))
    with pytest.raises(DataError, match=r"track 1 has shape \(2, 2, 2\)"):
        read_predictions(tmp_path)
