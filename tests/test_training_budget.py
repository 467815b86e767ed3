"""What training costs, measured in little."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import training_budget
from training_budget import main

from composenet.network.weights import default_weights, weights_id
from composenet.training import data


def test_its_parts_are_those_of_a_step(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (data, training_budget):
        monkeypatch.setattr(module, "POOL_FRAMES", 64)
    main(parts="boxes", scenes=1, out=tmp_path / "budget.json")
    found = json.loads((tmp_path / "budget.json").read_text())
    costs = found["seconds_per_frame"]
    assert 0 < costs["forward"] < costs["step"] and costs["sample"] > 0
    share = costs["sample"] / (costs["sample"] + costs["step"])
    assert costs["generator_share"] == pytest.approx(share, abs=2e-3)
    assert found["weights"] == weights_id(default_weights()) and found["commit"]
