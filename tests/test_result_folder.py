"""A result replaces an earlier one, and nothing else."""

from __future__ import annotations

import errno
import json
import os
import tempfile
from pathlib import Path

import pytest

from composenet import config as configuration
from composenet.config import Config
from composenet.errors import DataError
from composenet.result_folder import claim, clear

TRACKS = json.dumps({"schema": "composenet.tracks/0"})


def a_result(folder: Path) -> Path:
    """As far as it is known by its files."""
    (folder / "meshes").mkdir(parents=True)
    configuration.dump(Config(), folder / "config.json")
    (folder / "tracks.json").write_text(TRACKS)
    (folder / "meshes" / "track_1.ply").write_text("ply")
    return folder


def test_an_earlier_result_may_be_replaced(tmp_path: Path) -> None:
    folder = a_result(tmp_path / "result")
    (folder / "notes.txt").write_text("mine")
    (folder / "meshes" / "track_1_cleaned.ply").write_text("mine")
    claim(folder)
    clear(folder)
    left = sorted(p.name for p in folder.rglob("*") if p.is_file())
    assert left == ["notes.txt", "track_1_cleaned.ply", "tracks.json"]
    claim(folder)  # were it killed here


def test_a_folder_that_cannot_be_written_to_is_told_of_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(**_: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(tempfile, "TemporaryFile", refuse)
    with pytest.raises(DataError, match=r"cannot write the result here .*--out"):
        claim(tmp_path)


@pytest.mark.parametrize(
    "name", ["config.json", "report.html", "tracks.json", "meshes/track_1.ply", "replay.rrd"]
)
def test_files_of_others_are_left_alone(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    path.write_text('{"schema": "mine/1", "volume": 3}')
    with pytest.raises(DataError, match=f"not a result.*{name}.*--out"):
        claim(tmp_path)
    assert path.read_text() == '{"schema": "mine/1", "volume": 3}'


@pytest.mark.parametrize("text", ['{"volume": 3}', "[1]", "no JSON"])
def test_tracks_beside_a_configuration_of_others(tmp_path: Path, text: str) -> None:
    folder = a_result(tmp_path / "result")
    (folder / "config.json").write_text(text)
    with pytest.raises(DataError, match=r"not a result.*config\.json"):
        claim(folder)


def test_a_folder_of_other_things_is_free(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    claim(tmp_path)
    claim(tmp_path / "new" / "folder")
    assert (tmp_path / "new" / "folder").is_dir()
