"""The benchmark's page: who leads, what is missing, and pictures of the frames that fail."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from composenet.baselines.records import Cameras
from composenet.commands.bench_page import markdown, write_page
from composenet.commands.failures import (
    PICTURES,
    Failure,
    frame_of,
    frame_with_boxes,
    picture,
    worst_frames,
)
from composenet.commands.jobs import Job, Outcome
from composenet.commands.scoring import ScoredSequence, moved_truth, score_tracks
from composenet.geometry.transform import inverse_T, make_T, rotation_z
from composenet.metrics.clear import FrameErrors
from composenet.metrics.report import RunInfo
from composenet.records import Box, Similarity, TrackedObject, TrackState
from composenet.sequences import open_sequence
from composenet.synth.sequence_folder import read_truth

MISSED, FALSE = (214, 150, 0), (214, 40, 50)
INFO = RunInfo("tiny", 0, "composenet bench", "w")


def world_of(folder: Path) -> np.ndarray:
    return open_sequence(folder).T_level_source


def perfect(folder: Path, T_world_source: np.ndarray | None = None) -> list[list[TrackedObject]]:
    """The truth itself as tracks, in the levelled world or another."""
    T = world_of(folder) if T_world_source is None else T_world_source
    truth = moved_truth(read_truth(folder), T)
    objects = {item.gt_id: item for item in truth.objects}
    return [
        [
            TrackedObject(
                o.gt_id, i, objects[o.gt_id].class_id, TrackState.TRACKED, 1.0, o.box,
                Similarity(1.0, o.T_world_object[:3, :3], o.box.center),
                objects[o.gt_id].extents_m, True,
            )
            for o in frame
        ]
        for i, frame in enumerate(truth.frames)
    ]  # fmt: skip


def scored(
    folder: Path, tracked: list[list[TrackedObject]], T_world_source: np.ndarray | None = None
) -> ScoredSequence:
    T = world_of(folder) if T_world_source is None else T_world_source
    return score_tracks(moved_truth(read_truth(folder), T), tracked)


@pytest.fixture(scope="module")
def outcomes(recordings: Path) -> dict[Job, Outcome]:
    """full is right; f2f-gt puts all tracks 1 m off in frame 3 of the first sequence, and fails on
    the second one; no-corr fails altogether."""
    first, second = sorted(recordings.glob("val_*"))
    wrong = perfect(first)
    off = np.array([1.0, 0, 0])
    wrong[3] = [
        replace(
            e,
            box=Box(e.box.center + off, e.box.extents),
            S_world_canonical=replace(e.S_world_canonical, t=e.S_world_canonical.t + off),
        )
        for e in wrong[3]
    ]
    return {
        ("f2f-gt", first): scored(first, wrong),
        ("f2f-gt", second): "no depth in it",
        ("no-corr", first): "no memory",
        ("full", first): scored(first, perfect(first)),
        ("full", second): scored(second, perfect(second)),
    }


def test_the_page(outcomes: dict[Job, Outcome], tmp_path: Path) -> None:
    page = tmp_path / "docs" / "benchmark.md"
    (tmp_path / "docs" / "benchmark").mkdir(parents=True)
    (tmp_path / "docs" / "benchmark" / "full-3.jpg").write_bytes(b"of a worse day")
    write_page(page, INFO, outcomes, Cameras.GIVEN)
    text = page.read_text()
    assert text.startswith("# Benchmark: tiny\n")
    assert "| f2f-gt (1 of 2) |" in text and "| full |" in text
    assert "- not scored: val_00001 (f2f-gt): no depth in it" in text
    assert "- f2f-gt: told true masks, classes and identities; where each track starts (" in text
    assert "### full\n\nNo errors." in text
    assert "### no-corr\n\nNo sequence could be scored." in text and "| no-corr" not in text
    assert "- not scored: val_00000 (no-corr): no memory" in text
    links = re.findall(r"!\[(.*)\]\((.*)\)", text)
    assert [link for _, link in links] == ["benchmark/f2f-gt-1.jpg"]
    assert links[0][0].startswith("val_00000, frame 3: ") and "false" in links[0][0]
    assert [p.name for p in (tmp_path / "docs" / "benchmark").iterdir()] == ["f2f-gt-1.jpg"]


def test_who_leads_over_the_sequences_of_both(outcomes: dict[Job, Outcome]) -> None:
    text = markdown(INFO, outcomes, Cameras.GIVEN)
    worse = next(iter(outcomes.values()))
    assert isinstance(worse, ScoredSequence)
    points = 100 * (1 - worse.scores.clear.mota)
    assert f"full is {points:.1f} points of MOTA ahead of f2f-gt" in text and points > 6.5
    assert "falls short" not in text
    (_, first), (_, second) = list(outcomes)[:2]
    swapped = {("full", first): worse, ("f2f-gt", first): outcomes["full", first]}
    text = markdown(INFO, swapped, Cameras.ESTIMATED)
    assert f"full is {points:.1f} points of MOTA behind f2f-gt" in text and "falls short" in text
    assert "points of MOTA" not in markdown(INFO, {("full", second): worse}, Cameras.GIVEN)


def test_who_leads_among_those_given_no_true_masks(outcomes: dict[Job, Outcome]) -> None:
    worse = next(iter(outcomes.values()))
    folder = next(path for name, path in outcomes if name == "full")
    perfect = outcomes["full", folder]
    rows = {("f2f-gt", folder): perfect, ("maskfusion", folder): worse, ("full", folder): perfect}
    first, second = re.findall(r"\*\*full is .*", markdown(INFO, rows, Cameras.GIVEN))
    assert "0.0 points of MOTA ahead of f2f-gt**, the best other row" in first
    assert "ahead of maskfusion**, the best that is given no true masks" in second
    assert "falls short" in first and "falls short" not in second
    assert "- maskfusion: told where each track starts (" in markdown(INFO, rows, Cameras.GIVEN)
    del rows["f2f-gt", folder]  # then the best other row is that one, and said once
    assert len(re.findall(r"\*\*full is", markdown(INFO, rows, Cameras.GIVEN))) == 1


def test_a_row_that_failed_on_some_sequences_is_not_the_best(outcomes: dict[Job, Outcome]) -> None:
    worse, folders = next(iter(outcomes.values())), [path for _, path in list(outcomes)[:2]]
    perfect = outcomes["full", folders[0]]
    rows = {(name, f): worse for name in ("full", "f2f-gt") for f in folders}
    rows |= {("midfusion", folders[0]): perfect, ("midfusion", folders[1]): "out of memory"}
    assert "of f2f-gt**, the best other row" in markdown(INFO, rows, Cameras.GIVEN)


def test_worst_frames_of_each_sequence_come_first(outcomes: dict[Job, Outcome]) -> None:
    any_scores = next(o for o in outcomes.values() if isinstance(o, ScoredSequence))

    def with_errors(*counts: int) -> ScoredSequence:
        errors = tuple(FrameErrors(tuple(range(n)), (), ()) for n in counts)
        return replace(any_scores, errors=errors)

    a, b, c = Path("a"), Path("b"), Path("c")
    failures = worst_frames({a: with_errors(0, 5, 9), b: with_errors(1, 0), c: with_errors(3)})
    assert [(f.folder, f.frame) for f in failures] == [(a, 2), (c, 0), (b, 0)]
    failures = worst_frames({a: with_errors(4, 5, 9, 2), b: with_errors(0)})
    assert [f.frame for f in failures] == [2, 1, 0] and len(failures) == PICTURES
    assert failures[0].caption == "a, frame 2: 9 missed"
    assert worst_frames({b: with_errors(0, 0)}) == ()


def near(image: Image.Image, color: tuple[int, ...]) -> np.ndarray:
    """(K, 2) pixels of a colour, column and row."""
    return np.argwhere((np.asarray(image) == color).all(axis=-1))[:, ::-1]


def test_a_picture_shows_what_is_missed_and_what_is_false(outcomes: dict[Job, Outcome]) -> None:
    (_, folder), wrong = next(iter(outcomes.items()))
    assert isinstance(wrong, ScoredSequence)
    shown = picture(Failure(folder, 3, wrong.errors[3]), wrong)
    right = picture(Failure(folder, 2, wrong.errors[2]), wrong)
    assert shown is not None and right is not None and shown.size == (480, 360)
    assert len(near(shown, MISSED)) > 50 and len(near(shown, FALSE)) > 50
    assert not len(near(right, MISSED)) and not len(near(right, FALSE))
    assert picture(Failure(folder, 99, wrong.errors[3]), wrong) is None


def test_pictures_are_of_the_world_that_was_tracked_in(outcomes: dict[Job, Outcome]) -> None:
    """As odometry's, which lies elsewhere."""
    folder = next(path for name, path in outcomes if name == "full")
    T = make_T(rotation_z(np.pi / 2), [3.0, -2.0, 0.5]) @ world_of(folder)
    here, there = outcomes["full", folder], scored(folder, perfect(folder, T), T)
    assert isinstance(here, ScoredSequence)
    assert there.scores.clear.mota == here.scores.clear.mota == 1
    (one, *_), (other, *_) = (item.truth(folder).frames for item in (here, there))
    for a, b in zip(one, other, strict=True):
        np.testing.assert_allclose(
            b.T_world_object, T @ inverse_T(world_of(folder)) @ a.T_world_object, atol=1e-9
        )
    pictures = [picture(Failure(folder, 2, item.errors[2]), item) for item in (here, there)]
    assert all(pictures)
    plain, moved = (np.asarray(image).astype(int) for image in pictures)
    assert (np.abs(plain - moved).max(axis=-1) > 60).mean() < 0.002
    drawn = frame_with_boxes(frame_of(folder, 2, there), [])  # type: ignore[arg-type]
    assert (np.abs(plain - np.asarray(drawn).astype(int)).max(axis=-1) > 60).mean() > 0.01


def test_what_the_masks_are_worth_is_said_where_a_network_finds_them(
    outcomes: dict[Job, Outcome],
) -> None:
    folder = next(path for name, path in outcomes if name == "full")
    rows = {
        ("full", folder): outcomes["full", folder],
        ("f2f-gt", folder): outcomes["full", folder],
    }
    assert "Mask R-CNN" not in markdown(INFO, rows, Cameras.GIVEN)
    rows["maskfusion", folder] = outcomes["full", folder]
    told = markdown(INFO, rows, Cameras.GIVEN)
    assert "masks of maskfusion are those of a Mask R-CNN that has learned from 27,008" in told
