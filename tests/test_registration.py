"""Colour of another camera: it is found by its edges, and brought onto the depth images."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from composenet.geometry.camera import back_project
from composenet.geometry.transform import inverse_T, make_T
from composenet.records import Camera, FloatArray
from composenet.sequences import SequenceOptions, open_sequence
from composenet.sequences.brightness import LEVELS, LitView
from composenet.sequences.registration import ColorCamera, find_color_camera
from composenet.synth.scene import Scene, SceneOptions, generate_scene

OPTIONS = SceneOptions(frames=8, image_size=(240, 180))
Images = list[tuple[np.ndarray, np.ndarray]]


@pytest.fixture(scope="module", params=[0, 4, 6])
def scene(request: pytest.FixtureRequest) -> Scene:
    return generate_scene("train", 8_000_000 + request.param, OPTIONS)


def other_camera(
    camera: Camera, zoom: float, aside_m: float, shift_px: tuple[float, float]
) -> ColorCamera:
    K = camera.K * zoom
    K[:2, 2] = (camera.width - 1) / 2 + shift_px[0], (camera.height - 1) / 2 + shift_px[1]
    K[2, 2] = 1
    return ColorCamera(K, make_T(np.eye(3), [aside_m, 0, 0]))


def seen_by(scene: Scene, color: ColorCamera, size: tuple[int, int] | None = None) -> Images:
    """Depth of the scene's own camera, colour of another."""
    width, height = size or (scene.camera.width, scene.camera.height)
    other = replace(
        scene,
        camera=Camera(np.asarray(color.K), width, height),
        T_world_camera=scene.T_world_camera @ inverse_T(color.T_color_depth),
    )
    pairs = []
    for i in range(scene.n_frames):
        rgb = other.render(i, noise=False).frame.color
        assert rgb is not None
        pairs.append((scene.render(i, color=False).frame.depth_m, rgb))
    return pairs


def places(color: ColorCamera, depth_m: np.ndarray, camera: Camera) -> FloatArray:
    """Pixels of the colour image, of all pixels with depth."""
    points = back_project(depth_m, camera)[depth_m > 0] @ color.T_color_depth[:3, :3].T
    points = points + color.T_color_depth[:3, 3]
    return points[:, :2] / points[:, 2:] * color.K[[0, 1], [0, 1]] + color.K[:2, 2]


def off_px(found: ColorCamera, true: ColorCamera, images: Images, camera: Camera) -> float:
    """Median distance of what both say, of the pixels that the colour camera sees."""
    far = []
    for depth_m, _ in images:
        a, b = places(found, depth_m, camera), places(true, depth_m, camera)
        seen = ((b >= 0) & (b < [camera.width, camera.height])).all(axis=1)
        far.append(np.hypot(*(a - b)[seen].T))
    return float(np.median(np.concatenate(far)))


def test_colour_that_lies_on_depth_is_left_alone(scene: Scene) -> None:
    images = seen_by(scene, ColorCamera(scene.camera.K, np.eye(4)))
    assert find_color_camera(images, scene.camera) is None


@pytest.mark.parametrize(
    ("zoom", "aside_m", "shift_px"),
    [(0.9, -0.025, (2.0, -1.0)), (1.5, 0.015, (-3.0, 2.0)), (0.75, 0.05, (0.0, 0.0))],
)
def test_another_camera_is_found(
    scene: Scene, zoom: float, aside_m: float, shift_px: tuple[float, float]
) -> None:
    true = other_camera(scene.camera, zoom, aside_m, shift_px)
    images = seen_by(scene, true)
    found = find_color_camera(images, scene.camera)
    assert found is not None
    none = ColorCamera(scene.camera.K, np.eye(4))
    before, after = (off_px(c, true, images, scene.camera) for c in (none, found))
    assert after < 2.5 and after < before / 3
    assert found.K[0, 0] == pytest.approx(zoom * scene.camera.K[0, 0], rel=0.04)
    assert found.K[1, 1] == found.K[0, 0]


def test_images_of_another_shape_are_stretched_back(scene: Scene) -> None:
    width, height = 320, 180  # 16:9 beside 4:3
    K = np.array([[300.0, 0, 159.5], [0, 300.0, 89.5], [0, 0, 1]])
    wide = seen_by(scene, ColorCamera(K, np.eye(4)), (width, height))
    camera = scene.camera
    images = [
        (d, np.array(Image.fromarray(rgb).resize((camera.width, camera.height)))) for d, rgb in wide
    ]
    aspect = width * camera.height / (height * camera.width)
    found = find_color_camera(images, camera, aspect)
    assert found is not None
    assert found.K[0, 0] == pytest.approx(300 * camera.width / width, rel=0.04)
    assert found.K[1, 1] == pytest.approx(300 * camera.height / height, rel=0.04)


def test_what_edges_do_not_tell_is_not_told(scene: Scene) -> None:
    camera, rng = scene.camera, np.random.default_rng(0)
    images = seen_by(scene, ColorCamera(camera.K, np.eye(4)))
    depths, colours = [d for d, _ in images], [c for _, c in images]
    noise = rng.integers(1, 255, (len(images), *colours[0].shape)).astype(np.uint8)
    cases = {
        "wall": [(np.full_like(d, 2.0), c) for d, c in images],
        "nothing": [(np.zeros_like(d), c) for d, c in images],
        "noise": list(zip(depths, noise, strict=True)),
        "grey": [(d, np.full_like(c, 128)) for d, c in images],
        "black": [(d, np.zeros_like(c)) for d, c in images],
        "other frames": list(zip(depths, colours[4:] + colours[:4], strict=True)),
        "few": images[:3],
        "none": [],
    }
    for what, pairs in cases.items():
        assert find_color_camera(pairs, camera) is None, what


@pytest.mark.parametrize("zoom", [1.25, 1.6])
def test_colour_that_was_registered_has_black_margins(scene: Scene, zoom: float) -> None:
    narrow = other_camera(scene.camera, zoom, 0.015, (0.0, 0.0))
    images = [(d, narrow.onto(c, d, scene.camera)) for d, c in seen_by(scene, narrow)]
    assert all((c == 0).all(axis=-1).mean() > 0.2 for _, c in images)
    assert find_color_camera(images, scene.camera) is None


def test_colours_place_is_projection_pixel_by_pixel() -> None:
    rng = np.random.default_rng(0)
    camera = Camera(np.array([[20.0, 0, 11.5], [0, 20.0, 8.5], [0, 0, 1]]), 24, 18)
    depth_m = rng.uniform(0.3, 4, (18, 24)).astype(np.float32)
    depth_m[rng.random(depth_m.shape) < 0.2] = 0
    rgb = rng.integers(1, 255, (30, 40, 3)).astype(np.uint8)
    T = make_T(Rotation.from_euler("xyz", [3, -9, 12], degrees=True).as_matrix(), [0.3, -0.1, 0.2])
    other = ColorCamera(np.array([[30.0, 0, 18], [0, 33, 16], [0, 0, 1]]), T)
    got = other.onto(rgb, depth_m, camera)
    for v, u in np.argwhere(depth_m > 0):
        expected = np.zeros(3)
        point = T[:3, :3] @ (depth_m[v, u] * (np.linalg.inv(camera.K) @ [u, v, 1])) + T[:3, 3]
        if point[2] > 0:
            a, b = np.rint((other.K @ point / point[2])[:2]).astype(int)
            if 0 <= a < 40 and 0 <= b < 30:
                expected = rgb[b, a]
        assert np.array_equal(got[v, u], expected)
    assert 0.1 < (got.max(axis=-1) > 0).mean() < 0.95


def test_a_stretched_image_shows_a_point_where_its_pixel_went() -> None:
    camera = ColorCamera(np.array([[30.0, 0, 18], [0, 33, 16], [0, 0, 1]]), np.eye(4))
    half = camera.stretched((40, 30), (20, 60))
    ray = np.array([0.2, -0.1, 1.0])
    (u, v, _), (x, y, _) = camera.K @ ray, half.K @ ray
    assert x == pytest.approx((u + 0.5) / 2 - 0.5) and y == pytest.approx((v + 0.5) * 2 - 0.5)
    same = camera.stretched((40, 30), (40, 30))
    assert np.array_equal(same.K, camera.K)


def test_colour_comes_onto_depth_as_if_it_had_been_seen_from_there(scene: Scene) -> None:
    true = other_camera(scene.camera, 0.8, 0.02, (1.0, 2.0))
    images = seen_by(scene, true)
    for i, (_, rgb) in enumerate(images):
        ours = scene.render(i)
        clean_m = ours.clean_depth_m
        got = true.onto(rgb, clean_m, scene.camera)
        expected = ours.frame.color
        assert got.shape == rgb.shape and expected is not None
        apart = np.abs(got.astype(int) - expected).max(axis=-1)
        raw = np.abs(rgb.astype(int) - expected).max(axis=-1)
        assert np.mean(apart[clean_m > 0] > 40) < 0.12
        assert np.mean(apart > 40) < 0.75 * np.mean(raw > 40)


def test_where_the_colour_camera_does_not_look_it_is_black() -> None:
    camera = Camera(np.array([[100.0, 0, 39.5], [0, 100.0, 29.5], [0, 0, 1]]), 80, 60)
    narrow = ColorCamera(np.array([[200.0, 0, 39.5], [0, 200.0, 29.5], [0, 0, 1]]), np.eye(4))
    rgb = np.full((60, 80, 3), 200, np.uint8)
    depth_m = np.full((60, 80), 2.0, np.float32)
    depth_m[20:40, 30:50] = 0  # a hole is as far as what is around it
    out = narrow.onto(rgb, depth_m, camera)
    assert (out[15:45, 20:60] == 200).all()
    assert (out[:14] == 0).all() and (out[:, :19] == 0).all()
    assert not narrow.onto(rgb, np.zeros_like(depth_m), camera).any()


def test_how_far_off_it_is_is_said_in_pixels() -> None:
    camera = Camera(np.array([[100.0, 0, 39.5], [0, 100.0, 29.5], [0, 0, 1]]), 80, 60)
    aside = ColorCamera(camera.K, make_T(np.eye(3), [0.1, 0, 0]))
    assert aside.pixels_off(camera, depth_m=2.0) == pytest.approx(5.0)
    K = camera.K.copy()
    K[0, 0] = K[1, 1] = 50.0
    corner = 0.5 * np.hypot(39.5, 29.5)
    assert ColorCamera(K, np.eye(4)).pixels_off(camera) == pytest.approx(corner)


def write(root: Path, scene: Scene, images: Images) -> Path:
    for name in ("depth", "color", "pose"):
        (root / name).mkdir(parents=True)
    for i, (depth_m, rgb) in enumerate(images):
        Image.fromarray(np.rint(depth_m * 1000).astype(np.uint16)).save(root / f"depth/{i}.png")
        Image.fromarray(rgb).save(root / f"color/{i}.png")
        np.savetxt(root / f"pose/{i}.txt", scene.T_world_camera[i])
    np.savetxt(root / "camera-intrinsics.txt", scene.camera.K)
    return root


def test_recordings_are_looked_at(scene: Scene, tmp_path: Path) -> None:
    true = other_camera(scene.camera, 0.85, 0.03, (0.0, 0.0))
    images = seen_by(scene, true)
    sequence = open_sequence(write(tmp_path / "off", scene, images))
    (note,) = (w for w in sequence.warnings if "colour is of another camera" in w)
    assert 10 < float(note.split("up to ")[1].split(" pixels")[0]) < 40
    for frame, (depth_m, rgb) in zip(sequence, images, strict=True):
        expected = true.onto(rgb, depth_m, scene.camera)
        assert frame.color is not None
        far = np.abs(frame.color.astype(int) - expected).max(axis=-1) > 40
        raw = np.abs(rgb.astype(int) - expected).max(axis=-1) > 40
        assert far.mean() < raw.mean()
    (tmp_path / "off" / "color" / "0.png").write_bytes(b"broken")
    warnings = open_sequence(tmp_path / "off").warnings
    assert any("colour is of another camera" in w for w in warnings)
    own = seen_by(scene, ColorCamera(scene.camera.K, np.eye(4)))
    registered = open_sequence(write(tmp_path / "on", scene, own))
    assert not any("colour" in w for w in registered.warnings)
    assert all(np.array_equal(f.color, rgb) for f, (_, rgb) in zip(registered, own, strict=True))


def test_what_colour_does_not_show_says_nothing_of_the_cameras_way() -> None:
    camera = Camera(np.array([[100.0, 0, 79.5], [0, 100.0, 59.5], [0, 0, 1]]), 160, 120)
    rng = np.random.default_rng(1)
    rgb = rng.integers(1, 255, (120, 160, 3)).astype(np.uint8)
    rgb[:, :60] = 0
    view = LitView(np.full((120, 160), 2.0, np.float32), rgb, camera)
    assert len(view.levels) == LEVELS
    for level in view.levels:
        width = level.depth_m.shape[1]
        known = np.flatnonzero((level.depth_m > 0).any(axis=0))
        assert known.min() / width > 60 / 160 and known.max() > width - 3
        assert len(level.points) and level.points[:, 0].min() > 2.0 * (60 - 79.5) / 100


def test_odometry_of_a_recording_sees_registered_colour(
    scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from composenet.sequences import recording

    given: list[np.ndarray | None] = []

    class Follows:
        def __init__(self, rough_color: bool) -> None:
            assert rough_color

        def __call__(self, depth_m: object, camera: object, color: np.ndarray | None) -> FloatArray:
            given.append(color)
            return np.eye(4)

        def way(self) -> list[FloatArray]:
            return [np.eye(4)] * len(given)

    monkeypatch.setattr(recording, "Odometry", Follows)
    images = seen_by(scene, other_camera(scene.camera, 0.85, 0.03, (0.0, 0.0)))
    path = write(tmp_path / "off", scene, images)
    sequence = open_sequence(path, options=SequenceOptions(odometry=True))
    assert len(given) == len(images)
    for color, frame, (_, rgb) in zip(given, sequence, images, strict=True):
        assert color is not None and np.array_equal(color, frame.color)
        assert not np.array_equal(color, rgb)
