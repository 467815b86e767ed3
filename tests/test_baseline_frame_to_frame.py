"""F2F on scenes whose motion is known to the millimetre."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from baseline_scenes import (
    CABINET,
    CHAIR,
    Seen,
    cabinet,
    camera_pose,
    look,
    motion_errors,
    pillar,
    screen,
    without_ids,
)
from composenet.baselines.frame_to_frame import END_AFTER_FRAMES, FrameToFrame
from composenet.baselines.records import Cameras
from composenet.records import TrackedObject, TrackState


def follow(scenes: list[Seen], cameras: Cameras = Cameras.GIVEN) -> list[tuple[TrackedObject, ...]]:
    system = FrameToFrame(cameras)
    return [system(seen.frame, seen.masks) for seen in scenes]


@pytest.mark.parametrize("with_ids", [True, False])
def test_a_box_slides_at_known_speed(with_ids: bool) -> None:
    """11 cm a frame."""
    truth = [cabinet(2.5 + 0.05 * i, -0.6 + 0.1 * i, yaw=0.5) for i in range(12)]
    scenes = [look(i, [box]) for i, box in enumerate(truth)]
    tracked = follow(scenes if with_ids else [without_ids(s) for s in scenes])
    assert {entry.track_id for frame in tracked for entry in frame} == {0}
    metres, degrees = motion_errors([frame[0] for frame in tracked], truth)
    assert metres.max() < 0.03 and degrees.max() < 3
    places = np.array([frame[0].S_world_canonical.t for frame in tracked])
    np.testing.assert_allclose(np.diff(places, axis=0), [[0.05, 0.1, 0]] * 11, atol=0.01)
    assert all(frame[0].class_id == CABINET and frame[0].observed for frame in tracked)


def test_a_box_turns_about_itself() -> None:
    truth = [cabinet(2.5, 0.1, yaw=0.3 + np.radians(8) * i) for i in range(12)]
    tracked = follow([look(i, [box]) for i, box in enumerate(truth)])
    metres, degrees = motion_errors([frame[0] for frame in tracked], truth)
    assert metres.max() < 0.03 and degrees.max() < 3  # the seen sides change: 88 degrees in all


def test_a_box_passes_behind_a_narrow_occluder() -> None:
    truth = [cabinet(3.0, 0.6 - 0.08 * i, yaw=0.5) for i in range(14)]
    scenes = [look(i, [box], [screen(1.6, 0.0, width=0.2)]) for i, box in enumerate(truth)]
    pixels = [int(seen.masks.masks.sum()) for seen in scenes]
    assert 0 < min(pixels) < 0.6 * max(pixels)  # never out of sight, in two pieces meanwhile
    entries = [frame[0] for frame in follow(scenes)]
    assert all(entry.observed and entry.track_id == 0 for entry in entries)
    metres, degrees = motion_errors(entries, truth)
    assert metres.max() < 0.1 and degrees.max() < 10  # of 1.04 m


def test_a_box_passes_behind_an_occluder_and_keeps_its_identity() -> None:
    truth = [cabinet(3.0, 1.1 - 0.11 * i, yaw=0.5) for i in range(20)]
    scenes = [look(i, [box], [screen(1.6, 0.0)]) for i, box in enumerate(truth)]
    hidden = [i for i, seen in enumerate(scenes) if len(seen.masks.masks) == 0]
    assert len(hidden) >= 2  # fully out of sight in between, and cut to slivers before and after
    tracked = follow(scenes)
    entries = [frame[0] for frame in tracked]
    assert {entry.track_id for frame in tracked for entry in frame} == {0}
    assert all(entries[i].state is TrackState.OCCLUDED for i in hidden)
    assert entries[hidden[-1] + 1].state is TrackState.RE_FOUND
    seen = [i for i in range(20) if i not in hidden]
    metres, _ = motion_errors([entries[i] for i in seen], [truth[i] for i in seen])
    # It vanishes with its left edge and returns with its right one: frame to frame, no surface is
    # seen in both, and the motion between them (0.44 m) is a guess.
    assert metres[: hidden[0]].max() < 0.08 and metres.max() < 0.35


def test_a_box_at_rest_rests_while_the_camera_moves() -> None:
    poses = [camera_pose(yaw=0.05 * i, x=0.05 * i) for i in range(10)]
    box = cabinet(2.6, 0.7, yaw=0.7)
    tracked = follow([look(i, [box], T_world_camera=T) for i, T in enumerate(poses)])
    metres, degrees = motion_errors([frame[0] for frame in tracked], [box] * 10)
    assert metres.max() < 0.005 and degrees.max() < 0.7


def test_an_estimated_camera_follows_fast_turns() -> None:
    """Only the first pose is told; the clouds of the room give the others."""
    yaws = [0.0, 0.1, 0.4, 0.7, 0.4]
    poses = [camera_pose(yaw, x=0.06 * i) for i, yaw in enumerate(yaws)]
    box = cabinet(2.6, 0.9, 0.7)
    things = [pillar(3.2, -0.2), pillar(2.4, 2.0), pillar(3.0, 2.9), pillar(3.6, 1.0)]
    scenes = [look(i, [box], things, T) for i, T in enumerate(poses)]
    told = [replace(s, frame=replace(s.frame, T_world_camera=poses[0])) for s in scenes]
    tracked = follow(told, Cameras.ESTIMATED)
    metres, degrees = motion_errors([frame[0] for frame in tracked], [box] * len(poses))
    assert metres.max() < 0.05 and degrees.max() < 2


def test_two_boxes_change_places_without_identities_of_masks() -> None:
    ahead = [cabinet(2.2, -1.0 + 0.12 * i, 0.4) for i in range(16)]
    behind = [cabinet(3.6, 1.0 - 0.12 * i, 0.4) for i in range(16)]
    pairs = zip(ahead, behind, strict=True)
    scenes = [without_ids(look(i, list(pair))) for i, pair in enumerate(pairs)]
    tracked = follow(scenes)
    assert all([e.track_id for e in frame if e.observed] == [0, 1] for frame in tracked)
    for track_id, truth in enumerate((ahead, behind)):
        metres, degrees = motion_errors([frame[track_id] for frame in tracked], truth)
        assert metres.max() < 0.05 and degrees.max() < 4


def test_small_weak_and_empty_masks() -> None:
    seen = look(0, [cabinet(2.5, 0.0)])
    mask = np.zeros_like(seen.masks.masks)
    assert FrameToFrame()(seen.frame, replace(seen.masks, masks=mask)) == ()
    mask[0, 50:53, 70:73] = True  # 9 pixels: too few to follow
    assert FrameToFrame()(seen.frame, replace(seen.masks, masks=mask)) == ()
    weak = replace(seen.masks, scores=np.array([0.4], np.float32))
    assert FrameToFrame()(seen.frame, weak) == ()
    blank = replace(seen.frame, depth_m=np.zeros_like(seen.frame.depth_m))
    assert FrameToFrame()(blank, seen.masks) == ()


def test_a_sliver_of_a_mask_claims_nothing() -> None:
    scenes = [look(i, [cabinet(2.5, 0.0)]) for i in range(3)]
    rows, columns = np.nonzero(scenes[1].masks.masks[0])
    for pixels, seen in ((len(rows), True), (int(0.0008 * scenes[1].masks.masks[0].size), False)):
        mask = np.zeros_like(scenes[1].masks.masks)
        mask[0, rows[:pixels], columns[:pixels]] = True
        track, whole = FrameToFrame(), scenes[1]
        track(scenes[0].frame, scenes[0].masks)
        (entry,) = track(whole.frame, replace(whole.masks, masks=mask))
        assert entry.observed == seen and entry.track_id == 0


def test_a_mask_without_depth_goes_on_as_it_last_moved() -> None:
    truth = [cabinet(2.6, -0.4 + 0.1 * i, yaw=0.5) for i in range(6)]
    scenes = [look(i, [box]) for i, box in enumerate(truth)]
    dark = np.where(scenes[4].masks.masks[0], 0, scenes[4].frame.depth_m).astype(np.float32)
    scenes[4] = replace(scenes[4], frame=replace(scenes[4].frame, depth_m=dark))
    metres, _ = motion_errors([frame[0] for frame in follow(scenes)], truth)
    assert metres.max() < 0.03


def test_a_track_without_identity_ends_when_long_unseen() -> None:
    seen = without_ids(look(0, [cabinet(2.5, 0.0)]))
    system = FrameToFrame()
    assert len(system(seen.frame, seen.masks)) == 1
    for index in range(1, END_AFTER_FRAMES + 3):
        empty = without_ids(look(index, []))
        living = system(empty.frame, empty.masks)
        assert len(living) == (index <= END_AFTER_FRAMES)
    again = without_ids(look(40, [cabinet(2.5, 0.0)]))
    assert [entry.track_id for entry in system(again.frame, again.masks)] == [1]


def test_the_class_is_the_one_most_seen() -> None:
    scenes = [look(i, [cabinet(2.5, 0.0)], class_id=CHAIR if i == 0 else CABINET) for i in range(4)]
    assert [frame[0].class_id for frame in follow(scenes)][-1] == CABINET
