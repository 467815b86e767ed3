"""Which files a result folder of `track` holds, and whether a folder may become one."""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from composenet.errors import DataError
from composenet.predictions import CANONICAL, SCHEMA, TRACKS_JSON, TRACKS_TXT

_MESH = re.compile(r"track_\d+\.(ply|glb)")
_BEGIN = re.compile(r'\s*\{\s*"schema":\s*"' + re.escape(SCHEMA.partition("/")[0]) + "/")
CONFIG, TIMINGS, REPORT, REPLAY = "config.json", "timings.json", "report.html", "replay.rrd"


def claim(folder: Path) -> None:
    """Make the folder. Raises DataError where it cannot be made, or where it holds files that a
    result would replace and that are none of one."""
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):  # whether it can be written to
            pass
        foreign = _files(folder)
    if _is_tracks(folder / TRACKS_JSON):
        foreign = [] if _may_be_config(folder / CONFIG) else [folder / CONFIG]
    if foreign:
        raise DataError(
            f"{folder}: holds files that are not a result of `composenet track` "
            f"({foreign[0].relative_to(folder)}); give another --out folder"
        )


def clear(folder: Path) -> None:
    """Remove an earlier result but for its tracks.json, by which it is known for one."""
    for path in _files(folder):
        if path.name != TRACKS_JSON:
            path.unlink()


@contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Says what cannot be written as a DataError."""
    try:
        yield
    except OSError as error:
        raise DataError(
            f"{folder}: cannot write the result here ({error.strerror}); give another --out folder"
        ) from None


def _files(folder: Path) -> list[Path]:
    """Those there that a result would replace."""
    names = (TRACKS_JSON, TRACKS_TXT, CANONICAL, CONFIG, TIMINGS, REPORT, REPLAY)
    meshes = [p for p in (folder / "meshes").glob("track_*") if _MESH.fullmatch(p.name)]
    return [*(folder / name for name in names if (folder / name).exists()), *sorted(meshes)]


def _is_tracks(path: Path) -> bool:
    """Ours, of any version."""
    with suppress(OSError, UnicodeError), path.open() as file:
        if _BEGIN.match(file.read(200)):  # of a long recording the rest is large
            return True
    schema = _read_object(path).get("schema")
    return isinstance(schema, str) and schema.startswith(SCHEMA.partition("/")[0] + "/")


def _may_be_config(path: Path) -> bool:
    """Ours, of any version, or not there."""
    return not path.exists() or {"volume", "network", "tracking"} <= _read_object(path).keys()


def _read_object(path: Path) -> dict[str, object]:
    """What a JSON file holds; nothing where it is none."""
    try:
        data = json.loads(path.read_text())
    except (OSError, ValueError):
        return {}
    return data if isinstance(data, dict) else {}
