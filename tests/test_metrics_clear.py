"""CLEAR MOT: hand-checkable tables, published vectors, a slow reference, laws."""

import itertools
import json
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest

from composenet.metrics.clear import (
    ClearScores,
    Convention,
    FrameErrors,
    clear_mot,
    drop_ignored,
    frame_errors,
)
from composenet.metrics.hota import hota_scores
from composenet.metrics.identity import identity_scores
from composenet.metrics.records import FrameEvaluation, TrackingFrame
from metric_cases import frame, line, random_frames

SHARED = Path(__file__).resolve().parents[2] / "shared" / "vectors"
BOTH = list(Convention)


TABLE = {  # name: gt, tracks, tp fn fp idsw frag mt pt ml
    "perfect": ("AAAA", "aaaa", (4, 0, 0, 0, 0, 1, 0, 0)),
    "nothing found": ("AAAA", "....", (0, 4, 0, 0, 0, 0, 0, 1)),
    "nothing there": ("....", "aaaa", (0, 0, 4, 0, 0, 0, 0, 0)),
    "empty": ("....", "....", (0, 0, 0, 0, 0, 0, 0, 0)),
    "one drop": ("AAAA/BBBB", "a.aa/bbbb", (7, 1, 0, 0, 1, 1, 1, 0)),
    "first three dropped": ("AAAA", "...a", (1, 3, 0, 0, 0, 0, 1, 0)),
    "switch for one frame": ("AAAA", "aaba", (4, 0, 0, 2, 0, 1, 0, 0)),
    "switch after a gap": ("AAAAA", "aa.bb", (4, 1, 0, 1, None, None, None, 0)),
    "same id after a gap": ("AAA/BBB", "a.a/bbb", (5, 1, 0, 0, 1, 1, 1, 0)),
    "truth leaves, track stays": ("A.AA", "aaaa", (3, 0, 1, 0, 0, 1, 0, 0)),
    "two swap": ("AAAA/BBBB", "aabb/bbaa", (8, 0, 0, 2, 0, 2, 0, 0)),
    "one of two lost": ("AAAAAA/BBBBBB", "aaaaaa/b.....", (7, 5, 0, 0, 0, 1, 0, 1)),
    "wrong place": ("AA/..", "../aa", (0, 2, 2, 0, 0, 0, 0, 1)),
}


@pytest.mark.parametrize("convention", BOTH)
@pytest.mark.parametrize("name", TABLE)
def test_counts(name, convention):
    gts, tracks, expected = TABLE[name]
    score = clear_mot(line(gts, tracks), convention=convention)
    found = (
        score.tp,
        score.fn,
        score.fp,
        score.id_switches,
        score.fragmentations,
        score.mostly_tracked,
        score.partly_tracked,
        score.mostly_lost,
    )
    assert [f for f, e in zip(found, expected, strict=True) if e is not None] == [
        e for e in expected if e is not None
    ]


def test_where_the_conventions_differ():
    absent = line("AA.AA/BBBBB", "aa.aa/bbbbb")  # the truth is away: interrupted or not?
    assert clear_mot(absent).fragmentations == 1
    assert clear_mot(absent, convention=Convention.MOTMETRICS).fragmentations == 0
    four_of_five = line("AAAAA/BBBBB", "aaaa./bbbbb")
    assert clear_mot(four_of_five).mostly_tracked == 1
    assert clear_mot(four_of_five, convention=Convention.MOTMETRICS).mostly_tracked == 2
    returns = [  # track 1 had A, was gone for a frame, returns beside 2, which is nearer
        frame([0], [1], [[0.0]]),
        frame([0], [9], [[np.inf]]),
        frame([0], [1, 2], [[0.2, 0.1]]),
    ]
    assert clear_mot(returns).id_switches == 1
    assert clear_mot(returns, convention=Convention.MOTMETRICS).id_switches == 0


@pytest.mark.parametrize("convention", BOTH)
def test_known_correspondence_wins_over_nearer_track(convention):
    frames = [frame([0], [1], [[0.0]]), frame([0], [1, 2], [[0.24, 0.01]])]
    score = clear_mot(frames, convention=convention)
    assert (score.tp, score.fp, score.id_switches) == (2, 1, 0)
    assert score.motp_cm == pytest.approx(12)
    out_of_gate = [frames[0], frame([0], [1, 2], [[0.25, 0.01]])]  # under 25 cm, not at it
    assert clear_mot(out_of_gate, convention=convention).id_switches == 1


def test_mota_of_counts():
    assert ClearScores(tp=6, fn=4, fp=1, id_switches=2).mota == pytest.approx(0.3)
    assert ClearScores(tp=1, fn=1, fp=9).mota == pytest.approx(-4)
    assert np.isnan(ClearScores(fp=3).mota)
    total = ClearScores(tp=1, fn=1, distance_sum_m=0.1) + ClearScores(
        tp=1, fp=2, distance_sum_m=0.2
    )
    assert (total.truths, total.mota, total.motp_cm) == (3, pytest.approx(0), pytest.approx(15))


def published(similarity, gt_present, tracker_present) -> list[TrackingFrame]:
    frames = []
    for s, g, p in zip(similarity, gt_present, tracker_present, strict=True):
        rows, columns = np.flatnonzero(g), np.flatnonzero(p)
        distance = 0.5 * (1 - np.array(s, dtype=float)[np.ix_(rows, columns)])
        frames.append(TrackingFrame(rows, columns, distance))
    return frames


NONE, LOWER, UPPER = [[0, 0], [0, 0]], [[0, 0], [1, 0]], [[0, 1], [0, 0]]
PRESENT = ([[1, 1]] * 3 + [[1, 0]] * 2, [[1, 1]] * 4 + [[0, 1]])
TRACKEVAL = {  # TrackEval's tests/test_metrics.py; HOTA from TrackEval 1.3.0
    "no confusion": (
        published([LOWER, LOWER, NONE, UPPER, UPPER], *PRESENT),
        (4, 4, 5, 0),
        (4, 4, 5),
        0.31622776601683794,
    ),
    "with confusion": (
        published([LOWER, [[0, 0], [1, 1]], [[1, 0], [0, 0]], UPPER, UPPER], *PRESENT),
        (5, 3, 4, 1),
        (4, 4, 5),
        0.3446012188022555,
    ),
}


@pytest.mark.parametrize("name", TRACKEVAL)
def test_published_cases(name):
    frames, clear, identity, hota = TRACKEVAL[name]
    score, ids = clear_mot(frames), identity_scores(frames)
    assert (score.tp, score.fn, score.fp, score.id_switches) == clear
    assert (ids.idtp, ids.idfn, ids.idfp) == identity
    assert hota_scores(frames).hota == pytest.approx(hota, abs=1e-15)


def test_published_file():
    if not (SHARED / "trackeval_vectors.json").exists():
        pytest.skip("shared/vectors is not beside this checkout")
    vectors = json.loads((SHARED / "trackeval_vectors.json").read_text())["vectors"]
    for name, vector in vectors.items():
        data = vector["input"]
        frames = published(data["similarity"], data["gt_present"], data["tracker_present"])
        clear, ids, hota = clear_mot(frames), identity_scores(frames), hota_scores(frames)
        expected = vector["expected_clear"]
        assert clear.tp == expected["CLR_TP"], name
        assert clear.fn == expected["CLR_FN"]
        assert clear.fp == expected["CLR_FP"]
        assert clear.id_switches == expected["IDSW"]
        assert clear.mota == pytest.approx(expected["MOTA"], abs=1e-15)
        expected = vector["expected_identity"]
        assert (ids.idtp, ids.idfn, ids.idfp) == tuple(
            expected[key] for key in ("IDTP", "IDFN", "IDFP")
        )
        assert (ids.idr, ids.idp, ids.idf1) == pytest.approx(
            [expected[key] for key in ("IDR", "IDP", "IDF1")], abs=1e-15
        )
        expected = vector["hota_from_trackeval_1_3_0"]
        assert (hota.hota, hota.det_a, hota.ass_a, hota.loc_a) == pytest.approx(
            [expected[key] for key in ("HOTA", "DetA", "AssA", "LocA")], abs=1e-15
        )


def scenario_frames(case) -> list[TrackingFrame]:
    """nuScenes' centre-distance scenarios: one object at rest over 4 frames unless placed."""
    if "pos_gt" in case:
        gts, predictions = np.array(case["pos_gt"]), np.array(case["pos_pred"])
        return [
            frame(
                [0], range(len(predictions)), np.linalg.norm(gts[0, t] - predictions[:, t], axis=1)
            )
            for t in range(gts.shape[1])
        ]
    ids = case.get("pred_ids", ["ta"] * 4)
    gt = "".join("A" if t in case.get("gt", range(4)) else "." for t in range(4))
    seen = case.get("pred_frames", range(4))
    return line(gt, "".join(ids[t][1] if t in seen else "." for t in range(4)))


def test_centre_distance_scenarios():
    """Where TP excludes switched frames there, it includes them here."""
    if not (SHARED / "nuscenes_scenarios.json").exists():
        pytest.skip("shared/vectors is not beside this checkout")
    scenarios = json.loads((SHARED / "nuscenes_scenarios.json").read_text())["scenarios"]
    for case in scenarios:
        if case["name"] == "crossing":  # random positions
            continue
        score = clear_mot(scenario_frames(case), gate_m=2.0, convention=Convention.MOTMETRICS)
        expected = case["expected"]
        assert score.id_switches == expected["ids"], case["name"]
        if "tp" in expected:
            assert score.tp == expected["tp"] + expected["ids"]
            assert (score.fp, score.fn) == (expected["fp"], expected["fn"])
            assert score.fragmentations == expected["frag"]


def slow_counts(frames, gate):
    """CLEAR MOT by trying every assignment of a frame; TRACKEVAL's objective."""
    previous, last, tp, switches = {}, {}, 0, 0
    for f in frames:
        gts, tracks = f.gt_ids.tolist(), f.track_ids.tolist()
        best, best_value = [], -1.0
        slots = [*range(len(tracks)), *[None] * len(gts)]
        for choice in set(itertools.permutations(slots, len(gts))):
            pairs = [
                (g, tracks[c], f.distance_m[i, c])
                for i, (g, c) in enumerate(zip(gts, choice, strict=True))
                if c is not None and f.distance_m[i, c] < gate
            ]
            value = sum(1 - d / (2 * gate) + 1000 * (previous.get(g) == p) for g, p, d in pairs)
            if value > best_value:
                best, best_value = pairs, value
        tp += len(best)
        switches += sum(g in last and last[g] != p for g, p, _ in best)
        if gts and tracks:
            previous = {g: p for g, p, _ in best}
        last.update(previous)
    return tp, switches


@pytest.mark.parametrize("seed", range(15))
def test_against_every_assignment(seed):
    frames = random_frames(np.random.default_rng(seed), objects=3, tracks=3)
    score = clear_mot(frames)
    assert (score.tp, score.id_switches) == slow_counts(frames, 0.25)


def test_errors_of_single_frames():
    frames = line("AAA./BBBB", "aab./.b.b")
    a, b, c = ord("A"), ord("B"), ord("b")
    assert frame_errors(frames) == [
        FrameErrors((b,), (), ()),
        FrameErrors((), (), ()),
        FrameErrors((b,), (), (a,)),
        FrameErrors((), (), ()),
    ]
    beside = [frame([0], [1, 2], [[0.1, 0.2]]), frame([], [c], [])]
    assert frame_errors(beside) == [FrameErrors((), (2,), ()), FrameErrors((), (c,), ())]


@pytest.mark.parametrize("seed", range(5))
def test_errors_of_frames_add_up(seed):
    frames = random_frames(np.random.default_rng(seed))
    score, errors = clear_mot(frames), frame_errors(frames)
    kinds = [(len(e.missed), len(e.false), len(e.switched)) for e in errors]
    totals = (score.fn, score.fp, score.id_switches)
    assert tuple(sum(column) for column in zip(*kinds, strict=True)) == totals
    assert sum(e.count for e in errors) == sum(totals)


@pytest.mark.parametrize("convention", BOTH)
@pytest.mark.parametrize("seed", range(5))
def test_names_change_nothing(seed, convention):
    rng = np.random.default_rng(seed)
    frames = random_frames(rng)
    gt, track = rng.permutation(100), rng.permutation(100)
    renamed = [TrackingFrame(gt[f.gt_ids], track[f.track_ids], f.distance_m) for f in frames]
    assert clear_mot(frames, convention=convention) == clear_mot(renamed, convention=convention)


@pytest.mark.parametrize("seed", range(5))
def test_order_within_a_frame_changes_nothing(seed):
    rng = np.random.default_rng(seed)
    frames, shuffled = random_frames(rng), []
    for f in frames:
        g, p = rng.permutation(len(f.gt_ids)), rng.permutation(len(f.track_ids))
        shuffled.append(TrackingFrame(f.gt_ids[g], f.track_ids[p], f.distance_m[np.ix_(g, p)]))
    a, b = clear_mot(frames), clear_mot(shuffled)
    assert astuple(a)[:-1] == astuple(b)[:-1]
    assert a.distance_sum_m == pytest.approx(b.distance_sum_m)


def seen(gt_x, ignored, track_x, gt_class=None, track_class=None) -> FrameEvaluation:
    """Objects 0.. and tracks 0.. on the x axis."""
    g, p = len(gt_x), len(track_x)
    return FrameEvaluation(
        np.arange(g),
        np.array(gt_class or [0] * g),
        np.array([[x, 0, 0] for x in gt_x], dtype=float).reshape(-1, 3),
        np.array(ignored, dtype=bool),
        np.arange(p),
        np.array(track_class or [0] * p),
        np.array([[x, 0, 0] for x in track_x], dtype=float).reshape(-1, 3),
    )


IGNORED = {  # name: frames, tp fn fp
    "missed": ([seen([0], [True], [])], (0, 0, 0)),
    "found": ([seen([0], [True], [0.1])], (0, 0, 0)),
    "found twice": ([seen([0], [True], [0.1, 0.2])], (0, 0, 1)),
    "found beyond the gate": ([seen([0], [True], [0.3])], (0, 0, 1)),
    "found as another class": ([seen([0], [True], [0.1], [2], [3])], (0, 0, 1)),
    "beside a counted one": ([seen([0, 0.3], [True, False], [0.02, 0.29])], (1, 0, 0)),
    "counted but another class": ([seen([0], [False], [0.1], [2], [3])], (0, 1, 1)),
    "in and out of sight": (
        [seen([0], [i in (1, 2)], [0.01]) for i in range(4)],
        (2, 0, 0),
    ),
}


@pytest.mark.parametrize("name", IGNORED)
def test_ignored_objects(name):
    frames, expected = IGNORED[name]
    score = clear_mot(drop_ignored(frames))
    assert (score.tp, score.fn, score.fp) == expected
    assert score.id_switches == 0


def test_ignored_object_keeps_its_own_track():
    """Track 0 follows the ignored object 0; the nearer assignment would swap the two."""
    frames = [seen([0, 0.4], [True, False], [0.0, 0.4]), seen([0, 0.2], [True, False], [0.1, 0.09])]
    kept = drop_ignored(frames)
    assert [f.track_ids.tolist() for f in kept] == [[1], [1]]
    assert clear_mot(kept).id_switches == 0
