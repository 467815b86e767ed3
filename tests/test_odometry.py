"""Camera poses from depth alone: true ones come back, whatever the world; a lost camera is told."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import composenet
from baseline_scenes import CAMERA, cabinet, camera_pose, look, pillar
from composenet import cli
from composenet.errors import ConfigError, SequenceError
from composenet.geometry.camera import pixel_rays
from composenet.geometry.transform import angle_between_deg, inverse_T, make_T, rotation_z
from composenet.predictions import read_predictions
from composenet.records import Camera, Frame
from composenet.sequences import Odometry, SequenceOptions, open_sequence
from composenet.synth.scene import generate_scene

THINGS = [pillar(3.2, -0.2), pillar(2.4, 2.0), pillar(3.0, 2.9), pillar(3.6, 1.0)]
OPTIONS = SequenceOptions(odometry=True)
NOTHING = np.zeros((CAMERA.height, CAMERA.width), np.float32)


def walk(yaws: list[float]) -> list[Frame]:
    """Views of a room on a walk of 6 cm a step, turned to the left by so many radians."""
    poses = [camera_pose(yaw, x=0.06 * i) for i, yaw in enumerate(yaws)]
    return [look(i, [cabinet(2.6, 0.9, 0.7)], THINGS, T).frame for i, T in enumerate(poses)]


SWAY = walk([0.0, 0.05, 0.1, 0.2, 0.3, 0.25, 0.1, 0.0])


def assert_same(T: np.ndarray, other: np.ndarray, metres: float = 0.01, degrees: float = 0.3):
    assert np.linalg.norm(T[:3, 3] - other[:3, 3]) < metres
    assert angle_between_deg(T[:3, :3], other[:3, :3]) < degrees


def from_first(frame: Frame, first: Frame) -> np.ndarray:
    """The true pose in the axes of the first camera."""
    return inverse_T(first.T_world_camera) @ frame.T_world_camera


class FromFirst:
    """Odometry's poses in the axes of the first camera."""

    def __init__(self) -> None:
        self._odometry = Odometry()
        self._T_first_world: np.ndarray | None = None

    def __call__(self, depth_m: np.ndarray, camera: Camera = CAMERA) -> np.ndarray | None:
        T = self._odometry(depth_m, camera)
        if T is None:
            return None
        if self._T_first_world is None:
            self._T_first_world = inverse_T(T)
        return self._T_first_world @ T


def save(root: Path, frames: list[Frame]) -> Path:
    """A plain folder without poses."""
    (root / "depth").mkdir(parents=True)
    for frame in frames:
        units = np.round(1000 * frame.depth_m).astype(np.uint16)
        Image.fromarray(units).save(root / f"depth/{frame.index}.png")
    np.savetxt(root / "camera-intrinsics.txt", CAMERA.K)
    return root


def test_a_swaying_camera_is_followed() -> None:
    odometry = FromFirst()
    for frame in SWAY:
        T = odometry(frame.depth_m)
        assert T is not None
        assert_same(T, from_first(frame, SWAY[0]))


def test_a_fast_turn_is_followed() -> None:
    """23 degrees from one frame to the next, with another motion before."""
    frames = walk([0.0, -0.05, 0.35, 0.4, 0.0])
    odometry = FromFirst()
    for frame in frames:
        T = odometry(frame.depth_m)
        assert T is not None
        assert_same(T, from_first(frame, frames[0]), metres=0.03, degrees=1)


def test_rounding_does_not_add_up() -> None:
    """A motion that is not quite a rotation, applied again and again, is soon none at all."""
    odometry = FromFirst()
    for _ in range(60):
        T = odometry(SWAY[0].depth_m)
        assert T is not None
    assert_same(T, np.eye(4), metres=0.001, degrees=0.05)
    assert np.abs(T[:3, :3].T @ T[:3, :3] - np.eye(3)).max() < 1e-12


def test_what_moves_is_outvoted() -> None:
    odometry = FromFirst()
    for i in range(8):
        T_world_camera = camera_pose(0.03 * i, x=0.04 * i)
        seen = look(i, [cabinet(2.4, -0.8 + 0.1 * i)], THINGS, T_world_camera)
        T = odometry(seen.frame.depth_m)
        assert T is not None
        assert_same(T, inverse_T(camera_pose()) @ T_world_camera, metres=0.03, degrees=1)


def test_bare_walls_do_not_carry_it_away() -> None:
    """A noisy view of walls and floor: without its spring a guess slides along them, by a metre
    here."""
    scene, odometry = generate_scene("val", 121), FromFirst()
    frames = [scene.render(i, color=False).frame for i in range(9)]
    for frame in frames:
        T = odometry(frame.depth_m, frame.camera)
        assert T is not None
        assert_same(T, from_first(frame, frames[0]), metres=0.12, degrees=1)


def painted(colored: Callable[[int], bool]) -> float:
    """How far off, in metres, the camera ends that moves by 60 cm along a painted wall, with colour
    in some of its frames."""
    rays, odometry, poses = pixel_rays(CAMERA), Odometry(), []
    for i in range(13):
        right = 0.05 * i
        depth_m = np.full(rays.shape[:2], 2.0, np.float32)
        x, y = 2 * rays[..., 0] + right, 2 * rays[..., 1]
        paint = 0.5 + 0.2 * np.sin(4 * x) * np.cos(3 * y) + 0.1 * np.sin(11 * x + 5 * y)
        image = np.repeat(np.uint8(255 * paint)[..., None], 3, axis=2)
        poses.append(odometry(depth_m, CAMERA, image if colored(i) else None))
    assert all(T is not None for T in poses)
    return float(np.linalg.norm((inverse_T(poses[0]) @ poses[-1])[:3, 3] - [right, 0, 0]))


def test_a_bare_wall_is_followed_by_its_colour() -> None:
    assert painted(lambda i: False) > 0.4
    assert painted(lambda i: True) < 0.05


def test_colour_need_not_come_with_every_frame() -> None:
    """As of a slower camera, or where one image is lost."""
    assert painted(lambda i: i % 2 == 0) < 0.05
    assert painted(lambda i: i != 4) < 0.05


@pytest.mark.parametrize("number", [242, 284])
def test_colour_helps_where_surfaces_say_little(number: int) -> None:
    """Cameras of the generator that surfaces alone put 80 cm off, and images told of from one to
    the next 18 cm; an image of some time ago holds the second."""
    scene, odometry, poses = generate_scene("val", number), Odometry(), []
    frames = [scene.render(i).frame for i in range(30)]
    for frame in frames:
        poses.append(odometry(frame.depth_m, frame.camera, frame.color))
        assert poses[-1] is not None
    assert_same(inverse_T(poses[0]) @ poses[-1], from_first(frames[-1], frames[0]), 0.05, 1)


def test_rough_colour_says_less() -> None:
    """The second of these cameras, where colour is said to lie on the depth to some pixels only."""
    scene, odometry = generate_scene("val", 284), Odometry(rough_color=True)
    frames = [scene.render(i).frame for i in range(30)]
    poses = [odometry(frame.depth_m, frame.camera, frame.color) for frame in frames]
    found, true = inverse_T(poses[0]) @ poses[-1], from_first(frames[-1], frames[0])
    assert 0.08 < np.linalg.norm(found[:3, 3] - true[:3, 3]) < 0.4


def test_a_frame_without_colour_is_followed_by_its_surfaces() -> None:
    odometry = Odometry()
    poses = []
    for i, frame in enumerate(SWAY):
        noise = np.random.default_rng(i).integers(0, 255, (*frame.depth_m.shape, 3))
        poses.append(odometry(frame.depth_m, CAMERA, noise.astype(np.uint8) if i % 3 else None))
        assert poses[-1] is not None  # noise is no likeness, and moves nothing far
        assert_same(inverse_T(poses[0]) @ poses[-1], from_first(frame, SWAY[0]), metres=0.03)


def test_colour_of_another_size_is_refused() -> None:
    with pytest.raises(SequenceError, match=r"odometry: color is uint8 of shape \(9, 9, 3\)"):
        Odometry()(SWAY[0].depth_m, CAMERA, np.zeros((9, 9, 3), np.uint8))


def test_a_lost_camera_is_told_and_found_again() -> None:
    odometry = FromFirst()
    for frame in SWAY[:4]:
        odometry(frame.depth_m)
    funnel = np.hypot(*np.indices(NOTHING.shape)).astype(np.float32) / 200 + 0.5
    for stranger in (NOTHING, NOTHING + np.float32(0.3), funnel):
        assert odometry(stranger) is None
    T = odometry(SWAY[4].depth_m)
    assert T is not None
    assert_same(T, from_first(SWAY[4], SWAY[0]), metres=0.02)


def test_it_begins_with_the_first_frame_that_shows_something() -> None:
    odometry = Odometry()
    assert odometry(NOTHING, CAMERA) is None
    first, true = odometry(SWAY[0].depth_m, CAMERA), SWAY[0].T_world_camera
    assert first is not None
    assert abs(first[2, 3] - true[2, 3]) < 0.01  # its world is levelled
    assert first[2, :3] @ true[2, :3] > np.cos(np.radians(0.5))


def hand(index: int) -> np.ndarray:
    """Something uneven before the camera."""
    noise = np.random.default_rng(index).normal(0, 0.003, NOTHING.shape)
    return (0.3 + 0.02 * np.sin(np.arange(CAMERA.width) / 9) + noise).astype(np.float32)


def saved(root: Path, depths: list[np.ndarray]) -> Path:
    """A plain folder without poses."""
    frames = [replace(SWAY[0], index=i, depth_m=depth_m) for i, depth_m in enumerate(depths)]
    return save(root, frames)


@pytest.mark.parametrize("hands", [1, 3])
def test_a_hand_at_first_loses_only_itself(hands: int, tmp_path: Path, capfd) -> None:
    room = [frame.depth_m for frame in SWAY]
    folder = saved(tmp_path / "walk", [*(hand(i) for i in range(hands)), *room])
    sequence = open_sequence(folder, options=OPTIONS)
    assert sequence.skipped_indices == tuple(range(hands))
    assert {reason.split(":")[0] for _, reason in sequence.skipped} == {"odometry lost the camera"}
    first = next(iter(sequence))
    for frame, true in zip(sequence, SWAY, strict=True):
        assert_same(from_first(frame, first), from_first(true, SWAY[0]))
    assert not capfd.readouterr().err  # of the library that aligns


@pytest.mark.parametrize("again", [0, 4])
def test_a_good_beginning_is_kept(again: int, tmp_path: Path) -> None:
    """However long a hand covers the camera then, which for itself says where it is, too."""
    room = [frame.depth_m for frame in SWAY[:4]]
    depths = [*room, *(hand(i) for i in range(4)), *room[4 - again :]]
    sequence = open_sequence(saved(tmp_path / "walk", depths), options=OPTIONS)
    shown = [*SWAY[:4], *SWAY[4 - again : 4]]
    frames = list(sequence)
    assert [frame.index for frame in frames[:4]] == [0, 1, 2, 3]
    assert len(frames) >= 4 + max(0, again - 1)  # the first that is known again may be skipped
    for frame in frames:
        true = shown[frame.index if frame.index < 4 else frame.index - 4]
        assert_same(from_first(frame, frames[0]), from_first(true, SWAY[0]), metres=0.02)


def test_what_agrees_with_nothing_takes_no_beginnings_place(tmp_path: Path) -> None:
    """Though it is more, and is tried as a beginning of its own."""
    depths = [frame.depth_m for frame in SWAY[:3]]
    depths += [hand(i) * np.float32(far) for i, far in enumerate((1, 6, 1.5, 12, 3))]
    sequence = open_sequence(saved(tmp_path / "walk", depths), options=OPTIONS)
    assert [frame.index for frame in sequence] == [0, 1, 2]
    assert sequence.skipped_indices == (3, 4, 5, 6, 7)


def test_a_recording_gets_poses_in_a_levelled_world(tmp_path: Path) -> None:
    folder = save(tmp_path / "walk", SWAY)
    given = open_sequence(folder)
    assert not given.has_poses and "--odometry" in given.warnings[0]
    sequence = open_sequence(folder, options=OPTIONS)
    assert sequence.has_poses and "from odometry" in " ".join(sequence.warnings)
    frames = list(sequence)
    assert all(frame.pose_known for frame in frames)
    assert [frame.index for frame in reversed(sequence)] == [frame.index for frame in frames[::-1]]
    for frame, true in zip(frames, SWAY, strict=True):
        assert_same(from_first(frame, frames[0]), from_first(true, SWAY[0]))
        up, true_up = frame.T_world_camera[2, :3], true.T_world_camera[2, :3]
        assert up @ true_up > np.cos(np.radians(0.5))
        assert abs(frame.T_world_camera[2, 3] - true.T_world_camera[2, 3]) < 0.01


def test_poses_of_the_recording_are_not_used(tmp_path: Path) -> None:
    """Wrong ones change nothing, and a frame that lacks its own is as good as any."""
    folder = save(tmp_path / "walk", SWAY)
    plain = [frame.T_world_camera for frame in open_sequence(folder, options=OPTIONS)]
    (folder / "pose").mkdir()
    for frame in SWAY[1:]:
        T = make_T(rotation_z(frame.index), [100.0 * frame.index, 0, 0])
        np.savetxt(folder / f"pose/{frame.index}.txt", T)
    np.savetxt(folder / "gravity-direction.txt", [1.0, 0, 0])
    posed = [frame.T_world_camera for frame in open_sequence(folder, options=OPTIONS)]
    np.testing.assert_array_equal(posed, plain)


def test_frames_without_the_room_are_skipped_with_the_reason(tmp_path: Path) -> None:
    folder = save(tmp_path / "walk", SWAY)
    hand = np.full(NOTHING.shape, 300, np.uint16)
    hand[:, :8] = 900
    Image.fromarray(hand).save(folder / "depth/3.png")
    (folder / "depth/5.png").write_bytes(b"no image")
    watched = []
    sequence = open_sequence(
        folder, options=OPTIONS, watch=lambda frames: watched.extend(frames) or frames
    )
    reasons = dict(sequence.skipped)
    assert reasons.keys() == {"3", "5"} and "odometry lost the camera" in reasons["3"]
    assert [frame.name for frame in sequence] == ["0", "1", "2", "4", "6", "7"]
    assert len(watched) == 7  # the corrupt one is known before
    for i in range(8):
        Image.fromarray(np.zeros_like(hand)).save(folder / f"depth/{i}.png")
    with pytest.raises(SequenceError, match="no measurement"):
        open_sequence(folder, options=OPTIONS)


def test_a_wrong_depth_scale_is_named_before_the_camera_is_sought(tmp_path: Path) -> None:
    folder = save(tmp_path / "walk", SWAY[:3])
    wrong = replace(OPTIONS, depth_scale=1.0)
    with pytest.raises(SequenceError, match="is depth_scale 1000 meant"):
        open_sequence(folder, options=wrong, watch=lambda frames: pytest.fail("it was sought"))


def test_track_follows_a_recording_without_poses(
    recordings: Path, tiny_weights: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, out = tmp_path / "recording", tmp_path / "out"
    shutil.copytree(recordings / "val_00000", folder)
    shutil.rmtree(folder / "pose")
    arguments = [folder, "--out", out, "--odometry", "--device", "cpu", "--weights", tiny_weights]
    monkeypatch.setattr(sys, "argv", ["composenet", "track", *map(str, arguments)])
    with pytest.raises(SystemExit) as stop:
        cli.main()
    assert stop.value.code == 0
    run = read_predictions(out)
    assert any("odometry" in line for line in run.warnings)
    assert run.T_level_source is None  # the recording has no world of its own
    true = [np.loadtxt(recordings / f"val_00000/pose/{frame.name}.txt") for frame in run.frames]
    for frame, T in zip(run.frames, true, strict=True):
        got = inverse_T(run.frames[0].T_world_camera) @ frame.T_world_camera
        assert_same(got, inverse_T(true[0]) @ T, metres=0.1, degrees=2)


def test_without_the_library_one_line_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = save(tmp_path / "walk", SWAY[:2])
    monkeypatch.setitem(sys.modules, "small_gicp", None)
    with pytest.raises(ConfigError, match=r"composenet\[odometry\]"):
        open_sequence(folder, options=OPTIONS)
    with pytest.raises(ConfigError, match=r"composenet\[odometry\]"):
        composenet.Odometry()
