"""Meshes, pictures, replay: right size, right place, closed."""

from __future__ import annotations

import importlib.util
import re
import socket
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from rich.console import Console
from scipy import ndimage

import composenet
from composenet.errors import DataError
from composenet.geometry.transform import apply_T, make_T
from composenet.predictions import FrameRecord, PredictedSequence
from composenet.records import CLASS_NAMES, Track, TrackState
from composenet.view import figures, meshes, plots, replay, report_svg
from fake_tracks import CAMERA, LOOK_X, box_grid, centres, make_frame, make_object


def test_mesh_is_closed_metric_and_in_place() -> None:
    entry = make_object()
    gone = make_object(frame_index=1, state=TrackState.OCCLUDED, center=(9.0, 9.0, 9.0))
    track = Track(1, 1, (entry, gone), box_grid(entry.extents_m))
    mesh = meshes.track_mesh(track)
    assert mesh is not None and mesh.is_watertight and mesh.volume > 0
    cell_m = entry.S_world_canonical.scale_m / 64
    in_object = (mesh.vertices - entry.S_world_canonical.t) @ entry.S_world_canonical.R
    np.testing.assert_allclose(np.ptp(in_object, axis=0), entry.extents_m, atol=cell_m)
    np.testing.assert_allclose(mesh.bounds.mean(axis=0), entry.box.center, atol=cell_m / 2)


def test_an_objects_mesh_is_that_of_the_world_in_its_own_axes() -> None:
    """Also where it was in an earlier frame."""
    entry = make_object()
    track = Track(1, entry.class_id, (entry,), box_grid(entry.extents_m))
    own, world = meshes.object_mesh(track), meshes.track_mesh(track)
    assert own is not None and world is not None and own.is_watertight
    last = meshes.last_observed(track.history)
    np.testing.assert_allclose(
        apply_T(last.T_world_object, np.asarray(own.vertices)), world.vertices, atol=1e-9
    )
    S = last.S_world_canonical
    np.testing.assert_allclose(last.T_world_object, make_T(S.R, S.t))
    assert last.class_name == track.class_name == CLASS_NAMES[track.class_id]
    assert meshes.object_mesh(replace(track, history=())) is None


def test_what_users_import_is_at_the_top() -> None:
    assert sorted(composenet._MODULES) == composenet.__all__
    assert all(getattr(composenet, name) is not None for name in composenet.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        composenet.nothing  # noqa: B018


def test_sphere_volume_and_outward_normals() -> None:
    distance = np.linalg.norm(centres(), axis=-1)
    mesh = meshes.canonical_mesh(np.clip(0.5 + (0.3 - distance) * 32, 0, 1).astype(np.float32))
    assert mesh is not None and mesh.is_watertight
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * 0.3**3, rel=0.01)
    assert ((mesh.face_normals * mesh.triangles_center).sum(axis=1) > 0).all()


def test_full_grid_is_closed_at_its_edge() -> None:
    mesh = meshes.canonical_mesh(np.ones((64, 64, 64), dtype=np.float32))
    assert mesh is not None and mesh.is_watertight
    np.testing.assert_allclose(mesh.extents, 1.0, atol=1 / 64)


def test_small_pieces_are_dropped_and_empty_is_none() -> None:
    grid = np.zeros((64, 64, 64), dtype=np.float32)
    assert meshes.canonical_mesh(grid) is None
    grid[10:30, 10:30, 10:30] = 1
    grid[50:60, 50:60, 50:60] = 1  # an eighth of the volume: kept
    grid[40:42, 5:7, 5:7] = 1  # a thousandth: dropped
    mesh = meshes.canonical_mesh(grid)
    assert mesh is not None and len(mesh.split(only_watertight=True)) == 2


@settings(max_examples=25)
@given(seed=st.integers(0, 10_000), share=st.floats(0.05, 0.9))
def test_any_grid_gives_a_closed_mesh(seed: int, share: float) -> None:
    grid = np.random.default_rng(seed).random((12, 12, 12)) ** (1 / (share + 0.1))
    binary = (grid > 0.6).astype(np.float32)
    for values in (grid, binary):
        mesh = meshes.canonical_mesh(values)
        assert mesh is None or mesh.is_watertight


def test_simplified_stays_closed_and_close() -> None:
    mesh = meshes.canonical_mesh(box_grid(np.array([0.6, 1.2, 0.8])))
    assert mesh is not None
    small = meshes.simplified(mesh, 0.3 / 64)
    assert small.is_watertight and len(small.faces) < len(mesh.faces) / 20
    assert small.volume == pytest.approx(mesh.volume, rel=0.02)


def test_an_unsure_shape_has_the_mesh_of_a_sure_one() -> None:
    """No cell of a thin shape that was seen seldom need be more likely filled than not."""
    shape = box_grid(np.array([0.6, 1.2, 0.8]))
    sure, unsure = meshes.canonical_mesh(shape), meshes.canonical_mesh(0.4 * shape)
    assert sure is not None and unsure is not None and unsure.is_watertight
    np.testing.assert_allclose(unsure.bounds, sure.bounds, atol=1e-6)


def test_legs_that_nobody_is_sure_of_are_kept() -> None:
    """A board with a leg of half its certainty, two cells thick, blurred as a network's
    guess is, and all of it in a haze that is no part of it."""
    shape = 0.22 * np.exp(-4 * (centres() ** 2).sum(axis=-1))
    shape[12:52, 12:52, 40:44] = 1
    shape[20:22, 20:22, 8:40] = 0.45
    mesh = meshes.canonical_mesh(ndimage.gaussian_filter(shape, 0.5))
    assert mesh is not None and mesh.is_watertight
    assert mesh.bounds[0, 2] == pytest.approx(8 / 64 - 0.5, abs=1 / 64)
    below = mesh.vertices[mesh.vertices[:, 2] < -0.1]
    np.testing.assert_allclose(below[:, :2].mean(axis=0), 21 / 64 - 0.5, atol=0.5 / 64)
    np.testing.assert_allclose(np.ptp(below[:, :2], axis=0), 2 / 64, atol=1 / 64)


@pytest.mark.parametrize("blur_cells", [0.5, 1.0, 2.0])
def test_a_thick_part_is_as_large_as_where_it_is_half_sure(blur_cells: float) -> None:
    shape = np.zeros((64, 64, 64), dtype=np.float32)
    shape[16:48, 16:48, 20:40] = 1
    mesh = meshes.canonical_mesh(ndimage.gaussian_filter(shape, blur_cells))
    assert mesh is not None
    np.testing.assert_allclose(mesh.extents, np.array([32, 32, 20]) / 64, atol=0.5 / 64)


def test_saved_meshes_load_back(tmp_path: Path) -> None:
    entry = make_object()
    mesh = meshes.track_mesh(Track(1, 1, (entry,), box_grid(entry.extents_m)))
    assert mesh is not None
    glb, ply = meshes.save_mesh(mesh, figures.track_color(1), tmp_path / "track_1")
    from_ply = trimesh.load(ply, force="mesh")
    assert from_ply.is_watertight
    np.testing.assert_allclose(from_ply.bounds, mesh.bounds, atol=1e-5)
    assert tuple(from_ply.visual.vertex_colors[0][:3]) == tuple(figures.track_color(1))
    from_glb = trimesh.load(glb, force="mesh")  # y up: world (x, y, z) is (x, z, -y)
    assert from_glb.is_watertight
    expected = mesh.vertices[:, [0, 2, 1]] * [1, 1, -1]
    np.testing.assert_allclose(from_glb.bounds[0], expected.min(axis=0), atol=1e-5)
    light = np.array(from_glb.visual.material.baseColorFactor[:3]) / 255  # glTF: linear
    srgb = 255 * (1.055 * light ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(srgb, figures.track_color(1), atol=2)
    assert not list(tmp_path.glob("*.part"))


def test_depth_colours_mark_missing_and_order() -> None:
    image = figures.depth_to_color(np.array([[0.0, 0.5, 3.0]], dtype=np.float32))
    assert tuple(image[0, 0]) == (128, 128, 128)
    assert image[0, 1].sum() > image[0, 2].sum()
    assert (figures.depth_to_color(np.zeros((2, 2), dtype=np.float32)) == 128).all()


def test_track_colours_are_stable_and_distinct() -> None:
    colors = {tuple(figures.track_color(n)) for n in range(1, 21)}
    assert len(colors) == 20
    assert figures.track_hex(3) == "#" + bytes(figures.track_color(3)).hex()


def test_box_is_drawn_where_it_projects() -> None:
    entry = make_object(center=(3.0, 0.0, 1.0), yaw=0.0, extents=(1.0, 1.0, 1.0))
    image = Image.new("RGB", (80, 60), "black")
    figures.draw_objects(image, CAMERA, LOOK_X, [entry])
    color = figures.track_color(entry.track_id)
    lit = (np.asarray(image) == color).all(axis=-1)
    columns = np.flatnonzero(lit[30:].any(axis=0))  # below the label
    half = 60 * 0.5 / 2.5  # nearest face: 2.5 m away, 0.5 m to each side
    assert columns.min() == pytest.approx(39.5 - half, abs=1.5)
    assert columns.max() == pytest.approx(39.5 + half, abs=1.5)


def test_boxes_behind_or_around_the_camera_do_not_crash() -> None:
    image = Image.new("RGB", (80, 60), "black")
    behind = make_object(center=(-3.0, 0.0, 1.0))
    figures.draw_objects(image, CAMERA, LOOK_X, [behind])
    assert not np.asarray(image).any()
    around = make_object(center=(0.0, 0.0, 1.0), extents=(2.0, 2.0, 2.0))
    ended = make_object(2, state=TrackState.ENDED)
    figures.draw_objects(image, CAMERA, LOOK_X, [around, ended])
    assert np.asarray(image).any()


def test_mesh_overlay_is_fainter_behind_the_measured_depth() -> None:
    cube = trimesh.creation.box((1.0, 1.0, 1.0))
    cube.apply_translation((3.0, 0.0, 1.0))
    mesh = figures.ColoredMesh(cube, np.array([255, 0, 0], dtype=np.uint8))
    blank = np.zeros((60, 80, 3), dtype=np.uint8)

    def draw(depth: float) -> np.ndarray:
        depth_m = np.full((60, 80), depth, dtype=np.float32)
        return figures.overlay_meshes(blank, depth_m, CAMERA, LOOK_X, [mesh])

    seen, hidden = draw(5.0), draw(1.0)
    assert seen[30, 40, 0] > 1.5 * hidden[30, 40, 0] > 0
    assert not seen[0, 0].any()
    assert (figures.overlay_meshes(blank, blank[..., 0], CAMERA, LOOK_X, []) == blank).all()


def test_overlay_scales_and_draws_depth_without_colour() -> None:
    picture = figures.overlay(make_frame(color=False), [make_object()], width=160)
    assert picture.size == (160, 120)


def test_top_view_bounds_hold_camera_and_tracks() -> None:
    entry = make_object(center=(3.0, -2.0, 0.4))
    record = FrameRecord(0, "0", None, LOOK_X, (entry,))
    run = PredictedSequence("s", CAMERA, (record,), {1: 1})
    view = plots.top_view_of(run)
    corners = figures.box_corners(entry)[:, :2]
    assert (view.low < np.minimum(corners.min(axis=0), 0)).all()
    assert (view.high > np.maximum(corners.max(axis=0), 0)).all()
    picture = np.asarray(plots.top_view(run, width=300))
    assert (picture == figures.track_color(1)).all(axis=-1).any()
    plots.top_view(PredictedSequence("empty", CAMERA, (), {}))


def far_apart() -> PredictedSequence:
    """Two objects at the edges of a wide, narrow room."""
    left, right = (make_object(i, center=(x, 0.0, 0.4)) for i, x in ((1, 0.0), (11, 40.0)))
    record = FrameRecord(0, "0", None, LOOK_X, (left, right))
    return PredictedSequence("s", CAMERA, (record,), {1: 1, 11: 2})


def test_labels_at_the_edge_are_whole() -> None:
    drawing = report_svg.TopViewDrawing(plots.top_view_of(far_apart()))
    labels = re.findall(r'<text x="([0-9.]+)"[^>]*text-anchor="middle"[^>]*>([^<]+)<',
                        drawing.svg(far_apart()))  # fmt: skip
    assert [name for _, name in labels] == ["1 bed", "11 bookshelf"]
    for x, name in labels:
        half = 3.5 * len(name)  # narrower than any font of that size draws it
        assert half < float(x) < drawing.width - half
    picture = np.asarray(plots.top_view(far_apart(), width=600)).astype(int)
    for edge in (picture[:, :2], picture[:, -2:]):  # of the second label nothing is cut off
        assert not (np.abs(edge - figures.track_color(11)).max(axis=-1) < 30).any()


@pytest.mark.parametrize(("frames", "stride"), [(1001, 3), (251, 1), (12, 1), (1, 1)])
def test_numbers_of_the_timeline_are_whole(frames: int, stride: int) -> None:
    records = [FrameRecord(stride * n, str(n), None, LOOK_X, ()) for n in range(frames)]
    svg = report_svg.timeline_svg(PredictedSequence("s", CAMERA, tuple(records), {}))
    ticks = re.findall(r'<text x="([0-9.]+)"[^>]*text-anchor="(\w+)"[^>]*>(\d+)<', svg)
    assert int(ticks[-1][2]) >= stride * (frames - 1) * 0.8
    for x, anchor, name in ticks:
        end = float(x) + (0 if anchor == "end" else 6.7 * len(name))
        assert end <= report_svg.TIMELINE_WIDTH


def test_state_segments_join_equal_neighbours() -> None:
    states = [TrackState.TRACKED, TrackState.TRACKED, TrackState.LOST, TrackState.TRACKED]
    history = [make_object(frame_index=10 + 2 * n, state=s) for n, s in enumerate(states)]
    positions = {10 + 2 * n: n for n in range(4)}
    assert plots.state_segments(history, positions) == [
        (0, 1, TrackState.TRACKED),
        (2, 2, TrackState.LOST),
        (3, 3, TrackState.TRACKED),
    ]


def test_contact_sheet() -> None:
    images = [np.full((30, 40, 3), 10 * n, dtype=np.uint8) for n in range(5)]
    sheet = plots.contact_sheet(images, [str(n) for n in range(5)], columns=2, cell=(60, 40))
    assert sheet.size == (128, 186)


def test_a_replay_that_cannot_be_written_is_no_reason_to_wait(tmp_path: Path) -> None:
    class Stuck:
        def flush(self, timeout_sec: float) -> None:
            raise RuntimeError(f"not written in {timeout_sec} s")

        def disconnect(self) -> None:
            raise AssertionError("it would wait for ever")

    stuck = object.__new__(replay.RerunReplay)
    stuck._path, stuck._stream = tmp_path / "replay.rrd", Stuck()
    with pytest.raises(DataError, match=r"replay\.rrd: cannot be written .*disk full"):
        stuck.close()


def test_without_rerun_the_replay_is_nothing(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    nothing = replay.open_replay(tmp_path / "replay.rrd", "s")
    assert "pip install" in nothing.hint and "\n" not in nothing.hint
    nothing.add_frame(make_frame(), [make_object()])
    nothing.finish({})
    nothing.close()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("error", [AttributeError("StateTimelineView"), ImportError("pyarrow")])
def test_another_rerun_is_no_reason_not_to_track(
    error: Exception, tmp_path: Path, monkeypatch
) -> None:
    def unfit(*_: object) -> None:
        raise error

    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object())
    monkeypatch.setattr(replay, "RerunReplay", unfit)
    hint = replay.open_replay(tmp_path / "replay.rrd", "s").hint
    assert "does not fit" in hint and str(error) in hint and "\n" not in hint


@pytest.mark.parametrize("which", ["WEB_PORT", "DATA_PORT"])
def test_a_taken_port_is_said(which: str, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object())
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        for name in ("WEB_PORT", "DATA_PORT"):
            monkeypatch.setattr(replay, name, port if name == which else 0)
        with pytest.raises(DataError, match=f"port {port} is taken.*a b/replay.rrd") as caught:
            replay.serve_replay(tmp_path / "a b" / "replay.rrd", Console())
    assert "\n" not in str(caught.value)


def test_replay_holds_every_entity(tmp_path: Path) -> None:
    chunk = pytest.importorskip("rerun.chunk", reason="the viz extra is not installed")
    path = tmp_path / "replay.rrd"
    stream = replay.open_replay(path, "s")
    for n in range(4):
        state = TrackState.TRACKED if n < 3 else TrackState.ENDED
        stream.add_frame(make_frame(n), [make_object(1, n, state), make_object(2, n)])
    mesh = meshes.canonical_mesh(box_grid(np.array([0.6, 1.2, 0.8])))
    assert mesh is not None
    stream.finish({1: mesh})
    store = chunk.RrdReader(str(path)).store()
    assert [column.name for column in store.schema().index_columns()] == ["frame"]
    entities = set(store.schema().entity_paths())
    for name in ("camera", "camera/depth", "camera/color", "boxes", "tracks/1/mesh", "paths/2"):
        assert f"/world/{name}" in entities
    assert {"/states/track_1_bed", "/states/track_2_bookshelf"} <= entities


def test_what_is_over_is_not_shown_to_the_end_of_the_replay(tmp_path: Path) -> None:
    """Rerun shows the last of what was logged: an image without a successor, a mesh, a state."""
    pytest.importorskip("rerun", reason="the viz extra is not installed")
    logged: list[tuple[int, str, object]] = []
    stream = replay.open_replay(tmp_path / "replay.rrd", "s")
    assert isinstance(stream, replay.RerunReplay)
    at, real_time, real_log = [0], stream._stream.set_time, stream._stream.log

    def set_time(name: str, *, sequence: int) -> None:
        at[0] = sequence
        real_time(name, sequence=sequence)

    def log(entity: str, what: object, *more: object, **options: object) -> None:
        logged.append((at[0], entity, what))
        real_log(entity, what, *more, **options)

    stream._stream.set_time, stream._stream.log = set_time, log
    for n in range(6):
        told = [make_object(1, n)] if n in (1, 2, 4) else []
        stream.add_frame(make_frame(n, color=n < 2), told)
    mesh = meshes.canonical_mesh(box_grid(np.array([0.6, 1.2, 0.8])))
    assert mesh is not None
    stream.finish({1: mesh})

    def of(entity: str) -> list[tuple[int, str]]:
        return [(n, type(what).__name__) for n, name, what in logged if name == entity]

    image, over = "EncodedImage", "Clear"
    assert of("world/camera/color") == [(0, image), (1, image), *((n, over) for n in range(2, 6))]
    assert of("world/tracks/1/mesh") == [(1, "Mesh3D"), (5, over)]
    states = [n for n, name in of("states/track_1_bed") if name == "StateChange"]
    assert states == [1, 3, 4, 5]  # tracked, over, tracked, over
