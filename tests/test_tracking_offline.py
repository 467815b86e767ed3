"""The paper's second pass over whole sequences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from composenet.config import TrackingConfig
from composenet.records import Track, TrackedObject, TrackState
from composenet.tracking.offline import in_order_of_time, link_offline
from tracking_scenes import CHAIR, TABLE, block, thing

CONFIG = TrackingConfig()
FRAMES = range(20)
LETTERS = {
    "T": TrackState.TRACKED,
    "O": TrackState.OCCLUDED,
    "L": TrackState.LOST,
    "R": TrackState.RE_FOUND,
    "E": TrackState.ENDED,
}


def track(
    track_id: int,
    states: str,
    y: float = 0.0,
    class_id: int = CHAIR,
    canonical: np.ndarray | None = None,
) -> Track:
    """A track at (3, y) with one letter a frame, first frame first; a dot: not yet born."""
    estimate = thing(3, y)
    history = tuple(
        TrackedObject(
            track_id=track_id,
            frame_index=index,
            class_id=class_id,
            state=LETTERS[letter],
            confidence=0.5,
            box=estimate.box,
            S_world_canonical=estimate.S_world_canonical,
            extents_m=estimate.extents_m,
            observed=letter in "TR",
        )
        for index, letter in enumerate(states)
        if letter != "."
    )
    return Track(track_id, class_id, history, block() if canonical is None else canonical)


def letters(linked: Track) -> str:
    names = {state: letter for letter, state in LETTERS.items()}
    start = linked.history[0].frame_index
    return "." * start + "".join(names[entry.state] for entry in linked.history)


@pytest.mark.parametrize(
    ("tracks", "expected"),
    [
        pytest.param(
            [track(1, "TTLL"), track(2, "..TT", y=0.6)],
            {1: "TTTT"},
            id="one after the other, the second at once",
        ),
        pytest.param(
            [track(1, "TTLLL"), track(2, "...TT", y=0.6)],
            {1: "TTLRT"},
            id="with an absence between",
        ),
        pytest.param(
            [track(1, "TTLE"), track(2, "....TLE")],
            {1: "TTLLRLE"},
            id="the first had ended, the second ends",
        ),
        pytest.param(
            [track(1, "TT"), track(2, "....TT")],
            {1: "TTOORT"},
            id="nobody looked between the two",
        ),
        pytest.param(
            [track(1, "TTLRT"), track(2, "..TLLL")],
            {1: "TTTTT"},
            id="a single proposal fills a gap",
        ),
        pytest.param(
            [track(1, "TLLLLL"), track(2, "..TLLL"), track(3, "....TT")],
            {1: "TLRLRT"},
            id="three in a chain",
        ),
        pytest.param(
            [track(1, "TTT"), track(2, "..T", y=1.0)],
            {1: "TTT", 2: "..T"},
            id="seen together: two objects",
        ),
        pytest.param(
            [track(1, "TTLL"), track(2, "..TT", class_id=TABLE)],
            {1: "TTLL", 2: "..TT"},
            id="another class",
        ),
        pytest.param(
            [track(1, "TTLL"), track(2, "..TT", canonical=block(hollow=True))],
            {1: "TTLL", 2: "..TT"},
            id="another shape",
        ),
        pytest.param(
            [track(1, "TTLL"), track(2, "..TT", y=2.5)],
            {1: "TTLL", 2: "..TT"},
            id="faster than furniture moves",
        ),
        pytest.param(
            [track(1, "TTLLL"), track(2, "TTLLL", y=1.0), track(3, "..TTT", canonical=block())],
            {1: "TTTTT", 2: "TTLLL"},
            id="one heir for two",
        ),
        pytest.param([], {}, id="nothing"),
    ],
)
def test_linking_table(tracks: Sequence[Track], expected: dict[int, str]):
    linked = link_offline(tracks, FRAMES, CONFIG)
    assert {one.track_id: letters(one) for one in linked} == expected
    for one in linked:
        assert {entry.track_id for entry in one.history} == {one.track_id}
        frames = [entry.frame_index for entry in one.history]
        assert frames == list(range(frames[0], frames[-1] + 1))


def test_confidence_falls_where_nobody_looked():
    (linked,) = link_offline([track(1, "TT"), track(2, "....TT")], FRAMES, CONFIG)
    gap = [0.5 * CONFIG.occluded_decay, 0.5 * CONFIG.occluded_decay**2]
    assert [e.confidence for e in linked.history] == pytest.approx([0.5, 0.5, *gap, 0.5, 0.5])


def test_poses_and_model_of_a_merged_track():
    solid, grown = block(), block((0.6, 0.6, 1.2))
    first, second = track(1, "TTTLL"), track(2, "....T", y=0.6, canonical=grown)
    (linked,) = link_offline([first, second], FRAMES, CONFIG)
    ys = [entry.box.center[1] for entry in linked.history]
    np.testing.assert_allclose(ys, [0, 0, 0, 0, 0.6])
    np.testing.assert_allclose(linked.canonical, (3 * solid + grown) / 4, atol=1e-6)


def test_the_likest_pair_is_linked():
    grown = block((0.6, 0.6, 1.2))
    old = [track(1, "TLLL"), track(2, "TLLL", y=0.5, canonical=grown)]
    new = [track(3, "..TT", y=0.5), track(4, "..TT", y=0.0, canonical=grown)]
    linked = link_offline(old + new, FRAMES, CONFIG)
    ys = {one.track_id: [entry.box.center[1] for entry in one.history] for one in linked}
    assert ys == {1: [0, 0, 0.5, 0.5], 2: [0.5, 0.5, 0, 0]}


def test_without_correspondences_nothing_is_linked():
    tracks = (track(1, "TTLL"), track(2, "..TT"))
    assert link_offline(tracks, FRAMES, replace(CONFIG, use_correspondences=False)) == tracks


@pytest.mark.parametrize("use_correspondences", [True, False])
def test_in_hindsight_every_entry_has_the_class_of_its_track(use_correspondences: bool):
    one = track(1, "TTTT")
    doubtful = replace(one.history[0], class_id=TABLE)
    one = replace(one, history=(doubtful, *one.history[1:]))
    config = replace(CONFIG, use_correspondences=use_correspondences)
    (linked,) = link_offline([one], FRAMES, config)
    assert {entry.class_id for entry in linked.history} == {one.class_id} != {TABLE}


@pytest.mark.parametrize(
    ("looked_at_backwards", "told"),
    [
        ("TTTT", "TTTT"),
        ("OOTLLRTT", "TTTLLROO"),  # in both, the last two frames do not show it
        ("TTRLE", "..TTT"),  # gone in the two earliest frames: not yet seen
        ("RLT", "TLR"),
        ("OO", ""),
    ],
)
def test_a_track_looked_at_backwards_reads_forwards(looked_at_backwards, told):
    found = track(1, looked_at_backwards)
    last = len(found.history) - 1
    turned = tuple(replace(e, frame_index=last - e.frame_index) for e in found.history)
    read = in_order_of_time(replace(found, history=turned), CONFIG)
    assert letters(read) if told else not read.history
    if told:
        assert letters(read) == told
    boxes = {e.frame_index: e.box for e in turned}
    assert all(entry.box is boxes[entry.frame_index] for entry in read.history)


def test_looking_back_an_object_stays_where_the_last_frame_in_time_shows_it():
    """The first frames looked at on the way back have it where the way there left it."""
    found, there = track(1, "OLTOT"), track(1, "OLTOT", y=2.0)
    entries = (*there.history[:2], *found.history[2:])
    turned = tuple(replace(e, frame_index=4 - e.frame_index) for e in entries)
    read = in_order_of_time(replace(found, history=turned), CONFIG)
    assert letters(read) == "TORLO"
    for entry in read.history:
        assert entry.box is found.history[0].box
        assert entry.S_world_canonical is found.history[0].S_world_canonical


def test_the_whole_track_has_its_final_class():
    original = track(1, "TT")
    early = (replace(original.history[0], class_id=TABLE), original.history[1])
    (linked,) = link_offline([replace(original, history=early)], FRAMES, CONFIG)
    assert [entry.class_id for entry in linked.history] == [CHAIR, CHAIR]


tracks_of_one_frame_each = st.lists(
    st.tuples(st.integers(0, 6), st.sampled_from("TLO"), st.integers(-4, 4)), max_size=7
)


@settings(max_examples=50)
@given(tracks_of_one_frame_each)
def test_no_observation_is_lost_or_made_and_none_are_simultaneous(births):
    tracks = [
        track(number, "." * start + "T" + then * 2, y=0.5 * place)
        for number, (start, then, place) in enumerate(sorted(births), start=1)
    ]
    linked = link_offline(tracks, FRAMES, CONFIG)
    seen = sorted(
        (entry.frame_index, entry.box.center[1])
        for one in tracks
        for entry in one.history
        if entry.observed
    )
    kept = [[(e.frame_index, e.box.center[1]) for e in one.history if e.observed] for one in linked]
    assert sorted(pair for part in kept for pair in part) == seen
    assert all(len({frame for frame, _ in part}) == len(part) for part in kept)
    assert {one.track_id for one in linked} <= {one.track_id for one in tracks}
    assert [one.history for one in link_offline(linked, FRAMES, CONFIG)] == [
        one.history for one in linked
    ]
