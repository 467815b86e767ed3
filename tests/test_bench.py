"""`composenet bench`: rows, resuming, failures, and the same numbers for any number of workers."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import pytest

from composenet import cli
from composenet.baselines import registry
from composenet.baselines.records import Cameras
from composenet.commands import bench, evaluate
from composenet.commands.evaluate import VARIANTS
from composenet.errors import DataError
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


def test_the_f2f_gt_row_resumes_and_is_the_same_for_any_number_of_workers(
    run, three: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one, two = tmp_path / "one", tmp_path / "two"
    asked = ["--data", three, "--methods", "f2f-gt"]
    assert run(*asked, "--out", two, "--workers", 2) == 0
    monkeypatch.setattr(evaluate, "_pool", Here)
    assert run(*asked, "--out", one) == 0
    rows = numbers(one)
    assert rows == numbers(two) and list(rows) == ["f2f-gt"]
    row = rows["f2f-gt"]
    assert row["sequences"] == 3 and row["mota_mean"] > 60 and row["id_switches"] == 0
    assert row["det_map25"] is None  # it says nothing of single frames

    text = (one / "results.md").read_text()
    assert "Camera poses: given to all alike." in text
    assert "f2f-gt: true masks, classes and identities." in text and "true centre" in text

    (one / "sequences" / "val_00001.f2f-gt.pkl").unlink()  # only this one is run again
    again = []
    real = bench.score_method

    def noted(folder: Path, name: str, **others):
        again.append((folder.name, name))
        return real(folder, name, **others)

    monkeypatch.setattr(bench, "score_method", noted)
    assert run(*asked, "--out", one) == 0
    assert again == [("val_00001", "f2f-gt")] and numbers(one) == rows


def test_a_failing_sequence_is_named_and_the_others_are_scored(
    run, capsys, three: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data, out = tmp_path / "data", tmp_path / "out"
    shutil.copytree(three, data)
    shutil.rmtree(data / "val_00001" / "instance")
    monkeypatch.setattr(evaluate, "_pool", Here)
    assert run("--data", data, "--methods", "f2f-gt", "--out", out) == 1
    errors = capsys.readouterr().err
    assert "not scored: val_00001 (f2f-gt)" in errors and "no readable instance image" in errors
    assert errors.count("\n") == 1 and "Traceback" not in errors
    assert numbers(out)["f2f-gt"]["sequences"] == 2
    assert "not scored: val_00001 (f2f-gt)" in (out / "results.md").read_text()


@pytest.mark.parametrize("camera", list(Cameras))
def test_our_variants_stand_in_the_same_table(
    run, camera: Cameras, recordings: Path, tiny_weights: Path, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    data = tmp_path / "data"
    shutil.copytree(recordings / "val_00000", data / "val_00000")
    monkeypatch.setattr(evaluate, "_pool", Here)
    methods = "full,f2f-gt,no-corr"
    common = ["--data", data, "--out", tmp_path / "out", "--weights", tiny_weights]
    assert run(*common, "--methods", methods, "--camera", camera.value) == 0
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    assert list(results["variants"]) == ["f2f-gt", "no-corr", "full"]
    assert results["weights"].startswith("tiny.safetensors")
    text = (tmp_path / "out" / "results.md").read_text()
    assert f"Camera poses: {camera.value}" in text


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
