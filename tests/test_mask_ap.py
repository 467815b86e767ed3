"""Mask AP by hand, and frame-to-frame tracking of masks that come without identity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from baseline_scenes import CABINET, CHAIR, Seen, cabinet, camera_pose, look, motion_errors
from composenet.baselines.frame_to_frame import FrameToFrame
from composenet.baselines.mask_ap import mask_scores, scored_classes
from composenet.baselines.records import InstanceMasks
from composenet.records import TrackState

HEIGHT, WIDTH = 240, 320


def squares(*items: tuple[int, int, float]) -> InstanceMasks:
    """Masks of 20x20 pixels: left column, class and score of each."""
    masks = np.zeros((len(items), HEIGHT, WIDTH), bool)
    for mask, (left, _, _) in zip(masks, items, strict=True):
        mask[100:120, left : left + 20] = True
    class_ids = np.array([item[1] for item in items], np.int64)
    return InstanceMasks(masks, class_ids, np.array([item[2] for item in items], np.float32))


TRUTH = squares((0, CHAIR, 1), (100, CHAIR, 1))

# Shifting a square of 20 columns by 2 gives an IoU of 18 / 22 = 0.82, by 6 of 14 / 26 = 0.54.
CASES = [
    ("both exact", [(0, CHAIR, 0.9), (100, CHAIR, 0.8)], 1.0, 1.0),
    ("one shifted by 2: 0.82 serves 7 of 10 thresholds", [(2, CHAIR, 0.9)], 0.5, 0.5 * 0.7),
    ("one shifted by 6: 0.54 serves the first only", [(6, CHAIR, 0.9)], 0.5, 0.5 * 0.1),
    ("wrong class", [(0, CABINET, 0.9)], 0.0, 0.0),
    ("nothing", [], 0.0, 0.0),
    ("a false one first: precision 1/2, then 2/3",
     [(200, CHAIR, 0.9), (0, CHAIR, 0.8), (100, CHAIR, 0.7)], 2 / 3, 2 / 3),
    ("a double is false: precision 1, then 2/3",
     [(0, CHAIR, 0.9), (0, CHAIR, 0.8), (100, CHAIR, 0.7)], (1 + 2 / 3) / 2, (1 + 2 / 3) / 2),
]  # fmt: skip


@pytest.mark.parametrize(("name", "found", "ap50", "ap"), CASES, ids=[c[0] for c in CASES])
def test_average_precision_by_hand(name: str, found: list, ap50: float, ap: float) -> None:
    scores = mask_scores([scored_classes(TRUTH, squares(*found))])
    assert scores.ap50 == pytest.approx(ap50) and scores.ap == pytest.approx(ap)
    assert scores.class_ap50[CHAIR] == pytest.approx(ap50) and scores.truths == 2
    assert np.isnan(scores.class_ap50[CABINET])  # no truth of that class


def test_precision_and_recall_pool_the_classes() -> None:
    found = squares((0, CHAIR, 0.9), (100, CABINET, 0.8), (200, CHAIR, 0.3))
    scores = mask_scores([scored_classes(TRUTH, found)] * 2)
    assert scores.precision50 == pytest.approx(1 / 3) and scores.recall50 == 0.5
    assert scores.truths == 4


def test_small_truths_are_ignored() -> None:
    small = np.zeros((1, HEIGHT, WIDTH), bool)
    small[0, :10, :14] = True  # 140 pixels
    truth = InstanceMasks(small, np.array([CHAIR]), np.ones(1, np.float32))
    scores = mask_scores([scored_classes(truth, truth)])
    assert scores.truths == 0 and np.isnan(scores.ap50) and np.isnan(scores.precision50)


def shuffled(seen: Seen, rng: np.random.Generator, drop: int | None = None) -> Seen:
    """The masks in any order and without identity, as a network gives them."""
    order = rng.permutation([i for i in range(len(seen.masks.masks)) if i != drop])
    masks, classes = seen.masks.masks[order], seen.masks.class_ids[order]
    return replace(seen, masks=InstanceMasks(masks, classes, seen.masks.scores[order]))


def test_shuffled_masks_keep_their_tracks() -> None:
    """Three boxes move by up to 12 cm a frame while the camera turns and walks; two look alike
    and pass each other; masks come in any order, and one misses a frame."""
    rng = np.random.default_rng(3)
    paths = [
        [cabinet(2.2, -0.9 + 0.12 * i, 0.4) for i in range(14)],
        [cabinet(3.4, 0.9 - 0.10 * i, 0.4) for i in range(14)],
        [cabinet(2.6 - 0.05 * i, 1.5, 0.1 + 0.05 * i) for i in range(14)],
    ]
    tracked, system = [], FrameToFrame()
    for i in range(14):
        pose = camera_pose(yaw=0.02 * i, x=-0.03 * i)
        seen = look(i, [path[i] for path in paths], T_world_camera=pose)
        given = shuffled(seen, rng, drop=2 if i == 6 else None)
        tracked.append(system(given.frame, given.masks))
    assert {len(entries) for entries in tracked} == {3}
    assert sum(entry.state is TrackState.OCCLUDED for entry in tracked[6]) == 1
    starts = {entry.track_id: entry.S_world_canonical.t for entry in tracked[0]}
    owners = {
        track_id: int(np.argmin([np.linalg.norm(path[0].center - t) for path in paths]))
        for track_id, t in starts.items()
    }
    assert sorted(owners.values()) == [0, 1, 2]
    for track_id, owner in owners.items():
        entries = [next(e for e in now if e.track_id == track_id) for now in tracked]
        metres, degrees = motion_errors(entries, paths[owner])
        assert metres.max() < 0.1 and degrees.max() < 6, (track_id, metres, degrees)


def test_a_false_mask_starts_its_own_track_and_takes_none() -> None:
    rng = np.random.default_rng(0)
    system = FrameToFrame()
    for i in range(6):
        seen = shuffled(look(i, [cabinet(2.5 + 0.04 * i, -0.5, 0.3)]), rng)
        if i == 3:  # a piece of floor far from the box
            floor = np.zeros((1, HEIGHT, WIDTH), bool)
            floor[0, 200:230, 20:80] = True
            masks = InstanceMasks(
                np.concatenate([floor, seen.masks.masks]),
                np.concatenate([[CHAIR], seen.masks.class_ids]),
                np.concatenate([[0.9], seen.masks.scores]).astype(np.float32),
            )
            seen = replace(seen, masks=masks)
        tracked = system(seen.frame, seen.masks)
        assert tracked[0].track_id == 0 and tracked[0].observed
        assert tracked[0].class_id == CABINET
    assert [entry.observed for entry in tracked] == [True, False]
