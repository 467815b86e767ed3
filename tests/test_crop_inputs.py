"""What boxes are told of the space in them: the loop against the passes over all cells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from composenet.config import VolumeConfig
from composenet.network.batch import CropBatch, VolumeBatch, collate
from composenet.network.crop_inputs import N_CHANNELS, all_at_once, crop_inputs
from composenet.records import Box
from composenet.volume.memory import Memory
from composenet.volume.voxels import voxelize
from tracking_scenes import frame

BOX = Box(np.array([2.5, 0.3, 0.45]), np.array([0.6, 0.8, 0.9]))
TRUNCATION_M = 0.15
TOLD_ALIKE = 0.001
"""A cell whose centre lies on the border of two pixels or voxels may be given to either."""


def two_frames() -> VolumeBatch:
    config = VolumeConfig(min_pixels=1, max_depth_m=7.0, memory_reach_m=20.0)
    memory, views = Memory(150), [frame(0, [BOX]), frame(1, [BOX], 1.2)]
    volumes = [voxelize(view, config, memory=memory) for view in views]
    assert volumes[0] is not None and volumes[1] is not None
    return collate([volumes[0], volumes[1]])


BATCH = two_frames()
NOTHING_OLD = replace(BATCH, remembered=torch.zeros_like(BATCH.remembered))
NOTHING_FREE = replace(BATCH, free=torch.zeros(2, 0, 0, 0, dtype=torch.bool))


def crops_of(seed: int, count: int) -> CropBatch:
    """Boxes in and around the grid, some behind the camera, some far beyond every border."""
    draw = np.random.default_rng(seed)
    values = draw.uniform([-2, -2, -1, 0.1, 0.1, 0.1, -4], [9, 9, 4, 4, 4, 3, 4], (count, 7))
    center, size, yaw = torch.from_numpy(values).float().split([3, 3, 1], dim=1)
    frames = torch.from_numpy(draw.integers(0, 2, count))
    return CropBatch(frames, center, size, yaw[:, 0])


@pytest.mark.parametrize("batch", [BATCH, NOTHING_OLD, NOTHING_FREE])
@given(seed=st.integers(0, 10**6), count=st.integers(0, 5), cells=st.sampled_from([4, 9, 16]))
@settings(max_examples=30, deadline=None)
def test_the_loop_tells_what_the_passes_tell(
    batch: VolumeBatch, seed: int, count: int, cells: int
) -> None:
    crops = crops_of(seed, count)
    fields, surface = crop_inputs(batch, crops, cells, TRUNCATION_M)
    expected, its_surface = all_at_once(batch, crops, cells, TRUNCATION_M)
    assert fields.shape == expected.shape == (count, N_CHANNELS, cells, cells, cells)
    assert surface.shape == its_surface.shape == (count, cells, cells, cells)
    assert fields.dtype == expected.dtype and surface.dtype == its_surface.dtype
    if count:
        assert ((fields - expected).abs() > 1e-4).float().mean() < TOLD_ALIKE
        assert (surface != its_surface).float().mean() < TOLD_ALIKE


def test_boxes_that_meet_all_of_it() -> None:
    """What the comparison above would not show if no box ever met anything."""
    places, mine = BATCH.coords[:, 1:].float() * BATCH.voxel_size_m, BATCH.coords[:, 0] == 1
    seen, old = places[mine & ~BATCH.remembered], places[mine & BATCH.remembered]
    center = torch.stack([seen.mean(dim=0), old.mean(dim=0)])
    crops = CropBatch.around(torch.tensor([1, 1]), center, torch.full((2, 3), 5.0), 1.0)
    fields, surface = crop_inputs(BATCH, crops, 24, TRUNCATION_M)
    tsdf, *flags = fields.transpose(0, 1).flatten(1)
    assert ((tsdf > -1) & (tsdf < 1) & (tsdf != 0)).any()
    for told in (*flags, surface):
        assert (told == 1).any() and (told == 0).any()


def test_no_gradient_comes_back_to_the_boxes() -> None:
    crops = crops_of(0, 2)
    crops = replace(crops, center=crops.center.requires_grad_(True))
    for told in (crop_inputs, all_at_once):
        fields, _ = told(BATCH, crops, 4, TRUNCATION_M)
        assert not fields.requires_grad
