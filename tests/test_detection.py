"""Mean shift against scikit-learn's; proposals from fields built by hand; the second look."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from sklearn.cluster import MeanShift

from composenet import detection
from composenet.config import DetectionConfig
from composenet.detection import (
    ALIKE_IOU,
    BOX_LIMITS_M,
    Proposals,
    propose,
    remembered,
    second_look,
)
from composenet.geometry.box import iou
from composenet.network.batch import VolumeBatch
from composenet.network.box_head import BoxFields
from composenet.network.detection_head import VoxelFields
from composenet.network.model import ComposeNet
from composenet.records import CLASS_NAMES, Box
from composenet.volume.memory import FreeSpace
from composenet.volume.voxels import Volume
from conftest import TINY

CONFIG = DetectionConfig()
VOXEL_M = 0.05


def blobs(seed: int, count: int, spread: float = 1.5, apart: float = 30.0) -> torch.Tensor:
    """Votes around well-separated centres, between 20 and 80 each."""
    rng = np.random.default_rng(seed)
    places = rng.permutation(np.stack(np.meshgrid(*[range(3)] * 3), -1).reshape(-1, 3))[:count]
    centers = apart * places + rng.uniform(-4, 4, (count, 3))
    parts = [c + spread * rng.normal(size=(int(rng.integers(20, 80)), 3)) for c in centers]
    return torch.from_numpy(np.concatenate(parts)).float()


def mean_shift(points: torch.Tensor, *args, **kwargs) -> tuple[torch.Tensor, torch.Tensor]:
    """Modes and members of one frame."""
    frame = torch.zeros(len(points), dtype=torch.long)
    modes, of, member = detection.mean_shift(points, frame, *args, **kwargs)
    assert not of.any() and len(of) == len(modes)
    return modes, member


def partition(labels: Sequence[int]) -> set[frozenset[int]]:
    labels = np.asarray(labels)
    return {frozenset(np.flatnonzero(labels == label).tolist()) for label in set(labels.tolist())}


@pytest.mark.parametrize(("seed", "count"), [(0, 1), (1, 3), (2, 6), (3, 9)])
def test_mean_shift_equals_scikit_learn(seed: int, count: int) -> None:
    points = blobs(seed, count)
    oracle = MeanShift(bandwidth=8.0).fit(points.numpy())
    modes, member = mean_shift(points, 8.0, 50, bin_size=0.05)
    assert len(modes) == len(oracle.cluster_centers_) == count
    assert partition(member.tolist()) == partition(oracle.labels_)
    gaps = torch.cdist(modes, torch.from_numpy(oracle.cluster_centers_).float())
    assert gaps.amin(dim=1).max() < 0.05


def test_coarse_bins_find_the_same_objects() -> None:
    points = blobs(4, 5)
    fine = mean_shift(points, 8.0, 20, bin_size=0.05)[1]
    for bins in ({"bin_size": 1.0}, {}):
        coarse = mean_shift(points, 8.0, 20, **bins)[1]
        assert partition(fine.tolist()) == partition(coarse.tolist())


def test_order_and_place_do_not_matter() -> None:
    points = blobs(5, 4)
    modes, member = mean_shift(points, 8.0, 20)
    order = torch.randperm(len(points), generator=torch.Generator().manual_seed(0))
    shuffled, shuffled_member = mean_shift(points[order], 8.0, 20)
    torch.testing.assert_close(shuffled, modes, atol=1e-3, rtol=0)
    assert torch.equal(shuffled_member, member[order])
    step = torch.tensor([16.0, -32.0, 8.0])  # whole bins
    moved, moved_member = mean_shift(points + step, 8.0, 20)
    torch.testing.assert_close(moved, modes + step, atol=1e-3, rtol=0)
    assert torch.equal(moved_member, member)


def test_the_strongest_mode_comes_first() -> None:
    sizes = (30, 90, 60)
    parts = [torch.full((n, 3), 40.0 * i) for i, n in enumerate(sizes)]
    modes, member = mean_shift(torch.cat(parts), 8.0, 20)
    np.testing.assert_allclose(modes[:, 0], [40, 80, 0])
    assert torch.bincount(member).tolist() == [90, 60, 30]


@pytest.mark.parametrize("radius", [6.0, 8.0, 20.0])
def test_each_frame_is_shifted_for_itself(radius: float) -> None:
    """Frames of different sizes in one place, one of them empty, their points mixed."""
    points = [blobs(seed, count, apart=12.0) for seed, count in ((0, 5), (1, 1), (2, 8))]
    frame = torch.cat([torch.full((len(p),), f) for p, f in zip(points, (0, 1, 3), strict=True)])
    order = torch.randperm(len(frame), generator=torch.Generator().manual_seed(0))
    every = torch.cat(points)[order]
    modes, of, member = detection.mean_shift(every, frame[order], radius, 20)
    assert of.tolist() == sorted(of.tolist()) and torch.equal(of[member], frame[order])
    for index, own in zip((0, 1, 3), points, strict=True):
        alone, alone_member = mean_shift(own, radius, 20)
        torch.testing.assert_close(modes[of == index], alone, atol=1e-3, rtol=0)
        back = torch.empty_like(order)
        back[order] = torch.arange(len(order))
        mine = member[back][frame == index] - int((of < index).sum())
        assert torch.equal(mine, alone_member)


def test_a_fuller_frame_does_not_stop_another() -> None:
    """Padded to the bins of the fullest, each frame still goes on until its own points rest."""
    random = torch.Generator().manual_seed(0)
    for _ in range(10):
        points = []
        for count in (400, 60, 5):
            centers = 200 * torch.rand(4, 3, generator=random)
            near = 3 * torch.randn(count, 3, generator=random)
            points.append(centers[torch.randint(4, (count,), generator=random)] + near)
        frame = torch.repeat_interleave(torch.arange(3), torch.tensor([len(p) for p in points]))
        modes, of, _ = detection.mean_shift(torch.cat(points), frame, 5.0, 20)
        for index, own in enumerate(points):
            alone, _ = mean_shift(own, 5.0, 20)
            torch.testing.assert_close(modes[of == index], alone, atol=1e-2, rtol=0)


@dataclass(frozen=True)
class Thing:
    """center, extents in voxels; objectness: probability of its voxels."""

    center: tuple[float, float, float]
    extents: tuple[float, float, float]
    class_id: int
    voxels: int = 200
    objectness: float = 0.9
    frame: int = 0


def field_of(things: Sequence[Thing], frames: int = 1) -> tuple[VoxelFields, VolumeBatch]:
    """Voxels scattered over each thing that know its box, and floor that belongs to none."""
    g = torch.Generator().manual_seed(0)
    rows, centers, extents, logits, objectness = [], [], [], [], []
    floor = [
        Thing((60, 60, 0), (120, 120, 1), 0, 300, objectness=0.05, frame=f) for f in range(frames)
    ]
    for thing in (*things, *floor):
        center, size = torch.tensor(thing.center), torch.tensor(thing.extents)
        sites = (center + (torch.rand(thing.voxels, 3, generator=g) - 0.5) * size).round().long()
        rows.append(torch.cat([torch.full((thing.voxels, 1), thing.frame), sites.abs()], dim=1))
        noise = 0.3 * torch.randn(thing.voxels, 3, generator=g)
        centers.append(center + noise - noise.mean(dim=0))
        extents.append(size.expand(thing.voxels, 3))
        one_hot = torch.nn.functional.one_hot(torch.tensor(thing.class_id), 10)
        logits.append(4.0 * one_hot.expand(thing.voxels, 10))
        objectness.append(torch.full((thing.voxels,), thing.objectness).logit())
    coords = torch.cat(rows)
    fields = VoxelFields(
        features=torch.zeros(len(coords), 1),
        objectness=torch.cat(objectness),
        center_offset=torch.cat(centers) - coords[:, 1:],
        extents=torch.cat(extents),
        class_logits=torch.cat(logits),
    )
    eye = torch.eye(4).expand(frames, 4, 4)
    depth = torch.zeros(frames, 4, 4)
    seen = torch.zeros(len(coords), dtype=torch.bool)
    batch = VolumeBatch(
        coords, fields.features, seen, depth[..., None] > 0, eye[:, 0, :3], depth, eye[:, :3, :3],
        eye, depth[:, 0, 0], VOXEL_M,
    )  # fmt: skip
    return fields, batch


CHAIR = Thing((20, 20, 9), (12, 12, 18), 4, objectness=0.95)
TABLE = Thing((60, 25, 7), (30, 20, 14), 8, objectness=0.9)
SOFA = Thing((40, 80, 8), (16, 40, 16), 7, objectness=0.8)


def test_three_objects_three_boxes() -> None:
    (found,) = propose(*field_of([SOFA, CHAIR, TABLE]), CONFIG)
    things = [CHAIR, TABLE, SOFA]  # by score
    assert found.class_probabilities.argmax(dim=1).tolist() == [t.class_id for t in things]
    np.testing.assert_allclose(found.center / VOXEL_M, [t.center for t in things], atol=0.01)
    np.testing.assert_allclose(found.extents / VOXEL_M, [t.extents for t in things], rtol=1e-5)
    np.testing.assert_allclose(found.score, [t.objectness for t in things], rtol=1e-5)
    np.testing.assert_array_equal(found.voxels, 200)
    np.testing.assert_allclose(found.class_probabilities.sum(dim=1), 1, rtol=1e-5)


@pytest.mark.parametrize(("voxels", "kept"), [(19, 1), (20, 2)])
def test_small_clusters_are_dropped(voxels: int, kept: int) -> None:
    lamp = Thing((90, 90, 10), (6, 6, 10), 0, voxels)
    (found,) = propose(*field_of([CHAIR, lamp]), CONFIG)
    assert len(found.center) == kept


@pytest.mark.parametrize(("seen", "kept"), [(0, 0), (4, 0), (5, 1), (200, 1)])
def test_what_is_only_remembered_is_not_found(seen: int, kept: int) -> None:
    fields, batch = field_of([CHAIR])
    remembered = torch.ones_like(batch.remembered)
    remembered[:seen] = False  # voxels of the chair come first
    (found,) = propose(fields, replace(batch, remembered=remembered), CONFIG)
    assert len(found.center) == kept
    np.testing.assert_array_equal(found.voxels, [200] * kept)


@pytest.mark.parametrize("things", [[], [Thing((20, 20, 9), (12, 12, 18), 4, objectness=0.4)]])
def test_nothing_found(things: list[Thing]) -> None:
    (found,) = propose(*field_of(things), CONFIG)
    assert found.center.shape == found.extents.shape == (0, 3)
    assert found.class_probabilities.shape == (0, 10) and found.score.shape == (0,)


def test_frames_of_a_batch_do_not_mix() -> None:
    there = Thing(TABLE.center, TABLE.extents, TABLE.class_id, frame=1)
    first, second, third = propose(*field_of([CHAIR, there], frames=3), CONFIG)
    assert first.class_probabilities.argmax(dim=1).tolist() == [CHAIR.class_id]
    assert second.class_probabilities.argmax(dim=1).tolist() == [TABLE.class_id]
    assert len(third.center) == 0


def test_a_larger_radius_takes_neighbours_for_one() -> None:
    """Two halves, 6 voxels apart."""
    halves = [Thing((20, 20, 9), (4, 4, 8), 4), Thing((26, 20, 9), (4, 4, 8), 4)]
    for radius, count in ((4.0, 2), (8.0, 1)):
        config = replace(CONFIG, mean_shift_radius_voxels=radius)
        (found,) = propose(*field_of(halves), config)
        assert len(found.center) == count


def test_no_more_than_asked_for_and_the_strongest_of_them() -> None:
    (found,) = propose(*field_of([SOFA, CHAIR, TABLE]), replace(CONFIG, max_proposals=2))
    assert found.class_probabilities.argmax(dim=1).tolist() == [CHAIR.class_id, TABLE.class_id]
    (found,) = propose(*field_of([SOFA, CHAIR, TABLE]), replace(CONFIG, min_score=0.85))
    assert len(found.center) == 2


@dataclass(frozen=True)
class Seen:
    """A proposal and what the second look makes of it: moved along x, of another class.

    x, move, side: metres; all are cubes at y = z = 0.
    """

    x: float
    objectness: float
    quality: float
    class_id: int = 4
    move: float = 0.0
    side: float = 1.0


class Looker:
    """In place of the network: corrects boxes as it is told. frames: one list a frame."""

    def __init__(self, frames: Sequence[Sequence[Seen]]) -> None:
        self.frames = frames

    def box_fields(
        self,
        fields: VoxelFields,
        batch: VolumeBatch,
        center: torch.Tensor,
        extents: torch.Tensor,
        frame: torch.Tensor,
    ) -> BoxFields:
        places = zip(frame.tolist(), center[:, 0].tolist(), strict=True)
        seen = [min(self.frames[index], key=lambda s: abs(s.x - x)) for index, x in places]
        move = torch.tensor([[s.move, 0, 0] for s in seen]).reshape(-1, 3)
        classes = torch.tensor([s.class_id for s in seen], dtype=torch.long)
        return BoxFields(
            center=center + move,
            extents=extents,
            quality=torch.tensor([s.quality for s in seen]).logit(),
            class_logits=40.0 * torch.nn.functional.one_hot(classes, 10),
        )


def looked(
    frames: Sequence[Sequence[Seen]], config: DetectionConfig = CONFIG
) -> tuple[Proposals, ...]:
    proposals = [
        Proposals(
            center=torch.tensor([[s.x, 0, 0] for s in seen]).reshape(-1, 3),
            extents=torch.tensor([[s.side] * 3 for s in seen]).reshape(-1, 3),
            class_probabilities=torch.full((len(seen), 10), 0.1),
            score=torch.tensor([s.objectness for s in seen]),
            voxels=torch.arange(len(seen)) + 50,
        )
        for seen in frames
    ]
    fields, batch = field_of([], frames=len(frames))
    return second_look(Looker(frames), fields, batch, tuple(proposals), config)  # type: ignore[arg-type]


HALF = DetectionConfig(min_score=0.0, duplicate_iou=0.5)


def test_a_second_look_orders_by_quality() -> None:
    seen = [Seen(0, 0.9, 0.2), Seen(4, 0.8, 0.9, 8, move=0.1), Seen(8, 0.6, 0.8, 7)]
    (found,) = looked([seen], DetectionConfig(min_score=0.1))
    np.testing.assert_allclose(found.score, [0.9, 0.8, 0.2], rtol=1e-5)
    np.testing.assert_allclose(found.center[:, 0], [4.1, 8, 0])  # corrected
    assert found.class_probabilities.argmax(dim=1).tolist() == [8, 7, 4]
    np.testing.assert_allclose(found.class_probabilities.sum(dim=1), 1, rtol=1e-6)
    assert found.voxels.tolist() == [51, 52, 50]


def test_a_second_look_drops_the_weak() -> None:
    seen = [Seen(0, 0.9, 0.2), Seen(4, 0.8, 0.9), Seen(8, 0.6, 0.8)]
    (found,) = looked([seen], DetectionConfig(min_score=0.5))
    assert found.center[:, 0].tolist() == [4, 8]
    (found,) = looked([seen], DetectionConfig(min_score=1.0))
    assert found.center.shape == (0, 3) and found.class_probabilities.shape == (0, 10)


@pytest.mark.parametrize("class_id", [4, 8])
@pytest.mark.parametrize(
    ("gap", "kept"),
    # IoU of unit cubes that far apart: 0.538, 0.481, 0
    [(0.3, 1), (0.35, 2), (1.5, 2)],
)
def test_one_box_a_place_whatever_the_classes(class_id: int, gap: float, kept: int) -> None:
    weak, strong = Seen(0, 0.7, 0.7, 4), Seen(gap, 0.9, 0.9, class_id)
    (found,) = looked([[weak, strong]], HALF)
    np.testing.assert_allclose(found.center[:, 0], [gap, 0][:kept])
    # The corrected boxes count: far apart as proposals, in one place afterwards.
    (found,) = looked(
        [[Seen(-2, 0.7, 0.7, 4, move=2), Seen(gap + 3, 0.9, 0.9, class_id, -3)]], HALF
    )
    np.testing.assert_allclose(found.center[:, 0], [gap, 0][:kept], atol=1e-6)


@pytest.mark.parametrize(
    ("one", "other", "gap", "kept"),
    # IoU of unit cubes that far apart: 0.333, 0.481, 0.538
    [
        ("chair", "table", 0.5, 2),
        ("chair", "desk", 0.35, 2),
        ("table", "chair", 0.35, 2),
        ("chair", "table", 0.3, 1),
        ("chair", "chair", 0.5, 1),
        ("table", "desk", 0.5, 1),
        ("chair", "sofa", 0.5, 1),
    ],
)
def test_chairs_stand_under_tables(one: str, other: str, gap: float, kept: int) -> None:
    """Nothing else shares so much of its box."""
    weak = Seen(0, 0.7, 0.7, CLASS_NAMES.index(one))
    strong = Seen(gap, 0.9, 0.9, CLASS_NAMES.index(other))
    (found,) = looked([[weak, strong]], DetectionConfig(min_score=0.0, duplicate_iou=0.25))
    np.testing.assert_allclose(found.center[:, 0], [gap, 0][:kept])
    (found,) = looked([[weak, strong]], DetectionConfig(min_score=0.0, duplicate_iou=1.0))
    assert len(found.center) == 2  # as the paper's recipe asks for


def test_what_was_dropped_drops_nothing() -> None:
    """Of a chain in which neighbours overlap the first and the third stay."""
    (found,) = looked([[Seen(0.4, 0.7, 0.7), Seen(0.2, 0.8, 0.8), Seen(0, 0.9, 0.9)]], HALF)
    np.testing.assert_allclose(found.center[:, 0], [0, 0.4])


@pytest.mark.parametrize("seed", range(5))
def test_duplicates_against_a_slow_loop(seed: int) -> None:
    """Of those alike before the look the first stays, of those that overlap after it the best."""
    rng = np.random.default_rng(seed)
    seen = [
        Seen(*rng.uniform((0, 0.3, 0.3), (8, 1, 1)).tolist(), int(rng.integers(10)))
        for _ in range(15)
    ]

    def apart(one: Seen, others: Sequence[Seen], limit: float) -> bool:
        cube, *cubes = (Box(np.array([s.x, 0, 0]), np.ones(3)) for s in (one, *others))
        return all(iou(cube, other) <= limit for other in cubes)

    looked_at: list[Seen] = []
    kept: list[Seen] = []
    for one in seen:
        looked_at += [one] * apart(one, looked_at, ALIKE_IOU)
    for one in sorted(looked_at, key=lambda s: -s.quality):
        kept += [one] * apart(one, kept, 0.5)
    (found,) = looked([seen], HALF)
    np.testing.assert_allclose(found.center[:, 0], [s.x for s in kept], rtol=1e-6)
    assert found.class_probabilities.argmax(dim=1).tolist() == [s.class_id for s in kept]
    assert 1 < len(kept) < 15


def test_boxes_nearly_alike_are_looked_at_once() -> None:
    """The first of them; corrected, they would be told apart."""
    one, other = Seen(0, 0.7, 0.7, 4, move=-1), Seen(0.05, 0.9, 0.9, 8, move=1)  # IoU 0.905
    (found,) = looked([[one, other]])
    assert found.center[:, 0].tolist() == [-1] and found.voxels.tolist() == [50]
    (found,) = looked([[one, replace(other, x=0.06)]])  # IoU 0.887
    assert len(found.center) == 2


def test_a_second_look_at_each_frame_for_itself() -> None:
    one, other = Seen(0, 0.9, 0.9, 4), Seen(0, 0.8, 0.8, 8)  # the same place
    first, second, third = looked([[one], [], [other]])
    assert first.class_probabilities.argmax(dim=1).tolist() == [4]
    assert third.class_probabilities.argmax(dim=1).tolist() == [8]
    assert second.center.shape == second.extents.shape == (0, 3)
    assert second.score.shape == second.voxels.shape == (0,)


def test_boxes_are_as_small_and_large_as_furniture() -> None:
    """The head learned on those."""
    low, high = BOX_LIMITS_M
    (found,) = looked([[Seen(0, 0.9, 0.9, side=0.01), Seen(20, 0.8, 0.8, side=30.0)]])
    np.testing.assert_allclose(found.extents, np.repeat([[low], [high]], 3, axis=1))


def test_a_second_look_of_the_network_itself() -> None:
    torch.manual_seed(0)
    network = ComposeNet(TINY.network, TINY.volume).eval()
    fields, batch = field_of([CHAIR, replace(TABLE, voxels=300)], frames=2)
    features = torch.randn(len(batch.coords), network.backbone.c_out)
    fields = VoxelFields(**{**vars(fields), "features": features})
    voted = propose(fields, batch, CONFIG)
    found, none = second_look(network, fields, batch, voted, DetectionConfig(min_score=0.0))
    assert len(found.center) == 2 and len(none.center) == 0
    order = [voted[0].voxels.tolist().index(n) for n in found.voxels.tolist()]
    gap = (found.center - voted[0].center[order]).abs() / voted[0].extents[order]
    assert 0 < gap.max() < 0.1  # it has learned nothing yet


def block_volume(quarter_turns: int, n_seen: int) -> tuple[Volume, Box]:
    """4 x 6 x 8 voxels of one block, of which the frame sees the first n_seen; and its box in the
    world, where the grid is turned and shifted."""
    coords = np.stack(np.meshgrid(range(4), range(6), range(8), indexing="ij"), -1).reshape(-1, 3)
    T, angle = np.eye(4), np.pi / 2 * quarter_turns
    T[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    T[:3, 3] = [1.0, -2.0, 0.5]
    volume = Volume(
        (coords + 3).astype(np.int32),
        np.zeros((len(coords), 12), np.float32),
        np.zeros(len(coords), np.int32),
        n_seen,
        FreeSpace.nothing(),
        (16, 16, 16),
        VOXEL_M,
        T,
        np.zeros((2, 2), np.float32),
        np.eye(3),
        np.eye(4),
    )
    corners = (VOXEL_M * (coords + 3)) @ T[:3, :3].T + T[:3, 3]
    low, high = corners.min(axis=0) - VOXEL_M / 2, corners.max(axis=0) + VOXEL_M / 2
    return volume, Box((low + high) / 2, high - low)


NOTHING = Proposals(
    torch.zeros(0, 3), torch.zeros(0, 3), torch.zeros(0, 10), torch.zeros(0), torch.zeros(0)
)


@pytest.mark.parametrize("quarter_turns", range(4))
def test_a_track_is_looked_for_where_it_was(quarter_turns: int) -> None:
    volume, box = block_volume(quarter_turns, 192)
    aside = Box(box.center + 1.0, box.extents)
    found = remembered([aside, box], volume, NOTHING, CONFIG)
    np.testing.assert_allclose(found.center, [[0.225, 0.275, 0.325]], atol=1e-6)
    np.testing.assert_allclose(found.extents, [[0.2, 0.3, 0.4]], atol=1e-6)
    assert found.voxels.tolist() == [192]
    assert found.class_probabilities.shape == (1, 10)


@pytest.mark.parametrize(("n_seen", "kept"), [(CONFIG.min_cluster_voxels - 1, 0), (20, 1), (0, 0)])
def test_a_track_that_the_frame_does_not_show_is_not_looked_for(n_seen: int, kept: int) -> None:
    volume, box = block_volume(1, n_seen)
    assert len(remembered([box], volume, NOTHING, CONFIG).center) == kept
    assert len(remembered([], volume, NOTHING, CONFIG).center) == 0
