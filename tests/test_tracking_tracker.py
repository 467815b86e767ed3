"""Online tracking: identities, states, confidence and their laws."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from composenet.config import TrackingConfig
from composenet.errors import SequenceError
from composenet.geometry.transform import make_T, rotation_z
from composenet.records import Box, Similarity, TrackState
from composenet.tracking.association import NO_SURFACE, elsewhere
from composenet.tracking.tracker import Tracker
from composenet.tracking.tracklet import FIRST_LOOK
from tracking_scenes import CHAIR, DESK, SIZE, TABLE, block, frame, screen, thing

CONFIG = TrackingConfig(min_confidence=0.0, keep_confidence=0.0)
AWAY, HIDE = frame(0, yaw=np.pi / 2), frame(0, [screen(1.5, 0.0)])
EMPTY = np.zeros((64, 64, 64), np.float32)


def run(stream, config=CONFIG, surface=NO_SURFACE):
    """Tracker and its outputs for a list of (Frame or None, estimates); frames are numbered."""
    tracker, outputs = Tracker(config), []
    for index, (view, estimates) in enumerate(stream):
        view = frame(0, [e.box for e in estimates]) if view is None else view
        outputs.append(tracker.update(replace(view, index=index), estimates, surface))
    return tracker, outputs


def ids_seen(output):
    return [entry.track_id for entry in output if entry.observed]


def seen_at(outputs):
    """For each frame the ids of what is seen, ordered by y."""
    return [
        [e.track_id for e in sorted(output, key=lambda e: e.box.center[1]) if e.observed]
        for output in outputs
    ]


def test_what_is_told_cannot_be_written_to():
    """Its arrays are the tracker's own."""
    tracker, outputs = run([(None, [thing(3, 0)]), (AWAY, [])])
    with pytest.raises(ValueError, match="read-only"):
        tracker.tracks()[0].canonical[:] = 0
    for (entry,) in outputs:
        S = entry.S_world_canonical
        for array in (entry.box.center, entry.box.extents, S.R, S.t, entry.extents_m):
            with pytest.raises(ValueError, match="read-only"):
                array += 1


def test_a_sliding_object_keeps_its_id():
    tracker, outputs = run([(None, [thing(3, 0.1 * step)]) for step in range(10)])
    assert seen_at(outputs) == [[1]] * 10
    (track,) = tracker.tracks()
    assert [entry.frame_index for entry in track.history] == list(range(10))
    assert {entry.state for entry in track.history} == {TrackState.TRACKED}
    # steps of 10 cm are within the noise of a box this size: followed, up to a step behind
    lag = [0.1 * entry.frame_index - entry.box.center[1] for entry in track.history]
    assert min(lag) >= -1e-9 and max(lag) <= 0.1


def test_a_still_object_is_averaged_and_a_long_step_is_followed_at_once():
    rng = np.random.default_rng(0)
    noisy = [(None, [thing(3 + e, 0)]) for e in 0.01 * rng.standard_normal(40)]
    _, outputs = run(noisy)
    places = np.array([out[0].box.center[0] for out in outputs[5:]])
    raw = np.array([e[0].box.center[0] for _, e in noisy[5:]])
    assert abs(places - 3).mean() < 0.75 * abs(raw - 3).mean()
    for out in outputs:  # pose and box move together
        np.testing.assert_allclose(out[0].S_world_canonical.t, out[0].box.center, atol=1e-9)
    _, outputs = run([*noisy, (None, [thing(3.3, 0)])])
    np.testing.assert_allclose(outputs[-1][0].box.center[0], 3.3)


def test_what_is_pushed_does_not_lag_behind():
    way = 3 + 0.08 * np.arange(12)
    _, outputs = run([(None, [thing(x, 0)]) for x in way])
    np.testing.assert_allclose([out[0].box.center[0] for out in outputs], way, atol=1e-9)


def test_two_crossing_objects_keep_their_ids():
    way = np.linspace(-1, 1, 17)
    stream = [(None, [thing(2.5, y), thing(3.2, -y)]) for y in way]
    _, outputs = run(stream)
    near = [next(e.track_id for e in out if e.box.center[0] == 2.5) for out in outputs]
    far = [next(e.track_id for e in out if e.box.center[0] == 3.2) for out in outputs]
    assert len(set(near)) == len(set(far)) == 1
    assert near[0] != far[0]


SEEN = (None, [thing(3, 0)])
T, H, L, R, E = (
    TrackState.TRACKED,
    TrackState.OCCLUDED,
    TrackState.LOST,
    TrackState.RE_FOUND,
    TrackState.ENDED,
)
SHORT = replace(CONFIG, end_after_frames=4, end_after_visible_misses=2)


@pytest.mark.parametrize(
    ("stream", "states"),
    [
        pytest.param([SEEN, SEEN], [T, T], id="tracked"),
        pytest.param([SEEN, (HIDE, [])], [T, H], id="hidden: occluded"),
        pytest.param([SEEN, (AWAY, [])], [T, H], id="out of view: occluded"),
        pytest.param([SEEN, (frame(0), [])], [T, L], id="place in view: lost"),
        pytest.param([SEEN, (HIDE, []), SEEN, SEEN], [T, H, R, T], id="occluded: re-found"),
        pytest.param([SEEN, (frame(0), []), SEEN, SEEN], [T, L, R, T], id="lost: re-found"),
        pytest.param([SEEN, (HIDE, []), (frame(0), [])], [T, H, L], id="occluded: lost"),
        pytest.param([SEEN, (frame(0), []), (HIDE, [])], [T, L, H], id="lost: occluded"),
        pytest.param([SEEN, (frame(0), []), (frame(0), [])], [T, L, E], id="lost: ended"),
        pytest.param([SEEN] + [(HIDE, [])] * 4, [T, H, H, H, E], id="occluded: ended"),
        pytest.param(
            [SEEN, (frame(0), []), SEEN, (frame(0), []), SEEN],
            [T, L, R, L, R],
            id="being seen forgives misses",
        ),
    ],
)
def test_states(stream, states):
    tracker, _ = run(stream, SHORT)
    (track,) = tracker.tracks()
    assert [entry.state for entry in track.history] == states
    assert [entry.observed for entry in track.history] == [s in (T, R) for s in states]


def test_an_ended_track_is_told_once_and_never_returns():
    gone = (frame(0), [])
    tracker, outputs = run([SEEN, gone, gone, gone, SEEN], SHORT)
    assert [[(e.track_id, e.state) for e in out] for out in outputs] == [
        [(1, T)],
        [(1, L)],
        [(1, E)],
        [],
        [(2, T)],
    ]
    assert [len(track.history) for track in tracker.tracks()] == [3, 1]
    assert tracker.tracks()[0].history[-1].confidence == 0


def test_an_unseen_track_keeps_its_last_pose():
    _, outputs = run([SEEN, (HIDE, [])])
    (before,), (after,) = outputs
    assert after.box == before.box
    assert after.S_world_canonical == before.S_world_canonical
    np.testing.assert_array_equal(after.extents_m, SIZE)


JUMP = [SEEN, (None, [thing(3, 0.6)])]


def test_a_jump_beyond_the_boxes_is_matched_by_shape():
    _, outputs = run(JUMP)
    assert seen_at(outputs) == [[1], [1]]
    assert outputs[1][0].state is T


def test_without_correspondences_the_jump_is_a_new_object():
    _, outputs = run(JUMP, replace(CONFIG, use_correspondences=False))
    assert seen_at(outputs) == [[1], [2]]


@pytest.mark.parametrize(
    ("second", "view"),
    [
        pytest.param(thing(3, 0.6, class_id=DESK), None, id="another class"),
        pytest.param(thing(3, 0.6, canonical=block(hollow=True)), None, id="another shape"),
        pytest.param(thing(3, 1.4), None, id="faster than furniture moves"),
        pytest.param(
            thing(3, 0.62),
            frame(0, [thing(3, 0).box, thing(3, 0.62).box]),
            id="the place still shows the object",
        ),
        pytest.param(
            thing(3, 0.58),
            frame(0, [thing(3, 0).box, thing(3, 0.58).box]),
            id="so it does where the boxes touch",
        ),
    ],
)
def test_no_match_by_shape(second, view):
    _, outputs = run([SEEN, (view, [second])])
    assert ids_seen(outputs[1]) == [2]


def test_elsewhere_is_where_neither_box_holds_the_centre_of_the_other():
    places = [thing(3, y).box for y in (0, 0.29, 0.31, 0.9)]
    grown = thing(3, 0.5, size=(0.6, 1.6, 0.9)).box
    np.testing.assert_array_equal(
        elsewhere(places[:1], [*places, grown]), [[False, False, True, True, False]]
    )
    np.testing.assert_array_equal(elsewhere([grown], places), elsewhere(places, [grown]).T)
    assert elsewhere([], places).shape == (0, 4) and elsewhere(places, []).shape == (4, 0)


def test_reach_grows_while_unseen_up_to_its_limit():
    for gap, ids in ((1, [2]), (4, [1])):
        _, outputs = run([SEEN] + [(AWAY, [])] * gap + [(None, [thing(3, 1.1)])])
        assert ids_seen(outputs[-1]) == ids
    for y, ids in ((1.1, [1]), (1.3, [2])):
        _, outputs = run([SEEN] + [(AWAY, [])] * 20 + [(None, [thing(3, y)])])
        assert ids_seen(outputs[-1]) == ids


def test_of_two_alike_the_nearer_is_re_matched():
    _, outputs = run([(None, [thing(3, 0)]), (AWAY, []), (None, [thing(3, 0.7), thing(3, -0.9)])])
    by_y = {e.box.center[1]: e.track_id for e in outputs[-1]}
    assert by_y == {0.7: 1, -0.9: 2}


def test_class_is_a_weighted_vote():
    classes = [(CHAIR, 1.0), (TABLE, 0.8), (TABLE, 0.8), (CHAIR, 0.7)]
    tracker, outputs = run([(None, [thing(3, 0, class_id=c, score=s)]) for c, s in classes])
    assert [out[0].class_id for out in outputs] == [CHAIR, CHAIR, TABLE, CHAIR]
    assert tracker.tracks()[0].class_id == CHAIR


def test_the_equal_class_is_preferred_among_overlapping_boxes():
    first = [thing(3, -0.15, class_id=CHAIR, score=0.9), thing(3, 0.15, class_id=TABLE, score=0.8)]
    second = [thing(3, 0.0, class_id=CHAIR, score=0.9), thing(3, 0.05, class_id=TABLE, score=0.8)]
    _, outputs = run([(None, first), (None, second)])
    assert [(e.track_id, e.class_id) for e in outputs[1]] == [(1, CHAIR), (2, TABLE)]


@pytest.mark.parametrize(
    ("second", "change", "ids"),
    [
        pytest.param({"y": 0.45}, {}, [1], id="of one class a little overlap is enough"),
        pytest.param({"y": 0.45}, {"same_class_iou_gate": 0.3}, [2], id="the paper's gate"),
        pytest.param({"y": 0.45, "class_id": DESK}, {}, [2], id="of another class it is not"),
        pytest.param({"y": 0.25, "class_id": DESK}, {}, [1], id="but much is"),
        pytest.param({"y": 0.61}, {"same_class_iou_gate": 0.0}, [2], id="none never is"),
    ],
)
def test_box_gate(second, change, ids):
    """An object of another shape than before, so that boxes alone can continue its track."""
    changed = thing(3, **second, canonical=block(hollow=True))
    _, outputs = run([SEEN, (None, [changed])], replace(CONFIG, **change))
    assert ids_seen(outputs[1]) == ids


def upright(y, n=100):
    """n points of surface on a vertical line in the middle of a thing at (3, y)."""
    return np.column_stack([np.full(n, 3.0), np.full(n, y), np.linspace(0.1, 0.8, n)])


@pytest.mark.parametrize(
    ("known", "y", "change", "ids"),
    [
        pytest.param(upright(0.2), 0.45, {}, [1], id="it was half a box off"),
        pytest.param(upright(0.12), 0.45, {}, [1], id="within the slack"),
        pytest.param(upright(0.0), 0.45, {}, [2], id="its neighbour: it still stands there"),
        pytest.param(upright(0.0, 40), 0.45, {}, [1], id="too little is known"),
        pytest.param(upright(0.9), 0.45, {}, [1], id="nothing is left where it stood"),
        pytest.param(upright(0.0), 0.45, {"kept_place_share": 0.0}, [1], id="the paper's way"),
        pytest.param(
            np.vstack([upright(0.0, 60), upright(0.2, 40)]), 0.45, {}, [1], id="enough is shared"
        ),
        pytest.param(
            np.vstack([upright(0.0, 80), upright(0.2, 20)]), 0.45, {}, [2], id="too little is"
        ),
        pytest.param(upright(-0.25), 0.25, {}, [1], id="much overlap asks for nothing"),
    ],
)
def test_a_track_does_not_leave_what_still_stands_in_its_place(known, y, change, ids):
    changed = thing(3, y, canonical=block(hollow=True))
    _, outputs = run([SEEN, (None, [changed])], replace(CONFIG, **change), known)
    assert ids_seen(outputs[1]) == ids


def test_duplicates_are_suppressed_and_weak_proposals_start_nothing():
    pair = [thing(3, 0, score=0.6), thing(3, 0.1, score=0.9)]
    _, outputs = run([(None, pair)])
    assert [e.confidence for e in outputs[0]] == [0.9 * FIRST_LOOK]
    weak, too_weak = (None, [thing(3, 0, score=0.45)]), (None, [thing(3, 0, score=0.25)])
    _, outputs = run([weak, SEEN, weak, too_weak])
    assert seen_at(outputs) == [[], [1], [1], []]


@pytest.mark.parametrize(("score", "y"), [(0.8, 0.0), (0.99, 0.3)])
def test_of_duplicates_the_one_in_a_tracks_place_counts_more(score, y):
    """A box that reaches over from a tracked chair to its neighbour must be much surer."""
    chair, reaching = thing(3, 0, score=0.65), thing(3, 0.3, score=score)
    _, outputs = run([(None, [thing(3, 0)]), (None, [chair, reaching])])
    (entry,) = outputs[1]
    assert entry.track_id == 1
    assert entry.box.center[1] == pytest.approx(y)


def test_canonical_model_is_the_running_mean():
    shapes = [block(), block(hollow=True), block()]
    tracker, _ = run([(None, [thing(3, 0, canonical=shape)]) for shape in shapes])
    expected = (4 * (4 * shapes[0] + shapes[1]) / 5 + shapes[2]) / 5
    np.testing.assert_allclose(tracker.tracks()[0].canonical, expected, atol=1e-6)


def test_an_unobservable_pose_keeps_rotation_shape_and_model():
    posed = thing(3, 0, size=(0.9, 0.6, 0.9), yaw=0.3)
    vague = thing(3, 0.2, canonical=EMPTY, observable=False)  # far enough not to be averaged
    tracker, outputs = run([(None, [posed]), (None, [vague])])
    (entry,) = outputs[1]
    np.testing.assert_array_equal(entry.S_world_canonical.R, rotation_z(0.3))
    np.testing.assert_allclose(entry.S_world_canonical.t, vague.box.center)
    np.testing.assert_array_equal(entry.extents_m, [0.9, 0.6, 0.9])
    np.testing.assert_array_equal(tracker.tracks()[0].canonical, posed.canonical)


def test_an_unobservable_pose_is_replaced_by_the_first_observable():
    vague, posed = thing(3, 0, canonical=EMPTY, observable=False), thing(3, 0, yaw=0.3)
    tracker, outputs = run([(None, [vague]), (None, [posed])])
    np.testing.assert_array_equal(outputs[1][0].S_world_canonical.R, rotation_z(0.3))
    np.testing.assert_array_equal(tracker.tracks()[0].canonical, posed.canonical)


@pytest.mark.parametrize("absence", [[(frame(0), [])] * 10, [(HIDE, [])] * 40])
def test_a_track_is_told_of_again_when_re_found(absence):
    """However far its confidence fell while it was away, but for a doubtful look."""
    seen, doubtful = [(None, [thing(3, 0, score=score)]) for score in (0.8, 0.5)]
    config = replace(TrackingConfig(), end_after_visible_misses=100)
    _, outputs = run([seen, seen, seen, *absence, seen, seen], config)
    assert outputs[-3][0].confidence < 0.4
    assert [[e.state for e in out] for out in outputs[-2:]] == [[R], [T]]
    _, outputs = run([seen, seen, seen, *absence, doubtful], config)
    assert outputs[-1] == ()


@pytest.mark.parametrize("stride", [1, 20])
def test_a_track_ends_after_as_many_frames_at_any_stride(stride):
    tracker = Tracker(SHORT)
    for step, (view, estimates) in enumerate([(frame(0), [thing(3, 0)])] + [(HIDE, [])] * 4):
        (entry,) = tracker.update(replace(view, index=step * stride), estimates)
    assert entry.state is E and len(tracker.tracks()[0].history) == 5


@pytest.mark.parametrize(
    ("scores", "told"),
    [
        ((0.9, 0.9, 0.9), [0, 1, 2]),
        ((0.65, 0.65, 0.65, 0.65), [1, 2, 3]),  # 0.59, 0.62, 0.63, 0.64
        ((0.6, 0.5, 0.5, 0.5, 0.5), []),
        ((0.9, 0.5, 0.5, 0.3), [0, 1, 2]),  # 0.81, 0.66, 0.58, 0.44
        ((0.9, 0.5, 0.4, 0.65, 0.7), [0, 1, 4]),  # 0.81, 0.66, 0.53, 0.59, 0.64
    ],
)
def test_a_track_is_told_of_while_it_is_sure(scores, told):
    """From a confidence of 0.6 on, until it is under 0.55."""
    config = TrackingConfig(min_confidence=0.6, keep_confidence=0.55)
    tracker, outputs = run([(None, [thing(3, 0, score=s)]) for s in scores], config)
    assert [index for index, out in enumerate(outputs) if out] == told
    assert [[e.frame_index for e in t.history] for t in tracker.tracks()] == [told] * bool(told)


def test_a_lower_bar_to_begin_with_is_a_lower_bar_to_stay():
    config = TrackingConfig(min_confidence=0.5, keep_confidence=0.7)
    _, outputs = run([(None, [thing(3, 0, score=0.6)])] * 5, config)
    assert all(outputs)


def test_what_ended_without_being_told_of_is_forgotten():
    """But for its number."""
    weak, sure = thing(3, 0, score=0.55), thing(3, 0, score=0.9)
    config = TrackingConfig(end_after_frames=2)
    hidden = [(HIDE, [])] * 3
    tracker, _ = run([(None, [weak]), *hidden, (None, [sure]), *hidden], config)
    (kept,) = tracker._tracklets
    (track,) = tracker.tracks()
    assert kept.track_id == track.track_id == 2


def test_looked_at_twice_everything_is_known_from_the_start():
    """A chair found in the third of five frames keeps its id on the way back and is told of in all
    of them, also in the first two, in which it was too faint to be found."""
    shown = [[thing(3, 0, score=score)] for score in (0.4, 0.4, 0.6, 0.9, 0.7)]
    shown[-1].append(thing(3, 1.5, class_id=TABLE))
    tracker, outputs = run([(None, estimates) for estimates in shown])
    assert ids_seen(outputs[0]) == [] and ids_seen(outputs[-1]) == [1, 2]
    tracker.turn_back()
    for index in reversed(range(5)):
        tracker.update(frame(index, [e.box for e in shown[index]]), shown[index])
    chairs, tables = tracker.tracks()
    assert [e.frame_index for e in chairs.history] == [0, 1, 2, 3, 4] and chairs.track_id == 1
    assert {e.state for e in chairs.history} == {T}
    assert [e.frame_index for e in tables.history] == [4]  # never seen before


def test_offline_tracks_are_linked_over_the_whole_recording():
    """A chair that is overlooked until its track has ended has two identities online, and one when
    looking back."""
    config = replace(CONFIG, end_after_visible_misses=2)
    empty = (frame(0), [])
    stream = [SEEN, SEEN, empty, empty, empty, SEEN, SEEN]
    tracker, _ = run(stream, config)
    assert [t.track_id for t in tracker.tracks()] == [1, 2]  # ended in between
    tracker, _ = run(stream, replace(config, offline=True))
    (chair,) = tracker.tracks()
    assert [e.frame_index for e in chair.history if e.observed] == [0, 1, 5, 6]


@pytest.mark.parametrize("use_correspondences", [True, False])
@pytest.mark.parametrize("company", [True, False])
def test_looking_back_leaves_no_gaps(company, use_correspondences):
    """A chair that two frames show with less confidence was there, whatever else there is."""
    scores = (0.9, 0.9, 0.9, 0.4, 0.4, 0.9, 0.9)
    table = [thing(3, 2.0, class_id=TABLE)] if company else []
    stream = [(None, [thing(3, 0, score=score), *table]) for score in scores]
    online = TrackingConfig(use_correspondences=use_correspondences)
    tracker, _ = run(stream, online)
    assert [e.frame_index for e in tracker.tracks()[0].history] == [0, 1, 2, 5, 6]
    tracker, _ = run(stream, replace(online, offline=True))
    chair = tracker.tracks()[0]
    assert [e.frame_index for e in chair.history] == list(range(7))
    assert all(e.observed and e.state is T for e in chair.history)


@pytest.mark.parametrize("gone", [20, 29])
def test_on_the_way_back_no_frame_is_missed_twice(gone):
    """A chair that the last frames do not show is the same on the way back, and the longer it has
    been unseen the less sure it is."""
    stream = [SEEN] * 5 + [(frame(0), [])] * gone
    tracker, _ = run(stream, replace(CONFIG, offline=True))
    tracker.turn_back()
    for index, (view, estimates) in reversed(list(enumerate(stream))):
        tracker.update(
            replace(view or frame(index, [e.box for e in estimates]), index=index), estimates
        )
    (chair,) = tracker.tracks()
    assert chair.track_id == 1
    assert [e.frame_index for e in chair.history if e.observed] == [0, 1, 2, 3, 4]
    unseen = [e.confidence for e in chair.history if not e.observed]
    assert len(unseen) == gone
    np.testing.assert_allclose(np.divide(unseen[1:], unseen[:-1]), CONFIG.lost_decay)


def looked_back(stream, back, config=CONFIG):
    """Tracks of a list of (Frame, estimates), looked at backwards with other estimates."""
    tracker, _ = run(stream, replace(config, offline=True))
    tracker.turn_back()
    for index, (view, _) in reversed(list(enumerate(stream))):
        tracker.update(replace(view, index=index), back[index])
    return tracker.tracks()


def seen_by(track):
    return [entry.frame_index for entry in track.history if entry.observed]


GONE = (AWAY, [])


def test_what_was_known_on_the_way_there_is_known_on_the_way_back():
    """A chair that comes back elsewhere keeps its id by its shape. Seen backwards its shape at
    first says nothing, but that frame showed it there."""
    here, there = [thing(3, -0.5)], [thing(3, 0.5)]
    at = [(frame(0, [e.box for e in shown]), shown) for shown in (here, there)]
    stream = [at[0]] * 4 + [GONE] * 3 + [at[1]] * 4
    back = [[thing(3, -0.5, canonical=EMPTY)]] * 4 + [[]] * 3 + [there] * 4
    (chair,) = looked_back(stream, back)
    assert chair.track_id == 1 and seen_by(chair) == [0, 1, 2, 3, 7, 8, 9, 10]
    back[:4] = [[thing(3, -0.5, class_id=TABLE)]] * 4  # which is not what that frame showed
    assert [seen_by(track) for track in looked_back(stream, back)] == [[7, 8, 9, 10], [0, 1, 2, 3]]


def test_what_stays_in_its_place_on_the_way_back_was_there():
    """The track of a chair that is out of view goes over to another one like it, and the chair gets
    a new one. On the way back each is where it last was, whoever was there before."""
    near, far = thing(3, -0.4), thing(3, 0.4)
    both = frame(0, [near.box, far.box])
    stream = [(both, [far])] * 4 + [GONE] * 3 + [(AWAY, [near])] * 4 + [(both, [near, far])] * 2
    assert seen_at(run(stream)[1]) == [[1]] * 4 + [[]] * 3 + [[1]] * 4 + [[1, 2]] * 2
    tracks = looked_back(stream, [[near, far]] * 4 + [[]] * 3 + [[near, far]] * 6)
    assert len(tracks) == 2
    for track in tracks:
        assert seen_by(track) == [0, 1, 2, 3, 7, 8, 9, 10, 11, 12]
        assert len({tuple(e.box.center.round(3)) for e in track.history}) == 1


def test_what_ended_up_in_a_place_does_not_take_what_was_there_before():
    """A chair moves, and once something is taken for a chair where it was, but not when looked at
    again."""
    here, there = thing(3, -0.5), thing(3, 0.5)
    views = [frame(0, [thing.box]) for thing in (here, there)]
    late = [(views[1], [there])] * 4
    late[1] = (views[1], [there, here])
    stream = [(views[0], [here])] * 4 + [GONE] * 3 + late
    assert seen_at(run(stream)[1])[8] == [2, 1]
    (chair,) = looked_back(stream, [[here]] * 4 + [[]] * 3 + [[there]] * 4)
    assert chair.track_id == 1 and seen_by(chair) == [0, 1, 2, 3, 7, 8, 9, 10]


def test_a_track_is_found_where_it_was_last_before_the_first_pass_had_lost_it():
    stream = [SEEN] * 4 + [(frame(0), [])] * 2
    stream = [(view or frame(0, [thing(3, 0).box]), shown) for view, shown in stream]
    back = [[thing(3, 0)]] * 4 + [[thing(3, 0, canonical=EMPTY)]] * 2
    (chair,) = looked_back(stream, back)
    assert chair.track_id == 1 and seen_by(chair) == [0, 1, 2, 3, 4, 5]


def test_a_track_that_frames_to_come_have_shown_does_not_end_on_the_way_back():
    here, there = thing(3, -0.9), thing(3, 0.9)
    views = [frame(0, [here.box]), frame(0, [there.box]), frame(0)]
    config = replace(CONFIG, end_after_visible_misses=3, reach_slack_m=2.0, max_reach_m=3.0)
    stream = [(views[0], [here])] * 3 + [GONE] + [(views[1], [there])] * 3
    back = [[thing(3, -0.9, canonical=EMPTY)]] + [[]] * 5 + [[there]]
    (chair,) = looked_back(stream, back, config)
    assert seen_by(chair) == [0, 6] and chair.history[-1].state is not E


def test_twice_is_enough_and_backwards_means_backwards():
    tracker, _ = run([SEEN, SEEN, SEEN])
    tracker.turn_back()
    with pytest.raises(SequenceError, match="twice at most"):
        tracker.turn_back()
    for index in (2, 1):
        tracker.update(frame(index), [])
    for index in (1, 2):
        with pytest.raises(SequenceError, match="backwards"):
            tracker.update(frame(index), [])


def test_a_sure_track_is_told_of_while_it_is_unseen():
    _, outputs = run([SEEN, SEEN, (HIDE, []), (HIDE, []), (frame(0), [])], TrackingConfig())
    assert [len(out) for out in outputs] == [1] * 5
    assert not outputs[-1][0].observed


def test_confidence_grows_with_hits_and_decays_while_unseen():
    stream = [SEEN] * 3 + [(HIDE, [])] * 2 + [(frame(0), [])] * 2 + [SEEN]
    _, outputs = run(stream)
    values = [out[0].confidence for out in outputs]
    seen = [0.9 * (1 - (1 - FIRST_LOOK) * 0.5**hits) for hits in (0, 1, 2)]
    unseen = [seen[-1] * factor for factor in (0.98, 0.98**2, 0.98**2 * 0.9, 0.98**2 * 0.81)]
    np.testing.assert_allclose(values, [*seen, *unseen, FIRST_LOOK * 0.9], rtol=1e-6)


def test_boxes_are_those_of_living_tracks_sure_or_not():
    config = TrackingConfig(end_after_visible_misses=2)
    tracker = Tracker(config)
    tracker.update(frame(0), [thing(3, 0, score=0.7)])
    assert not tracker.tracks()
    (box,) = tracker.boxes
    np.testing.assert_allclose(box.center[:2], [3, 0])
    for index in (1, 2):
        tracker.update(frame(index), [])
    assert tracker.boxes == ()


def test_frames_must_come_in_order():
    tracker = Tracker()
    tracker.update(frame(3), [])
    with pytest.raises(SequenceError, match="frame 3 came after frame 3"):
        tracker.update(frame(3), [])


def test_two_trackers_are_independent():
    first, second = Tracker(CONFIG), Tracker(CONFIG)
    assert ids_seen(first.update(frame(0), [thing(3, 0)])) == [1]
    assert ids_seen(second.update(frame(0), [thing(3, 0), thing(3, 1.5)])) == [1, 2]
    assert len(first.tracks()) == 1


def test_outputs_never_change_with_later_frames():
    stream = [SEEN, (HIDE, []), (None, [thing(3, 0.2), thing(2, 1.0)]), (frame(0), []), SEEN]
    tracker, whole = run(stream)
    for length in range(1, len(stream)):
        _, part = run(stream[:length])
        assert [[(e.track_id, e.state, e.confidence) for e in out] for out in part] == [
            [(e.track_id, e.state, e.confidence) for e in out] for out in whole[:length]
        ]
    by_frame = {(e.frame_index, e.track_id): e for t in tracker.tracks() for e in t.history}
    assert all(by_frame[e.frame_index, e.track_id] is e for out in whole for e in out)


def moved(estimate, R, t):
    """The estimate in another world frame; R turns by a multiple of 90 degrees about z."""
    S = estimate.S_world_canonical
    box = Box(R @ estimate.box.center + t, np.abs(R) @ estimate.box.extents)
    return replace(estimate, box=box, S_world_canonical=Similarity(S.scale_m, R @ S.R, R @ S.t + t))


steps = st.integers(-60, 60).map(lambda step: 0.0371 * step)  # no overlap exactly at a gate
objects = st.builds(
    thing,
    steps.map(lambda step: 3.2 + 0.7 * step),
    steps,
    class_id=st.sampled_from([CHAIR, TABLE]),
    score=st.floats(0, 1),
    size=st.sampled_from([(0.6, 0.6, 0.9), (1.4, 0.8, 0.7)]),
    yaw=st.floats(0, 3),
    observable=st.booleans(),
)
streams = st.lists(
    st.tuples(
        st.sampled_from([frame(0), AWAY, HIDE]),
        st.lists(objects, max_size=4, unique_by=lambda e: e.score),
    ),
    max_size=8,
)


def summary(outputs):
    return [[(e.track_id, e.class_id, e.state) for e in out] for out in outputs]


@settings(max_examples=40)
@given(streams, st.randoms(use_true_random=False))
def test_the_order_of_estimates_does_not_matter(stream, random):
    shuffled = [(view, random.sample(found, len(found))) for view, found in stream]
    assert summary(run(stream)[1]) == summary(run(shuffled)[1])


@settings(max_examples=40)
@given(streams, st.integers(0, 3), st.floats(-5, 5))
def test_the_choice_of_world_frame_does_not_matter(stream, turns, shift):
    R, t = np.round(rotation_z(turns * np.pi / 2)), np.array([shift, -2 * shift, 0.5 * shift])
    other = [
        (
            replace(view, T_world_camera=make_T(R, t) @ view.T_world_camera),
            [moved(estimate, R, t) for estimate in found],
        )
        for view, found in stream
    ]
    assert summary(run(stream)[1]) == summary(run(other)[1])


@settings(max_examples=60)
@given(streams)
def test_any_stream_keeps_the_laws(stream):
    tracker, outputs = run(stream, SHORT)
    ended: set[int] = set()
    for (_, found), output in zip(stream, outputs, strict=True):
        ids = [entry.track_id for entry in output]
        assert ids == sorted(set(ids))
        assert not ended & set(ids)
        assert sum(entry.observed for entry in output) <= len(found)
        ended |= {entry.track_id for entry in output if entry.state is E}
        for entry in output:
            assert 0 <= entry.confidence <= 1
            assert entry.observed == (entry.state in (T, R))
    for track in tracker.tracks():
        indices = [entry.frame_index for entry in track.history]
        assert indices == list(range(indices[0], indices[0] + len(indices)))
        assert [e.state for e in track.history[:-1]].count(E) == 0
