"""Up and the floor, from rooms whose truth is known."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from composenet.errors import SequenceError
from composenet.geometry.camera import back_project, pixel_rays
from composenet.geometry.transform import apply_T, make_T
from composenet.records import Camera
from composenet.sequences import SequenceOptions, open_sequence
from composenet.sequences.leveling import (
    CAMERA_UP,
    CameraLeveler,
    Surface,
    find_floor,
    find_up,
    level_camera,
    level_world,
    merge,
    surface_of,
)

SHARED = Path(__file__).resolve().parents[2] / "shared" / "sequences"
CAMERA = Camera(np.array([[150.0, 0, 79.5], [0, 150.0, 59.5], [0, 0, 1]]), 160, 120)


def looking(yaw_deg: float, pitch_deg: float, roll_deg: float = 0.0) -> np.ndarray:
    """(3, 3) R_world_camera: ahead is +x turned by yaw, pitched down, then rolled."""
    level = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    turn = Rotation.from_euler("z", yaw_deg, degrees=True).as_matrix()
    down = Rotation.from_euler("xz", [-pitch_deg, roll_deg], degrees=True).as_matrix()
    return turn @ level @ down


def room_depth(T_world_camera: np.ndarray, table: bool = True, noise: float = 0.0) -> np.ndarray:
    """(120, 160) depth of a 6 x 6 x 2.6 m room around the origin with a 0.75 m high table."""
    rays = pixel_rays(CAMERA) @ T_world_camera[:3, :3].T
    origin = T_world_camera[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        walls = np.where(rays > 0, (([3, 3, 2.6]) - origin) / rays, ([-3, -3, 0] - origin) / rays)
        depth = walls.min(axis=-1)
        top = (0.75 - origin[2]) / rays[..., 2]
        hit = np.abs(origin + top[..., None] * rays - [1.2, 0, 0.75]).max(axis=-1) < 0.5
    if table:
        depth = np.where(hit & (top > 0) & (top < depth), top, depth)
    depth += noise * depth**2 * np.random.default_rng(0).normal(size=depth.shape)
    return depth.astype(np.float32)


def angle_deg(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(np.arccos(np.clip(a @ b, -1, 1))))


@pytest.mark.parametrize(("pitch", "roll"), [(15, 0), (30, 10), (50, -15), (5, 5)])
def test_one_frame_finds_up_and_its_height(pitch, roll):
    T = make_T(looking(20, pitch, roll), [-1.0, 0.2, 1.4])
    surface = surface_of(room_depth(T), CAMERA)
    up = find_up(surface, CAMERA_UP)
    assert angle_deg(T[:3, :3] @ up, np.array([0, 0, 1])) < 0.2
    _, T_level_camera = CameraLeveler().level(surface)
    assert T_level_camera[2, 3] == pytest.approx(1.4, abs=0.01)
    np.testing.assert_allclose(T_level_camera[2, :3], T[2, :3], atol=4e-3)
    assert T_level_camera[:2, 3].tolist() == [0, 0]
    ahead = T_level_camera[:3, 2]
    assert ahead[0] > 0 and ahead[1] == pytest.approx(0, abs=1e-9)


def test_sensor_noise_costs_little():
    T = make_T(looking(20, 30), [-1.0, 0.2, 1.4])
    up = find_up(surface_of(room_depth(T, noise=0.003), CAMERA), CAMERA_UP)
    assert angle_deg(T[:3, :3] @ up, np.array([0, 0, 1])) < 1


def test_a_wall_alone_shows_no_up():
    depth = np.full((120, 160), 2.0, np.float32)
    surface = surface_of(depth, CAMERA)
    assert find_up(surface, CAMERA_UP) is None
    held = CameraLeveler(up=np.array([0, -0.8, -0.6]), height_m=1.3)
    after, T = held.level(surface)
    assert after == held
    np.testing.assert_allclose(T[:3, :3] @ held.up, [0, 0, 1], atol=1e-12)
    assert T[2, 3] == 1.3


@pytest.mark.parametrize("up", [(0, 0, 1), (0, 0, -1), (0, -1, 0), (0.1, -0.2, 0.9)])
def test_camera_levelling_is_a_rotation_for_any_up(up):
    up = np.array(up, dtype=float) / np.linalg.norm(up)
    _, T = CameraLeveler(up=up, height_m=1.0).level(merge([]))
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1)
    np.testing.assert_allclose(T[:3, :3] @ up, [0, 0, 1], atol=1e-12)


def recording(T_source_level: np.ndarray):
    """Surface in a source world and mean camera up of a walk through the room."""
    surfaces, ups = [], []
    for yaw in (-60, 0, 60, 120):
        T = T_source_level @ make_T(looking(yaw, 25), [-0.5, 0.1, 1.5])
        surfaces.append(surface_of(room_depth(np.linalg.inv(T_source_level) @ T), CAMERA).moved(T))
        ups.append(T[:3, :3] @ CAMERA_UP)
    return merge(surfaces), np.mean(ups, axis=0)


@pytest.mark.parametrize("seed", range(6))
def test_any_world_becomes_level(seed):
    """Level and source differ by any rotation and shift: level comes back up to yaw and x, y."""
    rng = np.random.default_rng(seed)
    T_source_level = make_T(Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3))
    surface, up = recording(T_source_level)
    T_level_source, notes = level_world(surface, up, gravity=None)
    back = T_level_source @ T_source_level
    assert notes == []
    assert angle_deg(back[:3, 2], np.array([0, 0, 1])) < 0.2
    assert back[2, 3] == pytest.approx(0, abs=0.01)


def test_gravity_overrules_the_surfaces():
    surface, up = recording(np.eye(4))
    gravity = np.array([0.05, 0, -1]) / np.linalg.norm([0.05, 0, -1])
    T, _ = level_world(surface, up, gravity)
    np.testing.assert_allclose(T[:3, :3] @ gravity, [0, 0, -1], atol=1e-12)


def test_a_level_world_is_hardly_changed():
    surface, up = recording(make_T(np.eye(3), [0, 0, 0.3]))
    T, _ = level_world(surface, up, gravity=None)
    np.testing.assert_allclose(T, make_T(np.eye(3), [0, 0, -0.3]), atol=0.01)


def test_without_surfaces_the_nearest_world_axis_is_up():
    T, notes = level_world(merge([]), np.array([0.1, -0.9, 0.2]), gravity=None)
    np.testing.assert_allclose(T[:3, :3] @ [0, -1, 0], [0, 0, 1], atol=1e-12)
    assert any("guessed" in note for note in notes)
    T, _ = level_world(merge([]), np.zeros(3), gravity=None)
    np.testing.assert_array_equal(T, np.eye(4))


def test_floor_is_the_lowest_large_level_not_reflections_below():
    rng = np.random.default_rng(0)
    z = np.concatenate([np.full(500, -0.6), np.full(3000, 0.02), np.full(9000, 0.75)])
    points = np.column_stack([rng.normal(size=(len(z), 2)), z + rng.normal(0, 0.004, len(z))])
    surface = merge([])
    surface = type(surface)(points, np.tile([0.0, 0, 1], (len(z), 1)), np.ones(len(z)))
    assert find_floor(surface) == pytest.approx(0.02, abs=0.005)


def points_of(sequence, count: int = 5) -> np.ndarray:
    frames = list(sequence)
    picked = frames[:: max(1, len(frames) // count)]
    clouds = [
        apply_T(f.T_world_camera, back_project(f.depth_m, f.camera)[f.depth_m > 0]) for f in picked
    ]
    return np.concatenate(clouds)


def real(name: str) -> Path:
    folder = SHARED / name
    if not folder.is_dir():
        pytest.skip(f"recording {name} is not on this machine")
    return folder


def test_kitchen_is_levelled_by_its_gravity_file():
    folder = real("redkitchen_7scenes")
    sequence = open_sequence(folder, stride=10)
    gravity = np.loadtxt(folder / "gravity-direction.txt")
    assert angle_deg(sequence.T_level_source[:3, :3] @ gravity, np.array([0, 0, -1])) < 0.1
    z = points_of(sequence)[:, 2]
    assert (z < -0.15).mean() < 0.005
    assert ((z > -0.05) & (z < 0.05)).mean() > 0.01
    near_table = np.histogram(z, np.arange(0.5, 0.95, 0.05))[0]
    assert 0.65 <= 0.5 + 0.05 * np.argmax(near_table) <= 0.75


def test_kitchen_surfaces_agree_with_its_gravity_file():
    """Its README: the dominant plane's normal is 1.8 degrees from gravity."""
    folder = real("redkitchen_7scenes")
    sequence = open_sequence(folder, stride=10)
    surface = merge([surface_of(f.depth_m, f.camera).moved(f.T_world_camera) for f in sequence])
    up = find_up(surface, np.array([0.0, 0, 1]))
    assert angle_deg(up, np.array([0, 0, 1])) < 2.5


def test_livingroom_is_levelled_by_its_floor():
    options = SequenceOptions(intrinsics=(525, 525, 319.5, 239.5))
    sequence = open_sequence(real("livingroom1_icl_synthetic"), stride=6, options=options)
    points = points_of(sequence)
    floor = points[np.abs(points[:, 2]) < 0.04]
    assert len(floor) > 0.1 * len(points)
    centered = floor - floor.mean(axis=0)
    normal = np.linalg.eigh(centered.T @ centered)[1][:, 0]
    assert angle_deg(np.abs(normal), np.array([0, 0, 1])) < 1
    assert np.median(floor[:, 2]) == pytest.approx(0, abs=0.02)
    assert (points[:, 2] < -0.1).mean() < 0.001


def test_aims_is_levelled_frame_by_frame():
    options = SequenceOptions(intrinsics=(423.8, 423.8, 320, 236.5))
    sequence = open_sequence(real("aims_realsense_floor"), stride=5, options=options)
    assert not sequence.has_poses
    assert any("no camera poses" in line for line in sequence.warnings)
    for frame in sequence:
        assert frame.depth_m.max() <= 10
        assert 0.4 < frame.T_world_camera[2, 3] < 0.8


def scene_with_little_floor(share: float) -> Surface:
    """A table top of 1 m^2 at 0.75 m, a wall, some of two seats at 0.45 m, and a floor that is so
    small a share of the table."""
    rng = np.random.default_rng(0)

    def flat(count: int, z: float) -> tuple[np.ndarray, np.ndarray]:
        points = np.column_stack([rng.uniform(-1, 1, (count, 2)), rng.normal(z, 0.003, count)])
        return points, np.tile([0.0, 0, 1], (count, 1))

    wall = np.column_stack([rng.uniform(-1, 1, 600), np.ones(600), rng.uniform(0, 2, 600)])
    parts = [flat(1000, 0.75), (wall, np.tile([0.0, -1, 0], (600, 1))), flat(int(1000 * share), 0)]
    if share:
        parts.append(flat(60, 0.45))
    points, normals = (np.concatenate(values) for values in zip(*parts, strict=True))
    return Surface(points, normals, np.ones(len(points)))


@pytest.mark.parametrize("share", [0.01, 0.05, 0.3])
def test_neither_table_tops_nor_seats_are_a_floor(share: float) -> None:
    """Where something lies below them."""
    floor = find_floor(scene_with_little_floor(share))
    assert floor == pytest.approx(0, abs=0.01)


@pytest.mark.parametrize("tilt_deg", [0.0, 20.0])
def test_two_walls_tell_what_is_up_where_nothing_level_is_seen(tilt_deg: float) -> None:
    rng = np.random.default_rng(0)
    sides = np.repeat([[1.0, 0, 0], [0, -1, 0]], [700, 300], axis=0)
    normals = sides + 0.03 * rng.standard_normal((1000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    turn = Rotation.from_euler("xyz", [tilt_deg, tilt_deg / 2, 30], degrees=True).as_matrix()
    walls = Surface(rng.uniform(-1, 1, (1000, 3)), normals @ turn.T, np.ones(1000))
    up = find_up(walls, np.array([0.0, 0, 1]))
    assert up is not None and angle_deg(up, turn[:, 2]) < 0.5
    one = Surface(walls.points[:700], walls.normals[:700], walls.weights[:700])
    assert find_up(one, np.array([0.0, 0, 1])) is None


@pytest.mark.parametrize("off_deg", [0.0, 4.0, 10.0, 30.0])
def test_gravity_that_is_not_what_is_seen_is_doubted(off_deg: float) -> None:
    T = make_T(looking(20, 30), [-1.0, 0.2, 1.4])
    surface = surface_of(room_depth(T), CAMERA).moved(T)
    gravity = Rotation.from_euler("x", off_deg, degrees=True).apply([0.0, 0, -1])
    T_level, notes = level_world(surface, np.array([0.0, 0, 1]), gravity)
    doubts = [note for note in notes if "gravity-direction.txt" in note]
    assert [f"{off_deg:.0f} degrees" in note for note in doubts] == [True] * (off_deg > 6)
    np.testing.assert_allclose(T_level[:3, :3] @ gravity, [0, 0, -1], atol=1e-9)  # it is believed


@pytest.mark.parametrize("share", [0.03, 0.08, 0.12])
def test_reflections_just_below_a_floor_leave_it_the_floor(share: float) -> None:
    rng = np.random.default_rng(0)
    floor = np.column_stack([rng.uniform(-1, 1, (1000, 2)), rng.normal(0, 0.003, 1000)])
    count = int(1000 * share)
    below = np.column_stack([rng.uniform(-1, 1, (count, 2)), rng.uniform(-0.28, -0.12, count)])
    points = np.concatenate([floor, below])
    surface = Surface(points, np.tile([0.0, 0, 1], (len(points), 1)), np.ones(len(points)))
    assert find_floor(surface) == pytest.approx(0, abs=0.01)


def test_without_a_floor_under_it_no_height_is_known() -> None:
    surface = scene_with_little_floor(0.0)
    assert find_floor(surface) is None
    turn = looking(0, 20)
    seen = Surface((surface.points - [0, -2, 1.4]) @ turn, surface.normals @ turn, surface.weights)
    leveler, T = CameraLeveler().level(seen)
    assert leveler.height_m is None and T[2, 3] == 0
    known = CameraLeveler.from_samples(
        [seen, surface_of(room_depth(make_T(turn, [-1, 0, 1.4])), CAMERA)]
    )
    assert known.height_m == pytest.approx(1.4, abs=0.02)
    T_level = level_world(surface, np.array([0.0, 0, 1]), np.array([0.0, 0, -1]))
    assert any("no floor found" in note for note in T_level[1])


UP = np.array([0.0, 0, 1])


def seen_above(height_m: float, T_camera: np.ndarray | None = None) -> tuple[Surface, np.ndarray]:
    """What four views of the room show above a height, and where the camera's top points.
    T_camera: (4, 4) how the camera is turned in its mount."""
    surfaces, ups = [], []
    for yaw in (0, 100, 200, 290):
        T = make_T(looking(yaw, 25), [-1.0, 0.2, 1.4])
        surfaces.append(surface_of(room_depth(T), CAMERA).moved(T))
        turn = np.eye(4) if T_camera is None else T_camera
        ups.append(T[:3, :3] @ turn[:3, :3] @ CAMERA_UP)
    every = merge(surfaces)
    shown = every.points[:, 2] > height_m
    kept = Surface(every.points[shown], every.normals[shown], every.weights[shown])
    return kept, np.mean(ups, axis=0)


@pytest.mark.parametrize("gravity", [None, -UP])
def test_a_world_that_is_level_keeps_its_floor_where_none_is_seen(gravity) -> None:
    surface, up = seen_above(0.05)
    standing = surface.points[:, 2] < 0.7  # without the table top nothing level is left
    standing |= surface.normals[:, 2] < 0.9
    surface = Surface(*(v[standing] for v in (surface.points, surface.normals, surface.weights)))
    T, notes = level_world(surface, up, gravity, own_floor_m=0.0)
    assert abs(T[2, 3]) < 0.05 and any("own world is taken" in note for note in notes)
    T, notes = level_world(surface, up, gravity)
    assert T[2, 3] < -0.05 and any("lowest surface" in note for note in notes)


def test_a_floor_above_that_of_a_level_world_is_doubted() -> None:
    surface, up = seen_above(0.7)
    T, notes = level_world(surface, up, None, own_floor_m=0.0)
    assert T[2, 3] == pytest.approx(-0.75, abs=0.02)  # the table's top
    assert any("--levelled" in note and "0.75 m above" in note for note in notes)
    whole, up = seen_above(-1.0)
    for own_floor_m in (None, 0.0, 0.05, 0.5):  # there is none, it is right, or things lie below
        T, notes = level_world(whole, up, None, own_floor_m)
        assert T[2, 3] == pytest.approx(0, abs=0.01) and notes == []
    tilted = make_T(Rotation.from_euler("x", 20, degrees=True).as_matrix(), np.zeros(3))
    _, notes = level_world(surface.moved(tilted), tilted[:3, :3] @ up, None, own_floor_m=0.0)
    assert not any("--levelled" in note for note in notes)  # no level world


@pytest.mark.parametrize("roll_deg", [0, 90, 180, -90])
def test_a_level_world_that_is_turned_for_a_camera_that_hangs_is_doubted(roll_deg: int) -> None:
    roll = make_T(Rotation.from_euler("z", roll_deg, degrees=True).as_matrix(), np.zeros(3))
    surface, up = seen_above(-1.0, roll)
    if abs(roll_deg) == 90:  # it does not pan
        up = np.array([0.0, np.sign(roll_deg), 0.2])
    T, notes = level_world(surface, up, None, own_floor_m=0.0)
    doubted = any("hangs sideways or upside down" in note for note in notes)
    assert doubted == (angle_deg(T[2, :3], UP) > 45) == (roll_deg != 0)
    for gravity, own_floor_m in ((-UP, 0.0), (None, None), (None, 1.0)):  # that is no floor
        assert "hangs" not in str(level_world(surface, up, gravity, own_floor_m)[1])


@pytest.mark.parametrize("tilt_deg", [0.0, 0.5, -0.5])
@pytest.mark.parametrize("away_m", [0.0, 100.0])
def test_the_floor_of_a_level_world_lies_under_what_is_seen(away_m: float, tilt_deg: float) -> None:
    """However far from the world's origin that is, where a small turn lifts it by much."""
    surface, up = seen_above(-1.0)
    turn = make_T(Rotation.from_euler("y", tilt_deg, degrees=True).as_matrix(), np.zeros(3))
    away = make_T(np.eye(3), [away_m, 0, 0])
    T_source = away @ turn  # the room lies so in the source's world
    there = surface.moved(T_source)
    T, notes = level_world(there, up, None, own_floor_m=0.0)
    assert notes == [] and (T @ T_source)[2, 3] == pytest.approx(0, abs=0.02)
    high = surface.points[:, 2] > 0.05
    high &= (surface.normals[:, 2] < 0.9) & (surface.points[:, 2] > 0.05)
    bare = Surface(surface.points[high], surface.normals[high], surface.weights[high])
    T, notes = level_world(bare.moved(T_source), up, None, own_floor_m=0.0)
    assert any("own world is taken" in note for note in notes)
    assert (T @ T_source)[2, 3] == pytest.approx(0, abs=0.03)


def test_gravity_that_points_up_is_told_of() -> None:
    surface, up = seen_above(-1.0)
    _, notes = level_world(surface, up, UP)
    assert any("accelerometer" in note for note in notes)
    assert "accelerometer" not in str(level_world(surface, up, -UP)[1])
    steep = np.abs(surface.normals[:, 2]) < 0.99  # walls and little else say nothing
    walls = Surface(surface.points[steep], surface.normals[steep], surface.weights[steep])
    for gravity in (UP, -UP):
        assert "accelerometer" not in str(level_world(walls, up, gravity)[1])
    assert level_world(merge([]), up, UP)[1]


@pytest.mark.parametrize(
    "depth", [np.full((120, 160), 1500, np.uint16), np.full((120, 160), 1500.0), np.ones((9, 9))]
)
def test_a_live_camera_is_levelled_by_metres(depth: np.ndarray) -> None:
    with pytest.raises(SequenceError, match="level_camera: depth_m"):
        level_camera(depth, CAMERA)


def test_what_a_live_camera_did_not_measure_is_nothing() -> None:
    T = make_T(looking(20, 40), [-1.0, 0.2, 1.4])
    depth = room_depth(T)
    expected = level_camera(depth, CAMERA)
    assert expected is not None
    unmeasured = depth.copy()
    unmeasured[:10, :10] = np.inf
    unmeasured[:10, 20:30] = np.nan
    depth[:10, :10] = depth[:10, 20:30] = 0
    np.testing.assert_array_equal(level_camera(unmeasured, CAMERA), level_camera(depth, CAMERA))
    np.testing.assert_allclose(level_camera(unmeasured, CAMERA), expected, atol=0.01)
