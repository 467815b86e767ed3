"""What is written comes back exactly; nothing is ever half written."""

import errno
import json
import os
import shutil
import socket
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from composenet.errors import DataError
from composenet.synth import cad, dataset, sequence_folder
from composenet.synth.scene import Scene, SceneOptions, generate_scene

OPTIONS = SceneOptions(frames=3, image_size=(160, 120))


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Scene, Path]:
    out = tmp_path_factory.mktemp("data")
    (folder,) = dataset.write_split("val", 1, out, 5, OPTIONS)
    return generate_scene("val", 5, OPTIONS), folder


def test_truth_comes_back_exactly(written: tuple[Scene, Path]) -> None:
    scene, folder = written
    ours, theirs = scene.truth, sequence_folder.read_truth(folder)
    assert theirs.image_size == ours.image_size == (160, 120)
    for a, b in zip(ours.objects, theirs.objects, strict=True):
        assert (a.gt_id, a.class_id, a.symmetry, a.recipe) == (
            b.gt_id,
            b.class_id,
            b.symmetry,
            b.recipe,
        )
        np.testing.assert_array_equal(a.extents_m, b.extents_m)
        np.testing.assert_array_equal(a.occupancy, b.occupancy)
        np.testing.assert_array_equal(a.hull, b.hull)
    for frame_a, frame_b in zip(ours.frames, theirs.frames, strict=True):
        for p, q in zip(frame_a, frame_b, strict=True):
            assert (p.gt_id, p.visible_pixels, p.visible_fraction, p.moving) == (
                q.gt_id,
                q.visible_pixels,
                q.visible_fraction,
                q.moving,
            )
            np.testing.assert_array_equal(p.T_world_object, q.T_world_object)
            np.testing.assert_array_equal(p.box.center, q.box.center)
            np.testing.assert_array_equal(p.box.extents, q.box.extents)


def test_images_come_back_exactly(written: tuple[Scene, Path]) -> None:
    scene, folder = written
    for i in range(scene.n_frames):
        rendered = scene.render(i)
        depth = np.asarray(Image.open(folder / f"depth/{i}.png"))
        assert depth.dtype == np.uint16
        np.testing.assert_array_equal((depth / 1000.0).astype(np.float32), rendered.frame.depth_m)
        np.testing.assert_array_equal(Image.open(folder / f"instance/{i}.png"), rendered.ids)
        np.testing.assert_array_equal(np.loadtxt(folder / f"pose/{i}.txt"), scene.T_world_camera[i])
        color = np.asarray(Image.open(folder / f"color/{i}.jpg")).astype(int)
        assert np.abs(color - np.asarray(rendered.frame.color)).mean() < 8
    intrinsic = np.loadtxt(folder / "intrinsic/intrinsic_depth.txt")
    np.testing.assert_array_equal(intrinsic[:3, :3], scene.camera.K)


def test_canonical_meshes_are_closed_and_of_diagonal_one(written: tuple[Scene, Path]) -> None:
    scene, folder = written
    for truth in scene.objects:
        mesh = trimesh.load(folder / f"shapes/{truth.gt_id}.ply")
        assert mesh.is_watertight
        assert np.linalg.norm(mesh.extents) == pytest.approx(1.0, abs=0.02)
        np.testing.assert_allclose(mesh.bounds.mean(axis=0), 0.0, atol=0.01)
        share = truth.occupancy.mean() * np.prod(truth.extents_m)
        volume = mesh.volume * np.linalg.norm(truth.extents_m) ** 3
        assert volume == pytest.approx(share, rel=0.35, abs=0.003)


def test_finished_sequences_are_kept(written: tuple[Scene, Path]) -> None:
    _, folder = written
    before = (folder / "annotations.json").stat().st_mtime_ns
    dataset.write_split("val", 1, folder.parent, 5, OPTIONS)
    assert (folder / "annotations.json").stat().st_mtime_ns == before
    with pytest.raises(DataError, match="n_frames"):
        dataset.write_split(
            "val", 1, folder.parent, 5, SceneOptions(frames=4, image_size=(160, 120))
        )


def test_sequences_of_other_meshes_are_not_taken_for_finished(tmp_path: Path) -> None:
    options = []
    for name, width in (("a", 0.5), ("b", 0.6)):
        (tmp_path / name / "table").mkdir(parents=True)
        mesh = trimesh.creation.box([1.0, 0.7, width]).subdivide_loop(1 if name == "b" else 0)
        mesh.export(tmp_path / name / "table" / "plain.ply")
        options.append(replace(OPTIONS, cad_dir=tmp_path / name, cad_share=1.0))
    (folder,) = dataset.write_split("val", 1, tmp_path / "out", 5, options[0])
    assert dataset.write_split("val", 1, tmp_path / "out", 5, options[0]) == (folder,)
    with pytest.raises(DataError, match="holds a sequence with cad_meshes"):
        dataset.write_split("val", 1, tmp_path / "out", 5, options[1])
    path = folder / "annotations.json"
    older = json.loads(path.read_text())
    assert older.pop("cad_meshes") == cad.digest(tmp_path / "a")
    path.write_text(json.dumps(older))  # written before the meshes were told of
    assert dataset.write_split("val", 1, tmp_path / "out", 5, options[1]) == (folder,)


def test_damaged_shapes_are_told_of(written: tuple[Scene, Path], tmp_path: Path) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(written[1], folder)
    path = next((folder / "shapes").glob("*.npz"))
    whole = path.read_bytes()
    spoiled = whole[:80] + bytes(64) + whole[144:]
    for content in (whole[: len(whole) // 2], b"", spoiled):
        path.write_bytes(content)
        with pytest.raises(DataError, match="damaged"):
            sequence_folder.read_truth(folder)


def test_interruption_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(dataset, "canonical_mesh", stop)
    with pytest.raises(KeyboardInterrupt):
        dataset.write_split("val", 1, tmp_path, 0, OPTIONS)
    assert list(tmp_path.iterdir()) == []


def test_what_a_killed_run_left_is_removed(tmp_path: Path) -> None:
    """But not what another run, here or elsewhere, is at."""
    here, gone, me = socket.gethostname(), 2**22 + 1, os.getpid()
    names = {f".val_00009.partial-{host}-{pid}" for host, pid in ((here, me), ("other", gone))}
    for name in (*names, f".val_00009.partial-{here}-{gone}"):
        (tmp_path / name / "depth").mkdir(parents=True)
    dataset.write_split("val", 1, tmp_path, 5, OPTIONS)
    assert {path.name for path in tmp_path.iterdir()} == {*names, "val_00005"}


def test_a_sequence_that_another_run_has_written_meanwhile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = dataset.write_sequence

    def late(scene: Scene, folder: Path) -> None:
        write(scene, folder)
        write(scene, folder)

    monkeypatch.setattr(dataset, "write_sequence", late)
    assert dataset.write_split("val", 1, tmp_path, 5, OPTIONS) == (tmp_path / "val_00005",)
    assert [path.name for path in tmp_path.iterdir()] == ["val_00005"]


def test_a_full_disk_names_the_sequence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(sequence_folder, "_write_matrix", full)
    with pytest.raises(DataError, match=r"val_00005: cannot be written \(No space left"):
        dataset.write_split("val", 1, tmp_path, 5, OPTIONS)
    assert list(tmp_path.iterdir()) == []


def test_workers_write_the_same(tmp_path: Path, written: tuple[Scene, Path]) -> None:
    _, folder = written
    folders = dataset.write_split("val", 1, tmp_path, 5, OPTIONS, workers=2)
    ours, theirs = folder / "annotations.json", folders[0] / "annotations.json"
    assert ours.read_bytes() == theirs.read_bytes()


@pytest.mark.parametrize("damage", ["missing", "cut", "version", "field"])
def test_bad_annotations_give_one_line(
    tmp_path: Path, written: tuple[Scene, Path], damage: str
) -> None:
    text = (written[1] / "annotations.json").read_text()
    data = json.loads(text)
    if damage == "cut":
        (tmp_path / "annotations.json").write_text(text[:500])
    elif damage == "version":
        (tmp_path / "annotations.json").write_text(json.dumps(data | {"version": 9}))
    elif damage == "field":
        del data["objects"][0]["class"]
        (tmp_path / "annotations.json").write_text(json.dumps(data))
    with pytest.raises(DataError, match=r"annotations\.json") as caught:
        sequence_folder.read_truth(tmp_path)
    assert "\n" not in str(caught.value)


def test_measuring_a_split() -> None:
    (found,) = dataset.measure_split("val", 1, 5, OPTIONS)
    assert len(found.camera_steps_m) == OPTIONS.frames - 1
    assert found.counted >= found.hidden >= 0
