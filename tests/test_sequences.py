"""Readers of folders and `.sens` files: what each bad input says; no corruption crashes them."""

import json
import shutil
import struct
import zlib
from io import BytesIO
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy.spatial.transform import Rotation

from composenet import config
from composenet.errors import ConfigError, SequenceError
from composenet.geometry.camera import pixel_rays
from composenet.geometry.transform import (
    inverse_T,
    make_T,
    quaternion_from_rotation,
    rotation_z,
)
from composenet.records import Camera, Frame
from composenet.sequences import SequenceOptions, checks, images, open_sequence, sens
from composenet.sequences.source import in_order

SHARED = Path(__file__).resolve().parents[2] / "shared" / "sequences"
WIDTH, HEIGHT, COUNT = 24, 18, 4
K = np.array([[20.0, 0, 11.5], [0, 20.0, 8.5], [0, 0, 1]])
AHEAD = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # looks along +x
DOWN = AHEAD @ Rotation.from_euler("x", -40, degrees=True).as_matrix()


def depth_units(index: int, scale: float = 1000) -> np.ndarray:
    """A floor 1.2 m below the camera and a wall at x = 3; the last column is unmeasured."""
    rays = pixel_rays(Camera(K, WIDTH, HEIGHT)) @ DOWN.T
    depth = np.minimum(1.2 / np.maximum(-rays[..., 2], 1e-6), (3 - 0.1 * index) / rays[..., 0])
    depth[:, -1] = 0
    return np.round(depth * scale).astype(np.uint16)


def pose(index: int) -> np.ndarray:
    return make_T(DOWN, [0.1 * index, 0, 1.2])


def save_depth(path: Path, units: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(units).save(path)


def save_color(path: Path, size: tuple[int, int] = (WIDTH, HEIGHT)) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", size, (200, 30, 30)).save(path)


def save_text(path: Path, numbers: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, numbers)


def write_plain(root: Path, count: int = COUNT) -> Path:
    for i in range(count):
        save_depth(root / f"depth/frame-{i}.png", depth_units(i))
        save_color(root / f"color/frame-{i}.jpg")
        save_text(root / f"pose/frame-{i}.txt", pose(i))
    save_text(root / "camera-intrinsics.txt", K)
    save_text(root / "gravity-direction.txt", np.array([0.0, 0, -1]))
    return root


def write_scannet(root: Path, count: int = COUNT) -> Path:
    for i in range(count):
        save_depth(root / f"depth/{i}.png", depth_units(i))
        save_color(root / f"color/{i}.jpg", (60, 40))
        save_text(root / f"pose/{i}.txt", pose(i))
    K4 = np.eye(4)
    K4[:3, :3] = K
    save_text(root / "intrinsic/intrinsic_depth.txt", K4)
    return root


def write_tum(root: Path, count: int = COUNT) -> Path:
    root.mkdir(parents=True, exist_ok=True)
    depth, color, truth = ["# depth maps"], ["# color"], ["# ground truth"]
    for i in range(count):
        t = 1305031102.1 + i / 30
        save_depth(root / f"depth/{t:.6f}.png", depth_units(i, 5000))
        save_color(root / f"rgb/{t + 0.01:.6f}.png")
        depth.append(f"{t:.6f} depth/{t:.6f}.png")
        color.append(f"{t + 0.01:.6f} rgb/{t + 0.01:.6f}.png")
        w, x, y, z = quaternion_from_rotation(pose(i)[:3, :3])
        tx, ty, tz = pose(i)[:3, 3]
        truth.append(f"{t:.6f} {tx} {ty} {tz} {x} {y} {z} {w}")
    for name, lines in (("depth", depth), ("rgb", color), ("groundtruth", truth)):
        (root / f"{name}.txt").write_text("\n".join(lines) + "\n")
    save_text(root / "camera-intrinsics.txt", K)
    return root


def write_seven_scenes(root: Path, count: int = COUNT) -> Path:
    for i in range(count):
        save_depth(root / f"frame-{i:06d}.depth.png", depth_units(i))
        save_color(root / f"frame-{i:06d}.color.png")
        save_text(root / f"frame-{i:06d}.pose.txt", pose(i))
    save_text(root / "camera-intrinsics.txt", K)
    return root


def sens_bytes(
    count: int = COUNT,
    *,
    version: int = 4,
    color: int = 2,
    depth: int = 1,
    claimed: int = COUNT,
    scale: float = 1000,
    size: tuple[int, int] = (WIDTH, HEIGHT),
) -> bytes:
    """As ScanNet's `sensorData.h` writes it. color: 0 raw, 1 PNG, 2 JPEG; depth: 0 raw, 1 zlib."""
    K4 = np.eye(4)
    K4[:3, :3] = K
    data = struct.pack("<IQ", version, 9) + b"StructIO3"
    for matrix in (2 * K4, np.eye(4), K4, np.eye(4)):
        data += matrix.astype("<f4").tobytes()
    data += struct.pack("<2i4IfQ", color, depth, 60, 40, *size, scale, claimed)
    image = Image.new("RGB", (60, 40), (200, 30, 30))
    for i in range(count):
        stream = BytesIO()
        if color:
            image.save(stream, "JPEG" if color == 2 else "PNG")
        rgb = stream.getvalue() if color else image.tobytes()
        units = depth_units(i, scale).tobytes()
        units = zlib.compress(units) if depth else units
        data += pose(i).astype("<f4").tobytes()
        data += struct.pack("<4Q", 0, 0, len(rgb), len(units)) + rgb + units
    return data + struct.pack("<Q", 0)


def write_sens(root: Path, count: int = COUNT) -> Path:
    root.mkdir(parents=True, exist_ok=True)
    path = root / "scene.sens"
    path.write_bytes(sens_bytes(count, claimed=count))
    return path


def write_open3d(root: Path, count: int = COUNT) -> Path:
    lines = []
    for i in range(count):
        save_depth(root / f"depth/{i:06d}.png", depth_units(i))
        save_color(root / f"color/{i:06d}.jpg")
        lines += [f"{i} {i} {i + 1}", *(" ".join(map(str, row)) for row in pose(i).tolist())]
    (root / "scene").mkdir()
    (root / "scene/trajectory.log").write_text("\n".join(lines) + "\n")
    numbers = {"width": WIDTH, "height": HEIGHT, "intrinsic_matrix": K.T.ravel().tolist()}
    (root / "camera_intrinsic.json").write_text(json.dumps(numbers))
    return root


WRITERS = {
    "plain": write_plain,
    "scannet": write_scannet,
    "tum": write_tum,
    "7-scenes": write_seven_scenes,
    "sens": write_sens,
    "open3d": write_open3d,
}


@pytest.fixture
def plain(tmp_path: Path) -> Path:
    return write_plain(tmp_path / "walk")


@pytest.mark.parametrize("kind", WRITERS)
def test_every_format_gives_the_same_frames(kind, tmp_path):
    sequence = open_sequence(WRITERS[kind](tmp_path / kind))
    frames = list(sequence)
    assert sequence.name == ("scene" if kind == "sens" else kind) and sequence.has_poses
    assert len(sequence) == len(frames) == COUNT
    assert sequence.skipped == [] and sequence.warnings == []
    assert [frame.index for frame in frames] == list(range(COUNT))
    np.testing.assert_array_equal(sequence.camera.K, K)
    for i, frame in enumerate(frames):
        np.testing.assert_allclose(frame.depth_m, depth_units(i) / 1000, atol=6e-4)
        assert frame.depth_m.dtype == np.float32
        assert frame.color.shape == (HEIGHT, WIDTH, 3) and frame.color.dtype == np.uint8
        source = inverse_T(sequence.T_level_source) @ frame.T_world_camera
        np.testing.assert_allclose(source, pose(i), atol=1e-6)
        np.testing.assert_allclose(frame.T_world_camera, pose(i), atol=0.03)


def test_iterates_as_often_as_wanted(plain):
    sequence = open_sequence(plain)
    assert [f.name for f in sequence] == [f.name for f in sequence]


def test_backwards_the_frames_are_the_same(plain):
    sequence = open_sequence(plain)
    there, back = list(sequence), list(reversed(sequence))
    assert len(there) == COUNT
    for one, other in zip(there, back[::-1], strict=True):
        assert (one.index, one.name) == (other.index, other.name)
        np.testing.assert_array_equal(one.depth_m, other.depth_m)
        np.testing.assert_array_equal(one.T_world_camera, other.T_world_camera)
    shutil.rmtree(plain / "pose")
    with pytest.raises(SequenceError, match="in order only"):
        reversed(open_sequence(plain))


@pytest.mark.parametrize(("color", "depth"), [(0, 0), (1, 1), (2, 0), (-1, 1)])
def test_every_compression_of_a_sens_file_is_read(color, depth, tmp_path):
    path = tmp_path / "scene.sens"
    path.write_bytes(sens_bytes(color=max(color, 0), depth=depth))
    if color < 0:  # unknown: the images are left out
        data = bytearray(path.read_bytes())
        data[21 + 256 : 21 + 260] = struct.pack("<i", -1)
        path.write_bytes(bytes(data))
    for i, frame in enumerate(open_sequence(path)):
        np.testing.assert_array_equal(frame.depth_m, (depth_units(i) / 1000).astype(np.float32))
        if color < 0:
            assert frame.color is None
        else:
            np.testing.assert_allclose(frame.color[5, 5], (200, 30, 30), atol=3)


@pytest.mark.parametrize("cut", [20, 100, 2000])
def test_a_sens_file_that_ends_early_keeps_what_it_holds(cut, tmp_path):
    path = tmp_path / "scene.sens"
    path.write_bytes(sens_bytes(depth=0)[:-cut])
    sequence = open_sequence(path)
    left = {20: 1, 100: 1, 2000: 2}[cut]
    assert len(sequence) == len(list(sequence)) == COUNT - left
    assert sequence.warnings == [f"{left} of its {COUNT} frames are missing or damaged"]


def test_a_sens_file_is_read_to_its_first_frame_without_depth(tmp_path):
    path = tmp_path / "scene.sens"
    path.write_bytes(sens_bytes(2, claimed=1 << 40) + bytes(1_000_000))
    sequence = open_sequence(path)
    assert len(sequence) == sequence.recorded == 2
    assert "missing or damaged" in sequence.warnings[0]


def test_a_sens_file_says_its_own_units_and_where_gravity_points(tmp_path):
    path = tmp_path / "SCENE.SENS"
    path.write_bytes(sens_bytes(scale=5000))
    save_text(tmp_path / "gravity-direction.txt", np.array([0.0, 0, -1]))
    sequence = open_sequence(path)
    np.testing.assert_allclose(next(iter(sequence)).depth_m, depth_units(0) / 1000, atol=6e-4)
    np.testing.assert_allclose(sequence.T_level_source[:3, :3], np.eye(3), atol=1e-12)
    assert sequence.name == "SCENE" and sequence.warnings == []


@pytest.mark.parametrize("scale", [0.0, np.nan, np.inf, -1.0])
def test_impossible_units_of_a_sens_file_are_told_of(scale, tmp_path):
    path = tmp_path / "scene.sens"
    data = sens_bytes().replace(struct.pack("<fQ", 1000, COUNT), struct.pack("<fQ", scale, COUNT))
    path.write_bytes(data)
    sequence = open_sequence(path)
    assert "depth units a metre" in sequence.warnings[0]
    np.testing.assert_allclose(next(iter(sequence)).depth_m, depth_units(0) / 1000, atol=6e-4)


def test_intrinsics_that_a_sens_file_lacks_can_be_given(tmp_path):
    path = tmp_path / "scene.sens"
    path.write_bytes(sens_bytes().replace(K.astype("<f4")[0, :1].tobytes(), bytes(4)))
    assert_refused(path, "no intrinsics", "--intrinsics", "the file's header")
    options = SequenceOptions(intrinsics=(20, 20, 11.5, 8.5))
    assert len(list(open_sequence(path, options=options))) == COUNT


def test_colour_that_a_sens_file_lacks_is_told_of(tmp_path):
    path = tmp_path / "scene.sens"
    data = sens_bytes(color=0).replace(bytes((200, 30, 30)) * 2400, b"")
    path.write_bytes(data.replace(struct.pack("<Q", 7200), struct.pack("<Q", 0)))
    sequence = open_sequence(path)
    assert sequence.warnings[0].startswith("4 frames without colour")
    assert len(list(sequence)) == COUNT and len(sequence.warnings) == 1
    path.write_bytes(sens_bytes().replace(struct.pack("<2i", 2, 1), struct.pack("<2i", -1, 1)))
    sequence = open_sequence(path)
    assert "unknown way" in sequence.warnings[0] and next(iter(sequence)).color is None


@pytest.mark.parametrize("size", [(0, 0), (2**32 - 1, 2**32 - 1), (2**32 - 1, 1)])
def test_impossible_sizes_of_a_sens_file_are_refused(size, tmp_path):
    path = tmp_path / "scene.sens"
    path.write_bytes(sens_bytes(size=size))
    assert_refused(path, "none of its frames can be used", "claims to be")


def test_a_packed_image_takes_no_more_memory_than_it_says(tmp_path, monkeypatch):
    path = tmp_path / "packed"
    bomb = zlib.compress(bytes(50_000_000))
    path.write_bytes(bomb)
    sizes = []
    real = np.frombuffer
    monkeypatch.setattr(np, "frombuffer", lambda data, t: sizes.append(len(data)) or real(data, t))
    image = images.PackedImage(path, 0, len(bomb), "zlib uint16", (WIDTH, HEIGHT))
    assert not images.read_depth(image).any()
    assert sizes == [2 * WIDTH * HEIGHT]
    for packing in ("file", "uint16", "rgb", "zlib uint16"):
        with pytest.raises(SequenceError, match="bytes"):
            images.read_depth(images.PackedImage(path, 0, 1 << 40, packing, (WIDTH, HEIGHT)))


def test_odometry_wants_no_poses_of_a_sens_file(tmp_path):
    path = tmp_path / "scene.sens"
    data = sens_bytes()
    for i in range(COUNT):
        data = data.replace(pose(i).astype("<f4").tobytes(), struct.pack("<16f", *[-np.inf] * 16))
    path.write_bytes(data)
    assert_refused(path, "poses in the file", "--odometry")
    source = sens.read_source(path).without_poses()
    assert [frame.problem for frame in source.frames] == [None] * COUNT


def test_a_sens_frame_without_a_pose_or_with_broken_depth_is_skipped(tmp_path):
    path = tmp_path / "scene.sens"
    data = bytearray(sens_bytes())
    first = data.index(pose(0).astype("<f4").tobytes())
    data[first : first + 4] = struct.pack("<f", -np.inf)
    last = bytes(data).rindex(zlib.compress(depth_units(COUNT - 1).tobytes()))
    data[last : last + 8] = b"\0" * 8
    path.write_bytes(bytes(data))
    sequence = open_sequence(path)
    assert [frame.index for frame in sequence] == [1, 2]
    assert [name for name, _ in sequence.skipped] == ["0", "3"]


@pytest.mark.parametrize(
    ("data", "word"),
    [
        (b"", "ends within its header"),
        (b"PK\x03\x04" + bytes(400), "version 4"),
        (sens_bytes()[:200], "ends within its header"),
        (struct.pack("<IQ", 4, 1 << 40) + bytes(400), "sensor name"),
        (sens_bytes(0, claimed=0), "no frame"),
        (sens_bytes(depth=2), "depth compression 2"),
    ],
)
def test_what_is_no_sens_file_is_refused(data, word, tmp_path):
    path = tmp_path / "scene.sens"
    path.write_bytes(data)
    assert_refused(path, "scene.sens", word)


def test_open3d_frames_take_the_poses_of_their_places(tmp_path):
    root = write_open3d(tmp_path / "walk")
    for kind, suffix in (("depth", "png"), ("color", "jpg")):  # names begin at 1, places at 0
        for i in reversed(range(COUNT)):
            (root / f"{kind}/{i:06d}.{suffix}").rename(root / f"{kind}/{i + 1:06d}.{suffix}")
    save_color(root / "color/000000.jpg")  # a colour image without depth has no place
    log = root / "scene/trajectory.log"
    lines = log.read_text().splitlines()
    log.write_text("\n".join([*lines[:5], "", "", *lines[10:]]) + "\n")  # without place 1
    sequence = open_sequence(root)
    assert [frame.index for frame in sequence] == [1, 3, 4]
    for frame in sequence:
        source = inverse_T(sequence.T_level_source) @ frame.T_world_camera
        np.testing.assert_allclose(source, pose(frame.index - 1), atol=1e-6)
    why = "no pose: none of its place in scene/trajectory.log"
    assert sequence.skipped == [("000000", "no depth image"), ("000002", why)]
    (root / "depth/000003.png").unlink()
    assert_refused(root, "trajectory.log", "number 3", "only 3")
    log.unlink()
    assert not open_sequence(root).has_poses and len(open_sequence(root)) == COUNT - 1


def test_intrinsics_of_open3d_may_stand_in_a_plain_folder(tmp_path):
    root = write_plain(tmp_path / "walk")
    numbers = {"intrinsic_matrix": (K + np.diag([1, 1, 0])).T.ravel().tolist()}
    (root / "intrinsic.json").write_text(json.dumps(numbers))
    sequence = open_sequence(root)
    assert sequence.has_poses and sequence.camera.K[0, 0] == 20
    (root / "camera-intrinsics.txt").unlink()
    sequence = open_sequence(root)
    assert sequence.has_poses and sequence.camera.K[0, 0] == 21 and len(sequence) == COUNT
    np.testing.assert_allclose(sequence.T_level_source[:3, :3], np.eye(3), atol=1e-12)


@pytest.mark.parametrize(
    ("file", "text", "word"),
    [
        ("camera_intrinsic.json", "{}", "intrinsic_matrix"),
        ("camera_intrinsic.json", "[1, 2]", "intrinsic_matrix"),
        ("camera_intrinsic.json", '{"intrinsic_matrix": [1, 2, 3]}', "intrinsic_matrix"),
        ("camera_intrinsic.json", '{"intrinsic_matrix": [1,0,0, 0,-1,0, 0,0,1]}', "intrinsics"),
        ("camera_intrinsic.json", f'{{"intrinsic_matrix": [{"9" * 400}]}}', "intrinsic_matrix"),
        ("camera_intrinsic.json", "[" * 200_000, "intrinsic_matrix"),
        ("scene/trajectory.log", "\n\n0 0 1\n1 0 0 0\n", "from line 3"),
        ("scene/trajectory.log", "1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n", "trajectory.log"),
    ],
)
def test_broken_files_of_open3d_are_named(file, text, word, tmp_path):
    root = write_open3d(tmp_path / "walk")
    (root / file).write_text(text)
    assert_refused(root, word)


def test_intrinsics_of_3dmatch_lie_above_its_frames(tmp_path):
    root = write_seven_scenes(tmp_path / "seq-01")
    save_text(tmp_path / "camera-intrinsics.txt", 2 * K)
    np.testing.assert_array_equal(open_sequence(root).camera.K, K)
    (root / "camera-intrinsics.txt").unlink()
    save_text(tmp_path / "camera-intrinsics.txt", K + np.diag([1, 1, 0]))
    assert open_sequence(root).camera.K[0, 0] == 21
    (tmp_path / "camera-intrinsics.txt").unlink()
    assert_refused(root, "--intrinsics", "24x18")


def test_a_7_scenes_frame_without_its_pose_is_skipped_and_without_any_all_are_kept(tmp_path):
    root = write_seven_scenes(tmp_path / "seq-01")
    (root / "frame-000002.pose.txt").unlink()
    (root / "frame-000001.color.png").unlink()
    sequence = open_sequence(root)
    assert [frame.index for frame in sequence] == [0, 1, 3]
    assert sequence.skipped == [("frame-000002", "no pose: no file NAME.pose.txt")]
    assert any("frame-000001" in line and "without colour" in line for line in sequence.warnings)
    for file in root.glob("*.pose.txt"):
        file.unlink()
    assert len(open_sequence(root)) == COUNT and not open_sequence(root).has_poses


@pytest.mark.parametrize("kind", ["sens", "7-scenes"])
def test_what_may_not_be_read_is_named(kind, tmp_path, monkeypatch):
    path = WRITERS[kind](tmp_path / kind)
    refuse = PermissionError(13, "Permission denied")
    monkeypatch.setattr(Path, "open" if kind == "sens" else "iterdir", Mock(side_effect=refuse))
    assert_refused(path, path.name, "cannot be read (Permission denied)")


def test_hidden_files_beside_7_scenes_are_none(tmp_path):
    root = write_seven_scenes(tmp_path / "seq-01")
    for file in root.glob("*.pose.txt"):
        file.rename(root / f"._{file.name}")
    sequence = open_sequence(root)
    assert len(sequence) == COUNT and not sequence.has_poses


def test_a_recording_inside_the_folder_is_pointed_at(tmp_path):
    write_seven_scenes(tmp_path / "redkitchen/seq-01")
    assert_refused(tmp_path / "redkitchen", "seq-01 in it is a recording")
    write_sens(tmp_path / "scene0000_00")
    assert_refused(tmp_path / "scene0000_00", "scene.sens in it is a recording")


def test_names_sort_as_numbers(tmp_path):
    names = [frame.name for frame in open_sequence(write_scannet(tmp_path / "s", 12))]
    assert names == [str(i) for i in range(12)]


def test_stride_and_max_frames_keep_the_recordings_index(tmp_path):
    root = write_plain(tmp_path / "s", 9)
    (root / "depth/frame-3.png").unlink()
    sequence = open_sequence(root, stride=3, max_frames=3)
    assert [frame.index for frame in sequence] == [0, 6]
    assert sequence.skipped == [("frame-3", "no depth image")]


def test_timestamps_come_from_tum(tmp_path):
    times = [frame.timestamp_s for frame in open_sequence(write_tum(tmp_path / "s"))]
    np.testing.assert_allclose(np.diff(times), 1 / 30, atol=1e-5)


def test_a_trajectory_of_another_shape_is_refused(tmp_path):
    root = write_tum(tmp_path / "s")
    path = root / "groundtruth.txt"
    path.write_text(path.read_text().replace(" ", ","))
    assert_refused(root, "groundtruth.txt", "none of its", "qx qy qz qw")


def test_colour_at_other_times_is_told_of(tmp_path):
    root = write_tum(tmp_path / "s")
    lines = (root / "rgb.txt").read_text().splitlines()
    (root / "rgb.txt").write_text("\n".join(lines[:2]) + "\n")
    sequence = open_sequence(root)
    assert sum(frame.color is None for frame in sequence) == COUNT - 1
    (line,) = sequence.warnings
    what = "rgb.txt has none within 0.02 s"
    assert line.startswith(f"{COUNT - 1} frames without colour: {what}")


def test_poses_of_other_times_are_told_from_those_around(tmp_path):
    """A trajectory at 50 Hz beside images at 30; one broken line, and a gap."""
    root = write_tum(tmp_path / "s", 8)
    times = [float(line.split()[0]) for line in (root / "depth.txt").read_text().splitlines()[1:]]
    lines = []
    for t in times[0] + np.arange(-2, 14) / 50 + 0.007:
        share = 30 * (t - times[0])
        lines.append(f"{t:.6f} {0.3 * share - 1} 0 1 0 0 {np.sin(share / 20)} {np.cos(share / 20)}")
    lines[3] = lines[3].replace(" 1 0 0 ", " nan 0 0 ")
    (root / "groundtruth.txt").write_text("\n".join(lines) + "\n")
    sequence = open_sequence(root)
    frames = list(sequence)
    assert [frame.index for frame in frames] == [0, 2, 3, 4, 5, 6, 7]
    assert [why for _, why in sequence.skipped] == ["pose is not finite (NaN or inf)"]
    for frame in frames:
        T = inverse_T(sequence.T_level_source) @ frame.T_world_camera
        true = make_T(rotation_z(frame.index / 10), [0.3 * frame.index - 1, 0, 1])
        np.testing.assert_allclose(T, true, atol=1e-4)
    (root / "groundtruth.txt").write_text("\n".join(lines[:3] + lines[12:]) + "\n")
    sequence = open_sequence(root)
    assert [frame.index for frame in sequence] == [0, 6, 7]
    assert sequence.skipped[0][1] == (
        "no pose: none within 0.02 s, nor two around it within 0.15 s of each other"
    )


def test_wide_images_are_subsampled_exactly(plain):
    sequence = open_sequence(plain, options=SequenceOptions(max_width=16))
    frame = next(iter(sequence))
    assert frame.depth_m.shape == (9, 12) and frame.color.shape == (9, 12, 3)
    np.testing.assert_allclose(frame.depth_m, depth_units(0)[::2, ::2] / 1000)
    np.testing.assert_allclose(sequence.camera.K[0], [10, 0, 5.75])


def test_generated_worlds_are_left_as_they_are(tmp_path):
    root = write_scannet(tmp_path / "s")
    (root / "annotations.json").write_text('{"version": 1, "generator_version": 3}')
    sequence = open_sequence(root)
    np.testing.assert_array_equal(sequence.T_level_source, np.eye(4))


@pytest.mark.parametrize("text", ['{"images": [], "annotations": []}', "[1]", "no JSON"])
def test_labels_of_others_do_not_make_a_world_level(tmp_path, text):
    root = write_scannet(tmp_path / "s")
    (root / "annotations.json").write_text(text)
    assert not np.array_equal(open_sequence(root).T_level_source, np.eye(4))


def test_garbage_depth_is_dropped(plain):
    units = depth_units(0)
    units[0, :3] = [65535, 12_000, 9_000]
    save_depth(plain / "depth/frame-0.png", units)
    depth_m = next(iter(open_sequence(plain))).depth_m
    assert depth_m[0, :3].tolist() == [0, 0, 9]


# Frames left out, each with its reason


def spoil(root: Path, what: str) -> None:
    """Spoil frame-2 of a plain recording."""
    depth, pose_file = root / "depth/frame-2.png", root / "pose/frame-2.txt"
    if what == "no depth":
        depth.unlink()
    elif what == "truncated depth":
        depth.write_bytes(depth.read_bytes()[:-60])
    elif what == "no image":
        depth.write_bytes(b"this is no image")
    elif what == "8 bit":
        Image.new("L", (WIDTH, HEIGHT), 90).save(depth)
    elif what == "size":
        save_depth(depth, depth_units(2)[:9])
    elif what == "no measurement":
        save_depth(depth, np.zeros((HEIGHT, WIDTH), np.uint16))
    elif what == "no pose":
        pose_file.unlink()
    elif what == "text pose":
        pose_file.write_text("1 0 0 nothing")
    else:
        T = pose(2)
        spoiled = {"nan": T * np.nan, "-inf": np.full((4, 4), -np.inf), "scaled": 2 * T}
        spoiled["mirrored"] = T @ np.diag([1, 1, -1, 1])
        save_text(pose_file, spoiled[what])


@pytest.mark.parametrize(
    ("what", "reason"),
    [
        ("no depth", "no depth image"),
        ("truncated depth", "depth image is truncated or corrupt"),
        ("no image", "depth image is corrupt or of an unknown kind"),
        ("8 bit", "depth is not a 16-bit grey image (mode L)"),
        ("size", "depth is 24x9, the others are 24x18"),
        ("no measurement", "depth image holds no measurement"),
        ("no pose", "no pose: no file of its name in pose/"),
        ("text pose", "pose is not a 4x4 matrix"),
        ("nan", "pose is not finite (NaN or inf)"),
        ("-inf", "pose is not finite (NaN or inf)"),
        ("scaled", "pose is not rigid (a rotation and a translation expected)"),
        ("mirrored", "pose is not rigid (a rotation and a translation expected)"),
    ],
)
def test_one_bad_frame_is_skipped_with_its_reason(plain, what, reason):
    spoil(plain, what)
    sequence = open_sequence(plain)
    assert [frame.name for frame in sequence] == ["frame-0", "frame-1", "frame-3"]
    assert sequence.skipped == [("frame-2", reason)]
    assert sequence.warnings == [f"1 frame skipped: {reason} (frame-2)"]


def test_invalid_poses_are_counted(plain):
    for i in (1, 3):
        save_text(plain / f"pose/frame-{i}.txt", np.full((4, 4), -np.inf))
    expected = "2 frames skipped: pose is not finite (NaN or inf) (first frame-1)"
    assert open_sequence(plain).warnings == [expected]


def test_colour_may_be_missing_or_corrupt(plain):
    (plain / "color/frame-0.jpg").unlink()
    path = plain / "color/frame-1.jpg"
    path.write_bytes(path.read_bytes()[:200])
    sequence = open_sequence(plain)
    assert [frame.color is None for frame in sequence] == [True, True, False, False]
    absent, corrupt = sequence.warnings
    assert absent == "1 frame without colour: no file of their name in color/ (frame-0)"
    assert corrupt.startswith("1 frame without colour: ") and corrupt.endswith("(frame-1)")
    shutil.rmtree(plain / "color")
    assert all(frame.color is None for frame in open_sequence(plain))


def test_frames_named_by_times_follow_each_other(tmp_path):
    root = write_plain(tmp_path / "r", 4)
    names = ["10.25", "10.5", "11.0", "9.75"]  # as Python prints them
    for i, name in enumerate(names):
        for path in root.glob(f"*/frame-{i}.*"):
            path.rename(path.with_name(name + path.suffix))
            (path.parent / f"._{name}{path.suffix}").write_bytes(b"kept by some file systems")
    assert [f.name for f in open_sequence(root)] == ["9.75", "10.25", "10.5", "11.0"]


def test_poses_that_are_nowhere_are_asked_for(plain):
    for i in range(4):
        (plain / f"pose/frame-{i}.txt").rename(plain / f"pose/frame-{i}.pose.txt")
    with pytest.raises(
        SequenceError, match=r"no file of its name in pose/\); pose/NAME.txt .*--odo"
    ):
        open_sequence(plain)


def test_colour_of_other_names_is_left_out(plain):
    for path in (plain / "color").iterdir():
        path.rename(path.with_stem("rgb-" + path.stem))
    sequence = open_sequence(plain)
    assert len(list(sequence)) == COUNT
    assert "no file has the name of a depth image" in sequence.warnings[0]


def test_without_poses_each_frame_is_levelled_with_a_warning(plain):
    shutil.rmtree(plain / "pose")
    sequence = open_sequence(plain)
    assert not sequence.has_poses
    assert "tracked in its camera's own levelled frame" in sequence.warnings[0]
    for frame in sequence:
        np.testing.assert_allclose(frame.T_world_camera, pose(0), atol=0.05)


# Recordings that cannot be used: one line that says what to do


def assert_refused(path: Path, *words: str, **arguments) -> None:
    with pytest.raises(SequenceError) as caught:
        open_sequence(path, **arguments)
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message, message


def test_missing_folder(tmp_path):
    assert_refused(tmp_path / "nowhere", "nowhere", "no such folder")


def test_a_file_instead_of_a_folder(tmp_path):
    path = tmp_path / "seq-01.zip"
    path.write_bytes(b"\x04")
    assert_refused(path, "is a file, neither a folder nor called *.sens")


def test_a_foreign_folder(tmp_path):
    assert_refused(tmp_path, "neither a depth/ folder nor depth.txt")


def test_an_empty_recording(tmp_path):
    (tmp_path / "depth").mkdir()
    assert_refused(tmp_path, "depth", "no depth image")


def test_an_empty_tum_list(tmp_path):
    (tmp_path / "depth.txt").write_text("# nothing\n")
    assert_refused(tmp_path, "depth.txt", "no `timestamp file` line")


def test_missing_intrinsics_name_the_flag_and_the_file(plain):
    (plain / "camera-intrinsics.txt").unlink()
    assert_refused(plain, "--intrinsics fx,fy,cx,cy", "camera-intrinsics.txt", "24x18")
    options = SequenceOptions(intrinsics=(20, 20, 11.5, 8.5))
    np.testing.assert_array_equal(open_sequence(plain, options=options).camera.K, K)


@pytest.mark.parametrize("text", ["", "1 2 3", "a b c d e f g h i", "0 " * 9, "nan " * 9])
def test_broken_intrinsics_name_their_file(plain, text):
    (plain / "camera-intrinsics.txt").write_text(text)
    assert_refused(plain, "camera-intrinsics.txt")


def test_intrinsics_of_another_image_size(plain):
    save_text(plain / "camera-intrinsics.txt", K * 40)
    assert_refused(plain, "camera-intrinsics.txt")
    save_text(plain / "camera-intrinsics.txt", np.diag([1.4, 1.4, 1]) @ K)
    assert "another image size" in open_sequence(plain).warnings[0]


@pytest.mark.parametrize("text", ["0 0 0", "down", "nan 0 1", "1 2"])
def test_broken_gravity_names_its_file(plain, text):
    (plain / "gravity-direction.txt").write_text(text)
    assert_refused(plain, "gravity-direction.txt")


@pytest.mark.parametrize(
    ("scale", "words"),
    [
        (1, ("median depth 1,", "is depth_scale 1000 meant?", "--depth-scale")),
        (100_000, ("median depth 0.01", "is depth_scale 1000 meant?")),
    ],
)
def test_impossible_depth_scale_is_named(plain, scale, words):
    assert_refused(plain, *words, options=SequenceOptions(depth_scale=scale))


def test_doubtful_depth_scale_is_a_warning(plain):
    sequence = open_sequence(plain, options=SequenceOptions(depth_scale=200, max_depth_m=20))
    assert "is depth_scale 1000 meant?" in sequence.warnings[0]
    assert len(list(sequence)) == COUNT


def test_poses_in_millimetres_are_named(plain):
    for i in range(COUNT):
        T = pose(i)
        T[:3, 3] *= 1000
        save_text(plain / f"pose/frame-{i}.txt", T)
    assert_refused(plain, "are the poses in millimetres?")


def test_one_lost_camera_does_not_spoil_the_rest(plain):
    save_text(plain / "pose/frame-2.txt", make_T(DOWN, [1e5, 0, 0]))
    sequence = open_sequence(plain)
    assert [frame.index for frame in sequence] == [0, 1, 3]
    assert sequence.skipped == [("frame-2", "camera is over 1,000 m from the others")]


def test_a_jump_of_the_camera_is_a_warning(plain):
    save_text(plain / "pose/frame-3.txt", make_T(DOWN, [20, 0, 1.2]))
    assert "jumps of the camera over 5 m between frames: 1" in open_sequence(plain).warnings[0]


def test_no_valid_pose_at_all(plain):
    for i in range(COUNT):
        save_text(plain / f"pose/frame-{i}.txt", np.full((4, 4), -np.inf))
    assert_refused(plain, "none of its frames can be used", "4 tried", "pose is not finite")


def test_every_depth_image_corrupt(plain):
    for path in (plain / "depth").iterdir():
        path.write_bytes(path.read_bytes()[:50])
    assert_refused(plain, "none of its frames can be used", "4 tried")


@pytest.mark.parametrize("arguments", [{"stride": 0}, {"max_frames": 0}])
def test_senseless_stride_or_count(plain, arguments):
    assert_refused(plain, "must be 1 or more", **arguments)


@pytest.mark.parametrize("field", [{"depth_scale": 0}, {"intrinsics": (1, 2)}, {"nonsense": 1}])
def test_options_are_validated(field):
    with pytest.raises(ConfigError, match=next(iter(field))):
        config.from_dict(field, SequenceOptions)


def test_intrinsics_flag_is_comma_separated():
    tyro = pytest.importorskip("tyro")
    options = tyro.cli(SequenceOptions, args=["--intrinsics", "525,525,319.5,239.5"])
    assert options.intrinsics == (525, 525, 319.5, 239.5)
    assert tyro.cli(SequenceOptions, args=[]) == SequenceOptions()
    with pytest.raises(SystemExit):
        tyro.cli(SequenceOptions, args=["--intrinsics", "525,525"])


# No corruption of any file is worse than a SequenceError or a skipped frame


@pytest.fixture(scope="module")
def originals(tmp_path_factory) -> dict[str, Path]:
    root = tmp_path_factory.mktemp("originals")
    return {kind: write(root / kind, 2) for kind, write in WRITERS.items()}


def corrupted(data: bytes, draw: st.DataObject) -> bytes:
    how = draw.draw(st.sampled_from(["truncate", "garble", "replace", "insert"]))
    at = draw.draw(st.integers(0, max(0, len(data) - 1)))
    junk = draw.draw(st.binary(min_size=1, max_size=12) | st.just(b" 1e308 ") | st.just(b"nan"))
    if how == "truncate":
        return data[:at]
    if how == "garble":
        return data[:at] + junk + data[at + len(junk) :]
    if how == "insert":
        return data[:at] + junk + data[at:]
    return junk


@pytest.mark.parametrize("kind", WRITERS)
@settings(max_examples=80, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_no_corruption_crashes_a_reader(kind, originals, tmp_path_factory, data):
    root = tmp_path_factory.mktemp(kind) / "recording"
    original = originals[kind] if originals[kind].is_dir() else originals[kind].parent
    shutil.copytree(original, root)
    opened = root if originals[kind].is_dir() else root / originals[kind].name
    files = sorted(path for path in root.rglob("*") if path.is_file())
    victims = data.draw(st.lists(st.sampled_from(files), min_size=1, max_size=2, unique=True))
    for victim in victims:
        victim.write_bytes(corrupted(victim.read_bytes(), data))
    try:
        sequence = open_sequence(opened)
        frames = list(sequence)
    except SequenceError as error:
        assert "\n" not in str(error)
    else:
        assert 0 < len(frames) <= 2
        for frame in frames:
            assert frame.depth_m.shape == (sequence.camera.height, sequence.camera.width)
            assert np.isfinite(frame.depth_m).all() and frame.depth_m.max() <= 10
            R = frame.T_world_camera[:3, :3]
            np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-6)
            assert np.isfinite(frame.T_world_camera).all()
    finally:
        shutil.rmtree(root)


# Real recordings


@pytest.mark.parametrize(
    ("name", "intrinsics", "count", "posed", "registered"),
    [
        ("redkitchen_7scenes", None, 160, True, False),
        ("livingroom1_icl_synthetic", (525, 525, 319.5, 239.5), 60, True, True),
        ("aims_realsense_floor", (423.8, 423.8, 320, 236.5), 20, False, False),
    ],
)
def test_real_recordings_open(name, intrinsics, count, posed, registered):
    if not (SHARED / name).is_dir():
        pytest.skip(f"recording {name} is not on this machine")
    sequence = open_sequence(SHARED / name, options=SequenceOptions(intrinsics=intrinsics))
    assert len(sequence) == count and sequence.has_poses == posed
    told = [warning.startswith("colour is of another camera") for warning in sequence.warnings]
    assert sum(told) == (not registered) and len(told) == sum(told) + (not posed)
    assert (sequence.camera.width, sequence.camera.height) == (320, 240)
    frame = next(iter(sequence))
    assert frame.color.shape == (240, 320, 3) and 0 < np.median(frame.depth_m) < 5


FINE = Camera(K * np.array([[5.0], [5], [1]]), 5 * WIDTH, 5 * HEIGHT)


def depth_in_a_room(T: np.ndarray) -> np.ndarray:
    """Of the walls, floor and ceiling around a camera, in millimetres."""
    rays = pixel_rays(FINE) @ T[:3, :3].T
    walls = np.where(rays > 0, [4.0, 3.0, 2.5], [-2.0, -3.0, 0.0])
    return np.round(1000 * ((walls - T[:3, 3]) / rays).min(axis=-1)).astype(np.uint16)


def test_poses_that_do_not_explain_the_depth_are_doubted(tmp_path):
    """World to camera, or with y up and z backward, instead of camera to world, z forward."""
    flat = AHEAD @ Rotation.from_euler("x", -15, degrees=True).as_matrix()
    turns = [Rotation.from_euler("z", 5 * i, degrees=True).as_matrix() for i in range(12)]
    poses = [make_T(turn @ flat, [0.05 * i, 0.05 * i, 1.2]) for i, turn in enumerate(turns)]

    def doubts(name, told, scale=1):
        root = write_plain(tmp_path / name, 12)
        save_text(root / "camera-intrinsics.txt", FINE.K)
        for i, T in enumerate(poses):
            save_depth(root / f"depth/frame-{i}.png", scale * depth_in_a_room(T))
            save_text(root / f"pose/frame-{i}.txt", told(T))
        return [line for line in open_sequence(root).warnings if "camera to world" in line]

    def half(T):
        return make_T(T[:3, :3], T[:3, 3] / 2)

    assert doubts("right", lambda T: T) == []
    for wrong in (inverse_T, lambda T: T @ np.diag([1.0, -1, -1, 1]), half):
        (line,) = doubts("wrong", wrong)
        assert "badly" in line and "cm" in line
    assert len(doubts("double", lambda T: T, scale=2)) == 1


def test_other_names_of_the_folders(tmp_path):
    root = write_plain(tmp_path / "r")
    (root / "color").rename(root / "rgb")
    (root / "pose").rename(root / "poses")
    sequence = open_sequence(root)
    assert sequence.has_poses and all(frame.color is not None for frame in sequence)
    shutil.rmtree(root / "poses")
    notes = open_sequence(root).warnings
    assert any("pose/NAME.txt" in line for line in notes)
    assert any("gravity" in line for line in notes)


def test_max_frames_counts_the_usable(tmp_path):
    root = write_plain(tmp_path / "r", 6)
    for i in (0, 1):
        save_text(root / f"pose/frame-{i}.txt", np.full((4, 4), -np.inf))
    assert [frame.index for frame in open_sequence(root, max_frames=3)] == [2, 3, 4]


@pytest.mark.parametrize(
    "depth",
    [np.ones((HEIGHT, WIDTH), np.uint16), np.ones((WIDTH, HEIGHT), np.float32), np.ones(3)],
)
def test_a_frame_refuses_depth_that_is_not_metres_of_its_camera(depth):
    with pytest.raises(SequenceError, match=r"frame 7: .*float32 of shape \(18, 24\)"):
        Frame(7, depth, Camera(K, WIDTH, HEIGHT), np.eye(4))


@pytest.mark.parametrize(
    "T", [np.eye(3), np.full((4, 4), np.nan), np.diag([1, 1, 1, -np.inf]), np.eye(4)[None]]
)
def test_a_frame_wants_a_pose_of_numbers(T: np.ndarray) -> None:
    depth = np.ones((HEIGHT, WIDTH), np.float32)
    with pytest.raises(SequenceError, match=r"frame 7: T_world_camera is no \(4, 4\)"):
        Frame(7, depth, Camera(K, WIDTH, HEIGHT), T)


@pytest.mark.parametrize(
    "T", [np.diag([2.0, 2, 2, 1]), np.diag([1.0, 1, -1, 1]), pose(1).T, np.zeros((4, 4))]
)
def test_a_frame_wants_a_rigid_pose(T: np.ndarray) -> None:
    depth = np.ones((HEIGHT, WIDTH), np.float32)
    with pytest.raises(SequenceError, match="frame 7: T_world_camera is no rigid motion"):
        Frame(7, depth, Camera(K, WIDTH, HEIGHT), T)


def test_a_frame_far_from_the_origin_is_refused() -> None:
    depth, camera = np.ones((HEIGHT, WIDTH), np.float32), Camera(K, WIDTH, HEIGHT)
    with pytest.raises(SequenceError, match=r"frame 7: the camera is 5,334 km .* subtract"):
        Frame(7, depth, camera, make_T(np.eye(3), [691e3, 5334e3, 520]))
    Frame(7, depth, camera, make_T(np.eye(3), [0, 9000, 0]))


@pytest.mark.parametrize(
    "color",
    [
        np.zeros((HEIGHT, WIDTH), np.uint8),
        np.zeros((HEIGHT, WIDTH, 4), np.uint8),
        np.zeros((HEIGHT, WIDTH, 3)),
        np.zeros((2 * HEIGHT, 2 * WIDTH, 3), np.uint8),
    ],
)
def test_a_frame_wants_colour_of_its_size(color: np.ndarray) -> None:
    depth = np.ones((HEIGHT, WIDTH), np.float32)
    with pytest.raises(SequenceError, match=r"frame 7: color is .* expected uint8 of shape \(18"):
        Frame(7, depth, Camera(K, WIDTH, HEIGHT), np.eye(4), color)


def test_a_frame_takes_lists_and_no_times_for_numbers() -> None:
    depth, camera = np.ones((HEIGHT, WIDTH)), Camera(K, WIDTH, HEIGHT)
    frame = Frame(7, depth.tolist(), camera, np.eye(4).tolist())  # type: ignore[arg-type]
    np.testing.assert_array_equal(frame.depth_m, depth)
    np.testing.assert_array_equal(frame.T_world_camera, np.eye(4))
    with pytest.raises(SequenceError, match=r"index is no count of frames.*timestamp_s"):
        Frame(1_700_000_000_000, depth, camera, np.eye(4))


@pytest.mark.parametrize("bad", [np.eye(4), np.full((3, 3), np.nan), np.diag([0.0, 20, 1])])
def test_a_camera_wants_a_matrix_of_its_focal_lengths(bad: np.ndarray) -> None:
    with pytest.raises(SequenceError, match="intrinsics of a 24x18 camera: K is"):
        Camera(bad, WIDTH, HEIGHT)


def test_a_maps_coordinates_are_moved_to_the_origin(plain) -> None:
    near = open_sequence(plain)
    far_away = np.array([691e3, 5334e3, 520])
    for i in range(COUNT):
        T = pose(i)
        T[:3, 3] += far_away
        save_text(plain / f"pose/frame-{i}.txt", T)
    far = open_sequence(plain)
    assert "the world's origin was moved to the cameras" in " ".join(far.warnings)
    places = [np.stack([f.T_world_camera[:3, 3] for f in s]) for s in (near, far)]
    np.testing.assert_allclose(*(p - p[0] for p in places), atol=1e-6)
    assert np.abs(places[1]).max() < 10
    moved = far.T_level_source @ [*far_away, 1]
    np.testing.assert_allclose(moved[2], near.T_level_source[2, 3], atol=0.01)


def test_pose_files_may_have_comments_and_a_byte_order_mark(plain) -> None:
    expected = [frame.T_world_camera for frame in open_sequence(plain)]
    for path in (plain / "pose").glob("*.txt"):
        path.write_bytes(b"\xef\xbb\xbf# camera to world\n" + path.read_bytes() + b"# metres\n")
    for frame, T in zip(open_sequence(plain), expected, strict=True):
        np.testing.assert_array_equal(frame.T_world_camera, T)


def test_millimetres_are_refused() -> None:
    depth, camera = np.full((HEIGHT, WIDTH), 1500, np.float32), Camera(K, WIDTH, HEIGHT)
    depth[:5] = 0
    with pytest.raises(SequenceError, match=r"frame 7: .* median of 1500; expected metres"):
        Frame(7, depth, camera, np.eye(4))
    for nothing in (65.535, np.inf):  # a covered lens, as sensors say it
        depth[depth > 0] = nothing
        assert not Frame(7, depth, camera, np.eye(4)).depth_m.any()


def test_what_no_camera_measures_is_nothing() -> None:
    depth = np.full((HEIGHT, WIDTH), 2, np.float32)
    depth[0, :5] = [np.nan, np.inf, -np.inf, -1, 65.535]
    given = depth.copy()
    frame = Frame(0, depth, Camera(K, WIDTH, HEIGHT), np.eye(4))
    assert (frame.depth_m[0, :5] == 0).all() and (frame.depth_m.ravel()[5:] == 2).all()
    assert frame.depth_m.dtype == np.float32
    np.testing.assert_array_equal(depth, given)  # the caller's image stays


def test_a_frame_is_numbered_by_a_whole_number() -> None:
    frame = make_own_frame(np.int64(7))
    assert type(frame.index) is int and frame.index == 7
    with pytest.raises(SequenceError, match=r"frame 0\.5: index is no whole number.*timestamp_s"):
        make_own_frame(0.5)


def make_own_frame(index) -> Frame:
    return Frame(index, np.ones((HEIGHT, WIDTH), np.float32), Camera(K, WIDTH, HEIGHT), np.eye(4))


def test_numbers_from_drivers_are_taken_as_they_are() -> None:
    camera = Camera(K, *np.array([WIDTH, HEIGHT]))
    assert type(camera.width) is int and json.dumps([camera.width, camera.height])
    depth = np.ones((HEIGHT, WIDTH), np.float32)
    frame = Frame(0, depth, camera, np.eye(4).tolist(), timestamp_s=np.float32(1.5))
    assert type(frame.timestamp_s) is float and frame.T_world_camera.dtype == np.float64
    with pytest.raises(SequenceError, match="whole numbers of pixels"):
        Camera(K, WIDTH / 1, HEIGHT)


@pytest.mark.parametrize("given", [(12, 5), "noon", np.nan, np.inf])
def test_times_that_are_none_are_refused(given) -> None:
    depth, camera = np.ones((HEIGHT, WIDTH), np.float32), Camera(K, WIDTH, HEIGHT)
    with pytest.raises(SequenceError, match=r"frame 3: timestamp_s is .*; expected seconds"):
        Frame(3, depth, camera, np.eye(4), timestamp_s=given)


@pytest.mark.parametrize("given", [None, "pose", [[1, None], [0, 1]], np.full((4, 4), None)])
def test_poses_that_are_none_are_refused(given) -> None:
    depth, camera = np.ones((HEIGHT, WIDTH), np.float32), Camera(K, WIDTH, HEIGHT)
    with pytest.raises(SequenceError, match="frame 3: T_world_camera is no"):
        Frame(3, depth, camera, given)


@pytest.mark.parametrize(
    "given",
    [
        K.T,
        K / WIDTH,
        np.diag([3.0, 3.0, 1.0]) @ K,
        K + 0.02 * K[0, 0] * np.eye(3, k=1),
        "K",
        None,
    ],
    ids=["transposed", "shares", "of a larger image", "skewed", "text", "none"],
)
def test_intrinsics_of_something_else_are_refused(given) -> None:
    with pytest.raises(SequenceError, match="intrinsics of a 24x18 camera: K is"):
        Camera(given, WIDTH, HEIGHT)


def test_intrinsics_of_the_full_image_do_not_fit_half_of_it() -> None:
    full = np.array([[600.0, 0, 319.5], [0, 600, 239.5], [0, 0, 1]])
    Camera(full, 640, 480)
    with pytest.raises(SequenceError, match=r"K is .*halve them"):
        Camera(full, 320, 240)


def test_intrinsics_may_be_lists_and_are_the_cameras_own() -> None:
    given = K.copy()
    camera, listed = Camera(given, WIDTH, HEIGHT), Camera(K.tolist(), WIDTH, HEIGHT)
    given[0, 0] = 1e9
    np.testing.assert_array_equal(camera.K, K)
    np.testing.assert_array_equal(listed.K, K)
    assert listed.K.dtype == np.float64


def turned(pan_deg: float, nod_deg: float, roll_deg: float) -> np.ndarray:
    """(N, 4, 4) poses of a camera that is rolled and then looks round, in any world."""
    swing = np.sin(np.linspace(0, 7, 30))
    world = Rotation.from_euler("xyz", [0.3, 1.2, -0.8])
    pan = Rotation.from_rotvec(np.outer(pan_deg * swing, (0, 0, 1)), degrees=True)
    nod = Rotation.from_rotvec(np.outer(nod_deg * swing, (0, 1, 0)), degrees=True)
    roll = Rotation.from_euler("z", roll_deg, degrees=True)
    axes = (world * pan * nod * Rotation.from_matrix(AHEAD) * roll).as_matrix()
    return np.stack([make_T(R, [0, 0, 0]) for R in axes])


@pytest.mark.parametrize("roll_deg", [0, 90, 180, 270])
def test_a_camera_held_sideways_is_told_of(roll_deg: float) -> None:
    sideways = roll_deg in (90, 270)
    assert len(checks.upright_notes(turned(40, 10, roll_deg))) == sideways
    assert checks.upright_notes(turned(5, 5, roll_deg)) == []  # nobody can tell


@pytest.mark.parametrize(("roll_deg", "gravity"), [(0, False), (90, False), (90, True)])
def test_a_recording_held_sideways_is_told_of(tmp_path, roll_deg: float, gravity: bool) -> None:
    write_plain(tmp_path)
    if not gravity:
        (tmp_path / "gravity-direction.txt").unlink()
    for i, T in enumerate(turned(40, 10, roll_deg)[:: 30 // COUNT][:COUNT]):
        save_text(tmp_path / f"pose/frame-{i}.txt", T)
    told = any("held sideways" in line for line in open_sequence(tmp_path).warnings)
    assert told == (roll_deg == 90 and not gravity)


def test_names_with_digits_that_are_no_numbers_have_an_order() -> None:
    assert in_order(["b10", "b²", "b2"]) == ["b2", "b10", "b²"]


def test_a_world_that_is_said_to_be_level_is_left_as_it_is(tmp_path):
    root = write_plain(tmp_path / "r")
    for path in (root / "pose").iterdir():
        shifted = np.loadtxt(path)
        shifted[:3, 3] += [5000.0, 0, 0.3]
        save_text(path, shifted)
    sought = open_sequence(root)
    stated = open_sequence(root, options=SequenceOptions(levelled=True))
    x = stated.T_level_source[0, 3]
    assert x == sought.T_level_source[0, 3] and abs(x) > 4000  # single precision wants it near
    np.testing.assert_array_equal(stated.T_level_source, make_T(np.eye(3), [x, 0, 0]))
    assert abs(sought.T_level_source[2, 3]) > 0.1
    for frame, index in zip(stated, range(COUNT), strict=True):
        T = pose(index)
        T[:3, 3] += [5000.0 + x, 0, 0.3]
        np.testing.assert_allclose(frame.T_world_camera, T, atol=1e-9)


def test_what_world_is_level_must_be_the_recordings(tmp_path):
    root = write_plain(tmp_path / "r")
    with pytest.raises(SequenceError, match=r"--levelled.*--odometry does without"):
        open_sequence(root, options=SequenceOptions(levelled=True, odometry=True))
    shutil.rmtree(root / "pose")
    with pytest.raises(SequenceError, match=r"--levelled.*it has none"):
        open_sequence(root, options=SequenceOptions(levelled=True))
