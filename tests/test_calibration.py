"""Calibration and completion of tracks: tables checkable by hand, and the pictures made of them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import figures
import gains
import numpy as np
import pytest
from PIL import Image

from composenet.commands.score_cache import ScoreCache
from composenet.commands.scoring import ScoredSequence, moved_truth, score_tracks
from composenet.errors import DataError
from composenet.metrics.calibration import Judged, calibration, judged_tracks
from composenet.metrics.evaluate import aggregate
from composenet.metrics.report import RunInfo, write_results
from composenet.metrics.tracklets import tracklet_completions
from composenet.records import (
    Box,
    ObjectFrameTruth,
    ObjectTruth,
    SequenceTruth,
    Similarity,
    Symmetry,
    TrackedObject,
    TrackState,
)
from composenet.sequences import open_sequence
from composenet.synth.sequence_folder import read_truth
from fake_tracks import box_grid, make_object

EXTENTS = np.array([0.6, 1.2, 0.8])


def claims(*pairs: tuple[float, int]) -> Judged:
    confidence, right = zip(*pairs, strict=True)
    return Judged(np.array(confidence), np.array(right, dtype=bool))


def test_table_by_hand() -> None:
    result = calibration(claims((0.55, 1), (0.55, 0), (0.9, 1), (1.0, 1)))
    assert result.counts.tolist() == [0, 0, 0, 0, 0, 2, 0, 0, 0, 2]
    assert result.confidence[[5, 9]] == pytest.approx([0.55, 0.95])
    assert result.share_right[[5, 9]].tolist() == [0.5, 1.0]
    assert np.isnan(result.share_right[0])
    assert result.error == pytest.approx((2 * 0.05 + 2 * 0.05) / 4)


@pytest.mark.parametrize(("confidence", "right", "error"), [(1.0, 1, 0.0), (1.0, 0, 1.0)])
def test_extremes(confidence: float, right: int, error: float) -> None:
    assert calibration(claims((confidence, right))).error == error


def test_what_is_right_as_often_as_it_says_has_no_error() -> None:
    values = [(0.25, int(n < 1)) for n in range(4)] + [(0.75, int(n < 3)) for n in range(4)]
    assert calibration(claims(*values)).error == pytest.approx(0)


def test_nothing_claimed_and_no_share() -> None:
    nothing = calibration(Judged.joined([]))
    assert np.isnan(nothing.error) and nothing.counts.sum() == 0
    with pytest.raises(DataError, match=r"outside 0\.\.1"):
        calibration(claims((1.2, 1)))


def truth_of(*entries: tuple[TrackedObject, int]) -> SequenceTruth:
    """One frame of full boxes: (object that stands there, visible pixels)."""
    objects = [
        ObjectTruth(
            e.track_id, e.class_id, Symmetry.NONE, e.extents_m, np.ones((64, 64, 64), bool),
            np.zeros((0, 3), np.float32),
        )
        for e, _ in entries
    ]  # fmt: skip
    frame = []
    for entry, pixels in entries:
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = entry.S_world_canonical.R, entry.S_world_canonical.t
        frame.append(ObjectFrameTruth(entry.track_id, T, entry.box, pixels, 1.0))
    return SequenceTruth(tuple(objects), (tuple(frame),))


def test_who_is_right() -> None:
    here, hidden = make_object(1), make_object(2, center=(3.0, 4.0, 1.0))
    truth = truth_of((here, 900), (hidden, 10))

    def at(confidence: float, offset_m: float, like: TrackedObject = here) -> TrackedObject:
        box = Box(like.box.center + np.array([offset_m, 0, 0]), like.box.extents)
        name = round(1000 * confidence)
        return replace(like, track_id=name, confidence=confidence, box=box)

    tracked = [
        [
            at(0.91, 0.10),  # right
            at(0.82, 0.12),  # one object, one track
            at(0.73, 0.26),  # too far
            replace(at(0.64, 0.0), class_id=7),  # another class
            at(0.55, 0.1, hidden),  # neither: its object does not count
            replace(at(0.46, 0.0), state=TrackState.LOST),  # claims nothing
        ]
    ]
    result = judged_tracks(truth, tracked)
    answer = dict(zip(result.confidence.tolist(), result.right.tolist(), strict=True))
    assert answer == {0.91: True, 0.82: False, 0.73: False, 0.64: False}


def test_completion_of_a_track_by_hand() -> None:
    here = replace(make_object(1, yaw=0.0), extents_m=EXTENTS)
    truth = truth_of((here, 900))
    whole = box_grid(EXTENTS)
    half = np.where(np.arange(64)[:, None, None] < 32, whole, 0)
    tracked = [[replace(here, track_id=5)]]
    (full,) = tracklet_completions(truth, tracked, {5: whole})
    assert (full.track_id, full.gt_id, full.frames) == (5, 1, 1) and full.volume_iou > 0.9
    (part,) = tracklet_completions(truth, tracked, {5: half})
    assert part.volume_iou == pytest.approx(0.5, abs=0.05)
    assert tracklet_completions(truth, tracked, {}) == ()
    assert tracklet_completions(truth, [[]], {5: whole}) == ()


def answered(folder: Path, confidence: float, off_m: float = 0.0) -> ScoredSequence:
    """The truth of a sequence as tracks that are full boxes, all off_m too high."""
    truth = moved_truth(read_truth(folder), open_sequence(folder).T_level_source)
    objects = {item.gt_id: item for item in truth.objects}
    tracked = [
        [
            TrackedObject(
                o.gt_id, i, objects[o.gt_id].class_id, TrackState.TRACKED, confidence,
                Box(o.box.center + np.array([0, 0, off_m]), o.box.extents),
                Similarity(
                    float(np.linalg.norm(objects[o.gt_id].extents_m)),
                    o.T_world_object[:3, :3],
                    o.T_world_object[:3, 3],
                ),
                objects[o.gt_id].extents_m, True,
            )
            for o in frame
        ]
        for i, frame in enumerate(truth.frames)
    ]  # fmt: skip
    grids = {gt_id: box_grid(item.extents_m) for gt_id, item in objects.items()}
    return score_tracks(truth, tracked, canonical=grids)


@pytest.fixture(scope="module")
def kept(recordings: Path, tiny_weights: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An evaluation's folder."""
    out = tmp_path_factory.mktemp("scores")
    cache = ScoreCache(out / "sequences", [], tiny_weights, "cpu")
    sequences = sorted(recordings.glob("val_*"))
    scored = {
        name: [answered(folder, 0.9, off_m) for folder in sequences]
        for name, off_m in (("full", 0.01), ("no-compl", 0.3))
    }
    for name, items in scored.items():
        for folder, item in zip(sequences, items, strict=True):
            cache.save(folder, name, item)
    info = RunInfo(recordings.name, 0, "composenet eval", "tiny")
    results = {
        name: aggregate({str(n): i.scores for n, i in enumerate(items)})
        for name, items in scored.items()
    }
    write_results(out / "results.json", info, results)
    return out


def test_pictures(kept: Path, recordings: Path, tmp_path: Path) -> None:
    numbers = tmp_path / "figures.json"
    figures.main(kept, recordings, out=tmp_path, numbers=numbers)
    for name in ("calibration.png", "mota_completion.png"):
        with Image.open(tmp_path / name) as image:
            assert min(image.size) > 400 and len(np.unique(np.asarray(image))) > 20
        assert (tmp_path / name).stat().st_size < 150_000
    data = json.loads(numbers.read_text())
    assert data["weights"] == "tiny" and data["sequences"] == 2
    tracks = data["calibration"]["tracks"]
    assert tracks["share_right"][9] == 1 and tracks["expected_calibration_error"] == 0.1
    assert sum(tracks["counts"]) == tracks["counts"][9] > 0
    points = data["mota_completion"]["sequences"]
    assert [p["mota"] for p in points] == [1, 1] and all(p["completion_iou"] > 0.1 for p in points)


def test_where_one_variant_is_ahead(kept: Path, recordings: Path, tmp_path: Path) -> None:
    image, numbers = tmp_path / "gain.png", tmp_path / "gain.json"
    gains.main(kept, recordings, image=image, numbers=numbers)
    with Image.open(image) as picture:  # a frame of each sequence, seen by both
        assert picture.width == 2 * 480 and picture.height == 2 * (360 + gains.CAPTION_PX)
    data = json.loads(numbers.read_text())
    counted = data["objects"]
    assert data["found_by_one_only"] == counted > 0 and data["found_by_other_only"] == 0
    assert data["one_only_because_other"] == {"place": counted}
    assert sum(data["one_only_by_class"].values()) == counted
    # Missed, and a false track; tracks of objects that do not count are false as well.
    assert data["errors_one_saves"] >= 2 * counted
    assert data["frames_other_leads"] == 0
    mota, ahead = data["mota"], data["mota_gain"]
    assert ahead["mean"] == pytest.approx(mota["full"] - mota["no-compl"], abs=0.01)
    assert 100 < ahead["interval"][0] <= ahead["mean"] <= ahead["interval"][1]
    assert data["center_error_cm_of_found_by_both"] == [None, None]

    gains.main(kept, recordings, one="no-compl", other="full", image=image, numbers=numbers)
    turned = json.loads(numbers.read_text())
    assert turned["found_by_other_only"] == counted
    assert turned["errors_one_saves"] == -data["errors_one_saves"]
    assert turned["mota_gain"]["interval"] == [-x for x in reversed(ahead["interval"])]
    gains.main(kept, recordings, other="full", image=tmp_path / "none", numbers=numbers)
    assert not (tmp_path / "none").exists()  # no frame differs
    same = json.loads(numbers.read_text())
    assert same["found_by_both"] == counted and same["mota_gain"]["interval"] == [0, 0]
    assert same["center_error_cm_of_found_by_both"] == [1.0, 1.0]


def test_scores_of_two_runs_are_refused(kept: Path, recordings: Path, tmp_path: Path) -> None:
    folders = sorted(recordings.glob("val_*"))
    with pytest.raises(DataError, match="no results of no-corr"):
        figures.read_scores(kept, folders, "no-corr")
    with pytest.raises(DataError, match="1 of 2 sequences"):
        figures.read_scores(kept, folders[:1], "full")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    for folder in folders:
        (elsewhere / folder.name).mkdir()
    with pytest.raises(DataError, match=r"not with those of .*elsewhere"):
        figures.read_scores(kept, sorted(elsewhere.iterdir()), "full")
    other = tmp_path / "other"
    other.mkdir()
    (other / "sequences").symlink_to(kept / "sequences")
    run = json.loads((kept / "results.json").read_text())
    run["variants"]["full"]["mota_mean"] = 50.0
    (other / "results.json").write_text(json.dumps(run))
    with pytest.raises(DataError, match="two runs"):
        figures.read_scores(other, folders, "full")


def test_groups_are_of_like_completion() -> None:
    points = [figures.SequencePoint(str(n), 1, n / 10, n / 10) for n in (3, 1, 0, 2, 7, 5, 4, 6)]
    low, high = figures.grouped(points)
    assert (low.sequences, low.completion_iou, low.mota) == (
        4,
        pytest.approx(0.15),
        low.completion_iou,
    )
    assert high.mota == pytest.approx(0.55) and high.low <= high.mota <= high.high
    assert figures.rank_correlation(points) == pytest.approx(1)
    assert figures.rank_correlation(points[:2]) is None
