"""A file is whole or as it was, whatever happens while it is written."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest
import torch

from composenet.errors import DataError
from composenet.files import held, write_atomic
from composenet.training.checkpoint import read_state, write_state


@pytest.fixture
def full_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    def half(path: Path, data: bytes) -> int:
        with path.open("wb") as file:
            file.write(data[: len(data) // 2])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", half)


def test_folders_are_made_and_a_file_replaced(tmp_path: Path) -> None:
    path = tmp_path / "new" / "deep" / "file.txt"
    assert write_atomic(path, b"one") == path
    assert write_atomic(path, b"two").read_bytes() == b"two"
    assert [found.name for found in path.parent.iterdir()] == ["file.txt"]


@pytest.mark.usefixtures("full_disk")
def test_a_full_disk_leaves_the_file_before_and_nothing_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "file.txt"
    path.write_text("before")
    with pytest.raises(DataError, match=r"file\.txt: cannot be written \(No space left on device"):
        write_atomic(path, b"after")
    assert [(found.name, found.read_text()) for found in tmp_path.iterdir()] == [
        ("file.txt", "before")
    ]


def test_a_checkpoint_survives_a_full_disk(tmp_path: Path, request: pytest.FixtureRequest) -> None:
    path = tmp_path / "checkpoint.pt"
    write_state(path, {"format": "test/1", "weights": torch.arange(5)})
    request.getfixturevalue("full_disk")
    with pytest.raises(DataError, match=r"checkpoint\.pt: cannot be written"):
        write_state(path, {"format": "test/1", "weights": torch.zeros(5)})
    assert read_state(path, "test/1", {"weights"})["weights"].tolist() == [0, 1, 2, 3, 4]


def test_a_folder_is_held_by_one_at_a_time(tmp_path: Path) -> None:
    with held(tmp_path):
        with pytest.raises(DataError, match="another run is writing here"), held(tmp_path):
            pytest.fail("held twice")
        with held(tmp_path.parent):
            pass
    with held(tmp_path):
        assert not list(tmp_path.iterdir())


def test_a_folder_is_free_again_after_an_error(tmp_path: Path) -> None:
    with pytest.raises(KeyError), held(tmp_path):
        raise KeyError
    with held(tmp_path):
        pass


def test_where_there_are_no_locks_everybody_may_write(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none_here(*_: object) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr("fcntl.flock", none_here)
    with held(tmp_path), held(tmp_path):
        pass
