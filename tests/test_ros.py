"""ROS recordings are read as the same images in a plain folder are, and say what they lack."""

import builtins
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from io import BytesIO
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy.spatial.transform import Rotation

from composenet.errors import ConfigError, SequenceError
from composenet.geometry.camera import pixel_rays
from composenet.geometry.transform import inverse_T, make_T
from composenet.records import Camera, Frame
from composenet.sequences import SequenceOptions, open_sequence
from composenet.sequences.images import read_depth
from composenet.sequences.ros_bag import Bag
from composenet.sequences.ros_transforms import Transforms
from ros_recordings import KINDS, Recording, packed_depth, png, rvl

WIDTH, HEIGHT, COUNT, START_S = 24, 18, 4, 100.0
K = np.array([[20.0, 0, 11.5], [0, 20.0, 8.5], [0, 0, 1]])
AHEAD = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # looks along +x
DOWN = AHEAD @ Rotation.from_euler("x", -40, degrees=True).as_matrix()
DEPTH, COLOR = "/camera/depth/image_rect_raw", "/camera/color/image_raw"


def depth_mm(index: int) -> np.ndarray:
    """A floor 1.2 m below the camera and a wall at x = 3; the last column is unmeasured."""
    rays = pixel_rays(Camera(K, WIDTH, HEIGHT)) @ DOWN.T
    depth = np.minimum(1.2 / np.maximum(-rays[..., 2], 1e-6), (3 - 0.1 * index) / rays[..., 0])
    depth[:, -1] = 0
    return np.round(depth * 1000).astype(np.uint16)


def color(index: int) -> np.ndarray:
    rgb = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    rgb[..., 0] = 10 * np.arange(WIDTH)
    rgb[..., 1] = 10 * np.arange(HEIGHT)[:, None]
    rgb[..., 2] = 40 * index
    return rgb


def pose(index: float) -> np.ndarray:
    return make_T(DOWN, [0.1 * index, 0, 1.2])


def time_s(index: int) -> float:
    return START_S + 0.25 * index


def write_plain(root: Path) -> Path:
    for name in ("depth", "color", "pose"):
        (root / name).mkdir(parents=True)
    for i in range(COUNT):
        Image.fromarray(depth_mm(i)).save(root / f"depth/{i}.png")
        Image.fromarray(color(i)).save(root / f"color/{i}.png")
        np.savetxt(root / f"pose/{i}.txt", pose(i))
    np.savetxt(root / "camera-intrinsics.txt", K)
    return root


def add_depth(bag: Recording, topic: str = DEPTH, frame: str = "optical") -> None:
    for i in range(COUNT):
        bag.image(topic, time_s(i), frame, depth_mm(i), "16UC1", late_s=0.04)
    bag.info(f"{topic.rpartition('/')[0]}/camera_info", frame, K, (WIDTH, HEIGHT))


def add_color(bag: Recording, frame: str = "optical") -> None:
    for i in range(COUNT):
        bag.image(COLOR, time_s(i) + 0.01, frame, color(i), "rgb8")
    bag.info("/camera/color/camera_info", frame, K, (WIDTH, HEIGHT))


def add_way(bag: Recording, root: str = "odom") -> None:
    """root -> base_link, told between the images' times, -> optical, told once."""
    T_base_optical = make_T(DOWN, [0.05, 0, 1.0])
    for k in np.arange(-0.38, COUNT, 0.5):
        T_root_base = pose(k) @ inverse_T(T_base_optical)
        bag.transform(START_S + 0.25 * k, root, "base_link", T_root_base)
    bag.transform(START_S, "base_link", "/optical", T_base_optical, "/tf_static")


def robot(kind: str) -> Recording:
    bag = Recording(kind)
    add_depth(bag)
    add_color(bag)
    add_way(bag)
    return bag


def frames_of(path: Path, **options: object) -> list[Frame]:
    return list(open_sequence(path, options=SequenceOptions(**options)))  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", KINDS)
def test_it_is_read_as_a_plain_folder_with_the_same_images_is(kind: str, tmp_path: Path) -> None:
    path = robot(kind).write(tmp_path)
    sequence, plain = open_sequence(path), open_sequence(write_plain(tmp_path / "plain"))
    assert sequence.name == "robot" and sequence.has_poses and not sequence.skipped
    assert [w for w in sequence.warnings if w not in plain.warnings] == []
    assert np.array_equal(sequence.camera.K, plain.camera.K)
    for ours, theirs in zip(sequence, plain, strict=True):
        assert np.array_equal(ours.depth_m, theirs.depth_m)
        assert np.allclose(ours.T_world_camera, theirs.T_world_camera, atol=1e-6)
        assert ours.color is not None and np.array_equal(ours.color, theirs.color)
        assert ours.timestamp_s == pytest.approx(time_s(ours.index))
    backwards = [frame.depth_m for frame in reversed(sequence)]
    assert all(np.array_equal(a, b.depth_m) for a, b in zip(backwards[::-1], sequence, strict=True))


@pytest.mark.parametrize("kind", ["mcap", "sqlite3"])
def test_a_file_of_a_ros_2_recording_is_one_too(kind: str, tmp_path: Path) -> None:
    folder = robot(kind).write(tmp_path)
    (file,) = (p for p in folder.iterdir() if p.suffix in (".mcap", ".db3"))
    moved = file.rename(tmp_path / f"alone{file.suffix}")
    assert len(frames_of(moved)) == COUNT


def floats(index: int) -> np.ndarray:
    depth_m = (depth_mm(index) / 1000).astype(np.float32)
    depth_m[depth_m == 0] = np.nan
    depth_m[0, 0], depth_m[0, 1], depth_m[0, 2] = np.inf, -1.0, 70.0
    return depth_m


@pytest.mark.parametrize("kind", ["bag", "mcap"])
@pytest.mark.parametrize(
    ("pixels", "encoding"),
    [
        (depth_mm, "mono16"),
        (lambda i: depth_mm(i).astype(">u2"), "16UC1"),
        (floats, "32FC1"),
        (lambda i: floats(i).astype(">f4"), "32FC1"),
    ],
)
def test_depth_of_every_encoding(
    kind: str, pixels: Callable[[int], np.ndarray], encoding: str, tmp_path: Path
) -> None:
    bag = Recording(kind)
    bag.image(DEPTH, 1.0, "optical", pixels(0), encoding)
    bag.info("/camera/depth/camera_info", "optical", K, (WIDTH, HEIGHT))
    (frame,) = frames_of(bag.write(tmp_path), max_depth_m=100)
    expected = depth_mm(0) / np.float32(1000)
    if encoding == "32FC1":
        expected[0, :3] = 0
    assert np.array_equal(frame.depth_m, expected.astype(np.float32))


def test_rows_may_be_padded(tmp_path: Path) -> None:
    bag = Recording("mcap")
    padded = np.pad(depth_mm(0), ((0, 0), (0, 5)), constant_values=9999)
    bag.image(DEPTH, 1.0, "optical", padded, "16UC1")
    bag.messages[-1][2].width = WIDTH
    bag.info("/camera/depth/camera_info", "optical", K, (WIDTH, HEIGHT))
    (frame,) = frames_of(bag.write(tmp_path))
    assert np.array_equal(frame.depth_m, depth_mm(0) / np.float32(1000))


@pytest.mark.parametrize("compressed", [png, rvl])
@pytest.mark.parametrize("kind", KINDS)
def test_compressed_depth(
    kind: str, compressed: Callable[[np.ndarray], bytes], tmp_path: Path
) -> None:
    scale, offset = 100.0, -0.5  # depth = scale / (steps - offset)
    metres = depth_mm(1) / 1000
    steps = np.where(metres > 0, scale / np.maximum(metres, 1e-3) + offset, 0)
    bag = Recording(kind)
    topic = f"{DEPTH}/compressedDepth"
    by = " rvl" if compressed is rvl else ""  # PNG need not be said
    data = packed_depth(depth_mm(0), compressed=compressed)
    bag.packed(topic, 1.0, "optical", data, f"16UC1; compressedDepth{by}")
    data = packed_depth(np.rint(steps).astype(np.uint16), scale, offset, compressed)
    bag.packed(topic, 2.0, "optical", data, f"32FC1; compressedDepth{by}")
    bag.info("/camera/depth/camera_info", "optical", K, (WIDTH, HEIGHT))
    first, second = frames_of(bag.write(tmp_path))
    assert np.array_equal(first.depth_m, depth_mm(0) / np.float32(1000))
    assert np.array_equal(second.depth_m > 0, metres > 0)
    error = np.abs(second.depth_m - metres)
    assert (error <= 0.5 * metres**2 / scale * 1.1 + 6e-4).all() and error.max() > 1e-4


def test_depth_that_cannot_be_unpacked_is_told_of(tmp_path: Path) -> None:
    bag = Recording("mcap")
    for i in range(2):
        topic = f"{DEPTH}/compressedDepth"
        bag.packed(topic, 1.0 + i, "optical", bytes(40), "16UC1; compressedDepth rvl")
    bag.info("/camera/depth/camera_info", "optical", K, (WIDTH, HEIGHT))
    with pytest.raises(SequenceError, match=r"none of its frames.*image claims to be 0x0"):
        open_sequence(bag.write(tmp_path))


@pytest.mark.parametrize("character", "#?")
def test_a_database_whose_path_is_no_address_is_told_of(character: str, tmp_path: Path) -> None:
    bag = Recording("sqlite3")
    add_depth(bag)
    path = bag.write(tmp_path).rename(tmp_path / f"robot{character}1")
    with pytest.raises(SequenceError, match="rename"):
        open_sequence(path)


@pytest.mark.parametrize(
    ("encoding", "channels"),
    [("rgb8", [0, 1, 2]), ("bgr8", [2, 1, 0]), ("rgba8", [0, 1, 2, 0]), ("bgra8", [2, 1, 0, 0])],
)
def test_colour_of_every_encoding(encoding: str, channels: list[int], tmp_path: Path) -> None:
    bag = Recording("mcap")
    add_depth(bag)
    bag.image(COLOR, time_s(1), "optical", color(1)[..., channels], encoding)
    frames = frames_of(bag.write(tmp_path))
    assert [frame.color is None for frame in frames] == [True, False, True, True]
    assert np.array_equal(frames[1].color, color(1))


@pytest.mark.parametrize("format", ["rgb8; png compressed bgr8", "png", ""])
def test_compressed_colour(format: str, tmp_path: Path) -> None:
    bag = Recording("mcap")
    add_depth(bag)
    bag.packed(f"{COLOR}/compressed", time_s(1), "optical", png(color(1)), format)
    bag.packed(f"{COLOR}/compressed", time_s(2), "optical", b"\xff\xd8 no image", format)
    sequence = open_sequence(bag.write(tmp_path))
    frames = list(sequence)
    assert np.array_equal(frames[1].color, color(1))
    assert frames[2].color is None
    assert any("1 frame without colour: image is corrupt" in w for w in sequence.warnings)


def test_images_of_one_time_are_told_apart(tmp_path: Path) -> None:
    bag = Recording("mcap")
    for i in range(3):
        bag.image(DEPTH, time_s(i), "optical", depth_mm(i), "16UC1", late_s=time_s(3) - time_s(i))
    bag.info("/camera/depth/camera_info", "optical", K, (WIDTH, HEIGHT))
    for i, frame in enumerate(frames_of(bag.write(tmp_path))):
        assert np.array_equal(frame.depth_m, depth_mm(i) / np.float32(1000))


def test_frames_without_a_transform_near_their_time_are_skipped(tmp_path: Path) -> None:
    bag = Recording("mcap")
    add_depth(bag)
    for at, k in ((time_s(0) + 0.06, 0.0), (time_s(1), 1.0), (time_s(3) + 1.1, 3.0)):
        bag.transform(at, "map", "optical", pose(k))
    sequence = open_sequence(bag.write(tmp_path))
    assert [frame.index for frame in sequence] == [1]
    assert {reason for _, reason in sequence.skipped} == {
        "no pose: no transform from 'map' to 'optical' at that time"
    }


def test_what_is_seldom_told_of_and_hardly_moves_holds_between(tmp_path: Path) -> None:
    """As a map's place, which a robot corrects by a little every few seconds."""
    bag = Recording("mcap")
    add_depth(bag)
    for i in range(COUNT):
        bag.transform(time_s(i), "odom", "optical", pose(i))
    for at, x in ((time_s(0) - 2, 0.0), (time_s(COUNT) + 2, 0.05)):
        bag.transform(at, "map", "odom", make_T(np.eye(3), [x, 0, 0]))
    assert len(list(open_sequence(bag.write(tmp_path, "slow")))) == COUNT
    bag.messages.pop()
    bag.transform(time_s(COUNT) + 2, "map", "odom", make_T(np.eye(3), [5.0, 0, 0]))
    with pytest.raises(SequenceError, match=r"no transform from 'map' to 'odom' at that time"):
        open_sequence(bag.write(tmp_path, "quick"))


@pytest.mark.parametrize(
    ("root", "moving", "posed"),
    [
        ("odom", True, True),
        ("robot1/odom", True, True),
        ("room", True, True),
        ("world", False, True),
        ("base_link", True, False),
        ("room", False, False),
    ],
)
def test_what_is_the_world(root: str, moving: bool, posed: bool, tmp_path: Path) -> None:
    bag = Recording("mcap")
    add_depth(bag)
    for i in range(COUNT if moving else 1):
        topic = "/tf" if moving else "/tf_static"
        bag.transform(time_s(i), root, "optical", pose(i), topic)
    sequence = open_sequence(bag.write(tmp_path))
    assert sequence.has_poses == posed
    told = any(
        "the camera's place, 'optical', is known in 'base_link' alone" in w
        for w in (sequence.warnings)
    )
    assert told == (root == "base_link")
    assert any(
        "'room', in which transforms place the camera, is taken" in w for w in (sequence.warnings)
    ) == (root == "room" and posed)
    if not posed:
        assert any("--odometry finds them" in w for w in sequence.warnings)


def test_depth_that_lies_on_colour_is_taken_and_another_can_be(tmp_path: Path) -> None:
    bag = Recording("mcap")
    add_depth(bag, "/camera/depth/image_rect_raw", "depth_optical")
    add_depth(bag, "/camera/aligned_depth_to_color/image_raw", "optical")
    other = 2 * K * [[1], [1], [0.5]]
    bag.info("/rear/depth/camera_info", "rear", other, (WIDTH, HEIGHT))
    for i in range(COUNT):
        bag.image("/rear/depth/image_raw", time_s(i), "rear", depth_mm(0), "16UC1")
    add_color(bag)
    path = bag.write(tmp_path)
    sequence = open_sequence(path)
    assert all(frame.color is not None for frame in sequence)
    (note,) = (w for w in sequence.warnings if "--depth-topic" in w)
    assert note.startswith("depth of /camera/aligned_depth_to_color/image_raw is taken")
    assert "/rear/depth/image_raw" in note and "/camera/depth/image_rect_raw" in note
    rear = open_sequence(path, options=SequenceOptions(depth_topic="/rear/depth/image_raw"))
    assert np.array_equal(rear.camera.K, other)
    with pytest.raises(SequenceError, match=r"no depth images of /front; there are /camera/.*rear"):
        open_sequence(path, options=SequenceOptions(depth_topic="/front"))


def test_a_depth_topic_is_of_no_use_elsewhere(tmp_path: Path) -> None:
    with pytest.raises(SequenceError, match="is no ROS recording"):
        open_sequence(write_plain(tmp_path / "plain"), options=SequenceOptions(depth_topic="/d"))


def test_compressed_depth_is_taken_where_there_is_no_other(tmp_path: Path) -> None:
    bag = Recording("mcap")
    add_depth(bag)
    data = packed_depth(depth_mm(0))
    bag.packed(f"{DEPTH}/compressedDepth", 1.0, "optical", data, "16UC1; compressedDepth png")
    sequence = open_sequence(bag.write(tmp_path))
    assert len(sequence) == COUNT and not any("--depth-topic" in w for w in sequence.warnings)


def test_colour_of_another_camera_is_brought_onto_the_depth(tmp_path: Path) -> None:
    bag = Recording("mcap")
    add_depth(bag)
    add_color(bag, "color_optical")
    T_color_depth = make_T(np.eye(3), [0.06, 0.0, 0.0])
    bag.transform(0.0, "rig", "optical", np.eye(4), "/tf_static")
    bag.transform(0.0, "rig", "color_optical", inverse_T(T_color_depth), "/tf_static")
    path = bag.write(tmp_path)
    for i, frame in enumerate(frames_of(path)):
        for v, u in ((3, 4), (10, 12), (17, 20)):
            z = frame.depth_m[v, u]
            right = int(np.rint(u + K[0, 0] * 0.06 / z))
            assert frame.color is not None
            assert frame.color[v, u].tolist() == color(i)[v, right].tolist()
        right = int(np.rint(WIDTH - 1 + K[0, 0] * 0.06 / frame.depth_m[5, -2]))
        assert right >= WIDTH and frame.color[5, -1].tolist() == [0, 0, 0]  # beyond the image
    bag.messages = [m for m in bag.messages if m[0] != "/tf_static"]
    given = frames_of(path, intrinsics=(10, 10, 11.5, 8.5))[1]
    z = given.depth_m[10, 12]
    u, v = np.rint([11.5 + 20 * (0.5 / 10 + 0.06 / z), 8.5 + 20 * 1.5 / 10]).astype(int)
    assert given.color is not None and given.color[10, 12].tolist() == color(1)[v, u].tolist()
    frames = frames_of(bag.write(tmp_path, "alone"))
    assert all(np.array_equal(frame.color, color(i)) for i, frame in enumerate(frames))


@pytest.mark.parametrize(("said", "metre"), [("0.000100", 1e4), ("0.001", 1e3), ("no", 1e3)])
def test_units_are_those_of_the_camera(said: str, metre: float, tmp_path: Path) -> None:
    bag = Recording("sqlite3")
    topic = "/device_0/sensor_0/Depth_0/image/data/compressedDepth"
    raw = (depth_mm(0) * (metre / 1e3)).astype(np.uint16)
    bag.packed(topic, 1.0, "Depth", packed_depth(raw), "16UC1; compressedDepth png")
    bag.info("/device_0/sensor_0/Depth_0/image/camera_info", "Depth", K, (WIDTH, HEIGHT))
    bag.text("/device_0/sensor_0/option/Depth_Units/value", said)
    (frame,) = frames_of(bag.write(tmp_path))
    assert np.allclose(frame.depth_m, depth_mm(0) / 1000, atol=1e-6)


def test_rectified_images_have_the_projections_intrinsics(tmp_path: Path) -> None:
    P = np.array([[22.0, 0, 10, 0], [0, 22.0, 9, 0], [0, 0, 1, 0]])
    for topic, expected in ((DEPTH, P[:, :3]), ("/camera/depth/image_raw", K)):
        bag = Recording("mcap")
        bag.image(topic, 1.0, "optical", depth_mm(0), "16UC1")
        info = "/camera/depth/camera_info"
        bag.info(info, "optical", K, (WIDTH, HEIGHT), P, [0.1, 0, 0, 0, 0])
        sequence = open_sequence(bag.write(tmp_path, topic.rpartition("/")[2]))
        assert np.array_equal(sequence.camera.K, expected)
        assert any("lens distorts" in w for w in sequence.warnings) == ("rect" not in topic)


def test_without_camera_info_intrinsics_are_asked_for(tmp_path: Path) -> None:
    bag = Recording("mcap")
    bag.image(DEPTH, 1.0, "optical", depth_mm(0), "16UC1")
    path = bag.write(tmp_path)
    with pytest.raises(SequenceError, match=f"beside {DEPTH}.*--intrinsics"):
        open_sequence(path)
    assert len(frames_of(path, intrinsics=(20, 20, 11.5, 8.5))) == 1


def test_a_recording_without_depth_says_what_it_has(tmp_path: Path) -> None:
    bag = Recording("mcap")
    add_color(bag)
    with pytest.raises(SequenceError, match=r"no topic with depth.*sensor_msgs/msg/Image"):
        open_sequence(bag.write(tmp_path))


def test_poses_are_not_wanted_with_odometry(tmp_path: Path) -> None:
    bag = Recording("mcap")
    add_depth(bag)
    bag.transform(time_s(0), "odom", "optical", pose(0))
    bag.transform(time_s(1), "odom", "optical", pose(1))
    sequence = open_sequence(bag.write(tmp_path), options=SequenceOptions(odometry=True))
    assert len(sequence) >= 1 and not any("no transform" in r for _, r in sequence.skipped)


@pytest.mark.parametrize("kind", KINDS)
def test_a_recording_in_a_folder_is_named(kind: str, tmp_path: Path) -> None:
    path = robot(kind).write(tmp_path)
    with pytest.raises(SequenceError, match=f"{path.name} in it is a recording; give that"):
        open_sequence(tmp_path)


def test_the_library_is_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = robot("bag").write(tmp_path)
    real = builtins.__import__

    def without(name: str, *args: object, **more: object) -> object:
        if name.startswith("rosbags"):
            raise ImportError(name)
        return real(name, *args, **more)  # type: ignore[arg-type]

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ConfigError, match=r"robot.bag.*pip install 'composenet\[ros\]'"):
        open_sequence(path)


@pytest.fixture(scope="module", params=KINDS)
def whole(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording that is one file."""
    path = robot(request.param).write(tmp_path_factory.mktemp(request.param))
    if path.is_dir():
        (path,) = (p for p in path.iterdir() if p.suffix in (".mcap", ".db3"))
    return path


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_no_corruption_crashes_it(whole: Path, tmp_path: Path, data: st.DataObject) -> None:
    content = bytearray(whole.read_bytes())
    for _ in range(data.draw(st.integers(0, 6))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.sampled_from([0, 0, 1, 100, len(content) // 2, len(content) - 20]))
    damaged = tmp_path / f"damaged{whole.suffix}"
    damaged.write_bytes(content[: len(content) - cut])
    try:
        for frame in open_sequence(damaged):
            assert np.isfinite(frame.depth_m).all()
    except SequenceError as error:
        assert "damaged" in str(error) and "\n" not in str(error)


# --- transforms -----------------------------------------------------------------------------


def told(time: float, parent: str, child: str, T: np.ndarray, fixed: bool = False) -> tuple:
    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat()
    stamp = SimpleNamespace(sec=int(time), nanosec=round(1e9 * (time - int(time))))
    translation = SimpleNamespace(**dict(zip("xyz", T[:3, 3], strict=True)))
    transform = SimpleNamespace(
        translation=translation, rotation=SimpleNamespace(x=x, y=y, z=z, w=w)
    )
    header = SimpleNamespace(stamp=stamp, frame_id=parent)
    return SimpleNamespace(header=header, child_frame_id=child, transform=transform), fixed


def random_T(rng: np.random.Generator) -> np.ndarray:
    return make_T(Rotation.random(rng=rng).as_matrix(), rng.normal(size=3))


def test_ways_multiply_and_turn_back() -> None:
    rng = np.random.default_rng(1)
    A, B, C = (random_T(rng) for _ in range(3))
    tree = Transforms(
        [told(1.0, "map", "odom", A, True), told(1.0, "odom", "base", B), told(2, "map", "c", C)]
    )
    assert tree.root("base") == "map" and tree.root("elsewhere") == "elsewhere"
    assert np.allclose(tree.T_root_frame("base", 1.0), A @ B)
    assert np.allclose(tree.T_root_frame("odom", 99.0), A)
    assert tree.T_between("base", "c", 1.0) is None  # that of c is a second away
    tree = Transforms(
        [told(1.0, "map", "odom", A, True), told(1.0, "odom", "base", B), told(1, "map", "c", C)]
    )
    ab, ba = tree.T_between("base", "c", 1.0), tree.T_between("c", "base", 1.0)
    assert np.allclose(ab, np.linalg.inv(A @ B) @ C) and np.allclose(ab @ ba, np.eye(4))
    assert tree.T_between("base", "elsewhere", 1.0) is None
    assert not tree.moves("base")
    tree = Transforms(
        [
            told(1.0, "map", "odom", A, True),
            *(told(t, "odom", "base", random_T(rng)) for t in (1, 2)),
        ]
    )
    assert tree.moves("base") and not tree.moves("odom")


@given(st.floats(0, 1), st.integers(0, 2**32 - 1))
def test_between_two_times_a_frame_turns_and_moves_evenly(share: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    A, B = random_T(rng), random_T(rng)
    tree = Transforms([told(2.0, "map", "c", B), told(1.0, "map", "c", A)])
    T = tree.T_root_frame("c", 1.0 + share)
    assert T is not None
    assert np.allclose(T[:3, 3], A[:3, 3] + share * (B[:3, 3] - A[:3, 3]), atol=1e-6)
    whole = Rotation.from_matrix(A[:3, :3].T @ B[:3, :3]).magnitude()
    first = Rotation.from_matrix(A[:3, :3].T @ T[:3, :3]).magnitude()
    rest = Rotation.from_matrix(T[:3, :3].T @ B[:3, :3]).magnitude()
    assert np.allclose([first, rest], [share * whole, (1 - share) * whole], atol=1e-4)


def test_transforms_hold_for_a_moment_only() -> None:
    rng = np.random.default_rng(5)
    tree = Transforms([told(t, "map", "c", random_T(rng)) for t in (1.0, 1.5, 3.0)])
    known = [tree.T_root_frame("c", t) is not None for t in (0.9, 0.96, 1.2, 1.5, 2.0, 3.04, 3.1)]
    assert known == [False, True, True, True, False, True, False]


def test_broken_transforms_are_left_out_and_circles_end() -> None:
    good = make_T(np.eye(3), [1.0, 2, 3])
    bad = told(1.0, "map", "c", good)
    bad[0].transform.translation.x = np.nan
    long = told(1.5, "map", "c", good)
    long[0].transform.rotation.w = 5.0
    tree = Transforms([bad, told(1.0, "map", "c", good), long])
    assert np.allclose(tree.T_root_frame("c", 1.0), good)
    assert tree.T_root_frame("c", 1.5) is None
    circle = Transforms([told(1, "a", "b", good), told(1, "b", "a", good)])
    assert circle.root("a") == "b" and not circle.is_world("elsewhere")


def test_a_frame_hangs_where_it_was_told_of_last() -> None:
    rng = np.random.default_rng(2)
    A, B = random_T(rng), random_T(rng)
    tree = Transforms([told(1.0, "base", "c", A), told(1.0, "map", "c", B)])
    assert tree.root("c") == "map" and np.allclose(tree.T_root_frame("c", 1.0), B)


@pytest.mark.parametrize("kind", KINDS)
def test_images_are_read_by_threads_in_turns(kind: str, tmp_path: Path) -> None:
    sequence = open_sequence(robot(kind).write(tmp_path))
    often = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(4) as pool:
            read = list(pool.map(lambda _: list(sequence), range(16)))
    finally:
        sys.setswitchinterval(often)
    assert not sequence.skipped
    for frames in read:
        assert [frame.index for frame in frames] == list(range(COUNT))
    for frame in (frame for frames in read for frame in frames):
        assert np.array_equal(np.round(frame.depth_m * 1000), depth_mm(frame.index))
        assert frame.color is not None and np.array_equal(frame.color, color(frame.index))


def test_a_broken_image_within_does_not_end_the_rest(tmp_path: Path) -> None:
    bag = Recording("mcap")
    add_depth(bag)
    bag.messages[1][2].step = 7
    bag.messages[2][2].encoding = "32FC1"
    sequence = open_sequence(bag.write(tmp_path))
    assert [frame.index for frame in sequence] == [0, 3]
    assert {reason for _, reason in sequence.skipped} == {"depth image is truncated or corrupt"}


def jpeg(pixels: np.ndarray) -> bytes:
    image = BytesIO()
    Image.fromarray(pixels).save(image, "JPEG")
    return image.getvalue()


def test_depth_is_no_colour(tmp_path: Path) -> None:
    bag = Recording("mcap")
    bag.image("/d", 1.0, "f", depth_mm(0), "16UC1")
    bag.packed("/c", 1.0, "f", jpeg(color(0)), "jpeg")
    bag.image("/infra", 1.0, "f", color(0)[..., 0], "mono8")
    bag.packed("/infra/compressed", 1.0, "f", png(color(0)[..., 0]), "mono8; png compressed")
    from composenet.sequences import ros, ros_bag

    bag.packed("/jpeg", 1.0, "f", jpeg(color(0)[..., 0]), "jpeg")
    opened = Bag(bag.write(tmp_path))
    assert ros._image_topics(opened, ros_bag.is_depth) == ["/d"]
    assert ros._image_topics(opened, ros_bag.is_color) == ["/c"]
    assert read_depth(ros_bag.BagImage(opened, "/d", int(1e9), 0, (WIDTH, HEIGHT))).any()
    with pytest.raises(SequenceError, match="image is missing"):
        ros_bag.BagImage(opened, "/d", int(1e9), 1, (WIDTH, HEIGHT)).open()


def test_the_command_tracks_a_recording(tmp_path: Path, tiny_weights: Path) -> None:
    from composenet.commands.track import run_track

    path, out = robot("mcap").write(tmp_path), tmp_path / "result"
    code = run_track(
        path,
        out,
        weights=tiny_weights,
        config=None,
        device="cpu",
        stride=1,
        max_frames=None,
        save_every=50,
        variant={},
        reading=SequenceOptions(),
    )
    assert code == 0 and (out / "tracks.json").is_file() and (out / "report.html").is_file()


# --- what real robots send ------------------------------------------------------------------

TOPICS = [  # depth to take, others with 16 bits, the colour to take, others with colour
    ("/depth/image_raw", ["/ir/image_raw"], "/rgb/image_raw", []),
    ("/depth_to_rgb/image_raw", ["/depth/image_raw", "/ir/image_raw"], "/rgb/image_raw", []),
    ("/camera/depth/image_raw", ["/camera/ir/image_raw"], "/camera/color/image_raw", []),
    ("/kinect2/sd/image_depth_rect", ["/kinect2/sd/image_ir_rect"], "/kinect2/hd/image_color", []),
    (
        "/zed/zed_node/depth/depth_registered",
        ["/zed/zed_node/confidence/confidence_map"],
        "/zed/zed_node/left/image_rect_color",
        ["/zed/zed_node/left_raw/image_raw_color"],
    ),
    ("/oak/stereo/image_raw", [], "/oak/rgb/image_raw", []),
    ("/robot1/camera/depth/image_raw", [], "/robot1/camera/image_raw", ["/a/image_raw"]),
    (
        "/camera/aligned_depth_to_color/image_raw",
        ["/camera/depth/image_rect_raw", "/camera/infra1/image_rect_raw"],
        "/camera/color/image_raw",
        [],
    ),
]


@pytest.mark.parametrize(("depth", "others", "colour", "more"), TOPICS)
def test_the_topics_of_common_cameras(
    depth: str, others: list[str], colour: str, more: list[str], tmp_path: Path
) -> None:
    from composenet.sequences import ros

    bag = Recording("mcap")
    for topic in (depth, *others):
        bag.image(topic, 1.0, "d", depth_mm(0), "16UC1")
    for topic in (colour, *more):
        bag.image(topic, 1.0, "c", color(0), "rgb8")
    opened, warnings = Bag(bag.write(tmp_path)), list[str]()
    assert ros._depth_topic(opened, None, warnings) == depth
    assert ros._color_topic(opened, depth) == colour
    assert any("are taken for depth" in w for w in warnings) == ("depth" not in depth)


def test_infrared_alone_is_no_depth_unless_it_is_asked_for(tmp_path: Path) -> None:
    bag = Recording("mcap")
    bag.image("/ir/image_raw", 1.0, "ir", depth_mm(0), "mono16")
    bag.info("/ir/camera_info", "ir", K, (WIDTH, HEIGHT))
    path = bag.write(tmp_path)
    with pytest.raises(SequenceError, match=r"no topic with depth.*/ir/image_raw.*--depth-topic"):
        open_sequence(path)
    assert len(frames_of(path, depth_topic="/ir/image_raw")) == 1


def test_intrinsics_are_those_of_the_camera_itself(tmp_path: Path) -> None:
    other = np.array([[30.0, 0, 11.5], [0, 30.0, 8.5], [0, 0, 1]])
    for infos, expected in (
        ([("/camera/color/camera_info", "color", other)], None),
        ([("/robot2/camera/depth/camera_info", "color", other)], None),
        ([("/elsewhere/camera_info", "optical", K)], K),
        ([("/camera/color/camera_info", "color", other), ("/x/camera_info", "optical", K)], K),
    ):
        bag = Recording("mcap")
        bag.image(DEPTH, 1.0, "optical", depth_mm(0), "16UC1")
        for topic, frame, matrix in infos:
            bag.info(topic, frame, matrix, (WIDTH, HEIGHT))
        bag.info("/camera/depth/half/camera_info", "optical", other, (WIDTH // 2, HEIGHT // 2))
        from composenet.sequences import ros

        found = ros._intrinsics(
            Bag(bag.write(tmp_path, f"{len(list(tmp_path.iterdir()))}")), DEPTH, []
        )
        assert (found is None) == (expected is None)
        assert expected is None or np.array_equal(found, expected)


def test_robots_keep_their_transforms(tmp_path: Path) -> None:
    bag = Recording("mcap")
    add_depth(bag, "/robot1/depth/image_raw")
    for i in range(COUNT):
        bag.transform(time_s(i), "odom", "optical", pose(i), "/robot1/tf")
        bag.transform(time_s(i), "odom", "optical", pose(-20 - 3 * i), "/robot2/tf")
    sequence = open_sequence(bag.write(tmp_path))
    xs = [frame.T_world_camera[0, 3] for frame in sequence]
    assert np.allclose(np.diff(xs), 0.1, atol=1e-6)


def test_what_changes_counts_before_what_holds_always() -> None:
    rng = np.random.default_rng(3)
    A, B, S = (random_T(rng) for _ in range(3))
    moving = [told(1.0, "map", "c", A), told(1.5, "map", "c", B)]
    for both in ([*moving, told(2.0, "map", "c", S, True)], [told(0, "x", "c", S, True), *moving]):
        tree = Transforms(both)
        assert np.allclose(tree.T_root_frame("c", 1.5), B) and tree.root("c") == "map"


def test_cameras_on_one_rig_need_no_way_to_the_world() -> None:
    rng = np.random.default_rng(4)
    A, B = random_T(rng), random_T(rng)
    tree = Transforms(
        [
            told(5.0, "map", "rig", random_T(rng)),
            told(0.0, "rig", "a", A, True),
            told(0.0, "rig", "b", B, True),
        ]
    )
    assert tree.T_root_frame("a", 0.0) is None
    assert np.allclose(tree.T_between("a", "b", 0.0), np.linalg.inv(A) @ B)
    assert np.allclose(tree.T_between("a", "rig", 0.0), np.linalg.inv(A))


def test_what_stays_the_same_holds_between_and_does_not_move() -> None:
    T = make_T(np.eye(3), [1.0, 2, 3])
    tree = Transforms([told(t, "trunk", "c", T) for t in (1.0, 5.0)])
    assert np.allclose(tree.T_root_frame("c", 3.0), T)
    assert not tree.moves("c") and not tree.is_world("c")


@pytest.mark.parametrize("topic", [DEPTH, f"{DEPTH}/compressed", f"{DEPTH}/compressedDepth"])
@pytest.mark.parametrize("format", ["png", "16UC1; png compressed", ""])
def test_compressed_depth_is_known_by_its_bytes(topic: str, format: str, tmp_path: Path) -> None:
    bag = Recording("mcap")
    bag.packed(topic, 1.0, "optical", png(depth_mm(0)), format)
    bag.packed(topic, 2.0, "optical", packed_depth(depth_mm(1)), format)
    bag.info("/camera/depth/camera_info", "optical", K, (WIDTH, HEIGHT))
    frames = frames_of(bag.write(tmp_path))
    for i, frame in enumerate(frames):
        assert np.array_equal(frame.depth_m, depth_mm(i) / np.float32(1000))
        assert frame.color is None
    assert len(frames) == 2


def test_depth_as_a_tiff_of_metres(tmp_path: Path) -> None:
    bag, image = Recording("mcap"), BytesIO()
    Image.fromarray((depth_mm(0) / 1000).astype(np.float32)).save(image, "TIFF")
    bag.packed(f"{DEPTH}/compressed", 1.0, "optical", image.getvalue(), "32FC1; tiff compressed")
    bag.info("/camera/depth/camera_info", "optical", K, (WIDTH, HEIGHT))
    (frame,) = frames_of(bag.write(tmp_path))
    assert np.allclose(frame.depth_m, depth_mm(0) / 1000, atol=1e-6)


def test_eight_bits_are_no_depth_where_there_is_better(tmp_path: Path) -> None:
    bag = Recording("mcap")
    eight = (depth_mm(0) // 16).astype(np.uint8)
    bag.packed(f"{DEPTH}/compressed", 1.0, "optical", jpeg(eight), "16UC1; jpeg compressed ")
    bag.packed(f"{DEPTH}/compressedDepth", 1.0, "optical", packed_depth(depth_mm(0)), "")
    bag.info("/camera/depth/camera_info", "optical", K, (WIDTH, HEIGHT))
    (frame,) = frames_of(bag.write(tmp_path))
    assert np.array_equal(frame.depth_m, depth_mm(0) / np.float32(1000))


def test_frames_of_no_name_are_not_one_camera(tmp_path: Path) -> None:
    bag = Recording("bag")
    topic = "/device_0/sensor_0/Depth_0/image/data"
    bag.image(topic, 1.0, "0", depth_mm(0), "mono16")
    bag.info("/device_0/sensor_0/Depth_0/info/camera_info", "0", K, (WIDTH, HEIGHT))
    wide = np.array([[40.0, 0, 23.5], [0, 40.0, 17.5], [0, 0, 1]])
    bag.image("/device_0/sensor_1/Color_0/image/data", 1.0, "0", color(0), "rgb8")
    bag.info("/device_0/sensor_1/Color_0/info/camera_info", "0", wide, (WIDTH, HEIGHT))
    sequence = open_sequence(bag.write(tmp_path))
    assert np.array_equal(sequence.camera.K, K)
