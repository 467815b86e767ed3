"""The error of odometry, with odometry that errs by a known way."""

from __future__ import annotations

from pathlib import Path

import camera_error
import numpy as np
import pytest

from composenet.errors import DataError, SequenceError
from composenet.geometry.transform import make_T, rotation_z
from composenet.records import Camera, Frame

CAMERA = Camera(K=np.array([[20.0, 0, 7.5], [0, 20.0, 5.5], [0, 0, 1]]), width=16, height=12)
OWN_WORLD = make_T(rotation_z(1.0), [3.0, -2.0, 0.5])  # not that of the recording


class Walk(list[Frame]):
    """Four frames of a camera that walks along x."""

    name = "walk"

    def __init__(self) -> None:
        depth_m = np.ones((12, 16), np.float32)
        poses = [make_T(np.eye(3), [0.1 * i, 0, 0]) for i in range(4)]
        super().__init__(Frame(i, depth_m, CAMERA, T) for i, T in enumerate(poses))


def wrong_by(*metres: float | None, at_once: float = 0.0):
    """Odometry that is off along x by so much, frame after frame; None: lost. at_once: so much
    more before later frames correct it."""

    class Wrong:
        def __init__(self) -> None:
            self._count = 0

        def __call__(
            self, depth_m: np.ndarray, camera: Camera, color: np.ndarray | None
        ) -> np.ndarray | None:
            self._count += 1
            return self._pose(self._count - 1, at_once if self._count > 1 else 0.0)

        def way(self) -> list[np.ndarray | None]:
            return [self._pose(i, 0.0) for i in range(self._count)]

        def _pose(self, i: int, more: float) -> np.ndarray | None:
            off = metres[i]
            if off is None:
                return None
            return OWN_WORLD @ make_T(np.eye(3), [0.1 * i + off + more, 0, 0])

    return Wrong


def test_errors_by_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    follower = wrong_by(0.0, 0.02, None, 0.06, at_once=0.01)
    monkeypatch.setattr(Walk, "odometry", lambda _: follower(), raising=False)
    errors = camera_error.camera_errors(Walk())  # type: ignore[arg-type]
    np.testing.assert_allclose(errors.cm, [0, 2, np.inf, 6], atol=1e-9)
    np.testing.assert_allclose(errors.cm_at_once, [0, 3, np.inf, 7], atol=1e-9)
    np.testing.assert_allclose(errors.degrees, [0, 0, np.inf, 0], atol=1e-5)
    row = errors.row
    assert (row["frames"], row["lost"]) == (4, 1)
    assert (row["error_cm_median"], row["error_cm_max"], row["error_cm_end"]) == (2, 6, 6)


def test_the_first_frame_found_is_where_errors_begin(monkeypatch: pytest.MonkeyPatch) -> None:
    follower = wrong_by(None, 0.5, 0.5, 0.51)
    monkeypatch.setattr(Walk, "odometry", lambda _: follower(), raising=False)
    errors = camera_error.camera_errors(Walk())  # type: ignore[arg-type]
    np.testing.assert_allclose(errors.cm, [np.inf, 0, 0, 1], atol=1e-9)


def test_a_camera_that_stays_lost_ends_nowhere(monkeypatch: pytest.MonkeyPatch) -> None:
    follower = wrong_by(0.0, 0.02, 0.02, None)
    monkeypatch.setattr(Walk, "odometry", lambda _: follower(), raising=False)
    row = camera_error.camera_errors(Walk()).row  # type: ignore[arg-type]
    assert (row["error_cm_max"], row["error_cm_end"]) == (2, None)


def test_no_camera_at_all(monkeypatch: pytest.MonkeyPatch) -> None:
    follower = wrong_by(None, None, None, None)
    monkeypatch.setattr(Walk, "odometry", lambda _: follower(), raising=False)
    with pytest.raises(DataError, match="walk"):
        camera_error.camera_errors(Walk())  # type: ignore[arg-type]


def test_folders_of_recordings(recordings: Path, tmp_path: Path) -> None:
    names = [sequence.name for sequence in camera_error.opened(recordings)]
    assert names == sorted(folder.name for folder in recordings.iterdir()) and len(names) > 1
    assert [s.name for s in camera_error.opened(recordings / names[0])] == names[:1]
    with pytest.raises(SequenceError, match="no such folder"):
        camera_error.opened(tmp_path / "nowhere")
