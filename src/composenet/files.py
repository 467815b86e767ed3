"""Files that are whole or not there."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from composenet.errors import DataError


def write_atomic(path: Path, data: bytes) -> Path:
    """Write beside the target and rename over it, so that a reader never sees half a file.

    Raises DataError when that fails, for instance on a full disk.
    """
    part = path.with_name(path.name + ".part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part.write_bytes(data)
        part.replace(path)
    except OSError as error:
        with suppress(OSError):
            part.unlink(missing_ok=True)
        raise DataError(f"{path}: cannot be written ({error.strerror})") from None
    return path
