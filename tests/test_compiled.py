"""Compiled loops find a place."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from composenet import compiled


@pytest.fixture
def environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> pytest.MonkeyPatch:
    monkeypatch.setattr(compiled.tempfile, "tempdir", str(tmp_path))
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    return monkeypatch


def test_nothing_is_chosen_where_numba_finds_a_place(environment: pytest.MonkeyPatch) -> None:
    compiled.keep_compiled_loops()
    assert "NUMBA_CACHE_DIR" not in os.environ


def test_a_folder_for_one_run_where_nothing_can_be_written(
    environment: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    environment.setattr(compiled, "writable", lambda _: False)
    with pytest.warns(UserWarning, match="set NUMBA_CACHE_DIR"):
        compiled.keep_compiled_loops()
    chosen = Path(os.environ["NUMBA_CACHE_DIR"])
    assert chosen.is_dir() and chosen.parent == tmp_path
    compiled.keep_compiled_loops()  # and no other one
    assert os.environ["NUMBA_CACHE_DIR"] == str(chosen)


def test_a_folder_that_can_be_made_is_writable(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []
    monkeypatch.setattr(compiled.os, "access", lambda path, mode: asked.append((path, mode)))
    assert not compiled.writable(tmp_path / "not" / "yet")
    assert asked == [(tmp_path, os.W_OK)]
