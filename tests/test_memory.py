"""What earlier frames saw: what is kept, what is forgotten, and how the network is told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from composenet.config import VolumeConfig
from composenet.geometry.transform import apply_T, inverse_T
from composenet.network.batch import CropBatch, collate
from composenet.network.crop_inputs import crop_inputs
from composenet.records import Box, Frame, ObjectFrameTruth, ObjectTruth, Symmetry
from composenet.training.targets import UNKNOWN, forget_moved
from composenet.volume.memory import Memory
from composenet.volume.voxels import (
    FEATURE_NAMES,
    OLD_FRAMES,
    Volume,
    _unlike,
    remember,
    voxelize,
)
from tracking_scenes import frame, screen

CONFIG = VolumeConfig(min_pixels=1, max_depth_m=7.0, memory_reach_m=20.0)
BOX = Box(np.array([2.5, 0.3, 0.45]), np.array([0.6, 0.8, 0.9]))
RING = [
    Box(np.array([3 * np.cos(a), 3 * np.sin(a), 0.45]), np.array([0.6, 0.8, 0.9]))
    for a in np.arange(8) * np.pi / 4
]
AGE = FEATURE_NAMES.index("age")


def seen_after(*views: Frame, config: VolumeConfig = CONFIG, ids: list | None = None) -> Volume:
    """The volume of the last frame, with what those before it saw."""
    memory = Memory(config.memory_frames)
    for i, view in enumerate(views):
        volume = voxelize(view, config, ids[i] if ids else None, memory)
        assert volume is not None
    return volume


def world(volume: Volume, rows: slice) -> np.ndarray:
    """Mean points of some voxels."""
    places = volume.coords[rows] + volume.features[rows, :3]
    return apply_T(volume.T_world_grid, places * volume.voxel_size_m)


def on_box(points: np.ndarray, box: Box, slack: float = 0.04) -> np.ndarray:
    """(M,) bool: within slack of the box."""
    return (np.abs(points - box.center) <= box.extents / 2 + slack).all(axis=1)


def above_floor(points: np.ndarray) -> np.ndarray:
    """(M,) bool: on BOX, and not on the floor that it stands on."""
    return on_box(points, BOX) & (points[:, 2] > 0.1)


@pytest.mark.parametrize("pose_known", [True, False])
def test_remembering_is_looking_without_telling(pose_known: bool) -> None:
    """A frame that is only remembered leaves the same for the next one as one that is looked at."""
    views = [frame(i, RING, 0.4 * i) for i in range(3)]
    views[1] = replace(views[1], pose_known=pose_known)
    looked_at = seen_after(*views)
    memory = Memory(CONFIG.memory_frames)
    for view in views[:2]:
        remember(view, CONFIG, None, memory)
    volume = voxelize(views[2], CONFIG, None, memory)
    assert volume is not None and len(volume.coords) > volume.n_seen
    np.testing.assert_array_equal(volume.coords, looked_at.coords)
    np.testing.assert_array_equal(volume.features, looked_at.features)
    np.testing.assert_array_equal(volume.free.cells, looked_at.free.cells)


@pytest.mark.parametrize(("yaw", "turn"), [(0.0, 0.5), (1.1, -0.3), (-3.0, 0.9), (2.0, 0.05)])
def test_a_camera_that_turns_keeps_what_left_the_image(yaw: float, turn: float) -> None:
    first, second = frame(0, RING, yaw), frame(1, RING, yaw + turn)
    near = replace(CONFIG, max_depth_m=5.0)  # the wall is no fixed thing
    alone, both = voxelize(first, near), seen_after(first, second, config=near)
    assert alone is not None
    fresh = voxelize(second, near)
    assert fresh is not None and both.n_seen == fresh.n_seen
    assert len(np.unique(both.coords, axis=0)) == len(both.coords)
    # Remembered places are places of the first frame, outside the second image.
    recalled = world(both, slice(both.n_seen, None))
    before = world(alone, slice(None))
    if len(recalled):
        gaps = np.linalg.norm(recalled[:, None] - before[None], axis=-1).min(axis=1)
        assert gaps.max() < 1e-3
        x, y, z = apply_T(inverse_T(second.T_world_camera), recalled).T
        u, v = 140 * x / z + 79.3, 140 * y / z + 59.3
        assert not ((z > 0.1) & (abs(u - 79.5) < 79) & (abs(v - 59.5) < 59)).any()
    # Nothing worth remembering is lost: all of the first frame outside the second image is there.
    x, y, z = apply_T(inverse_T(second.T_world_camera), before).T
    u, v = 140 * x / z + 79.3, 140 * y / z + 59.3
    out = (z < 0.1) | (abs(u - 79.5) > 81) | (abs(v - 59.5) > 61)
    out &= (before[:, 2] > 0.1) & (before[:, 2] < 2.1)
    everything = world(both, slice(None))
    for point in before[out][::20]:
        assert np.linalg.norm(everything - point, axis=1).min() < 0.08


def test_grids_turned_by_quarters_share_one_memory() -> None:
    """The first grid looks along +x, the second along +y; the box keeps its place."""
    volume = seen_after(frame(0, [BOX]), frame(1, [BOX], 1.2), config=CONFIG)
    recalled = world(volume, slice(volume.n_seen, None))
    kept = recalled[on_box(recalled, BOX)]
    assert len(kept) > 50
    front = kept[np.abs(kept[:, 0] - 2.2) < 0.03]
    normals = volume.features[volume.n_seen :, 3:6] @ volume.T_world_grid[:3, :3].T
    np.testing.assert_allclose(
        np.median(normals[on_box(recalled, BOX)], axis=0)[[1, 2]], 0, atol=0.05
    )
    assert len(front) > 30


def test_what_hides_is_remembered_and_what_went_away_is_not() -> None:
    board = screen(1.2, 0.3)
    hidden = seen_after(frame(0, [BOX]), frame(1, [BOX, board]))
    recalled = world(hidden, slice(hidden.n_seen, None))
    assert on_box(recalled, BOX).sum() > 50
    gone = seen_after(frame(0, [BOX]), frame(1))
    assert not above_floor(world(gone, slice(None))).any()
    farther = Box(BOX.center + np.array([0.5, 0, 0]), BOX.extents)
    moved = seen_after(frame(0, [BOX]), frame(1, [farther]))
    front = BOX.center[0] - BOX.extents[0] / 2
    assert not (np.abs(world(moved, slice(None))[:, 0] - front) < 0.1).any()


@pytest.mark.parametrize("seen_px", [0, 5])
def test_what_went_away_is_forgotten_though_all_in_view_is_too_far(seen_px: int) -> None:
    """Down a long hall: nothing near enough to be looked at, but the space before it is empty."""
    memory, later = Memory(CONFIG.memory_frames), frame(1)
    far = np.full_like(later.depth_m, CONFIG.max_depth_m + 2)
    far[:seen_px, :seen_px] = CONFIG.max_depth_m - 1
    voxelize(frame(0, [BOX]), CONFIG, memory=memory)
    assert above_floor(memory.surface.points).any()
    assert voxelize(replace(later, depth_m=far), CONFIG, memory=memory) is None
    assert not above_floor(memory.surface.points).any()
    assert memory.free_space(1).cells.any()


def test_the_same_view_again_adds_nothing() -> None:
    once, twice = seen_after(frame(0, [BOX])), seen_after(*(frame(i, [BOX]) for i in range(4)))
    np.testing.assert_array_equal(once.coords, twice.coords[: twice.n_seen])
    np.testing.assert_array_equal(once.features, twice.features[: twice.n_seen])
    assert len(twice.coords) - twice.n_seen < 0.01 * twice.n_seen  # noise of single voxels


@pytest.mark.parametrize(("later", "age"), [(1, 0.5 + 0.5 / OLD_FRAMES), (30, 1.0)])
def test_age(later: int, age: float) -> None:
    volume = seen_after(frame(0, [BOX]), frame(later, [BOX], 1.2))
    assert (volume.features[: volume.n_seen, AGE] == 0).all()
    np.testing.assert_allclose(volume.features[volume.n_seen :, AGE], age, rtol=1e-6)
    assert len(volume.coords) > volume.n_seen


@pytest.mark.parametrize("why", ["too long ago", "switched off", "unknown pose", "not near"])
def test_when_nothing_is_remembered(why: str) -> None:
    config, first, second = CONFIG, frame(0, [BOX]), frame(1, [BOX], 1.2)
    if why == "too long ago":
        second = replace(second, index=CONFIG.memory_frames + 1)
    elif why == "switched off":
        config = replace(CONFIG, memory_frames=0)
    elif why == "unknown pose":
        first, second = replace(first, pose_known=False), replace(second, pose_known=False)
    else:
        config = replace(CONFIG, memory_reach_m=0.01)
        second = frame(1, [BOX], 3.1)
    volume = seen_after(first, second, config=config)
    alone = voxelize(second, config)
    assert alone is not None
    assert len(volume.coords) - volume.n_seen <= (5 if why == "not near" else 0)
    assert volume.n_seen == len(alone.coords)


def test_labels_follow_the_surface_until_the_object_moves() -> None:
    first, second = frame(0, [BOX]), frame(1, [BOX], 1.2)
    ids = np.where(first.depth_m < 3.2, 7, 0).astype(np.uint16)
    volume = seen_after(first, second, ids=[ids, np.zeros_like(ids)])
    recalled = world(volume, slice(volume.n_seen, None))
    mine = on_box(recalled, BOX, 0.02) & (recalled[:, 2] > 0.15)

    def truth(shift: float) -> dict:
        T = np.eye(4)
        T[:3, 3] = BOX.center + np.array([0, shift, 0])
        item = ObjectTruth(
            7, 4, Symmetry.NONE, BOX.extents, np.ones((64,) * 3, bool), np.zeros((0, 3), np.float32)
        )
        return {7: (item, ObjectFrameTruth(7, T, Box(T[:3, 3], BOX.extents), 500, 0.7))}

    def labels(objects: dict) -> np.ndarray:
        copy = replace(volume, labels=volume.labels.copy())
        forget_moved(copy, objects)
        return copy.labels[volume.n_seen :][mine]

    assert (labels(truth(0.0)) == 7).mean() > 0.95
    assert (labels(truth(2.0)) == 0).mean() > 0.95
    half = labels(truth(0.4))
    assert 0.2 < (half == 7).mean() < 0.8
    assert (labels({}) == UNKNOWN).mean() > 0.95


def test_crops_are_told_where_surface_is_remembered() -> None:
    volume = seen_after(frame(0, [BOX]), frame(1, [BOX], 1.2))
    batch = collate([volume, volume])
    cell = int(np.argmax(on_box(world(volume, slice(volume.n_seen, None)), BOX)))
    at = torch.from_numpy(volume.coords[volume.n_seen + cell] * 0.05).float()
    crops = CropBatch.around(torch.tensor([1, 0]), at.expand(2, 3), torch.full((2, 3), 0.75), 1.0)
    samples, surface = crop_inputs(batch, crops, 16, 0.15)
    points = (crops.points(16)[0] / 0.05).round().long()
    places = {tuple(row) for row in volume.coords[volume.n_seen :].tolist()}
    expected = torch.tensor([tuple(p) in places for p in points.tolist()]).view(16, 16, 16)
    assert expected.any() and not expected.all()
    for row in range(2):
        torch.testing.assert_close(samples[row, 2], expected.float())
        assert surface[row][expected].all()


@pytest.mark.parametrize("seed", range(5))
def test_no_voxel_is_remembered_twice(seed: int) -> None:
    """`_unlike` against its readable counterpart."""
    rng = np.random.default_rng(seed)
    shape = (6, 5, 4)
    cells = rng.integers(-1, 7, (200, 3)).astype(np.int32)
    coords = np.unique(rng.integers(0, shape, (30, 3)), axis=0).astype(np.int32)
    taken = {tuple(row) for row in coords.tolist()}
    expected = []
    for row in cells.tolist():
        out = any(not 0 <= at < n for at, n in zip(row, shape, strict=True))
        expected.append(out or tuple(row) not in taken)
        taken.add(tuple(row))
    assert _unlike(cells, coords, shape).tolist() == expected
    assert 0 < sum(expected) < len(expected)
