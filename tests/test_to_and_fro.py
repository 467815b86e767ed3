"""A recording played to and fro: the same frames, forwards and backwards."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import to_and_fro
from PIL import Image

import composenet
from composenet.errors import DataError


def recording(folder: Path, frames: int = 3) -> Path:
    """Depth of i + 1 metres from a camera that walks along x; the second frame has no pose."""
    for name in ("depth", "pose"):
        (folder / name).mkdir(parents=True)
    for i in range(frames):
        depth = np.full((12, 16), 1000 * (i + 1), np.uint16)
        Image.fromarray(depth).save(folder / "depth" / f"frame-{i}.png")
        if i != 1:
            T = np.eye(4)
            T[0, 3] = i
            np.savetxt(folder / "pose" / f"frame-{i}.txt", T)
    np.savetxt(folder / "camera-intrinsics.txt", np.array([[20, 0, 8], [0, 20, 6], [0, 0, 1]]))
    (folder / "gravity-direction.txt").write_text("0 1 0\n")
    return folder


def test_every_second_pass_is_backwards(tmp_path: Path) -> None:
    to_and_fro.main(recording(tmp_path / "once"), tmp_path / "out", passes=3)
    frames = list(composenet.open_sequence(tmp_path / "out"))
    assert [round(float(frame.depth_m.max())) for frame in frames] == [1, 3, 3, 1, 1, 3]
    places = np.array([frame.T_world_camera[:3, 3] for frame in frames])
    steps = np.linalg.norm(places - places[0], axis=1)
    np.testing.assert_allclose(steps, [0, 2, 2, 0, 0, 2], atol=1e-6)
    assert not (tmp_path / "once" / "depth" / "000000.png").exists()


def test_what_is_there_is_kept(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    with pytest.raises(DataError, match="is there already"):
        to_and_fro.main(recording(tmp_path / "once"), tmp_path / "out")
    assert not list((tmp_path / "out").iterdir())
