"""Recordings of one's own: what is written is what the generator would have written of them."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from composenet import open_sequence
from composenet.commands.variants import score_variants
from composenet.errors import DataError
from composenet.geometry.transform import make_T, rotation_z
from composenet.synth.annotated import AnnotatedObject, AnnotatedWriter
from composenet.synth.dataset import write_sequence
from composenet.synth.scene import Scene, SceneOptions, generate_scene
from composenet.synth.sequence_folder import UNTOLD, read_truth
from composenet.training.config import TrainingConfig
from composenet.training.data import samples_of_scene
from composenet.training.disk import DiskScene
from composenet.training.targets import UNKNOWN, collate_samples

OPTIONS = SceneOptions(frames=3, image_size=(160, 120))


@pytest.fixture(scope="module")
def scene() -> Scene:
    return generate_scene("val", 5, OPTIONS)


def slot(scene: Scene, gt_id: int) -> int:
    return int(np.flatnonzero(scene.gt_ids == gt_id)[0])


def objects_of(scene: Scene, shift: np.ndarray) -> dict[int, AnnotatedObject]:
    """The furniture with origins that lie elsewhere."""
    found = {}
    for truth in scene.objects:
        shape = scene.shape_of(truth.gt_id)
        mesh = trimesh.Trimesh(shape.vertices + shift, shape.faces, process=False)
        found[truth.gt_id] = AnnotatedObject(shape.class_name, mesh, truth.symmetry)
    return found


def poses_of(scene: Scene, i: int, shift: np.ndarray) -> dict[int, np.ndarray]:
    return {
        truth.gt_id: scene.T_world_shape[i, slot(scene, truth.gt_id)] @ make_T(np.eye(3), -shift)
        for truth in scene.objects
    }


def written(scene: Scene, folder: Path, *, with_ids: bool) -> Path:
    shift = np.array([0.3, -0.2, 0.5])
    with AnnotatedWriter(folder, objects_of(scene, shift)) as writer:
        for i in range(scene.n_frames):
            rendered = scene.render(i)
            ids = rendered.ids if with_ids else None
            writer.add(rendered.frame, poses_of(scene, i, shift), ids)
        writer.finish()
    return folder


def test_it_is_what_the_generator_writes(scene: Scene, tmp_path: Path) -> None:
    write_sequence(scene, tmp_path / "generated")
    expected = read_truth(tmp_path / "generated")
    found = read_truth(written(scene, tmp_path / "own", with_ids=True))
    for a, b in zip(expected.objects, found.objects, strict=True):
        assert (a.gt_id, a.class_id, a.symmetry) == (b.gt_id, b.class_id, b.symmetry)
        np.testing.assert_allclose(b.extents_m, a.extents_m, atol=1e-5)
        # A mesh does not tell which of its parts are closed, as the generator knows.
        both, either = a.occupancy & b.occupancy, a.occupancy | b.occupancy
        assert both.sum() > 0.8 * either.sum()
    for before, now in zip(expected.frames, found.frames, strict=True):
        for p, q in zip(before, now, strict=True):
            assert (p.gt_id, p.visible_pixels, p.moving) == (q.gt_id, q.visible_pixels, q.moving)
            assert q.visible_fraction == pytest.approx(p.visible_fraction, abs=0.01)
            np.testing.assert_allclose(q.T_world_object, p.T_world_object, atol=1e-5)
            np.testing.assert_allclose(q.box.center, p.box.center, atol=1e-5)
            np.testing.assert_allclose(q.box.extents, p.box.extents, atol=1e-5)


def test_depth_tells_what_a_pixel_shows(scene: Scene, tmp_path: Path) -> None:
    disk = DiskScene(written(scene, tmp_path / "own", with_ids=False))
    for i in range(scene.n_frames):
        rendered, ids = scene.render(i), disk.render(i).ids
        measured = rendered.frame.depth_m > 0
        agree = (ids == rendered.ids)[measured].mean()
        assert agree > 0.9 and (ids > 0).sum() > 0.7 * ((rendered.ids > 0) & measured).sum()
        assert not ids[~measured].any()


def test_tracking_and_training_take_its_world_as_it_is(scene: Scene, tmp_path: Path) -> None:
    sequence = open_sequence(written(scene, tmp_path / "own", with_ids=True))
    np.testing.assert_array_equal(sequence.T_level_source, np.eye(4))
    for i, frame in enumerate(sequence):
        np.testing.assert_allclose(frame.T_world_camera, scene.T_world_camera[i])
        assert frame.color is not None


def one_box(**changes: object) -> dict[int, AnnotatedObject]:
    item = AnnotatedObject("table", trimesh.creation.box([1.0, 0.8, 0.7]))
    return {7: replace(item, **changes)}  # type: ignore[arg-type]


TILTED_SHEET = trimesh.Trimesh(
    [[0.0, 0, 0], [1, 0, 0.5], [1, 1, 0.5], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]]
)
UPRIGHT = make_T(rotation_z(0.4), np.array([1.0, 2.0, 0.35]))


def in_view(scene: Scene, i: int = 0) -> np.ndarray:
    """(4, 4) of a one metre box around what the middle of an image shows, on the floor."""
    depth_m = scene.render(i, noise=False).frame.depth_m[60, 80]
    at = scene.T_world_camera[i] @ np.array([0.0, 0.0, depth_m, 1.0])
    return make_T(np.eye(3), np.array([at[0], at[1], max(at[2], 0.35)]))


@pytest.mark.parametrize(("told", "kept"), [(None, "two"), ("four", "four")])
def test_symmetry_is_measured_where_it_is_not_told(
    scene: Scene, tmp_path: Path, told: str | None, kept: str
) -> None:
    ids = np.zeros((120, 160), np.int64)
    ids[60, 80] = 7
    with AnnotatedWriter(tmp_path / "own", one_box(symmetry=told)) as writer:
        writer.add(scene.render(0, noise=False).frame, {7: in_view(scene)}, ids)
        assert writer.finish() == {7: 1}
    (item,) = read_truth(tmp_path / "own").objects
    assert (item.gt_id, item.symmetry.value) == (7, kept)


def test_poses_that_the_images_deny_are_refused(scene: Scene, tmp_path: Path) -> None:
    frame, ids = scene.render(0).frame, np.full((120, 160), 7)
    away = make_T(np.eye(3), np.array([50.0, 0.0, 0.35]))
    for given, message in ((None, "no object seen"), (ids, "object 7 is not where its pixels are")):
        with (
            pytest.raises(DataError, match=f"own: {message}; are poses in the frames' world"),
            AnnotatedWriter(tmp_path / "own", one_box()) as writer,
        ):
            writer.add(frame, {7: away}, given)
            writer.finish()
    assert list(tmp_path.iterdir()) == []


def test_what_nobody_can_tell_is_not_learned_from(scene: Scene, tmp_path: Path) -> None:
    rendered = scene.render(0)
    ids = rendered.ids.astype(np.int64)
    ids[:, :80] = UNTOLD
    with AnnotatedWriter(tmp_path / "own", objects_of(scene, np.zeros(3))) as writer:
        writer.add(rendered.frame, poses_of(scene, 0, np.zeros(3)), ids)
        writer.finish()
    disk = DiskScene(tmp_path / "own")
    assert (disk.render(0).ids[:, :80] == UNKNOWN).all()
    config = TrainingConfig(frames_per_scene=1)
    samples = list(samples_of_scene(disk, config, np.random.default_rng(0), augment=False))
    assert len(samples) == 1
    known = collate_samples(samples).voxel_object > -2
    assert 0 < known.float().mean() < 1


def test_it_is_learned_from_and_scored(scene: Scene, tmp_path: Path, tiny_weights: Path) -> None:
    """As what the generator writes is."""
    folder = written(scene, tmp_path / "own", with_ids=True)
    samples = list(samples_of_scene(DiskScene(folder), TrainingConfig(), np.random.default_rng(0)))
    assert sum(len(sample.gt_id) for sample in samples) > 0
    write_sequence(scene, tmp_path / "generated")
    ours, theirs = (
        score_variants(path, ["full"], weights=tiny_weights, device="cpu")["full"].scores.clear
        for path in (folder, tmp_path / "generated")
    )
    assert ours == theirs


def test_errors_of_the_users_own_are_left_alone(scene: Scene, tmp_path: Path) -> None:
    with (
        pytest.raises(FileNotFoundError, match=r"poses/7\.npy"),
        AnnotatedWriter(tmp_path / "own", one_box()) as writer,
    ):
        writer.add(scene.render(0).frame, {7: UPRIGHT})
        np.load("poses/7.npy")
    with pytest.raises(DataError, match="`with` statement"):
        AnnotatedWriter(tmp_path / "own", one_box()).add(scene.render(0).frame, {7: UPRIGHT})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"class_name": "lamp"}, "class 'lamp'; expected bathtub, bed"),
        ({"mesh": trimesh.creation.box([1000.0, 800.0, 700.0])}, "1e.03 m long; .* metres"),
        ({"mesh": trimesh.creation.box([1.0, 0.8, 0.001])}, "0.001 m thick"),
        ({"mesh": trimesh.Trimesh()}, "no mesh with faces"),
        ({"mesh": trimesh.Scene()}, "no mesh with faces"),
        ({"mesh": TILTED_SHEET}, "its mesh is flat"),
        ({"symmetry": "three"}, "symmetry 'three'; expected none, two, four, inf"),
    ],
)
def test_what_cannot_be_learned_is_refused(
    tmp_path: Path, changes: dict[str, object], message: str
) -> None:
    with pytest.raises(DataError, match=message):
        AnnotatedWriter(tmp_path / "own", one_box(**changes))


def bad_calls(scene: Scene) -> Iterator[tuple[str, dict[str, object]]]:
    scaled, tilted = UPRIGHT.copy(), UPRIGHT.copy()
    scaled[:3, :3] *= 1.3
    tilted[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    frame = scene.render(0).frame
    yield "no rigid motion .* scale belongs into its mesh", {"T_world_objects": {7: scaled}}
    yield "tilted by 90 degrees", {"T_world_objects": {7: tilted}}
    sunk = make_T(np.eye(3), np.array([1.0, 2.0, -3.0]))
    yield r"reaches 3\.[34] m below the floor", {"T_world_objects": {7: sunk}}
    yield "no pose of object 7", {"T_world_objects": {}}
    yield "no camera pose", {"frame": replace(frame, pose_known=False)}
    yield "ids hold 3, which is no object", {"ids": np.full((120, 160), 3)}
    yield r"ids are int64 of shape \(2, 2\)", {"ids": np.zeros((2, 2), np.int64)}
    yield "ids are float64", {"ids": np.zeros((120, 160))}


def test_bad_frames_are_named_and_nothing_stays(scene: Scene, tmp_path: Path) -> None:
    frame = scene.render(0).frame
    for message, changes in bad_calls(scene):
        arguments = {"frame": frame, "T_world_objects": {7: UPRIGHT}} | changes
        with (
            pytest.raises(DataError, match="own, frame 1: .*" + message),
            AnnotatedWriter(tmp_path / "own", one_box()) as writer,
        ):
            writer.add(frame, {7: UPRIGHT})
            writer.add(**arguments)  # type: ignore[arg-type]
        assert list(tmp_path.iterdir()) == []
    with (
        pytest.raises(DataError, match="no frame was added"),
        AnnotatedWriter(tmp_path / "own", one_box()) as writer,
    ):
        writer.finish()
    with pytest.raises(DataError, match="no object"):
        AnnotatedWriter(tmp_path / "own", {})
    with pytest.raises(DataError, match="ids from 1"):
        AnnotatedWriter(tmp_path / "own", {0: one_box()[7]})


def test_a_writer_that_failed_begins_anew(scene: Scene, tmp_path: Path) -> None:
    writer, ids = AnnotatedWriter(tmp_path / "own", one_box()), np.zeros((120, 160), np.int64)
    ids[60, 80] = 7
    frame = scene.render(0, noise=False).frame
    with pytest.raises(ZeroDivisionError), writer:
        writer.add(frame, {7: in_view(scene)}, ids)
        raise ZeroDivisionError
    with pytest.raises(DataError, match="no frame was added"):
        writer.finish()
    with writer:
        writer.add(frame, {7: in_view(scene)}, ids)
        assert writer.finish() == {7: 1}
    assert len(read_truth(tmp_path / "own").frames) == 1


def test_another_camera_is_refused(scene: Scene, tmp_path: Path) -> None:
    frame = scene.render(0).frame
    camera = replace(frame.camera, K=frame.camera.K * [[1.1], [1.0], [1.0]])
    with (
        pytest.raises(DataError, match="frame 1 is of another camera"),
        AnnotatedWriter(tmp_path / "own", one_box()) as writer,
    ):
        writer.add(frame, {7: UPRIGHT})
        writer.add(replace(frame, camera=camera), {7: UPRIGHT})


def test_a_folder_that_is_there_is_not_touched(tmp_path: Path) -> None:
    """And it is said before hours of work."""
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "mine.txt").write_text("x")
    with (
        pytest.raises(DataError, match="own: is there already"),
        AnnotatedWriter(tmp_path / "own", one_box()),
    ):
        pytest.fail("it was entered")
    assert [p.name for p in tmp_path.iterdir()] == ["own"]
