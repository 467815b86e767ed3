"""Whole sequences: a small world, its perfect answer, and answers wrong in known ways."""

import json
from dataclasses import fields, replace

import numpy as np
import pytest

from composenet.errors import DataError
from composenet.geometry.box import OrientedBox, aabb_of_oriented
from composenet.geometry.transform import make_T, rotation_z
from composenet.metrics.evaluate import aggregate, bootstrap_interval, evaluate_sequence
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
    "id_switches",
    "det_map25",
    "det_map50",
    "completion_map25",
    "completion_map50",
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
