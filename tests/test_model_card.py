"""The model card says what the shipped weights and the results say."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from model_card import BEGIN, COLUMNS, END, ROOT, figures, refreshed

from composenet.network.weights import default_weights, weights_id
from composenet.records import CLASS_NAMES

CARD = (ROOT / "docs" / "model_card.md").read_text()


def test_the_card_is_up_to_date() -> None:
    again = refreshed(CARD, default_weights(), ROOT / "benchmarks" / "results")
    assert again == CARD, "run `python benchmarks/model_card.py`"
    assert weights_id(default_weights()) in CARD


@pytest.fixture
def results(tmp_path: Path) -> Path:
    per_class = dict.fromkeys(CLASS_NAMES, 50.0)
    variant = dict.fromkeys(COLUMNS, 12.34) | {
        "sequences": 3,
        "id_switches": 0,
        "seconds_per_frame_median": None,
        "mota_per_class": per_class | {"bed": -65.8, "sink": None},
    }
    run = {"data": "tiny", "commit": "abc", "date": "2026-01-01", "seed": 0, "hardware": "one core"}
    run |= {"command": "composenet eval", "weights": "w sha256:1", "variants": {"full": variant}}
    (tmp_path / "own.json").write_text(json.dumps(run))
    (tmp_path / "old.json").write_text(json.dumps(run | {"weights": "w sha256:0", "data": "past"}))
    comparison = run | {"data": "many", "variants": {"full": variant, "f2f-gt": variant}}
    (tmp_path / "comparison.json").write_text(json.dumps(comparison))
    (tmp_path / "parity.json").write_text("{}")
    return tmp_path


def test_only_figures_of_these_weights_are_shown(results: Path) -> None:
    text = "\n".join(figures("w sha256:1", results))
    assert "| tiny, full | 3 | 12.3 |" in text and "past" not in text
    assert "f2f-gt" not in text and "many" not in text  # a comparison has a page of its own
    assert "not shown here: old.json (w sha256:0)." in text
    assert "| tiny, MOTA | 50.0 | -65.8 |" in text and "- tiny: bed (-66)" in text
    assert "not shown here: old.json" in text and "Confidence" not in text


def test_tracking_without_poses_is_told_apart(results: Path) -> None:
    run = json.loads((results / "own.json").read_text())
    nothing = dict.fromkeys(CLASS_NAMES)
    run["command"] += " --camera estimated"
    run["variants"]["full"] |= {"det_ap50_per_class": nothing}
    (results / "estimated.json").write_text(json.dumps(run))
    text = "\n".join(figures("w sha256:1", results))
    assert "| tiny, full | 3 |" in text and "| tiny without camera poses, full | 3 |" in text
    assert "| tiny without camera poses, MOTA | 50.0 |" in text
    assert "camera poses, detection" not in text  # not measured


def test_new_weights_have_no_figures(results: Path) -> None:
    text = "\n".join(figures("w sha256:2", results))
    assert text.startswith("Nothing was measured") and "tiny, full" not in text


def test_calibration_belongs_to_its_weights(results: Path) -> None:
    tracks = {"expected_calibration_error": 0.0704}
    run = {"data": "tiny", "weights": "w sha256:1", "calibration": {"tracks": tracks}}
    (results / "figures.json").write_text(json.dumps(run))
    assert "on tiny: 0.070." in "\n".join(figures("w sha256:1", results))
    assert "0.070" not in "\n".join(figures("w sha256:0", results))


def test_what_stands_outside_the_marks_is_kept() -> None:
    again = refreshed(f"# A\n\n{BEGIN}\nlast time\n{END}\n\nB\n", default_weights(), Path("none"))
    assert again.startswith(f"# A\n\n{BEGIN}\n") and again.endswith(f"{END}\n\nB\n")
    assert "last time" not in again
