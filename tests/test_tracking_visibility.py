"""What the depth image should show of an unseen object."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from composenet.records import Box
from composenet.tracking import visibility as shown_by
from composenet.tracking.canonical import CanonicalModel
from composenet.tracking.visibility import surface_in_world
from tracking_scenes import CHAIR, WALL_M, block, frame, screen, thing

CHAIR_AT_3 = thing(3.0, 0.0)
visibility = partial(shown_by.visibility, max_depth_m=5.5)


def surface(estimate):
    model = CanonicalModel(estimate.canonical)
    return surface_in_world(model.surface, estimate.S_world_canonical, estimate.box)


BLANK = replace(frame(0), depth_m=np.zeros_like(frame(0).depth_m))


@pytest.mark.parametrize(
    ("shown", "low", "high"),
    [
        pytest.param(frame(0, [CHAIR_AT_3.box]), 0.9, 1.0, id="there, in view"),
        pytest.param(frame(0), 0.9, 1.0, id="gone, place in view"),
        pytest.param(frame(0, [screen(1.5, 0.0)]), 0.0, 0.02, id="behind a screen"),
        pytest.param(frame(0, [screen(1.5, 0.7)]), 0.3, 0.7, id="half behind a screen"),
        pytest.param(frame(0, yaw=np.pi / 2), 0.0, 0.0, id="out of view"),
        pytest.param(frame(0, yaw=np.pi), 0.0, 0.0, id="behind the camera"),
        pytest.param(BLANK, 0.0, 0.0, id="no measurement"),
    ],
)
def test_share_expected_to_be_seen(shown, low, high):
    assert low <= visibility(*surface(CHAIR_AT_3), shown).expected <= high


def test_agreeing_and_seen_through_tell_presence_from_absence():
    there = visibility(*surface(CHAIR_AT_3), frame(0, [CHAIR_AT_3.box]))
    gone = visibility(*surface(CHAIR_AT_3), frame(0))
    hidden = visibility(*surface(CHAIR_AT_3), frame(0, [screen(1.5, 0.0)]))
    assert there.still_there and there.seen_through < 0.1
    assert not gone.still_there and gone.agreeing < 0.1
    assert not hidden.still_there


def test_own_back_does_not_count_as_hidden():
    bed = thing(3.0, 0.0, size=(2.0, 1.6, 0.6))
    assert visibility(*surface(bed), frame(0, [bed.box])).agreeing > 0.85


def test_nothing_is_expected_beyond_the_depth_limit():
    points, spacing_m = surface(CHAIR_AT_3)
    assert visibility(points, spacing_m, frame(0), max_depth_m=2.0).expected == 0


def test_no_points_are_not_visible():
    assert visibility(np.zeros((0, 3)), 0.05, frame(0)).expected == 0


def test_an_empty_model_falls_back_to_its_box():
    empty = thing(3.0, 0.0, class_id=CHAIR, canonical=np.zeros((64, 64, 64), np.float32))
    points, spacing_m = surface(empty)
    box = Box(points.mean(axis=0), np.ptp(points, axis=0))
    np.testing.assert_allclose(box.center, empty.box.center, atol=1e-9)
    np.testing.assert_allclose(box.extents, empty.box.extents, atol=1e-9)
    assert visibility(points, spacing_m, frame(0)).expected > 0.9


def test_surface_follows_the_pose():
    turned = thing(2.0, 1.0, size=(1.2, 0.6, 0.7), yaw=np.pi / 2)
    points, _ = surface(turned)
    np.testing.assert_allclose(np.ptp(points, axis=0), [0.6, 1.2, 0.7], atol=0.1)
    np.testing.assert_allclose(points.mean(axis=0), turned.box.center, atol=0.05)
    assert points[:, 0].max() < WALL_M


def test_a_few_milliseconds():
    points, spacing_m = surface(thing(3.0, 0.0, canonical=block((1, 1, 1)), size=(1, 1, 1)))
    view = frame(0)
    visibility(points, spacing_m, view)
    start = time.process_time()
    for _ in range(10):
        visibility(points, spacing_m, view)
    assert (time.process_time() - start) / 10 < 0.05
