"""Whole sequences: a small world, its perfect answer, and answers wrong in known ways."""

import json
from dataclasses import fields, replace

import numpy as np
import pytest

from composenet.errors import DataError
from composenet.geometry.box import OrientedBox, aabb_of_oriented
from composenet.geometry.transform import make_T, rotation_z
from composenet.metrics.completion import CompletionError
from composenet.metrics.detection import DetectionOutcomes
from composenet.metrics.evaluate import aggregate, bootstrap_interval, evaluate_sequence
from composenet.metrics.objects import ClassOutcomes, MatchedObject, ObjectScores
from composenet.metrics.pose import PoseError
from composenet.metrics.report import (
    RunInfo,
    results,
    sections,
    to_markdown,
    to_rich,
    write_results,
)
from composenet.records import (
    CLASS_NAMES,
    Box,
    Camera,
    Frame,
    ObjectEstimate,
    ObjectFrameTruth,
    ObjectTruth,
    SequenceTruth,
    Similarity,
    Symmetry,
    TrackedObject,
    TrackState,
)

CHAIR, TABLE = CLASS_NAMES.index("chair"), CLASS_NAMES.index("table")
EXTENTS = {1: (0.5, 0.5, 1.0), 2: (0.5, 0.6, 0.9), 3: (1.5, 0.8, 0.7)}
CLASSES = {1: CHAIR, 2: CHAIR, 3: TABLE}


def pose(gt_id: int, t: int) -> np.ndarray:
    """Object 1 walks along x and turns; 2 and 3 rest."""
    place = {1: (0.1 * t, 0, 0.5), 2: (0, 3, 0.45), 3: (3, 0, 0.35)}[gt_id]
    return make_T(rotation_z(0.3 * gt_id + (0.05 * t if gt_id == 1 else 0)), place)


def world(
    frames=6, visible=lambda gt_id, t: 900, move=None, image_size=(320, 240)
) -> SequenceTruth:
    """`move`: (4, 4) applied to the whole world."""
    move = np.eye(4) if move is None else move
    placed = []
    for t in range(frames):
        row = []
        for gt_id, extents in EXTENTS.items():
            T = move @ pose(gt_id, t)
            box = aabb_of_oriented(OrientedBox(T[:3, 3], T[:3, :3], np.array(extents)))
            row.append(ObjectFrameTruth(gt_id, T, box, visible(gt_id, t), 1.0))
        placed.append(tuple(row))
    occupancy = np.ones((64, 64, 64), dtype=bool)
    objects = tuple(
        ObjectTruth(i, CLASSES[i], Symmetry.NONE, np.array(e), occupancy, np.zeros((0, 3)))
        for i, e in EXTENTS.items()
    )
    return SequenceTruth(objects, tuple(placed), image_size)


def answer_tracks(frames=6, move=None) -> list[list[TrackedObject]]:
    """What a perfect tracker says, written from the recipe of the world and not from its truth."""
    move = np.eye(4) if move is None else move
    result = []
    for t in range(frames):
        row = []
        for gt_id, extents in EXTENTS.items():
            T = move @ pose(gt_id, t)
            size = np.abs(T[:3, :3]) @ extents
            S = Similarity(float(np.linalg.norm(extents)), T[:3, :3].copy(), T[:3, 3].copy())
            row.append(
                TrackedObject(
                    40 - gt_id,
                    t,
                    CLASSES[gt_id],
                    TrackState.TRACKED,
                    0.9,
                    Box(T[:3, 3].copy(), size),
                    S,
                    np.array(extents),
                    True,
                )
            )
        result.append(row)
    return result


def canonical(extents) -> np.ndarray:
    share = np.array(extents) / np.linalg.norm(extents)
    centres = np.abs((np.arange(64) + 0.5) / 64 - 0.5)
    x, y, z = np.ix_(centres, centres, centres)
    return ((2 * x < share[0]) & (2 * y < share[1]) & (2 * z < share[2])).astype(np.float32)


CANONICAL = {extents: canonical(extents) for extents in EXTENTS.values()}


def answer_estimates(tracks) -> list[list[ObjectEstimate]]:
    return [
        [
            ObjectEstimate(
                np.eye(10)[o.class_id],
                o.confidence,
                o.box,
                o.S_world_canonical,
                True,
                o.extents_m,
                np.zeros((0, 3)),
                CANONICAL[tuple(o.extents_m.tolist())],
            )
            for o in row
        ]
        for row in tracks
    ]


def changed(tracks, condition, **changes) -> list[list[TrackedObject]]:
    return [[replace(o, **changes) if condition(o) else o for o in row] for row in tracks]


def shares_memory_with_truth(truth: SequenceTruth, estimates) -> bool:
    arrays = [getattr(o, f.name) for o in truth.objects for f in fields(o)]
    for row in truth.frames:
        arrays += [array for p in row for array in (p.T_world_object, p.box.center, p.box.extents)]
    arrays = [array for array in arrays if isinstance(array, np.ndarray)]
    predicted = [
        array
        for row in estimates
        for e in row
        for array in (e.box.center, e.box.extents, e.extents_m, e.canonical, e.S_world_canonical.t)
    ]
    return any(np.shares_memory(a, b) for a in arrays for b in predicted)


def test_perfect_answer():
    truth, tracks = world(), answer_tracks()
    estimates = answer_estimates(tracks)
    assert not shares_memory_with_truth(truth, estimates)
    scores = aggregate(
        {"one": evaluate_sequence(truth, tracks, estimates, seconds_per_frame=[0.2] * 6)}
    )
    assert (scores.clear.tp, scores.clear.mota, scores.mota_mean) == (18, 1, 1)
    assert (scores.clear.mostly_tracked, scores.clear.fragmentations) == (3, 0)
    assert scores.clear.motp_cm == pytest.approx(0, abs=1e-9)
    assert scores.identity.idf1 == 1
    assert scores.hota.hota == pytest.approx(1)
    for name in ("box25", "box50", "oriented25", "oriented50", "completion25", "completion50"):
        values = getattr(scores.precisions, name)
        assert values[CHAIR] == values[TABLE] == pytest.approx(1), name
        assert np.isnan(values[0])
    assert scores.pose.rotation_deg_median == pytest.approx(0, abs=1e-5)
    assert (scores.pose.recall, scores.seconds_median) == (1, 0.2)
    assert scores.completion.volume_iou > 0.9  # canonical cells are 1.9 cm
    assert scores.completion.chamfer_cm < 1


def is_track(track_id, frames=range(100)):
    return lambda o: o.track_id == track_id and o.frame_index in frames


@pytest.mark.parametrize(
    ("condition", "changes", "expected"),  # tp fn fp idsw of 18 object-frames
    [
        (is_track(39, [3]), {"state": TrackState.OCCLUDED}, (17, 1, 0, 0)),
        (is_track(39, [3]), {"state": TrackState.LOST}, (17, 1, 0, 0)),
        (is_track(39, [3]), {"state": TrackState.RE_FOUND}, (18, 0, 0, 0)),
        (is_track(39, [3]), {"track_id": 7}, (18, 0, 0, 2)),
        (is_track(39, range(3, 6)), {"track_id": 7}, (18, 0, 0, 1)),
        (is_track(38), {"class_id": TABLE}, (12, 6, 6, 0)),
        (is_track(37, [0]), {"box": Box(np.array([3, 0.3, 0.35]), np.ones(3))}, (17, 1, 1, 0)),
    ],
)
def test_wrong_in_a_known_way(condition, changes, expected):
    score = evaluate_sequence(world(), changed(answer_tracks(), condition, **changes))
    clear = score.clear
    assert (clear.tp, clear.fn, clear.fp, clear.id_switches) == expected
    assert sum(c.tp for c in score.clear_per_class) == clear.tp
    assert sum(c.id_switches for c in score.clear_per_class) == clear.id_switches
    assert score.objects is None


def test_hardly_visible_objects_are_ignored():
    """Object 2 is seen by 149 pixels in frames 2 and 3: neither needed nor wrong."""
    truth = world(visible=lambda gt_id, t: 149 if gt_id == 2 and t in (2, 3) else 150)
    tracks = answer_tracks()
    without = [[o for o in row if is_track(38, [2, 3])(o) is False] for row in tracks]
    for given in (tracks, without):
        score = evaluate_sequence(truth, given, answer_estimates(given))
        assert (score.clear.tp, score.clear.fn, score.clear.fp) == (16, 0, 0)
        assert score.objects.counted == 16
        chairs = score.objects.classes[CHAIR].box50
        assert (len(chairs.scores), chairs.truths, chairs.correct.all()) == (10, 10, True)
        assert len(score.objects.matched) == 16


def test_visible_pixels_scale_with_the_image():
    large = world(visible=lambda gt_id, t: 599, image_size=(640, 480))
    assert evaluate_sequence(large, answer_tracks()).clear.truths == 0
    large = world(visible=lambda gt_id, t: 600, image_size=(640, 480))
    assert evaluate_sequence(large, answer_tracks()).clear.truths == 18


def test_moving_the_world_changes_nothing():
    rng = np.random.default_rng(5)
    move = make_T(rotation_z(1.1), [4.0, -2.0, 0.5])
    noise = rng.normal(0, 0.12, (6, 3, 3))
    plain, moved = answer_tracks(), answer_tracks(move=move)

    def shaken(tracks, R):
        return [
            [
                replace(o, box=Box(o.box.center + R @ noise[t, i], o.box.extents))
                for i, o in enumerate(row)
            ]
            for t, row in enumerate(tracks)
        ]

    a = evaluate_sequence(world(), shaken(plain, np.eye(3)))
    b = evaluate_sequence(world(move=move), shaken(moved, move[:3, :3]))
    assert 0 < a.clear.tp < 18
    assert a.clear.tp == b.clear.tp
    assert a.clear.mota == b.clear.mota
    assert a.clear.motp_cm == pytest.approx(b.clear.motp_cm)
    assert a.hota.hota == pytest.approx(b.hota.hota)


def test_dataset_means_and_pools():
    good = evaluate_sequence(world(), answer_tracks())
    half = evaluate_sequence(world(frames=2), [answer_tracks(frames=1)[0], []])
    nothing = evaluate_sequence(world(frames=1, visible=lambda i, t: 0), [[]])
    scores = aggregate({"good": good, "half": half, "nothing": nothing})
    assert scores.mota_by_sequence["good"] == 1 and scores.mota_by_sequence["half"] == 0.5
    assert np.isnan(scores.mota_by_sequence["nothing"])
    assert scores.mota_mean == pytest.approx(0.75)  # the third has nothing to find
    assert scores.clear.mota == pytest.approx(21 / 24)
    assert scores.clear_per_class[TABLE].mota == pytest.approx(7 / 8)
    assert scores.mota_interval == pytest.approx((0.5, 1.0))
    assert scores.precisions is None
    assert bootstrap_interval(np.array([0.4, 0.4])) == pytest.approx((0.4, 0.4))


def test_identities_and_hota_are_pooled():
    """The sums of all sequences, each wrong in its own way, by hand: of `half`, 3 of 6 found, each
    trajectory half as long as its object; of `renamed`, one of three objects in two halves."""
    half = evaluate_sequence(world(frames=2), [answer_tracks(frames=1)[0], []])
    good = evaluate_sequence(world(), answer_tracks())
    renamed = changed(answer_tracks(), is_track(39, range(3, 6)), track_id=7)
    parts = {"half": half, "good": good, "renamed": evaluate_sequence(world(), renamed)}
    scores = aggregate(parts)
    assert [part.identity.idf1 for part in parts.values()] == pytest.approx([2 / 3, 1, 5 / 6])
    assert (scores.identity.idtp, scores.identity.idfn, scores.identity.idfp) == (36, 6, 3)
    assert scores.identity.idf1 == pytest.approx(2 * 36 / (2 * 36 + 6 + 3))
    tp, fn = 3 + 18 + 18, 3
    association = 3 * 1 / 2 + 18 + (12 + 6 * 1 / 2)
    assert scores.hota.det_a == pytest.approx(tp / (tp + fn))
    assert scores.hota.ass_a == pytest.approx(association / tp)
    assert scores.hota.hota == pytest.approx(np.sqrt(association / (tp + fn)))


def objects_by_hand(found, truths, errors, counted) -> ObjectScores:
    """`found`: right detections of tables, one number a kind of outcome; `errors`: of each
    matched object rotation, translation, volume IoU, chamfer, seen and unseen distance."""

    def outcomes(found, truths):
        return ClassOutcomes(
            *(DetectionOutcomes(np.full(n, 0.9), np.ones(n, dtype=bool), truths) for n in found)
        )

    classes = [outcomes([0] * 6, 0)] * len(CLASS_NAMES)
    classes[TABLE] = outcomes(found, truths)
    matched = [MatchedObject(TABLE, PoseError(*e[:2]), CompletionError(*e[2:])) for e in errors]
    return ObjectScores(tuple(classes), tuple(matched), counted)


def test_scores_of_objects_are_pooled():
    nan = float("nan")
    first = objects_by_hand([1, 2, 3, 4, 5, 6], 10, [(40, 4, 0.5, 3, 1, 7)], 3)
    second = objects_by_hand([0] * 6, 20, [(10, 6, 0.3, 4, 2, 8), (20, 8, 0.1, 8, nan, 9)], 9)
    plain = evaluate_sequence(world(frames=1), answer_tracks(frames=1))
    scores = aggregate(
        {
            "first": replace(plain, objects=first, seconds_per_frame=(20, 3, 1, 19)),
            "second": replace(plain, objects=second, seconds_per_frame=(0, 2, *range(4, 19))),
            "only tracks": plain,
        }
    )
    by_class = [getattr(scores.precisions, field.name) for field in fields(scores.precisions)]
    assert [values[TABLE] for values in by_class] == pytest.approx([n / 30 for n in range(1, 7)])
    assert all(np.isnan(values[CHAIR]) for values in by_class)
    completion, pose = scores.completion, scores.pose
    assert (completion.volume_iou, completion.chamfer_cm) == pytest.approx((0.3, 5))
    assert (completion.seen_cm, completion.unseen_cm) == pytest.approx((1.5, 8))
    assert (pose.rotation_deg_median, pose.translation_cm_median) == (20, 6)
    assert pose.recall == pytest.approx(3 / 12)
    assert (scores.seconds_median, scores.seconds_p95) == pytest.approx((10, 19))  # of 0 .. 20


LONG = (2.0, 0.4, 1.0)


def long_table(symmetry=Symmetry.NONE, frames=1) -> SequenceTruth:
    """One table on the floor, its length along the diagonal of the world's x and y."""
    T = make_T(rotation_z(np.pi / 4), (0, 0, 0.5))
    box = aabb_of_oriented(OrientedBox(T[:3, 3], T[:3, :3], np.array(LONG)))
    occupancy = np.ones((64, 64, 64), dtype=bool)
    table = ObjectTruth(1, TABLE, symmetry, np.array(LONG), occupancy, np.zeros((0, 3)))
    return SequenceTruth((table,), ((ObjectFrameTruth(1, T, box, 900, 1.0),),) * frames)


def long_estimate(turn_deg=0.0, along_m=0.0, up_m=0.0, filled_cells=64) -> ObjectEstimate:
    """The long table, turned, moved along its length and up, cut off above its lowest cells."""
    R = rotation_z(np.pi / 4 + np.radians(turn_deg))
    center = along_m * R[:, 0] + (0, 0, 0.5 + up_m)
    S = Similarity(float(np.linalg.norm(LONG)), R, center)
    shape = canonical(LONG)
    shape[:, :, filled_cells:] = 0
    box = Box(center, np.abs(R) @ LONG)
    probabilities = np.eye(10)[TABLE]
    return ObjectEstimate(probabilities, 0.9, box, S, True, np.array(LONG), np.zeros((0, 3)), shape)


KINDS = {  # name: change; found at 0.25 and 0.5 by boxes, by oriented boxes, by volumes
    "right": ({}, (1, 1, 1, 1, 1, 1)),
    # IoU 0.6 / 1.4 of every kind
    "raised": ({"up_m": 0.4}, (1, 0, 1, 0, 1, 0)),
    # bounds are the same squares; the tables share 0.16 of 1.44 square metres
    "turned": ({"turn_deg": 90}, (1, 1, 0, 0, 0, 0)),
    # IoU 1.1 / 2.9 of the tables, 0.24 of their bounds
    "moved": ({"along_m": 0.9}, (0, 0, 1, 0, 1, 0)),
    # 0.36 m of 1 m
    "lower third": ({"filled_cells": 28}, (1, 1, 1, 1, 1, 0)),
    # 0.15 m of 1 m
    "only a foot": ({"filled_cells": 22}, (1, 1, 1, 1, 0, 0)),
}


@pytest.mark.parametrize("name", KINDS)
def test_each_precision_has_its_own_iou_and_threshold(name):
    change, expected = KINDS[name]
    score = evaluate_sequence(long_table(), [[]], [[long_estimate(**change)]])
    scores = aggregate({"one": score})
    found = [getattr(scores.precisions, f.name)[TABLE] for f in fields(scores.precisions)]
    assert tuple(found) == expected
    assert scores.pose.recall == expected[0]  # objects are compared at box IoU 0.25


@pytest.mark.parametrize(
    ("symmetry", "error_deg"), [(Symmetry.NONE, 170), (Symmetry.TWO, 10), (Symmetry.INF, 0)]
)
def test_rotations_are_compared_by_the_symmetry_of_the_object(symmetry, error_deg):
    score = evaluate_sequence(long_table(symmetry), [[]], [[long_estimate(turn_deg=170)]])
    assert aggregate({"one": score}).pose.rotation_deg_median == pytest.approx(error_deg, abs=1e-5)


def test_surfaces_are_split_by_what_their_own_frame_sees():
    """A camera 4 m above the table, blind in the first of two frames. The estimate ends 0.65 m
    below the top, which is seen; the sides, which are not, are nearer or whole."""
    K, R = np.array([[50.0, 0, 79.5], [0, 50, 59.5], [0, 0, 1]]), np.diag([1.0, -1, -1])
    frames = [
        Frame(i, np.full((120, 160), depth, np.float32), Camera(K, 160, 120), make_T(R, (0, 0, 5)))
        for i, depth in enumerate((0.0, 4.0))
    ]
    estimates = [[long_estimate(filled_cells=28)]] * 2
    score = evaluate_sequence(long_table(frames=2), [[], []], estimates, frames=frames)
    blind, seeing = (item.completion for item in score.objects.matched)
    assert np.isnan(blind.seen_cm)
    assert seeing.seen_cm == pytest.approx(65, abs=1)
    assert 0 < seeing.unseen_cm < blind.unseen_cm < 30


def test_bad_input():
    with pytest.raises(DataError, match="tracks for 5 frames"):
        evaluate_sequence(world(), answer_tracks(frames=5))
    with pytest.raises(DataError, match="estimates for 0 frames"):
        evaluate_sequence(world(), answer_tracks(), [])
    twice = changed(answer_tracks(), is_track(38), track_id=39)
    with pytest.raises(DataError, match="frame 0: a track id stands there twice"):
        evaluate_sequence(world(), twice)
    orphan = replace(world(), objects=())
    with pytest.raises(DataError, match="object 1 is not in"):
        evaluate_sequence(orphan, answer_tracks())
    with pytest.raises(DataError, match="no sequences"):
        aggregate({})


KEYS = [
    "sequences",
    "mota_mean",
    "mota_pooled",
    "mota_per_class",
    "idf1",
    "hota",
    "counted",
    "tracked",
    "false_positives",
    "id_switches",
    "det_map25",
    "det_map50",
    "completion_map25",
    "completion_map50",
    "track_iou",
    "rotation_error_deg_median",
    "translation_error_cm_median",
    "pose_recall",
    "seconds_per_frame_median",
    "mota_interval",
    "det_ap50_per_class",
    "completion_ap25_per_class",
    "mota_per_sequence",
]


def test_results_file(tmp_path):
    tracks = answer_tracks()
    full = aggregate({"one": evaluate_sequence(world(), tracks, answer_estimates(tracks))})
    only_tracks = aggregate({"one": evaluate_sequence(world(), tracks)})
    info = RunInfo(data="tiny", seed=3)
    write_results(tmp_path / "results.json", info, {"full": full, "no-corr": only_tracks})
    data = json.loads((tmp_path / "results.json").read_text())
    origin = ["data", "commit", "seed", "hardware", "date", "command", "weights"]
    assert list(data) == [*origin, "variants", "not_scored"]
    assert (data["data"], data["seed"]) == ("tiny", 3)
    assert data["commit"] and "cores" in data["hardware"]
    assert [list(variant) for variant in data["variants"].values()] == [KEYS, KEYS]
    first, second = data["variants"]["full"], data["variants"]["no-corr"]
    assert (first["mota_mean"], first["idf1"], first["det_map50"]) == (100, 100, 100)
    assert first["mota_per_class"]["chair"] == 100
    assert first["mota_per_class"]["bed"] is None
    counts = [first[key] for key in ("counted", "tracked", "false_positives", "id_switches")]
    assert counts == [18, 18, 0, 0]
    assert first["mota_interval"] == [100, 100]
    assert first["mota_per_sequence"] == {"one": 100}
    assert first["det_ap50_per_class"]["chair"] == 100
    assert first["completion_ap25_per_class"]["bed"] is None
    assert second["det_map25"] is second["det_ap50_per_class"]["chair"] is None
    assert first["seconds_per_frame_median"] is None
    assert [p.name for p in tmp_path.iterdir()] == ["results.json"]
    assert results(info, {"full": full})["variants"]["full"] == first


def test_tables():
    tracks = answer_tracks()
    scores = aggregate({"one": evaluate_sequence(world(), tracks, answer_estimates(tracks))})
    text = to_markdown(RunInfo("tiny", 0, commit="abc", hardware="two cores"), {"full": scores})
    assert "Data tiny, commit abc, seed 0, two cores." in text
    only_tracks = aggregate({"one": evaluate_sequence(world(), tracks)})
    rows = [len(table.rows) for table in sections({"f2f": only_tracks, "full": scores})]
    assert rows == [2, 2, 1, 1, 1] and len(sections({"f2f": only_tracks})) == 2
    tables = sections({"full": scores, "no-compl": scores})
    for section in tables:
        assert all(len(row) == len(section.columns) for row in section.rows)
        assert [row[0] for row in section.rows] == ["full", "no-compl"]
        assert to_rich(section).row_count == 2
    tracking = dict(zip(tables[0].columns, tables[0].rows[0], strict=True))
    assert tracking["seq. mean"] == "100.0 [100.0, 100.0]"
    assert tracking["bed"] == "-"
