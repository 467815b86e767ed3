"""Identities of objects that leave and come back: cases countable by hand, laws, a picture."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import gains
import numpy as np
import pytest
import returns as benchmark
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from composenet.commands.score_cache import ScoreCache
from composenet.commands.scoring import ScoredSequence, moved_truth, score_tracks
from composenet.errors import DataError
from composenet.metrics.evaluate import aggregate, posed_truths
from composenet.metrics.report import RunInfo, write_results
from composenet.metrics.returns import Outcome, Return, returns
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
from fake_tracks import make_object

SEEN, FEW = 900, 10
"""Pixels that count, and too few."""


def scene(
    pixels: Sequence[int], ids: Sequence[int | None], moved_m: Sequence[float] | None = None
) -> tuple[SequenceTruth, list[list[TrackedObject]]]:
    """One chair: of so many pixels, under these identities, so far along y, frame by frame."""
    thing = make_object(4)
    empty = np.zeros((0, 3), np.float32)
    constant = ObjectTruth(
        7, thing.class_id, Symmetry.NONE, thing.extents_m, np.ones((64, 64, 64), bool), empty
    )
    frames, tracked = [], []
    for index, (count, name) in enumerate(zip(pixels, ids, strict=True)):
        shift = np.array([0, moved_m[index] if moved_m else 0, 0])
        box = Box(thing.box.center + shift, thing.box.extents)
        T = np.eye(4)
        T[:3, 3] = box.center
        frames.append((ObjectFrameTruth(7, T, box, count, 1.0),))
        entry = replace(thing, track_id=name or 0, frame_index=index, box=box)
        tracked.append([] if name is None else [entry])
    return SequenceTruth((constant,), tuple(frames)), tracked


def outcomes(pixels: Sequence[int], ids: Sequence[int | None]) -> list[Outcome]:
    return [item.outcome for item in returns(*scene(pixels, ids))]


AWAY = [SEEN] * 2 + [FEW] * 3 + [SEEN] * 2


@pytest.mark.parametrize(
    ("ids", "outcome"),
    [
        ([1, 1, None, None, None, 1, 1], Outcome.KEPT),
        ([1, 1, None, None, None, 2, 2], Outcome.CHANGED),
        ([1, None, None, None, None, None, 1], Outcome.KEPT),  # last before, first after
        ([1, 2, None, None, None, 2, 1], Outcome.KEPT),
        ([1, 1, 2, 2, 2, 1, 1], Outcome.KEPT),  # while it does not count nothing is asked
        ([None, None, None, None, None, 1, 1], Outcome.UNKNOWN),
        ([None] * 7, Outcome.UNKNOWN),
        ([1, 1, None, None, None, None, None], Outcome.MISSED),
    ],
)
def test_what_becomes_of_an_identity(ids: list[int | None], outcome: Outcome) -> None:
    assert outcomes(AWAY, ids) == [outcome]


def test_two_frames_are_no_absence_and_each_absence_counts() -> None:
    assert outcomes([SEEN] + [FEW] * 2 + [SEEN], [1, None, None, 2]) == []
    twice = [SEEN] + [FEW] * 3 + [SEEN] + [FEW] * 4 + [SEEN]
    ids = [1, *[None] * 3, 2, *[None] * 4, 2]
    assert outcomes(twice, ids) == [Outcome.CHANGED, Outcome.KEPT]
    assert outcomes([FEW] * 4 + [SEEN] + [FEW] * 4, [1] * 9) == []  # neither left nor back


def test_how_far_it_moved_while_away() -> None:
    (item,) = returns(*scene(AWAY, [1] * 7, [0.0, 0.1, 0.5, 0.9, 1.2, 1.6, 1.8]))
    assert (item.left, item.back) == (1, 5)
    assert item.moved_m == pytest.approx(1.5)


def test_only_a_track_that_says_that_it_sees_the_object_has_it() -> None:
    truth, tracked = scene(AWAY, [1] * 7)
    lost = [[replace(e, state=TrackState.LOST) for e in frame] for frame in tracked]
    (item,) = returns(truth, [*tracked[:5], *lost[5:]])
    assert item.outcome is Outcome.MISSED
    far = [[replace(e, box=Box(e.box.center + 0.2, e.box.extents)) for e in f] for f in tracked]
    assert returns(truth, [*far[:2], *tracked[2:]])[0].outcome is Outcome.UNKNOWN  # 35 cm off


@given(
    st.lists(st.sampled_from([SEEN, FEW]), min_size=1, max_size=30),
    st.lists(st.one_of(st.none(), st.integers(1, 3)), min_size=30, max_size=30),
)
def test_names_of_tracks_and_the_way_of_time_do_not_matter(
    pixels: list[int], ids: list[int | None]
) -> None:
    ids = ids[: len(pixels)]
    plain = outcomes(pixels, ids)
    assert outcomes(pixels, [None if i is None else 100 - i for i in ids]) == plain
    back = outcomes(pixels[::-1], ids[::-1])
    assert len(back) == len(plain)
    for outcome in (Outcome.KEPT, Outcome.CHANGED):
        assert back.count(outcome) == plain.count(outcome)
    one = outcomes(pixels, [1] * len(pixels))
    assert set(one) <= {Outcome.KEPT} and len(one) == len(plain)


def test_shares_are_of_those_known_before_and_after() -> None:
    def item(before: int | None, after: int | None, moved_m: float) -> Return:
        return Return(1, 0, 9, moved_m, before, after)

    found = [item(1, 1, 0.0), item(1, 2, 0.0), item(None, 2, 0.0), item(3, None, 0.3)]
    table = benchmark.summary(found)
    rest = {"kept": 1, "changed": 1, "unknown": 1, "missed": 0, "kept_share": 0.5}
    moved = {"kept": 0, "changed": 0, "unknown": 0, "missed": 1, "kept_share": None}
    assert table == {"at_rest": rest, "moved": moved}


def test_pictures_are_of_sequences_that_both_have() -> None:
    kept, changed = Return(1, 0, 9, 0.5, 0, 0), Return(1, 0, 9, 0.5, 0, 2)
    a, b = Path("a"), Path("b")
    (case,) = benchmark.chosen({a: (kept,), b: (kept,)}, {a: (changed,)})
    assert (case.folder, case.one, case.other) == (a, kept, changed)


def renamed(folder: Path, names: Sequence[int]) -> ScoredSequence:
    """The truth of a sequence as tracks, whose names grow by names[frame]."""
    truth = moved_truth(read_truth(folder), open_sequence(folder).T_level_source)
    objects = {item.gt_id: item for item in truth.objects}
    tracked = []
    for index, frame in enumerate(truth.frames):
        entries = []
        for o in frame:
            extents, T = objects[o.gt_id].extents_m, o.T_world_object
            S = Similarity(float(np.linalg.norm(extents)), T[:3, :3], T[:3, 3])
            name, class_id = o.gt_id + names[index], objects[o.gt_id].class_id
            seen = TrackState.TRACKED
            entries.append(TrackedObject(name, index, class_id, seen, 0.9, o.box, S, extents, True))
        tracked.append(entries)
    return score_tracks(truth, tracked)


def test_numbers_and_picture(
    recordings: Path, tiny_weights: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scores = tmp_path / "scores"
    cache = ScoreCache(scores / "sequences", [], tiny_weights, "cpu")
    folders = sorted(recordings.glob("val_*"))
    rows = {"full": [0] * 6, "no-corr": [0] * 3 + [100] * 3}
    results = {}
    for name, names in rows.items():
        items = [renamed(folder, names) for folder in folders]
        for folder, item in zip(folders, items, strict=True):
            cache.save(folder, name, item)
        results[name] = aggregate({f.name: i.scores for f, i in zip(folders, items, strict=True)})
    write_results(
        scores / "results.json", RunInfo(recordings.name, 0, "composenet eval", "x"), results
    )
    image, numbers = tmp_path / "returns.png", tmp_path / "returns.json"
    benchmark.main(scores, recordings, numbers, image)
    data = json.loads(numbers.read_text())
    assert set(data["rows"]) == set(rows) and data["sequences"] == 2
    assert data["rows"]["full"]["mota_by_part"] == [100] * 5  # what does not count is ignored
    parts = data["rows"]["no-corr"]["mota_by_part"]  # other names from frame 3 of 6 on
    assert parts[2] < 100 and parts[:2] + parts[3:] == [100] * 4
    assert not image.exists()  # in six frames nobody goes and comes back
    frames = [(f, posed) for f in folders for posed in posed_truths(read_truth(f))]
    count = {(f, item.placed.gt_id) for f, posed in frames for item in posed if not item.ignored}
    assert data["objects"] == len(count) > 0 and data["objects_that_return"] == 0

    def left(folder: Path, item: ScoredSequence) -> tuple[Return, ...]:
        after = max(e.track_id for e in item.tracked[5])
        before = max(e.track_id for e in item.tracked[0])
        return (Return(before, 0, 5, 0.6, before, after),)

    monkeypatch.setattr(benchmark, "returns_of", left)
    benchmark.main(scores, recordings, numbers, image)
    told = json.loads(numbers.read_text())
    rows_now = told["rows"]
    assert told["objects_that_return"] == 2  # one a recording
    assert rows_now["full"]["moved"]["kept"] == rows_now["no-corr"]["moved"]["changed"] == 2
    with Image.open(image) as picture:  # two cases: last seen, back by the one, by the other
        assert picture.size == (3 * 480, 2 * (360 + gains.CAPTION_PX))
        assert len(np.unique(np.asarray(picture))) > 20
    with pytest.raises(DataError, match="no results of no-compl"):  # a row that was not scored
        benchmark.main(scores, recordings, numbers, image, other="no-compl")
    with pytest.raises(DataError, match=r"results\.json"):
        benchmark.main(tmp_path, recordings, numbers, image)
