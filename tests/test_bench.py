"""`composenet bench`: rows, resuming, failures, and the same numbers for any number of workers."""

from __future__ import annotations

import importlib
import json
import os
import pickle
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from rich.console import Console

import composenet
from composenet import cli, pipeline
from composenet.baselines import registry
from composenet.baselines.records import Cameras, MaskSource, Row
from composenet.commands import bench, bench_page, jobs
from composenet.commands.score_cache import ScoreCache, kept_sequences, sources_of
from composenet.commands.scoring import VARIANTS, ScoredSequence
from composenet.errors import DataError, WeightsError
from composenet.files import held
from composenet.metrics.clear import ClearScores
from composenet.metrics.evaluate import SequenceScores
from composenet.metrics.hota import hota_scores
from composenet.metrics.identity import IdentityScores
from composenet.synth.dataset import write_split
from composenet.synth.scene import SceneOptions

SIZE = (160, 120)


@pytest.fixture(scope="module")
def three(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three generated sequences of 8 frames."""
    out = tmp_path_factory.mktemp("three")
    write_split("val", 3, out, 0, SceneOptions(frames=8, image_size=SIZE))
    return out


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch):
    """Runs the program in this process, workers too if there is one; returns its exit code."""

    def call(*arguments: object) -> int:
        monkeypatch.setattr(sys, "argv", ["composenet", "bench", *map(str, arguments)])
        with pytest.raises(SystemExit) as stop:
            cli.main()
        return stop.value.code if isinstance(stop.value.code, int) else 0

    return call


class Here:
    """In place of worker processes."""

    def __init__(self, _: int) -> None: ...

    def __enter__(self) -> Here:
        return self

    def __exit__(self, *_: object) -> None: ...

    def submit(self, work, *arguments):
        from concurrent.futures import Future

        future: Future = Future()
        future.set_result(work(*arguments))
        return future


def numbers(out: Path) -> dict:
    """results.json without what may differ from run to run."""
    rows = json.loads((out / "results.json").read_text())["variants"]
    for row in rows.values():
        assert row.pop("seconds_per_frame_median") > 0
    return rows


def test_the_f2f_gt_row_is_the_same_for_any_number_of_workers_and_after_an_interruption(
    run, three: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two processes, undisturbed, against one that ctrl-C stops while the third sequence is read:
    an image of it is a pipe that nobody writes to."""
    data, two, one = tmp_path / "data", tmp_path / "two", tmp_path / "one"
    asked = ["--data", data, "--methods", "f2f-gt"]
    shutil.copytree(three, data)
    assert run(*asked, "--out", two, "--workers", 2) == 0
    rows = numbers(two)
    row = rows["f2f-gt"]
    assert list(rows) == ["f2f-gt"] and row["sequences"] == 3
    assert row["mota_mean"] > 90 and row["id_switches"] == 0
    assert row["det_map25"] is None  # it says nothing of single frames

    image = sorted((data / "val_00002" / "instance").iterdir())[4]
    image.rename(tmp_path / "image.png")
    os.mkfifo(image)
    program = [sys.executable, "-m", "composenet", "bench", *map(str, asked), "--out", str(one)]
    stopped = subprocess.Popen(program, start_new_session=True, stderr=subprocess.PIPE, text=True)
    kept = [one / "sequences" / f"val_0000{i}.f2f-gt.pkl" for i in range(3)]
    while stopped.poll() is None and not kept[1].exists():
        time.sleep(0.05)
    os.killpg(stopped.pid, signal.SIGINT)
    _, errors = stopped.communicate(timeout=60)
    assert (stopped.returncode, errors) == (130, "composenet: interrupted\n")
    assert [path.exists() for path in kept] == [True, True, False]
    (tmp_path / "image.png").replace(image)

    again = []
    real = bench.score_methods

    def noted(folder: Path, names: tuple[str, ...], **others):
        again.append((folder.name, *names))
        return real(folder, names, **others)

    monkeypatch.setattr(bench, "score_methods", noted)
    monkeypatch.setattr(jobs, "worker_pool", Here)
    assert run(*asked, "--out", one) == 0
    assert again == [("val_00002", "f2f-gt")] and numbers(one) == rows
    text = (one / "results.md").read_text()
    assert "Camera poses: given to all alike." in text
    assert (
        "f2f-gt: told true masks, classes and identities; where each track starts (" in text
        and "true centre" in text
    )


def test_the_start_shift_helps_a_system_that_sees_surfaces_only(three: Path) -> None:
    row = registry.ROWS["f2f-gt"]
    shifted, seen = (
        bench.score_system(
            three / "val_00000",
            replace(row, starts_at_true_centre=at_centre),
            Cameras.GIVEN,
            device="cpu",
        )
        for at_centre in (True, False)
    )
    assert shifted.scores.clear.mota > seen.scores.clear.mota + 0.3


def test_a_row_of_ones_own_keeps_its_scores_only_while_it_is_the_same(
    three: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its arguments count, and its code where that is no part of this package."""
    theirs = registry.ROWS["f2f-gt"]
    module = tmp_path / "own_tracker.py"
    module.write_text("def make(_, gate=1):\n    return gate\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    asked, sequence = bench.Asked(Cameras.GIVEN, None, "cpu"), three / "val_00000"

    def key(row: Row) -> bytes:
        monkeypatch.setattr(bench, "ROWS", {"own": row})
        return bench._cache(tmp_path / "out", "own", None, asked)._key(sequence, "own")

    make = importlib.import_module("own_tracker").make
    plain = key(replace(theirs, make=make))
    assert key(replace(theirs, make=make)) == plain
    keys = {plain, key(replace(theirs, make=make, starts_at_true_centre=False))}
    keys |= {key(replace(theirs, make=partial(make, gate=gate))) for gate in (1, 2)}
    keys.add(key(replace(theirs, make=partial(theirs.make, 3))))
    assert len(keys) == 5
    module.write_text("def make(_, gate=2):\n    return gate\n")
    assert key(replace(theirs, make=make)) != plain


def test_the_page_tells_who_is_told_where_tracks_start(monkeypatch: pytest.MonkeyPatch) -> None:
    row = registry.ROWS["maskfusion"]
    monkeypatch.setattr(
        bench_page, "ROWS", {"a": row, "b": replace(row, starts_at_true_centre=False)}
    )
    assert "told where each track starts" in bench_page._row_line("a")
    assert "told nothing" in bench_page._row_line("b")


def test_masks_are_asked_for_on_the_device_that_was_chosen(
    three: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = []

    def noted(folder: Path, device: str) -> MaskSource:
        seen.append(device)
        return registry.ROWS["f2f-gt"].masks(folder, device)

    rows = {"f2f-gt": replace(registry.ROWS["f2f-gt"], masks=noted)}
    monkeypatch.setattr(bench, "ROWS", rows)
    monkeypatch.setattr(pipeline, "select_device", lambda name: f"{name}:1")
    asked = bench.Asked(Cameras.GIVEN, None, "cuda")
    assert list(bench.score_methods(three / "val_00000", ["f2f-gt"], asked=asked)) == ["f2f-gt"]
    assert seen == ["cuda:1"]


def dies_of_one(folder: Path, names: tuple[str, ...]) -> dict[str, ScoredSequence]:
    """Work for a process: one folder kills it, one fails."""
    if folder.name == "deadly":
        os._exit(1)
    if folder.name == "broken":
        raise ZeroDivisionError(*names)
    scores = SequenceScores(ClearScores(tp=3), (), IdentityScores(), hota_scores([]))
    return {name: ScoredSequence(scores, (), ()) for name in names}


def test_a_process_that_dies_takes_no_other_sequence_along(tmp_path: Path) -> None:
    names = ["first", "broken", "deadly", "last"]
    for name in names:
        (tmp_path / name).mkdir()
        (tmp_path / name / "annotations.json").write_text("{}")
    folders = [tmp_path / name for name in names]
    cache = ScoreCache(tmp_path / "kept", [], Path(os.devnull))
    outcomes = jobs.run_jobs(["row"], folders, dies_of_one, cache, 1, Console(quiet=True))
    assert list(outcomes) == [("row", folder) for folder in folders]  # in order, none dropped
    first, broken, deadly, last = outcomes.values()
    assert isinstance(first, ScoredSequence) and isinstance(last, ScoredSequence)
    assert deadly == jobs.DIED and str(broken).startswith("ZeroDivisionError: row (test_bench.py")
    assert sorted(p.name for p in cache.folder.iterdir()) == ["first.row.pkl", "last.row.pkl"]


def test_a_kept_score_that_was_cut_off_is_made_anew(tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    cache = ScoreCache(tmp_path / "kept", [], Path(os.devnull))
    cache.save(tmp_path / "one", "row", dies_of_one(tmp_path / "first", ("row",))["row"])
    assert cache.load(tmp_path / "one", "row") is not None
    (path,) = cache.folder.iterdir()
    for kept in (path.read_bytes()[:-5], path.read_bytes().partition(b"\n")[0] + b"\n"):
        path.write_bytes(kept)
        assert cache.load(tmp_path / "one", "row") is None


def test_scores_are_kept_whatever_a_sequence_is_called(tmp_path: Path) -> None:
    cache = ScoreCache(tmp_path / "kept", [], Path(os.devnull))
    folder = tmp_path / "room v1.2 K\udcfcche"
    folder.mkdir()
    (folder / "annotations.json").write_text("{}")
    outcomes = jobs.run_jobs(["row"], [folder], dies_of_one, cache, 1, Console(quiet=True))
    assert list(outcomes) == [("row", folder)] and cache.load(folder, "row") is not None
    ((name, variant, _),) = kept_sequences(cache.folder)
    assert (name, variant) == (folder.name, "row")


def test_scores_of_an_older_version_are_told_of(tmp_path: Path) -> None:
    scored = dies_of_one(tmp_path / "first", ("row",))["row"]
    del vars(scored)["T_world_source"]
    (tmp_path / "val_00000.full.pkl").write_bytes(b"key\n" + pickle.dumps(scored))
    with pytest.raises(DataError, match=r"older version, without T_world_source"):
        list(kept_sequences(tmp_path))


def test_a_second_run_does_not_keep_scores_in_the_same_folder(tmp_path: Path) -> None:
    cache = ScoreCache(tmp_path / "kept", [], Path(os.devnull))
    with held(cache.folder), pytest.raises(DataError, match="another run is writing"):
        jobs.run_jobs(["row"], [tmp_path], dies_of_one, cache, 1, Console(quiet=True))


def test_a_page_is_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str], run) -> None:
    data = tmp_path / "data"
    for report in (tmp_path, tmp_path / "page"):
        assert run("--data", data, "--out", tmp_path / "out", "--report", report) == 2
        assert "name a file" in capsys.readouterr().err


def test_a_failing_sequence_is_named_and_the_others_are_scored(
    run, capsys, three: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data, out = tmp_path / "data", tmp_path / "out"
    shutil.copytree(three, data)
    shutil.rmtree(data / "val_00001" / "instance")
    monkeypatch.setattr(jobs, "worker_pool", Here)
    assert run("--data", data, "--methods", "f2f-gt", "--out", out) == 1
    errors = capsys.readouterr().err
    assert "not scored: val_00001 (f2f-gt)" in errors and "no readable instance image" in errors
    assert errors.count("\n") == 1 and "Traceback" not in errors
    assert numbers(out)["f2f-gt"]["sequences"] == 2
    assert "not scored: val_00001 (f2f-gt)" in (out / "results.md").read_text()
    (line,) = json.loads((out / "results.json").read_text())["not_scored"]
    assert "val_00001 (f2f-gt)" in line


@pytest.mark.parametrize(
    ("camera", "methods"), [(Cameras.GIVEN, "full,f2f-gt"), (Cameras.ESTIMATED, "no-corr")]
)
def test_our_variants_stand_in_the_same_table(
    run, camera: Cameras, methods: str, recordings: Path, tiny_weights: Path, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    data = tmp_path / "data"
    shutil.copytree(recordings / "val_00000", data / "val_00000")
    monkeypatch.setattr(jobs, "worker_pool", Here)
    common = ["--data", data, "--out", tmp_path / "out", "--weights", tiny_weights]
    page = tmp_path / "docs" / "benchmark.md"
    common += ["--methods", methods, "--camera", camera.value, "--report", page]
    assert run(*common) == 0
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    assert list(results["variants"]) == [n for n in ("f2f-gt", "no-corr", "full") if n in methods]
    assert results["weights"].startswith("tiny.safetensors")
    text = page.read_text()
    assert f"Camera poses: {camera.value}" in text and "## Where each system fails" in text
    assert all((page.parent / link).is_file() for link in re.findall(r"\]\((.*)\)", text))
    assert not (tmp_path / "out" / "results.md").exists()


def test_rows_without_their_weights_are_left_out_of_all(
    run, capsys, three: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Named one by one, they are an error before anything has run."""

    def missing() -> Path:
        raise WeightsError("nowhere.safetensors: no weights; make them")

    rows = {"f2f-gt": registry.ROWS["f2f-gt"]}
    rows["untaught"] = replace(rows["f2f-gt"], weights=missing)
    monkeypatch.setattr(bench, "ROWS", rows)
    monkeypatch.setattr(bench, "METHODS", tuple(rows))
    monkeypatch.setattr(jobs, "worker_pool", Here)
    one = tmp_path / "data"
    shutil.copytree(three / "val_00000", one / "val_00000")
    common = ["--data", one, "--out", tmp_path / "out", "--methods"]
    assert run(*common, "all") == 0
    assert "without untaught: nowhere.safetensors: no weights" in capsys.readouterr().out
    assert list(numbers(tmp_path / "out")) == ["f2f-gt"]
    assert run(*common, "f2f-gt,untaught") == 2
    assert "nowhere.safetensors: no weights" in capsys.readouterr().err


def test_the_rows_and_their_order() -> None:
    names = bench.chosen_methods(["all"])
    assert names == [*registry.ROWS, "no-corr-no-compl", "no-corr", "no-compl", "full"]
    assert set(VARIANTS).isdisjoint(registry.ROWS)
    assert bench.chosen_methods(["full", "f2f-gt"]) == ["f2f-gt", "full"]
    with pytest.raises(DataError, match="'best': expected some of all, f2f-gt"):
        bench.chosen_methods(["full", "best"])


BAD = [
    (["--data", "{tmp}/none", "--out", "{tmp}/o"], "no such folder"),
    (["--data", "{data}", "--out", "{tmp}/o", "--methods", "f2f-gt,best"], "best"),
    (["--data", "{data}", "--out", "{tmp}/o", "--camera", "guessed"], "guessed"),
    (["--data", "{data}", "--out", "{tmp}/o", "--workers", "0"], "--workers"),
    (["--data", "{data}", "--out", "{tmp}/o", "--weights", "{tmp}/none"], "none"),
    (
        ["--data", "{data}", "--out", "{tmp}/o", "--methods", "f2f-gt", "--device", "cuda:99"],
        "--device cuda:99",
    ),
]


@pytest.mark.parametrize(("arguments", "names"), BAD)
def test_bad_input_is_one_line(run, capsys, three: Path, tmp_path: Path, arguments, names) -> None:
    assert run(*(a.format(tmp=tmp_path, data=three) for a in arguments)) == 2
    errors = capsys.readouterr().err
    assert errors.startswith("composenet: ") and errors.count("\n") == 1 and names in errors


def test_it_explains_itself(run, capsys) -> None:
    assert run("--help") == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "usage: composenet bench" in text and "--camera" in text
    assert all(name in text for name in bench.METHODS)


def test_what_a_row_is_made_of() -> None:
    """Its own code and what that imports, lazily or not; no other system's, and nothing of ours."""
    package = Path(composenet.__file__).parent

    def made_of(name: str) -> set[str]:
        return {str(p.relative_to(package)) for p in sources_of(*bench.made_by(name))}

    fusion = made_of("maskfusion")
    ours = {str(p.relative_to(package)) for p in sources_of("composenet.commands.variants")}
    assert {"baselines/surfels.py", "baselines/mask_rcnn_network.py", "errors.py"} <= fusion
    assert {"metrics/clear.py", "geometry/__init__.py", "commands/rows.py"} <= fusion
    assert not {"pipeline.py", "network/model.py", "baselines/mid_fusion.py"} & fusion
    assert "baselines/mask_rcnn_network.py" not in made_of("maskfusion-gt-masks")
    assert {"pipeline.py", "network/sparse.py", "tracking/tracker.py"} <= ours
    assert "baselines/surfels.py" not in ours
