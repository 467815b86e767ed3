"""Space that was seen to be empty: what is kept, what is forgotten, and how the network is told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from composenet.config import VolumeConfig, from_dict
from composenet.errors import ConfigError
from composenet.geometry.transform import apply_T, inverse_T, rotation_z
from composenet.network.batch import CropBatch, collate
from composenet.network.crop_inputs import crop_inputs
from composenet.records import LARGEST_INDEX, Box, Frame
from composenet.volume.memory import FREE_CELL_M, FreeSpace, Memory
from composenet.volume.voxels import voxelize
from tracking_scenes import frame

BOX = Box(np.array([2.5, 0.3, 0.45]), np.array([0.6, 0.8, 0.9]))
CONFIG = VolumeConfig(min_pixels=1, max_depth_m=7.0)
AT_THE_BOX, BESIDE_IT, BEHIND_IT = [2.5, 0.3, 0.45], [2.5, 1.0, 0.45], [3.5, 0.4, 0.35]


def space_after(*views: Frame, frames: int = 150) -> FreeSpace:
    memory = Memory(frames)
    for view in views:
        memory.see_through(view.index, view.depth_m, view.camera.K, view.T_world_camera)
        space = memory.free_space(view.index)
    return space


def is_free(space: FreeSpace, points: np.ndarray | list) -> np.ndarray:
    """(M,) bool, for points (M, 3) in the axes of the space."""
    cells = np.floor((np.reshape(points, (-1, 3)) - space.low) / FREE_CELL_M).astype(int)
    inside = ((cells >= 0) & (cells < space.cells.shape)).all(axis=1)
    return np.array([ok and space.cells[tuple(c)] for ok, c in zip(inside, cells, strict=True)])


def test_it_is_what_some_frame_saw_through_and_none_saw_filled_since() -> None:
    """Cell by cell against the frames, by the words of the docstring."""
    views = [frame(0), frame(1, [BOX], 0.4), frame(2, [BOX], -0.7)]
    space = space_after(*views)
    draw = np.random.default_rng(0)
    cells = draw.integers(0, space.cells.shape, (4000, 3))
    cells[:2000, :2] = cells[:2000, :2] % 60 + 60  # near the camera
    centres = space.low + (cells + 0.5) * FREE_CELL_M
    expected = np.zeros(len(cells), bool)
    for view in views:
        K = view.camera.K
        for i, (x, y, z) in enumerate(apply_T(inverse_T(view.T_world_camera), centres)):
            if z <= 0.1:
                continue
            u, v = np.floor([K[0, 0] * x / z + K[0, 2] + 0.5, K[1, 1] * y / z + K[1, 2] + 0.5])
            if 0 <= u < view.camera.width and 0 <= v < view.camera.height:
                depth = view.depth_m[int(v), int(u)]
                gap = FREE_CELL_M / 2 + 0.03 + 0.01 * depth**2
                if z < depth - gap:
                    expected[i] = True
                elif z <= depth + gap:
                    expected[i] = False
    assert expected.sum() > 200
    np.testing.assert_array_equal(space.cells[tuple(cells.T)], expected)


def test_what_came_is_no_longer_free_and_what_went_is() -> None:
    points = [AT_THE_BOX, BESIDE_IT, BEHIND_IT]
    front = [BOX.center[0] - BOX.extents[0] / 2, 0.3, 0.45]
    assert is_free(space_after(frame(0)), [*points, front]).all()
    came = space_after(frame(0), frame(1, [BOX]))
    assert not is_free(came, front).any() and is_free(came, [BESIDE_IT, BEHIND_IT]).all()
    there = space_after(frame(0, [BOX]))
    assert is_free(there, points).tolist() == [False, True, False]
    assert is_free(space_after(frame(0, [BOX]), frame(1)), [*points, front]).all()


def test_it_is_kept_while_the_camera_looks_elsewhere_and_forgotten_with_time() -> None:
    away = frame(20, (), 2.0)
    assert is_free(space_after(frame(0), away), [AT_THE_BOX, BESIDE_IT]).all()
    assert is_free(space_after(frame(0), away, frames=20), AT_THE_BOX).all()
    assert not is_free(space_after(frame(0), away, frames=19), AT_THE_BOX).any()
    longest = from_dict({"memory_frames": 2**30 - 1}, VolumeConfig).memory_frames
    late = [replace(view, index=LARGEST_INDEX - 1 + i) for i, view in enumerate([frame(0), away])]
    assert is_free(space_after(*late, frames=longest), AT_THE_BOX).all()
    with pytest.raises(ConfigError, match="memory_frames"):
        from_dict({"memory_frames": 2**30}, VolumeConfig)
    with pytest.raises(ConfigError, match="memory_reach_m"):
        from_dict({"memory_reach_m": float("inf")}, VolumeConfig)
    assert not is_free(space_after(away), AT_THE_BOX).any()


def shifted(view: Frame, by: list[float]) -> Frame:
    T = view.T_world_camera.copy()
    T[:3, 3] += by
    return replace(view, T_world_camera=T)


def test_the_window_moves_with_the_camera() -> None:
    start = frame(0)
    for step in ([0.0, 0.0, 0.0], [1.0, -2.0, 0.0], [-3.21, 0.77, 0.1], [0.04, 0.0, 0.3]):
        # Looking up at a near ceiling, so that the second frame says nothing of the floor.
        blind = replace(shifted(frame(1), step), depth_m=np.zeros_like(start.depth_m))
        space = space_after(start, blind)
        assert is_free(space, [AT_THE_BOX, BESIDE_IT, BEHIND_IT]).all()
        assert space.cells.sum() > 5000
    far = replace(shifted(frame(1), [30.0, 0, 0]), depth_m=np.zeros_like(start.depth_m))
    back = replace(frame(2), depth_m=far.depth_m)
    assert not space_after(start, far).cells.any()
    assert not space_after(start, far, back).cells.any()


@pytest.mark.parametrize("quarter", [0, 1, 2, 3, -1])
def test_turned_by_quarters(quarter: int) -> None:
    space, R = space_after(frame(0, [BOX])), np.round(rotation_z(quarter * np.pi / 2))
    points = np.random.default_rng(1).uniform([-1, -2, -0.3], [5, 2, 2.3], (3000, 3))
    turned = space.turned(R)
    np.testing.assert_array_equal(is_free(turned, points @ R.T), is_free(space, points))


def test_a_part_of_it() -> None:
    space = space_after(frame(0, [BOX]))
    low, high = np.array([1.03, -0.52, 0.17]), np.array([3.0, 0.9, 1.11])
    part = space.within(low, high)
    points = np.random.default_rng(2).uniform([-1, -2, -0.3], [5, 2, 2.3], (3000, 3))
    inside = ((points >= low) & (points < high)).all(axis=1)
    np.testing.assert_array_equal(is_free(part, points[inside]), is_free(space, points[inside]))
    assert not is_free(part, points[~inside & (points < low - FREE_CELL_M).any(axis=1)]).any()
    assert part.cells.size < 5000
    assert space.within(low + 40, high + 40).cells.size == 0


@pytest.mark.parametrize("yaw", [0.0, 1.2, 3.0, -1.5])
def test_crops_are_told_of_it(yaw: float) -> None:
    config, memory = CONFIG, Memory(150)
    views = [frame(0, [BOX], yaw), frame(1, [BOX], yaw + 0.5)]
    volumes = [voxelize(view, config, memory=memory) for view in views]
    assert volumes[0] is not None and volumes[1] is not None
    batch = collate([volumes[1], volumes[0]])
    space = space_after(*views)
    middle = volumes[1].coords.mean(axis=0) * volumes[1].voxel_size_m
    center = torch.from_numpy(middle).float().expand(2, 3)
    crops = CropBatch.around(torch.tensor([0, 1]), center, torch.full((2, 3), 3.0), 1.0)
    samples, _ = crop_inputs(batch, crops, 12, config.truncation_m)
    points = apply_T(volumes[1].T_world_grid, crops.points(12)[0].numpy().astype(float))
    assert is_free(space, points).any() and not is_free(space, points).all()
    np.testing.assert_array_equal(samples[0, 3].flatten().numpy() > 0, is_free(space, points))
    assert not torch.equal(samples[0, 3], samples[1, 3])


def test_without_memory_it_is_what_the_frame_sees() -> None:
    views = [frame(0, [BOX]), frame(1, [BOX], 1.2)]
    for config, pose_known in ((replace(CONFIG, memory_frames=0), True), (CONFIG, False)):
        memory = Memory(config.memory_frames)
        for view in views:
            volume = voxelize(replace(view, pose_known=pose_known), config, memory=memory)
        alone = voxelize(views[1], config)
        assert volume is not None and alone is not None and alone.free.cells.any()
        np.testing.assert_array_equal(volume.free.cells, alone.free.cells)
