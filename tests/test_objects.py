"""From proposals to posed objects, with a network that knows the truth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch

from composenet.config import Config, NetworkConfig, TrackingConfig
from composenet.detection import Proposals
from composenet.geometry.box import OrientedBox, aabb_of_oriented
from composenet.geometry.transform import angle_between_deg, make_T, rotation_z
from composenet.network.batch import CropBatch, VolumeBatch, collate
from composenet.network.detection_head import VoxelFields
from composenet.network.object_net import (
    HEADING_BINS,
    ObjectFields,
    likeliest_heading,
    scatter_features,
)
from composenet.objects import estimate_objects
from composenet.records import CLASS_NAMES, ObjectEstimate
from composenet.volume.memory import FreeSpace
from composenet.volume.voxels import FEATURE_NAMES, Volume

CELLS = 32
CONFIG = Config(network=NetworkConfig(crop_cells=CELLS))
NO_COMPLETION = replace(CONFIG, tracking=TrackingConfig(use_completion=False))
SOFA = CLASS_NAMES.index("sofa")
QUARTERS = [0, 1, 2, 3]


@dataclass(frozen=True)
class Block:
    """A box-shaped object in the world. yaw: of its front."""

    center: np.ndarray
    extents_m: np.ndarray
    yaw: float

    @property
    def R(self) -> np.ndarray:
        return rotation_z(self.yaw)

    @property
    def scale_m(self) -> float:
        return float(np.linalg.norm(self.extents_m))

    @property
    def bounds(self):
        return aabb_of_oriented(OrientedBox(self.center, self.R, self.extents_m))


BLOCK = Block(np.array([3.0, -1.0, 0.45]), np.array([0.8, 1.6, 0.9]), 0.6)


def volume_of(quarter: int) -> Volume:
    """An empty grid, turned by a quarter and away from the world's origin."""
    c, s = ((1, 0), (0, 1), (-1, 0), (0, -1))[quarter]
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]], dtype=float)
    return Volume(
        coords=np.ones((1, 3), np.int32),
        features=np.zeros((1, len(FEATURE_NAMES)), np.float32),
        labels=np.zeros(1, np.int32),
        n_seen=1,
        free=FreeSpace.nothing(),
        shape=(96, 96, 48),
        voxel_size_m=0.05,
        T_world_grid=make_T(R, np.array([1.0, -3.0, -0.1])),
        depth_m=np.zeros((4, 4), np.float32),
        K=np.eye(3),
        T_camera_grid=np.eye(4),
    )


class Oracle:
    """In place of the network: completion and correspondences are those of the block. Its cells
    within 10 cm of the side turned to the grid's -x are the observed surface. above_m: how much of
    the block's lower end it does not complete; spilled_m: how far it goes beyond its left side;
    notched: whether the quarter at its front and left is missing."""

    def __init__(
        self,
        block: Block,
        volume: Volume,
        collapsed: bool = False,
        above_m: float = 0.0,
        spilled_m: float = 0.0,
        notched: bool = False,
    ) -> None:
        R, low = volume.T_world_grid[:3, :3], volume.T_world_grid[:3, 3]
        self.R = torch.from_numpy(R.T @ block.R).float()
        self.t = torch.from_numpy(R.T @ (block.center - low)).float()
        self.half = torch.from_numpy(block.extents_m / 2).float()
        self.scale_m, self.collapsed = block.scale_m, collapsed
        self.above_m, self.spilled_m, self.notched = above_m, spilled_m, notched
        self.told: list[torch.Tensor] = []

    def object_fields(
        self, fields: VoxelFields, batch: VolumeBatch, crops: CropBatch, classes: torch.Tensor
    ) -> ObjectFields:
        self.told.append(classes)
        m = len(crops.center)
        points = crops.points(CELLS)
        local = (points - self.t) @ self.R
        low = torch.tensor([0.0, 0.0, self.above_m]) - self.half
        high = torch.tensor([0.0, self.spilled_m, 0.0]) + self.half
        inside = ((local >= low) & (local <= high)).all(dim=-1)
        if self.notched:
            inside &= (local[..., :2] < 0).any(dim=-1)
        front = torch.where(inside, points[..., 0], torch.inf).amin(dim=1, keepdim=True)
        surface = inside & (points[..., 0] < front + 0.1)
        nocs = (crops.points(CELLS // 2) - self.t) @ self.R / self.scale_m
        if self.collapsed:
            nocs = nocs * torch.tensor([0.0, 0.0, 1.0])
        half = (m, 3, CELLS // 2, CELLS // 2, CELLS // 2)
        return ObjectFields(
            crops=crops,
            occupancy=torch.where(inside, 8.0, -8.0).view(m, CELLS, CELLS, CELLS),
            nocs=nocs.transpose(1, 2).reshape(half),
            surface=surface.view(m, CELLS, CELLS, CELLS),
            heading_logits=torch.zeros(m, HEADING_BINS),
        )


def proposals_of(volume: Volume, *blocks: Block, shift_m: float = 0.0) -> Proposals:
    R, low = volume.T_world_grid[:3, :3], volume.T_world_grid[:3, 3]
    centers = np.array([R.T @ (b.bounds.center + shift_m - low) for b in blocks])
    extents = np.array([np.abs(R.T) @ b.bounds.extents for b in blocks])
    m = len(blocks)
    return Proposals(
        center=torch.from_numpy(centers.reshape(m, 3)).float(),
        extents=torch.from_numpy(extents.reshape(m, 3)).float(),
        class_probabilities=torch.full((m, 10), 0.02).index_fill(1, torch.tensor([SOFA]), 0.82),
        score=torch.linspace(0.9, 0.5, m),
        voxels=torch.full((m,), 200.0),
    )


def estimated(
    volume: Volume, oracle: Oracle, proposals: Proposals, config: Config = CONFIG
) -> tuple[ObjectEstimate, ...]:
    fields = VoxelFields(*[torch.zeros(1, 1)] * 5)
    return estimate_objects(oracle, fields, collate([volume]), volume, proposals, config)  # type: ignore[arg-type]


def cell_m(proposals: Proposals) -> float:
    return float(proposals.extents.max()) * CONFIG.network.crop_margin / CELLS


def crop_m3(proposals: Proposals) -> float:
    margin = CONFIG.network.crop_margin
    crop = CropBatch.around(torch.zeros(1), proposals.center, proposals.extents, margin)
    return crop.size.prod().item()


@pytest.mark.parametrize("quarter", QUARTERS)
@pytest.mark.parametrize("shift_m", [0.0, 0.06])
def test_pose_size_and_box_of_a_known_block(quarter: int, shift_m: float) -> None:
    volume = volume_of(quarter)
    proposals = proposals_of(volume, BLOCK, shift_m=shift_m)
    (found,) = estimated(volume, Oracle(BLOCK, volume), proposals)
    step = cell_m(proposals)
    S = found.S_world_canonical
    assert found.pose_observable and found.class_id == SOFA
    assert S.scale_m == pytest.approx(BLOCK.scale_m, rel=1e-3)
    assert angle_between_deg(S.R, BLOCK.R) < 0.1
    np.testing.assert_allclose(S.t, BLOCK.center, atol=1e-3)
    np.testing.assert_allclose(found.extents_m[:2], BLOCK.extents_m[:2], atol=step)
    assert found.extents_m[2] == pytest.approx(BLOCK.extents_m[2], abs=1e-3)
    # The box stands midway between where the pose and the proposal say.
    midway = BLOCK.bounds.center + shift_m / 2
    np.testing.assert_allclose(found.box.center[:2], midway[:2], atol=step / 4)
    assert found.box.center[2] == pytest.approx(midway[2], abs=1e-3)
    np.testing.assert_allclose(found.box.extents, BLOCK.bounds.extents, atol=1e-3)
    assert found.score == pytest.approx(0.9 * 0.82**0.5, rel=1e-5)


@pytest.mark.parametrize("quarter", QUARTERS)
def test_the_box_is_around_the_object_and_not_around_its_own_box(quarter: int) -> None:
    """Of an L that stands askew the middles of both are far apart, and its pose is at the one."""
    volume = volume_of(quarter)
    corners = np.array([[-1, -1], [1, -1], [1, 0], [0, 1], [-1, 1]]) * BLOCK.extents_m[:2] / 2
    corners = corners @ BLOCK.R[:2, :2].T + BLOCK.center[:2]
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    assert np.linalg.norm(middle - BLOCK.center[:2]) > 0.1
    proposals = proposals_of(volume, BLOCK)
    (found,) = estimated(volume, Oracle(BLOCK, volume, notched=True), proposals)
    np.testing.assert_allclose(found.S_world_canonical.t, BLOCK.center, atol=1e-3)
    posed = 2 * found.box.center - BLOCK.bounds.center  # without the proposal's half
    np.testing.assert_allclose(posed[:2], middle, atol=cell_m(proposals))
    assert posed[2] == pytest.approx(BLOCK.center[2], abs=1e-3)


def test_own_size_of_a_block_that_is_completed_badly() -> None:
    """Its legs are missing, and on one side too much is filled: that counts once, not twice."""
    volume = volume_of(1)
    proposals = proposals_of(volume, BLOCK)
    oracle = Oracle(BLOCK, volume, above_m=0.5, spilled_m=0.15)
    (found,) = estimated(volume, oracle, proposals)
    wanted = BLOCK.extents_m + np.array([0.0, 0.15, 0.0])
    np.testing.assert_allclose(found.extents_m[:2], wanted[:2], atol=cell_m(proposals))
    assert found.extents_m[2] == pytest.approx(BLOCK.extents_m[2], abs=1e-3)


def test_points_lie_in_the_block_and_correspond() -> None:
    volume = volume_of(1)
    (found,) = estimated(volume, Oracle(BLOCK, volume), proposals_of(volume, BLOCK))
    local = (found.points_world - BLOCK.center) @ BLOCK.R
    assert np.all(np.abs(local) <= BLOCK.extents_m / 2 + 1e-3)
    filled_m3 = len(found.points_world) * crop_m3(proposals_of(volume, BLOCK)) / CELLS**3
    assert filled_m3 == pytest.approx(np.prod(BLOCK.extents_m), rel=0.05)


@pytest.mark.parametrize("quarter", QUARTERS)
def test_the_canonical_reconstruction_is_the_block(quarter: int) -> None:
    volume = volume_of(quarter)
    (found,) = estimated(volume, Oracle(BLOCK, volume), proposals_of(volume, BLOCK))
    cells = (np.arange(64) + 0.5) / 64 - 0.5
    at = np.stack(np.meshgrid(cells, cells, cells, indexing="ij"), axis=-1)
    true = np.all(np.abs(at) <= BLOCK.extents_m / BLOCK.scale_m / 2, axis=-1)
    ours = found.canonical >= 0.5
    assert found.canonical.shape == (64, 64, 64)
    assert found.canonical.min() >= 0 and found.canonical.max() <= 1
    assert (ours & true).sum() / (ours | true).sum() > 0.85


def test_without_completion_only_the_seen_side_is_left() -> None:
    volume = volume_of(2)
    proposals = proposals_of(volume, BLOCK, shift_m=0.06)
    oracle = Oracle(BLOCK, volume)
    (whole,) = estimated(volume, oracle, proposals)
    (seen,) = estimated(volume, oracle, proposals, NO_COMPLETION)
    every = {tuple(p) for p in whole.points_world.round(4)}
    assert {tuple(p) for p in seen.points_world.round(4)} < every
    assert len(seen.points_world) < 0.3 * len(whole.points_world)
    # The grid's -x is the world's +x after half a turn: nothing far behind that side is left.
    assert seen.points_world[:, 0].min() > whole.points_world[:, 0].max() - 0.1 - 1e-3
    assert seen.canonical.sum() < 0.5 * whole.canonical.sum()
    # The pose is known from these cells alone, and the box stands midway to the proposal.
    np.testing.assert_allclose(seen.box.center, BLOCK.bounds.center + 0.03, atol=1e-3)
    np.testing.assert_allclose(seen.box.extents, BLOCK.bounds.extents, atol=1e-3)


def test_correspondences_on_a_line_fix_no_pose() -> None:
    volume = volume_of(3)
    proposals = proposals_of(volume, BLOCK, shift_m=0.04)
    (found,) = estimated(volume, Oracle(BLOCK, volume, collapsed=True), proposals)
    assert not found.pose_observable
    S = found.S_world_canonical
    np.testing.assert_allclose(S.R, np.eye(3), atol=1e-6)
    for center in (S.t, found.box.center):  # the detector's
        np.testing.assert_allclose(center, BLOCK.bounds.center + 0.04, atol=1e-3)
    assert S.scale_m == pytest.approx(np.linalg.norm(found.box.extents), rel=0.02)
    # the reconstruction is of that similarity: placed by it, it fills the object's own box
    points = (np.argwhere(found.canonical >= 0.5) + 0.5) / 64 - 0.5
    placed = S.scale_m * points @ S.R.T + S.t
    bounds = BLOCK.bounds
    np.testing.assert_allclose(placed.min(axis=0), bounds.center - bounds.extents / 2, atol=0.1)
    np.testing.assert_allclose(placed.max(axis=0), bounds.center + bounds.extents / 2, atol=0.1)


def test_without_completion_thin_surfaces_stay_whole() -> None:
    volume, thin = volume_of(0), replace(BLOCK, extents_m=np.array([0.07, 1.6, 0.9]))
    proposals = proposals_of(volume, thin)
    (seen,) = estimated(volume, Oracle(thin, volume), proposals, NO_COMPLETION)
    S = seen.S_world_canonical
    in_canonical = float((seen.canonical >= 0.5).sum()) * (S.scale_m / 64) ** 3
    in_crop = len(seen.points_world) * crop_m3(proposals) / CELLS**3
    assert in_canonical == pytest.approx(in_crop, rel=0.1)


def test_no_proposals_no_objects_and_empty_ones_are_dropped() -> None:
    volume = volume_of(0)
    oracle = Oracle(BLOCK, volume)
    assert estimated(volume, oracle, proposals_of(volume)) == ()
    elsewhere = replace(BLOCK, center=BLOCK.center + np.array([0, 3.0, 0]))
    found = estimated(volume, oracle, proposals_of(volume, elsewhere, BLOCK))
    assert len(found) == 1
    np.testing.assert_allclose(found[0].S_world_canonical.t, BLOCK.center, atol=1e-3)


def test_the_strongest_comes_first() -> None:
    """Of being an object and of its likeliest class."""
    volume, oracle = volume_of(0), Oracle(BLOCK, volume_of(0))
    proposals = proposals_of(volume, BLOCK, BLOCK)
    weak_first = replace(proposals, score=torch.tensor([0.3, 0.8]))
    first, second = estimated(volume, oracle, weak_first)
    assert (first.score, second.score) == pytest.approx((0.8 * 0.82**0.5, 0.3 * 0.82**0.5))
    unsure = torch.full((1, 10), 0.05).index_fill(1, torch.tensor([3]), 0.55)
    unsure_first = replace(
        proposals,
        score=torch.tensor([0.8, 0.7]),
        class_probabilities=torch.cat([unsure, proposals.class_probabilities[1:]]),
    )
    first, second = estimated(volume, oracle, unsure_first)
    assert [e.class_id for e in (first, second)] == [SOFA, 3]
    assert (first.score, second.score) == pytest.approx((0.7 * 0.82**0.5, 0.8 * 0.55**0.5))


def test_classes_are_the_detectors_and_the_network_is_told_them() -> None:
    volume = volume_of(0)
    proposals, oracle = proposals_of(volume, BLOCK), Oracle(BLOCK, volume)
    (found,) = estimated(volume, oracle, proposals)
    np.testing.assert_allclose(found.class_probabilities, proposals.class_probabilities[0])
    assert torch.equal(oracle.told[0], proposals.class_probabilities)


def test_scattering_against_a_slow_loop() -> None:
    g = torch.Generator().manual_seed(0)
    features, relative = (torch.rand(*shape, generator=g) for shape in ((40, 3), (2, 40, 3)))
    inside = torch.rand(2, 40, generator=g) < 0.7
    expected = torch.zeros(2, 3, 4, 4, 4)
    for index in range(2):
        for cell in np.ndindex(4, 4, 4):
            here = inside[index] & ((relative[index] * 4).long() == torch.tensor(cell)).all(dim=1)
            if here.any():
                expected[(index, slice(None), *cell)] = features[here].mean(dim=0)
    assert 0 < (expected != 0).float().mean() < 0.5  # some cells hold voxels, some none
    torch.testing.assert_close(scatter_features(features, relative, inside, 4), expected)


@pytest.mark.parametrize("sharpness", [1.0, 4.0])
def test_a_heading_between_two_bins_is_found(sharpness: float) -> None:
    """Logits that fall off with the angle: the heading is nearer than the bin, whatever it is."""
    true = torch.linspace(-3, 3, 61)
    bins = torch.arange(HEADING_BINS) * (2 * np.pi / HEADING_BINS)
    found = likeliest_heading(sharpness * torch.cos(bins - true[:, None]))
    gap = torch.remainder(found - true + np.pi, 2 * np.pi) - np.pi
    assert gap.abs().max() < np.radians(1)


def test_a_heading_stays_in_its_bin() -> None:
    bin_width = 2 * np.pi / HEADING_BINS
    logits = torch.randn(50, HEADING_BINS, generator=torch.Generator().manual_seed(0))
    off = likeliest_heading(logits) - logits.argmax(dim=1) * bin_width
    assert off.abs().max() <= bin_width / 2 + 1e-6
    assert likeliest_heading(torch.eye(HEADING_BINS)).tolist() == pytest.approx(
        [k * bin_width for k in range(HEADING_BINS)]
    )
    assert torch.isfinite(likeliest_heading(torch.zeros(1, HEADING_BINS))).all()
