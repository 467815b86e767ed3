"""Scenes: repeatable, physically possible, with truth that agrees with the images."""

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import manifold3d as m3
import numpy as np
import pytest
import trimesh
from rich.console import Console

from composenet.commands.terminal import warn_of_cad
from composenet.errors import DataError
from composenet.geometry.transform import apply_T
from composenet.records import (
    CLASS_NAMES,
    Box,
    ObjectFrameTruth,
    ObjectTruth,
    SequenceTruth,
    Symmetry,
)
from composenet.synth import cad, furnish, stats
from composenet.synth.furniture import FURTHER_STYLES
from composenet.synth.occupancy import occupancy
from composenet.synth.room import make_room
from composenet.synth.scene import Scene, SceneOptions, generate_scene, stretched
from composenet.synth.solid import union_of

SHARED_CAD = Path(__file__).resolve().parents[2] / "shared" / "cad"
SHORT = SceneOptions(frames=6)


@pytest.fixture(scope="module")
def scenes() -> list[Scene]:
    return [generate_scene("val", i) for i in range(8)]


def floor_rectangle(scene: Scene, frame: int, slot: int) -> m3.CrossSection:
    ex, ey, _ = scene.shapes[slot].extents_m
    T = scene.T_world_shape[frame, slot]
    corners = np.array([[-ex, -ey], [ex, -ey], [ex, ey], [-ex, ey]]) / 2
    return m3.CrossSection([corners @ T[:2, :2].T + T[:2, 3]])


def placed_solid(scene: Scene, frame: int, slot: int) -> m3.Manifold:
    solid = union_of(scene.shapes[slot])
    assert solid is not None
    return solid.transform(scene.T_world_shape[frame, slot, :3])


def bottoms(scene: Scene, frame: int) -> np.ndarray:
    heights = np.array([shape.extents_m[2] for shape in scene.shapes])
    return scene.T_world_shape[frame, :, 2, 3] - heights / 2


@pytest.mark.parametrize("index", [58, 142, 170, 185])
def test_nothing_drives_over_the_camera(index: int) -> None:
    """In these rooms something did, before the camera was asked for."""
    scene = generate_scene("val", index)
    for i in range(scene.n_frames):
        eye = scene.T_world_camera[i, :3, 3]
        for slot in range(1, len(scene.shapes)):
            local = apply_T(np.linalg.inv(scene.T_world_shape[i, slot]), eye[None])[0]
            assert (np.abs(local) > scene.shapes[slot].extents_m / 2).any(), (i, slot)


def test_no_corridor_reaches_into_the_room() -> None:
    """Behind the door of a notch's wall it would."""
    rng = np.random.default_rng(0)
    rooms = [make_room(rng, (6.0, 5.0)) for _ in range(120)]
    notched, doors = 0, 0
    for room in rooms:
        if room.notch is None:
            continue
        notched += 1
        mesh = trimesh.Trimesh(room.shape.vertices, room.shape.faces, process=False)
        points, _ = trimesh.sample.sample_surface(mesh, 20_000, seed=0)
        points = points + room.origin
        doors += (points[:, :2] < -0.9).any() or (points[:, :2] > np.array([6.9, 5.9])).any()
        x, y, _, half_x, half_y = room.notch
        standing = (points[:, 2] > 0.3) & (points[:, 2] < 2.2)
        inside = ((points[:, :2] > 0.1) & (points[:, :2] < np.array([5.9, 4.9]))).all(axis=1)
        off = np.abs(points[:, :2] - (x, y))
        cut = (off < np.array([half_x, half_y]) + 0.1).all(axis=1)
        assert not (standing & inside & ~cut).any()
    assert notched > 20 and doors > 5


def test_a_scene_is_a_function_of_split_and_index() -> None:
    a, b = generate_scene("test", 7, SHORT), generate_scene("test", 7, SHORT)
    for i in (0, 3):
        first, second = a.render(i), b.render(i)
        np.testing.assert_array_equal(first.frame.depth_m, second.frame.depth_m)
        np.testing.assert_array_equal(first.frame.color, second.frame.color)
        np.testing.assert_array_equal(first.ids, second.ids)
    other = generate_scene("train", 7, SHORT)
    assert not np.array_equal(a.camera.K, other.camera.K)
    assert not np.array_equal(a.camera.K, generate_scene("test", 8, SHORT).camera.K)


@pytest.mark.parametrize(("split", "index"), [("dev", 0), ("train", -1)])
def test_unknown_sequences_are_refused(split: str, index: int) -> None:
    with pytest.raises(DataError, match="train/val/test"):
        generate_scene(split, index)


def test_what_a_room_holds(scenes: list[Scene]) -> None:
    for scene in scenes:
        furniture = np.count_nonzero(scene.gt_ids)
        assert 3 <= furniture <= 9
        assert len(scene.shapes) - 1 - furniture >= 3
        ids = scene.gt_ids[scene.gt_ids > 0]
        np.testing.assert_array_equal(ids, np.arange(1, furniture + 1))


def test_nothing_interpenetrates_or_floats(scenes: list[Scene]) -> None:
    for scene in scenes[:5]:
        for frame in (0, 10, 29):
            bottom = bottoms(scene, frame)[1:]
            assert (bottom > -1e-4).all()
            standing = 1 + np.flatnonzero(bottom < 1e-4)
            rectangles = [floor_rectangle(scene, frame, int(k)) for k in standing]
            for (i, a), (j, b) in combinations(zip(standing, rectangles, strict=True), 2):
                if (a ^ b).area() > 1e-6:  # one is below the other's top
                    assert {"table", "desk"} & {scene.shapes[k].class_name for k in (i, j)}
                    shared = placed_solid(scene, frame, i) ^ placed_solid(scene, frame, j)
                    assert shared.volume() < 1e-9
            # What does not stand on the floor hangs or stands on something below its centre.
            for k in 1 + np.flatnonzero(bottom >= 1e-4):
                if scene.shapes[k].mount_m:
                    assert bottom[k - 1] == pytest.approx(scene.shapes[k].mount_m, abs=1e-4)
                    continue
                at = m3.CrossSection.circle(0.005).translate(scene.T_world_shape[frame, k, :2, 3])
                assert any((at ^ r).area() > 0 for r in rectangles)


def test_chairs_go_below_tables(scenes: list[Scene]) -> None:
    below = 0
    for scene in scenes:
        kinds = [shape.class_name for shape in scene.shapes]
        tops = [k for k, kind in enumerate(kinds) if kind in ("table", "desk")]
        chairs = [k for k, kind in enumerate(kinds) if kind == "chair"]
        overlaps = [
            (floor_rectangle(scene, 0, a) ^ floor_rectangle(scene, 0, b)).area()
            for a in tops
            for b in chairs
        ]
        below += sum(area > 0.02 for area in overlaps)
    assert below >= 3


def test_motion_stays_on_the_ground_and_is_flagged(scenes: list[Scene]) -> None:
    for scene in scenes:
        T = scene.T_world_shape
        np.testing.assert_array_equal(T[:, :, 2, 3], np.broadcast_to(T[0, :, 2, 3], T.shape[:2]))
        np.testing.assert_allclose(T[..., 2, :3], np.broadcast_to([0, 0, 1.0], T[..., 2, :3].shape))
        ids = scene.render(12, color=False).ids
        moved = {
            int(g)
            for g, a, b in zip(scene.gt_ids, T[11], T[12], strict=True)
            if g and not np.array_equal(a, b)
        }
        assert {o.gt_id for o in scene.frame_truth(12, ids) if o.moving} == moved
        ever = (T[1:] != T[:-1]).any(axis=(0, 2, 3))
        assert 1 <= np.count_nonzero(ever & (scene.gt_ids > 0)) <= 3


def test_camera_is_held_by_a_person_in_the_room(scenes: list[Scene]) -> None:
    for scene in scenes:
        assert (np.abs(scene.T_world_camera[:, 2, 3] - 1.4) < 0.55).all()
        np.testing.assert_allclose(np.linalg.det(scene.T_world_camera[:, :3, :3]), 1.0)
        assert (scene.T_world_camera[:, 2, 1] < -0.5).all()  # image y points down
        near = [scene.render(i, color=False, noise=False).clean_depth_m for i in (0, 15)]
        assert all(np.median(depth[depth > 0]) > 0.5 for depth in near)


def test_truth_without_visible_fractions_is_the_same_otherwise(scenes: list[Scene]) -> None:
    ids = scenes[0].render(4, color=False).ids
    whole, less = (scenes[0].frame_truth(4, ids, fractions=wanted) for wanted in (True, False))
    for entry, other in zip(whole, less, strict=True):
        assert np.isnan(other.visible_fraction)
        for name in ("gt_id", "T_world_object", "visible_pixels", "moving"):
            np.testing.assert_array_equal(getattr(entry, name), getattr(other, name))
        np.testing.assert_array_equal(entry.box.center, other.box.center)
        np.testing.assert_array_equal(entry.box.extents, other.box.extents)


def test_truth_agrees_with_the_image(scenes: list[Scene]) -> None:
    scene = scenes[0]
    rendered = scene.render(4)
    truth = scene.frame_truth(4, rendered.ids)
    seen = 0
    for entry in truth:
        assert entry.visible_pixels == np.count_nonzero(rendered.ids == entry.gt_id)
        assert 0.0 <= entry.visible_fraction <= 1.0
        assert (entry.visible_fraction > 0) == (entry.visible_pixels > 0)
        points = scene.shape_of(entry.gt_id).vertices @ entry.T_world_object[:3, :3].T
        points = points + entry.T_world_object[:3, 3]
        np.testing.assert_allclose(entry.box.center - entry.box.extents / 2, points.min(axis=0))
        np.testing.assert_allclose(entry.box.center + entry.box.extents / 2, points.max(axis=0))
        v, u = np.nonzero(rendered.ids == entry.gt_id)
        z = rendered.clean_depth_m[v, u].astype(float)
        K = scene.camera.K
        rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(len(u))])
        world = scene.T_world_camera[4][:3, :3] @ (rays * z) + scene.T_world_camera[4][:3, 3:]
        inside = np.abs(world.T - entry.box.center) <= entry.box.extents / 2 + 1e-3
        assert inside.all()
        seen += len(u) > 0
    assert seen >= 1


def test_others_are_the_clutter(scenes: list[Scene]) -> None:
    count = 0
    for scene in scenes:
        clutter = [k for k, shape in enumerate(scene.shapes) if k and not scene.gt_ids[k]]
        boxes = scene.others(3)
        assert len(boxes) == len(clutter)
        for k, box in zip(clutter, boxes, strict=True):
            assert scene.shapes[k].class_name not in CLASS_NAMES
            points = apply_T(scene.T_world_shape[3, k], scene.shapes[k].vertices.astype(float))
            np.testing.assert_allclose(box.center - box.extents / 2, points.min(axis=0))
            np.testing.assert_allclose(box.center + box.extents / 2, points.max(axis=0))
            count += 1
    assert count >= len(scenes)


def test_object_truth_follows_the_conventions(scenes: list[Scene]) -> None:
    scene = scenes[1]
    truth = scene.object_truth(1)
    assert truth is scene.objects[0]
    assert truth.occupancy.shape == (64, 64, 64)
    assert truth.occupancy.any(axis=(1, 2))[[0, -1]].all()
    np.testing.assert_allclose(np.ptp(truth.hull, axis=0), truth.extents_m, rtol=1e-5)
    np.testing.assert_allclose(truth.hull.min(axis=0), -truth.extents_m / 2, rtol=1e-4)
    with pytest.raises(DataError, match="no object 99"):
        scene.shape_of(99)


def test_images_on_request() -> None:
    scene = generate_scene("train", 3, SceneOptions(frames=3, image_size=(160, 120)))
    plain = scene.render(1, color=False, noise=False)
    assert plain.frame.color is None
    np.testing.assert_array_equal(plain.frame.depth_m, plain.clean_depth_m)
    noisy = scene.render(1)
    assert noisy.frame.color is not None and noisy.frame.color.shape == (120, 160, 3)
    assert not np.array_equal(noisy.frame.depth_m, noisy.clean_depth_m)
    seen = noisy.frame.depth_m > 0
    error = np.abs(noisy.frame.depth_m - noisy.clean_depth_m)[seen]
    assert np.median(error) < 0.05


def test_a_flat_mesh_is_named(tmp_path: Path) -> None:
    write_cad(tmp_path, "chair", trimesh.creation.box([0.5, 0.001, 0.5]))
    with pytest.raises(DataError, match=r"chair/\S+: only 0\.001 m thick"):
        cad.load_shape(cad.load_library(tmp_path)["chair"][0], "chair")


def write_cad(folder: Path, class_name: str, mesh: trimesh.Trimesh) -> None:
    (folder / class_name).mkdir(parents=True, exist_ok=True)
    mesh.export(folder / class_name / "one.obj")


def test_cad_axes_and_symmetry(tmp_path: Path) -> None:
    """A long box in CAD axes: 2 m wide (x), 0.5 m high (y), 1 m deep (z)."""
    write_cad(tmp_path, "desk", trimesh.creation.box([2.0, 0.5, 1.0]))
    write_cad(tmp_path, "table", trimesh.creation.box([1.0, 0.5, 1.0]))
    column = trimesh.creation.cylinder(0.5, 0.8, sections=64)
    column.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    write_cad(tmp_path, "sink", column)
    step = trimesh.util.concatenate(
        [trimesh.creation.box([1, 1, 1]), trimesh.creation.box([1, 2, 0.3])]
    )
    step.apply_translation([0, 0, 0.35])
    write_cad(tmp_path, "chair", step)
    library = cad.load_library(tmp_path)
    shapes = {name: cad.load_shape(files[0], name) for name, files in library.items()}
    np.testing.assert_allclose(shapes["desk"].extents_m, [1.0, 2.0, 0.5], rtol=1e-5)
    found = {name: shape.symmetry for name, shape in shapes.items()}
    assert found["desk"] is Symmetry.TWO
    assert found["table"] is Symmetry.FOUR
    assert found["sink"] is Symmetry.INF
    assert shapes["desk"].watertight


def test_cad_parts_may_face_inwards_or_both_ways(tmp_path: Path) -> None:
    """Nobody sees which way a face looks; what it encloses is solid all the same."""
    legs = [trimesh.creation.box([0.05, 0.4, 0.05]) for _ in range(4)]
    for leg, x, z in zip(legs, (-0.2, -0.2, 0.2, 0.2), (-0.2, 0.2, -0.2, 0.2), strict=True):
        leg.apply_translation([x, -0.225, z])
    seat = trimesh.creation.box([0.5, 0.05, 0.5])
    write_cad(tmp_path, "chair", trimesh.util.concatenate([seat, *legs]))
    for leg in legs:
        leg.invert()
    write_cad(tmp_path, "table", trimesh.util.concatenate([seat, *legs]))
    twice = trimesh.util.concatenate([seat, *legs])
    twice.faces = np.vstack([twice.faces, twice.faces[:, ::-1]])
    write_cad(tmp_path, "desk", twice)
    right, inward, both = (
        occupancy(cad.load_shape(tmp_path / name / "one.obj", name))
        for name in ("chair", "table", "desk")
    )
    assert right[:, :, :20].any()
    np.testing.assert_array_equal(inward, right)
    assert np.mean(both == right) > 0.98


def test_meshes_that_fit_in_no_room_are_told_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(furnish, "MOST_TRIES", 3)
    for name in CLASS_NAMES:
        write_cad(tmp_path, name, trimesh.creation.box([4.9, 3.0, 4.9]))
    (tmp_path / "chair" / "._one.obj").write_text("kept by some file systems")
    with pytest.raises(DataError, match="are the meshes in metres"):
        generate_scene("train", 0, SceneOptions(cad_dir=tmp_path, cad_share=1.0))


def test_cad_front_becomes_x(tmp_path: Path) -> None:
    wedge = trimesh.Trimesh(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 3]], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    )
    write_cad(tmp_path, "sofa", wedge)
    shape = cad.load_shape(tmp_path / "sofa" / "one.obj", "sofa")
    assert shape.symmetry is Symmetry.NONE
    tip = shape.vertices[np.argmax(shape.vertices[:, 0])]
    np.testing.assert_allclose(tip, [1.5, -0.5, -0.5])


def test_cad_folders_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no such folder"):
        generate_scene("train", 0, SceneOptions(cad_dir=tmp_path / "none"))
    (tmp_path / "chairs").mkdir()
    with pytest.raises(DataError, match="CLASS"):
        generate_scene("train", 0, SceneOptions(cad_dir=tmp_path))
    (tmp_path / "chair").mkdir()
    (tmp_path / "chair" / "bad.obj").write_text("not a mesh")
    with pytest.raises(DataError, match=r"bad\.obj"):
        cad.load_shape(tmp_path / "chair" / "bad.obj", "chair")
    write_cad(tmp_path, "bed", trimesh.creation.box([200, 50, 150]))
    with pytest.raises(DataError, match="metres"):
        cad.load_shape(tmp_path / "bed" / "one.obj", "bed")


def test_occupancy_of_a_stretched_mesh_is_kept(tmp_path: Path) -> None:
    """An open box: its winding numbers cost, so its stretched copies reuse its cells."""
    mesh = trimesh.creation.box([1.0, 0.5, 1.0])
    mesh.update_faces(np.arange(len(mesh.faces)) > 0)
    write_cad(tmp_path, "desk", mesh)
    shape = cad.load_shape(tmp_path / "desk" / "one.obj", "desk")
    assert not shape.watertight
    wide = stretched(shape, np.random.default_rng(0))
    assert wide.prototype is shape
    np.testing.assert_array_equal(occupancy(wide), occupancy(shape))
    again = stretched(wide, np.random.default_rng(1))
    assert again.prototype is shape
    fresh = occupancy(replace(wide, prototype=None))
    assert np.mean(fresh == occupancy(wide)) > 0.98


def test_cad_replaces_furniture() -> None:
    if not SHARED_CAD.is_dir():
        pytest.skip("no folder of CAD meshes beside the project")
    scene = generate_scene("test", 0, SceneOptions(frames=3, cad_dir=SHARED_CAD, cad_share=1.0))
    styles = [s.style for s, g in zip(scene.shapes, scene.gt_ids, strict=True) if g]
    assert styles and all(style.startswith("cad:") for style in styles)
    assert scene.render(0).ids.any()


def hand_truth(visible: list[list[int]]) -> SequenceTruth:
    """Two chairs; the second moves 10 cm and turns 5 degrees in the last frame."""
    objects = tuple(
        ObjectTruth(k, 4, Symmetry.NONE, np.ones(3), np.ones((64,) * 3, bool), np.zeros((4, 3)))
        for k in (1, 2)
    )
    frames = []
    for f, pixels in enumerate(visible):
        last = f == len(visible) - 1
        turned = np.eye(4)
        if last:
            c, s = np.cos(np.radians(5)), np.sin(np.radians(5))
            turned[:2, :2], turned[0, 3] = [[c, -s], [s, c]], 0.1
        frames.append(
            tuple(
                ObjectFrameTruth(
                    k + 1,
                    turned if k else np.eye(4),
                    Box(np.zeros(3), np.ones(3)),
                    pixels[k],
                    0.4 if k else 0.9,
                    bool(k and last),
                )
                for k in (0, 1)
            )
        )
    return SequenceTruth(objects, tuple(frames))


def test_difficulty_by_hand() -> None:
    truth = hand_truth([[200, 200], [149, 200], [0, 0], [10, 200], [150, 200], [200, 200]])
    cameras = np.tile(np.eye(4), (6, 1, 1))
    cameras[:, 0, 3] = 0.07 * np.arange(6)
    found = stats.difficulty(truth, cameras)
    np.testing.assert_allclose(found.object_steps_m, [0.1])
    np.testing.assert_allclose(found.object_steps_deg, [5.0])
    np.testing.assert_allclose(found.camera_steps_m, 0.07)
    assert (found.counted, found.hidden) == (3 + 5, 5)
    assert (found.seen, found.returning) == (2, 1)  # the first is gone for three frames
    assert found.class_ids == (4, 4)
    lines = {line.quantity: line for line in stats.requirements([found])}
    assert lines["moving objects: median step"].holds
    assert not lines["camera: median step"].holds  # it never turns
    assert lines["visible fraction under 0.5"].measured == "62.5 %"
    assert lines["two objects of one class"].holds
    assert not lines["tracks of the rarest class"].holds


def test_only_training_draws_further_styles() -> None:
    def drawn(split: str, count: int) -> set[str]:
        scenes = [generate_scene(split, index) for index in range(count)]
        return {
            f"{shape.class_name} {shape.style}"
            for scene in scenes
            for shape, gt_id in zip(scene.shapes, scene.gt_ids, strict=True)
            if gt_id
        }

    further = {f"{name} {style}" for name, known in FURTHER_STYLES.items() for style in known}
    assert drawn("train", 10) & further
    assert not (drawn("val", 5) | drawn("test", 5)) & further


def test_folders_that_are_no_class_are_told_of(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_cad(tmp_path, "chair", trimesh.creation.box([0.5, 1.0, 0.5]))
    warn_of_cad(Console(), tmp_path)
    assert capsys.readouterr().out == ""
    write_cad(tmp_path, "lamp", trimesh.creation.box([0.5, 1.0, 0.5]))
    (tmp_path / "textures").mkdir()
    warn_of_cad(Console(), tmp_path)
    assert "lamp left out, which is none of the ten classes" in capsys.readouterr().out
