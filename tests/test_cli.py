"""The program: help, one-line errors, and the whole path from a scene to its score."""

from __future__ import annotations

import dataclasses
import json
import os
import pickle
import platform
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import composenet
from composenet import cli
from composenet.commands import jobs, scoring, variants
from composenet.commands.score_cache import ScoreCache, kept_sequences
from composenet.errors import DataError
from composenet.metrics.tracklets import TrackletCompletion
from composenet.predictions import read_predictions
from composenet.synth.sequence_folder import read_truth

COMMANDS = ("demo", "synth", "train", "track", "eval", "view")
PROGRAM = [sys.executable, "-m", "composenet"]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch):
    """Runs the program in this process; returns its exit code."""

    def call(*arguments: object) -> int:
        monkeypatch.setattr(sys, "argv", ["composenet", *map(str, arguments)])
        with pytest.raises(SystemExit) as stop:
            cli.main()
        return stop.value.code if isinstance(stop.value.code, int) else 0

    return call


def test_help_is_instant_and_does_not_import_torch() -> None:
    code = (
        "import sys, composenet.cli as c\n"
        "sys.argv = ['composenet', '--help']\n"
        "try: c.main()\n"
        "except SystemExit as stop: code = stop.code\n"
        "slow = {'torch', 'numba', 'trimesh', 'plotly', 'skimage'} & set(sys.modules)\n"
        "assert not slow, slow\n"
        "sys.exit(code)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert all(name in done.stdout for name in COMMANDS)


def test_ctrl_c_while_it_starts_is_no_traceback() -> None:
    code = (
        "import sys\n"
        "class Press:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'tyro': raise KeyboardInterrupt\n"
        "sys.meta_path.insert(0, Press())\n"
        "from composenet.__main__ import main\n"
        "main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (130, "composenet: interrupted\n")


@pytest.mark.parametrize(("asked", "used"), [(None, "passive"), ("active", "active")])
def test_threads_wait_asleep_unless_asked_otherwise(
    asked: str | None, used: str, tmp_path: Path
) -> None:
    """Looked up at the first import of torch, which reads it once."""
    code = (
        "import os, sys\n"
        "class Watch:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'torch': sys.exit('torch meets ' + os.environ['OMP_WAIT_POLICY'])\n"
        "sys.meta_path.insert(0, Watch())\n"
        "from composenet import cli\n"
        "cli.main()"
    )
    environment = {k: v for k, v in os.environ.items() if k != "OMP_WAIT_POLICY"}
    done = subprocess.run(
        [sys.executable, "-c", code, "demo", "--out", str(tmp_path)],
        capture_output=True,
        text=True,
        env=environment | ({"OMP_WAIT_POLICY": asked} if asked else {}),
    )
    assert done.stderr == f"torch meets {used}\n"


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="glibc's own settings")
@pytest.mark.parametrize("asked", [None, "131072"])
def test_freed_memory_is_kept_for_what_comes_next(asked: str | None) -> None:
    """Faults of this process and of one that it starts, for ten arrays of 40 MB one after the
    other: 10,000 pages each, unless the second has the memory of the first."""
    code = (
        "import os, resource, subprocess, sys\n"
        "import numpy as np\n"
        "from composenet import cli\n"
        "if len(sys.argv) == 1:\n"
        "    cli.parse_command = lambda _: None\n"
        "    cli._guarded = lambda _: 0\n"
        "    try: cli.main()\n"
        "    except SystemExit: pass\n"
        "before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt\n"
        "for _ in range(10): np.ones(5_000_000)\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before, flush=True)\n"
        "if len(sys.argv) == 1: subprocess.run([sys.executable, '-c', os.environ['CODE'], '2'])"
    )
    environment = {k: v for k, v in os.environ.items() if not k.startswith("MALLOC_")}
    environment |= {"CODE": code, "NUMPY_MADVISE_HUGEPAGE": "0"}
    environment |= {"MALLOC_TRIM_THRESHOLD_": asked} if asked else {}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=environment
    )
    faults = [int(line) for line in done.stdout.split()]
    assert len(faults) == 2, done.stderr
    assert all((count > 50_000) == bool(asked) for count in faults), faults


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(run, capsys: pytest.CaptureFixture, command: str) -> None:
    assert run(command, "--help") == 0
    text = " ".join(capsys.readouterr().out.split())
    assert f"usage: composenet {command}" in text
    assert "--out" in text or command == "view"


def test_version(run, capsys: pytest.CaptureFixture) -> None:
    assert run("--version") == 0
    assert capsys.readouterr().out == f"composenet {composenet.__version__}\n"
    assert run("--help") == 0
    assert "--version" in capsys.readouterr().out


BAD_ARGUMENTS = [
    (["track", "{tmp}/none", "--out", "{tmp}/out"], "no such folder"),
    (["track", "{data}/val_00000"], "--out"),
    (["track", "{data}/val_00000", "--out", "{tmp}/out", "--stride", "-2"], "--stride"),
    (["track", "{data}/val_00000", "--out", "{tmp}/out", "--save-every", "0"], "--save-every"),
    (["track", "{data}/val_00000", "--out", "{tmp}/out", "--max-depth-m", "0"], "--max-depth-m"),
    (["track", "{data}/val_00000", "--out", "{tmp}/out", "--intrinsics", "1,2"], "four numbers"),
    (["track", "{data}/val_00000", "--out", "{tmp}/out", "--variant", "best"], "no-compl"),
    (["track", "{data}/val_00000", "--out", "{tmp}/out", "--weights", "{tmp}/bad"], "safetensors"),
    (["track", "{data}/val_00000", "--out", "{tmp}/out", "--weights", "{tmp}/no"], "no such"),
    (
        ["track", "{data}/val_00000", "--out", "{tmp}/out", "--weights", "{good}", "--device", "x"],
        "--device",
    ),
    (["track", "{data}/val_00000", "--out", "{tmp}/bad/out", "--weights", "{good}"], "bad/out"),
    (["track", "{data}/val_00000", "--out", "{data}/val_00000"], "recording itself"),
    (["synth", "--out", "{tmp}/bad/out"], "Not a directory"),
    (["synth"], "--out"),
    (["synth", "--stats", "--count", "-1"], "--count"),
    (["synth", "--out", "{tmp}/s", "--cad", "{tmp}/none"], "none"),
    (["train", "--out", "{tmp}/t", "--data-share", "0.5"], "--data-share is of the sequences"),
    (["train", "--out", "{tmp}/t", "--data", "{tmp}", "--data-share", "0.1"], "no sequences here"),
    (["train", "--out", "{tmp}/bad/out"], "Not a directory"),
    (["train", "--out", "{tmp}/t", "--max-minutes", "0"], "--max-minutes"),
    (["train", "--out", "{tmp}/t", "--config", "{tmp}/bad"], "bad"),
    (["train", "--out", "{tmp}/t", "--device", "tpu"], "--device"),
    (["eval", "--data", "{tmp}/none", "--out", "{tmp}/e"], "no such folder"),
    (["eval", "--data", "{tmp}", "--out", "{tmp}/e"], "nothing to score"),
    (["eval", "--data", "{data}", "--out", "{tmp}/e", "--variants", "full,best"], "best"),
    (["eval", "--data", "{data}", "--out", "{tmp}/e", "--weights", "{tmp}/bad"], "safetensors"),
    (["eval", "--data", "{data}", "--out", "{tmp}/e", "--workers", "0"], "--workers"),
    (["view", "{tmp}"], "no report"),
    (["fly"], "fly"),
    ([], "demo, synth"),
]


@pytest.mark.parametrize(("arguments", "names"), BAD_ARGUMENTS)
def test_bad_input_is_one_line(
    run,
    capsys: pytest.CaptureFixture,
    recordings: Path,
    tiny_weights: Path,
    tmp_path: Path,
    arguments: list[str],
    names: str,
) -> None:
    (tmp_path / "bad").write_text("this is nothing that a command can use")
    given = [a.format(tmp=tmp_path, data=recordings, good=tiny_weights) for a in arguments]
    assert run(*given) == 2
    errors = capsys.readouterr().err
    assert errors.startswith("composenet: ") and errors.count("\n") == 1 and errors[-1] == "\n"
    assert names in errors and "Traceback" not in errors


def test_bad_input_of_the_installed_program(tmp_path: Path) -> None:
    command = [*PROGRAM, "track", str(tmp_path / "none"), "--out", str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_file_as_recording_costs_nothing(
    run, capsys: pytest.CaptureFixture, tmp_path: Path
) -> None:
    own, other, out = tmp_path / "x.sens", tmp_path / "x.zip", tmp_path / "out"
    for path in (own, other):
        path.write_bytes(b"something")
    assert run("track", str(own), "--out", str(own)) == 2
    assert "recording itself" in capsys.readouterr().err
    assert run("track", str(other), "--out", str(out)) == 2
    assert "is a file" in capsys.readouterr().err and not out.exists()
    assert own.read_bytes() == other.read_bytes() == b"something"


@pytest.fixture(scope="module")
def tracked(recordings: Path, tiny_weights: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The result of `track` for the first sequence."""
    out = tmp_path_factory.mktemp("tracked")
    with pytest.MonkeyPatch.context() as patch:
        arguments = ["track", recordings / "val_00000", "--out", out / "val_00000"]
        arguments += ["--weights", tiny_weights]
        patch.setattr(sys, "argv", ["composenet", *map(str, arguments)])
        with pytest.raises(SystemExit) as stop:
            cli.main()
        assert stop.value.code == 0
    return out


def test_track_writes_what_it_found(tracked: Path, recordings: Path) -> None:
    result = read_predictions(tracked / "val_00000")
    assert result.complete and len(result.frames) == 6
    assert result.weights_id.startswith("tiny.safetensors sha256:")
    assert result.class_ids and set(result.canonical) == set(result.class_ids)
    for frame in result.frames:
        pose = np.loadtxt(recordings / "val_00000" / "pose" / f"{frame.name}.txt")
        np.testing.assert_allclose(frame.T_world_camera, pose, atol=0.1)  # levelled, not moved
    for name in ("report.html", "config.json", "timings.json", "tracks.txt"):
        assert (tracked / "val_00000" / name).stat().st_size > 0


def test_eval_of_predictions(run, tracked: Path, recordings: Path, tmp_path: Path) -> None:
    data = recordings / "val_00000"
    assert run("eval", "--data", data, "--out", tmp_path, "--predictions", tracked) == 0
    results = json.loads((tmp_path / "results.json").read_text())
    assert results["variants"]["predictions"]["sequences"] == 1
    assert (tmp_path / "results.md").read_text().startswith("Data ")


def test_the_reconstructions_of_predictions_are_scored(
    run, tracked: Path, recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = [TrackletCompletion(1, 1, 5, 0.25), TrackletCompletion(2, 3, 1, 0.75)]
    monkeypatch.setattr(scoring, "tracklet_completions", lambda *_: given)
    data = recordings / "val_00000"
    assert run("eval", "--data", data, "--out", tmp_path, "--predictions", tracked) == 0
    assert numbers(tmp_path)["predictions"]["track_iou"] == 50
    assert "track IoU %" in (tmp_path / "results.md").read_text()


def test_a_result_of_another_sequence_of_the_same_name_is_not_scored(
    run, capsys, tracked: Path, recordings: Path, tmp_path: Path
) -> None:
    own = tmp_path / "other" / "val_00000"
    shutil.copytree(recordings / "val_00000", own)
    path = own / "pose" / "3.txt"
    elsewhere = np.loadtxt(path)
    elsewhere[0, 3] += 0.05
    np.savetxt(path, elsewhere, fmt="%.17g")
    scores = ("--out", tmp_path / "scores", "--predictions", tracked)
    assert run("eval", "--data", own, *scores) == 1
    assert "its camera is elsewhere than that of" in (said := capsys.readouterr().err)
    assert "in frame 3" in said


def test_a_result_without_poses_is_not_scored(
    run, capsys, recordings: Path, tiny_weights: Path, tmp_path: Path
) -> None:
    """Each of its frames has a world of its own."""
    own, blind, out = recordings / "val_00000", tmp_path / "val_00000", tmp_path / "result"
    shutil.copytree(own, blind)
    shutil.rmtree(blind / "pose")
    assert run("track", blind, "--out", out, "--weights", tiny_weights) == 0
    assert run("eval", "--data", own, "--out", tmp_path / "s", "--predictions", out) == 1
    assert "tracked without poses" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["eval", "bench"])
def test_a_frame_that_is_gone_does_not_shift_the_truth(
    run, capsys, recordings: Path, tiny_weights: Path, tmp_path: Path, command: str
) -> None:
    data = tmp_path / "val_00000"
    shutil.copytree(recordings / "val_00000", data)
    for name in ("depth/2.png", "color/2.jpg"):
        (data / name).unlink()
    rows = ("--methods", "f2f-gt") if command == "bench" else ()
    options = ("--weights", tiny_weights, "--out", tmp_path / "out")
    assert run(command, "--data", data, *options, *rows) == 1
    assert "5 frames, but annotations.json tells of 6" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("there", "said"),
    [
        ('{"mine": 1}', "a results.json that is not ours"),
        ("{", "a results.json that is not ours"),
        ('{"variants": {}, "data": "test"}', "the scores of 'test'"),
    ],
)
@pytest.mark.parametrize("command", ["eval", "bench"])
def test_scores_of_other_data_are_not_replaced(
    run, capsys, recordings: Path, tiny_weights: Path, tmp_path: Path,
    there: str, said: str, command: str,
) -> None:  # fmt: skip
    (tmp_path / "results.json").write_text(there)
    rows = ("--methods", "f2f-gt") if command == "bench" else ()
    options = ("--weights", tiny_weights, "--out", tmp_path)
    assert run(command, "--data", recordings / "val_00000", *options, *rows) == 2
    assert said in capsys.readouterr().err
    assert (tmp_path / "results.json").read_text() == there


def test_scores_of_predictions_are_kept_for_comparisons(
    run, tracked: Path, recordings: Path, tmp_path: Path
) -> None:
    data = recordings / "val_00000"
    assert run("eval", "--data", data, "--out", tmp_path, "--predictions", tracked) == 0
    ((name, kind, scored),) = kept_sequences(tmp_path / "sequences")
    assert (name, kind) == ("val_00000", "predictions")
    mota = numbers(tmp_path)["predictions"]["mota_mean"]
    assert 100 * scored.scores.clear.mota == pytest.approx(mota)


def test_each_frame_is_told_of_once(
    run, capsys, tracked: Path, recordings: Path, tmp_path: Path
) -> None:
    copy, own = tmp_path / "copy", recordings / "val_00000"
    shutil.copytree(tracked / "val_00000", copy)
    data = json.loads((copy / "tracks.json").read_text())
    whole = data["frames"]
    options = ["eval", "--data", own, "--out", tmp_path / "scores", "--predictions", copy]
    for frames, said in (
        ([*whole, whole[0]], "of a frame twice"),
        ([whole[0], *whole[:-1]], "5 of the 6 frames of val_00000, not of frame 5"),
    ):
        (copy / "tracks.json").write_text(json.dumps(data | {"frames": frames}))
        assert run(*options) == 1
        assert said in capsys.readouterr().err


def test_predictions_are_scored_against_their_own_sequence(
    run, capsys, tracked: Path, recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own, other = recordings / "val_00000", recordings / "val_00001"
    result = tracked / "val_00000"
    options = ["--out", tmp_path / "scores", "--predictions"]
    for given in (f"{own}/", f"{other}/../val_00000"):
        assert run("eval", "--data", given, *options, result) == 0
    (tmp_path / "linked").symlink_to(own)
    assert run("eval", "--data", tmp_path / "linked", *options, result) == 0
    monkeypatch.chdir(own)
    for predictions in (tracked, result):
        assert run("eval", "--data", ".", *options, predictions) == 0
    capsys.readouterr()
    options[1] = tmp_path / "others"
    assert run("eval", "--data", other, *options, result) == 1
    said = capsys.readouterr().err
    assert "'val_00000'" in said and "'val_00001'" in said and said.count("\n") == 1
    # Of a folder of sequences, the one that it belongs to is scored.
    options[1] = tmp_path / "both"
    assert run("eval", "--data", recordings, *options, result) == 1
    assert numbers(tmp_path / "both")["predictions"]["sequences"] == 1


def test_predictions_of_some_frames_are_not_scored_as_all(
    run, capsys, recordings: Path, tiny_weights: Path, tmp_path: Path
) -> None:
    own, out = recordings / "val_00000", tmp_path / "some"
    assert run("track", own, "--out", out, "--weights", tiny_weights, "--max-frames", 4) == 0
    scores = ("--out", tmp_path / "scores", "--predictions", out)
    assert run("eval", "--data", own, *scores) == 1
    assert "tells of 4 of the 6 frames of val_00000" in capsys.readouterr().err


def test_perfect_predictions_score_perfectly(recordings: Path, tracked: Path) -> None:
    """The truth itself, in the world of the tracker, has MOTA 1: frames and ids line up."""
    from composenet.commands.scoring import moved_truth
    from composenet.metrics.evaluate import evaluate_sequence
    from composenet.records import Similarity, TrackedObject, TrackState

    truth = read_truth(recordings / "val_00000")
    shift = np.eye(4)
    shift[:3, 3] = (3.0, -2.0, 0.5)
    moved = moved_truth(truth, shift)
    classes = {item.gt_id: item for item in truth.objects}
    frames = [
        tuple(
            TrackedObject(
                o.gt_id, i, classes[o.gt_id].class_id, TrackState.TRACKED, 1.0, o.box,
                Similarity(1.0, np.eye(3), o.box.center), classes[o.gt_id].extents_m, True,
            )
            for o in frame
        )
        for i, frame in enumerate(moved.frames)
    ]  # fmt: skip
    assert evaluate_sequence(moved, frames).clear.mota == 1
    for frame, before in zip(moved.frames, truth.frames, strict=True):
        for a, b in zip(frame, before, strict=True):
            np.testing.assert_allclose(a.box.center - b.box.center, [3, -2, 0.5], atol=1e-4)
            np.testing.assert_allclose(a.box.extents, b.box.extents, atol=1e-4)


def numbers(out: Path) -> dict:
    """results.json without what may differ from run to run."""
    results = json.loads((out / "results.json").read_text())
    for scores in results["variants"].values():
        scores.pop("seconds_per_frame_median")
    return results["variants"]


class _Here:
    """In place of worker processes."""

    def __enter__(self):
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def submit(self, work, *arguments):
        from concurrent.futures import Future

        future: Future = Future()
        future.set_result(work(*arguments))
        return future


def kept(out: Path, name: str) -> dict:
    """All scores of a finished sequence, but for its times."""
    _, _, stored = (out / "sequences" / f"{name}.full.pkl").read_bytes().partition(b"\n")
    scores = pickle.loads(stored).scores
    return dataclasses.asdict(dataclasses.replace(scores, seconds_per_frame=()))


def test_eval_gives_the_same_for_any_number_of_workers_and_goes_on(
    run, recordings: Path, tiny_weights: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    common = ["eval", "--data", recordings, "--weights", tiny_weights]
    one, two = tmp_path / "one", tmp_path / "two"
    assert run(*common, "--out", two, "--workers", 2) == 0
    monkeypatch.setattr(jobs, "worker_pool", lambda _: _Here())
    again = [*common, "--out", one]
    assert run(*again) == 0
    assert numbers(one)["full"] == numbers(two)["full"]
    for name in ("val_00000", "val_00001"):
        np.testing.assert_equal(kept(one, name), kept(two, name))

    before = numbers(one)
    (one / "sequences" / "val_00001.full.pkl").unlink()  # only this one is scored again
    asked = []
    real = variants.score_variants

    def noted(folder: Path, names: tuple[str, ...], **others: object):
        asked.append((folder.name, names))
        return real(folder, names, **others)

    monkeypatch.setattr(variants, "score_variants", noted)
    assert run(*again) == 0
    assert asked == [("val_00001", ("full",))] and numbers(one) == before
    # A variant gives the same beside others, and only what is missing is asked for.
    alone = numbers(one)["full"]
    assert run(*again, "--variants", "full,no-compl,no-corr") == 0
    assert asked[1:] == [(name, ("no-compl", "no-corr")) for name in ("val_00000", "val_00001")]
    assert numbers(one)["full"] == alone
    together = tmp_path / "together"
    assert run(*common, "--out", together, "--variants", "no-corr,offline,full,no-compl") == 0
    assert {k: numbers(together)[k] for k in numbers(one)} == numbers(one)
    assert numbers(together)["offline"] != alone


def test_eval_with_another_configuration(
    run, capsys, tracked: Path, recordings: Path, tiny_weights: Path, tmp_path: Path
) -> None:
    """Which replaces the weights' own, is part of what is kept, and is none of `predictions`."""
    plain = json.loads((tracked / "val_00000" / "config.json").read_text())
    silent = plain | {
        "tracking": plain["tracking"] | {"min_confidence": 1.0, "keep_confidence": 1.0}
    }
    path, out = tmp_path / "silent.json", tmp_path / "scores"
    path.write_text(json.dumps(silent))
    common = ["eval", "--data", recordings / "val_00000", "--out", out]
    assert run(*common, "--weights", tiny_weights) == 0
    online = numbers(out)["full"]
    assert online["false_positives"] > 0
    assert run(*common, "--weights", tiny_weights, "--config", path) == 0
    assert numbers(out)["full"]["false_positives"] == 0
    back = tmp_path / "back.json"  # looking back is the variant's to say
    back.write_text(json.dumps(plain | {"tracking": plain["tracking"] | {"offline": True}}))
    assert run(*common, "--weights", tiny_weights, "--config", back) == 0
    assert numbers(out)["full"] == online
    for option, value in (("--config", path), ("--weights", tiny_weights)):
        assert run(*common, "--predictions", tracked, option, value) == 2
        assert f"{option} is for tracking, not for --predictions" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("way", "variant"), [("offline", "full"), ("offline-no-corr-no-compl", "no-corr-no-compl")]
)
def test_looking_back_is_scored_as_it_is_written(
    run, recordings: Path, tiny_weights: Path, tmp_path: Path, way: str, variant: str
) -> None:
    scores, written = tmp_path / "scores", tmp_path / "written"
    common, tracks = ["eval", "--data", recordings], tmp_path / "tracks"
    assert run(*common, "--out", scores, "--weights", tiny_weights, "--variants", way) == 0
    for name in ("val_00000", "val_00001"):
        options = ["--weights", tiny_weights, "--offline", "--variant", variant]
        assert run("track", recordings / name, *options, "--out", tracks / name) == 0
    assert run(*common, "--out", written, "--predictions", tracks) == 0
    ours, theirs = numbers(scores)[way], numbers(written)["predictions"]
    keys = ("mota_mean", "mota_pooled", "mota_per_class", "id_switches", "idf1", "hota")
    assert [ours[key] for key in keys] == [theirs[key] for key in keys]
    assert ours["mota_pooled"] != 0


def test_without_poses_it_is_scored_as_it_is_written(
    run, recordings: Path, tiny_weights: Path, tmp_path: Path
) -> None:
    """In a world of its own, levelled by what it sees; a frame that it cannot use is left out."""
    data, tracks = tmp_path / "val_00000", tmp_path / "tracks"
    shutil.copytree(recordings / "val_00000", data)
    blank = np.zeros_like(np.array(Image.open(data / "depth" / "2.png")))
    Image.fromarray(blank).save(data / "depth" / "2.png")
    scores, written, options = tmp_path / "scores", tmp_path / "written", ["--data", data]
    rows = ["--methods", "full", "--camera", "estimated", "--weights", tiny_weights]
    assert run("bench", *options, *rows, "--out", scores) == 0
    assert run("track", data, "--odometry", "--weights", tiny_weights, "--out", tracks) == 0
    assert read_predictions(tracks).skipped == (2,)
    assert run("eval", *options, "--out", written, "--predictions", tracks) == 0
    ours, theirs = numbers(scores)["full"], numbers(written)["predictions"]
    keys = ("counted", "tracked", "false_positives", "mota_pooled", "idf1", "hota")
    assert [ours[key] for key in keys] == [theirs[key] for key in keys]
    assert ours["mota_pooled"] != 0
    assert run("eval", *options, "--weights", tiny_weights, "--out", tmp_path / "given") == 0
    assert numbers(tmp_path / "given")["full"]["counted"] == ours["counted"]


def test_one_bad_sequence_does_not_stop_the_others(
    run, capsys, recordings: Path, tiny_weights: Path, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    data = tmp_path / "data"
    shutil.copytree(recordings, data)
    shutil.rmtree(data / "val_00000" / "depth")
    monkeypatch.setattr(jobs, "worker_pool", lambda _: _Here())
    common = ["eval", "--data", data, "--out", tmp_path / "out"]
    assert run(*common, "--weights", tiny_weights) == 1
    errors = capsys.readouterr().err
    assert "val_00000" in errors and errors.count("\n") == 1 and "Traceback" not in errors
    assert numbers(tmp_path / "out")["full"]["sequences"] == 1
    assert "not scored: val_00000" in (tmp_path / "out" / "results.md").read_text()
    assert run(*common, "--predictions", tmp_path) == 1  # nobody tracked anything
    assert capsys.readouterr().err.count("not scored") == 2


CODE = ["composenet.commands.rows"]


def test_scores_are_kept_only_for_what_made_them(tmp_path: Path, recordings: Path) -> None:
    weights, sequence = tmp_path / "w", tmp_path / "val_00000"
    weights.write_bytes(b"weights")
    sequence.mkdir()
    (sequence / "annotations.json").write_text("{}")
    folder = tmp_path / "kept"
    ScoreCache(folder, CODE, weights, "cpu", False).save(sequence, "full", "scores")  # type: ignore[arg-type]
    assert ScoreCache(folder, CODE, weights, "cpu", False).load(sequence, "full") == "scores"
    assert ScoreCache(folder, CODE, weights, "cpu", False).load(sequence, "no-corr") is None
    assert ScoreCache(folder, CODE, weights, "cpu", True).load(sequence, "full") is None
    (sequence / "depth").mkdir()
    (sequence / "depth/0.png").write_bytes(b"other images")
    assert ScoreCache(folder, CODE, weights, "cpu", False).load(sequence, "full") is None
    (sequence / "depth/0.png").unlink()
    assert ScoreCache(folder, CODE, weights, "cpu", False).load(sequence, "full") == "scores"
    (sequence / "annotations.json").write_text("[]")
    assert ScoreCache(folder, CODE, weights, "cpu", False).load(sequence, "full") is None
    (sequence / "annotations.json").write_text("{}")
    weights.write_bytes(b"better")
    assert ScoreCache(folder, CODE, weights, "cpu", False).load(sequence, "full") is None
    ours = ["composenet.commands.variants"]
    weights.write_bytes(b"weights")
    ScoreCache(folder, CODE, weights, "cpu", False).save(sequence, "full", "scores")  # type: ignore[arg-type]
    assert ScoreCache(folder, ours, weights, "cpu", False).load(sequence, "full") is None
    # A pickle of another origin is not even opened.
    (folder / "val_00000.full.pkl").write_bytes(pickle.dumps(DataError("no")))
    assert ScoreCache(folder, CODE, weights, "cpu", False).load(sequence, "full") is None


def test_ctrl_c_keeps_the_frames_that_are_done(
    recordings: Path, tiny_weights: Path, tmp_path: Path
) -> None:
    """The signal comes while the third frame is tracked; it is finished, the rest is left."""
    code = (
        "import os, signal, sys\n"
        "from composenet import cli, pipeline\n"
        "track, seen = pipeline.ObjectTracker.look, []\n"
        "def call(self, frame):\n"
        "    seen.append(frame)\n"
        "    if len(seen) == 3: os.killpg(0, signal.SIGINT)\n"
        "    return track(self, frame)\n"
        "pipeline.ObjectTracker.look = call\n"
        "cli.main()"
    )
    arguments = ["track", recordings / "val_00000", "--out", tmp_path, "--weights", tiny_weights]
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        capture_output=True,
        text=True,
        start_new_session=True,
        env={**os.environ},
    )
    assert done.returncode == 130, done.stderr
    assert done.stderr == "" and "interrupted" in done.stdout
    result = read_predictions(tmp_path)
    assert not result.complete and len(result.frames) == 3
    assert (tmp_path / "report.html").is_file()


def test_ctrl_c_before_anything_began(run, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    def interrupted(*_: object, **__: object) -> None:
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr("composenet.commands.demo.run_demo", interrupted)
    assert run("demo") == 130
    assert capsys.readouterr().err == "composenet: interrupted\n"
