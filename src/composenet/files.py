"""Files that are whole or not there, folders that one run at a time writes to."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
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


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """The folder, which must exist, is this run's alone, until it ends, however it does. Raises
    DataError where it is another's. File systems that know no locks let everybody in."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise DataError(
                    f"{folder}: another run is writing here; wait for its end, or give another "
                    "--out folder"
                ) from None
        yield
    finally:
        os.close(handle)
