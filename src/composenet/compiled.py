"""Where compiled loops are kept."""

from __future__ import annotations

import os
import tempfile
import warnings
from pathlib import Path


def keep_compiled_loops() -> None:
    """See to it that numba finds a folder for what it compiles; to be called before it is imported.

    It takes the package's folder, or the user's cache. Where neither can be written to, as in a
    container that runs as another user than it was built by, it would fail; then what is compiled
    is kept for this run alone, unless NUMBA_CACHE_DIR says where, and a warning says so.
    """
    cache = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    if "NUMBA_CACHE_DIR" in os.environ or any(map(writable, (Path(__file__).parent, Path(cache)))):
        return
    folder = tempfile.mkdtemp(prefix="composenet-")
    os.environ["NUMBA_CACHE_DIR"] = folder  # for processes that this one starts, too
    warnings.warn(
        f"neither composenet's folder nor {cache} can be written to: loops are compiled anew in "
        "every run, which takes a minute; set NUMBA_CACHE_DIR to a folder of yours",
        stacklevel=3,
    )


def writable(folder: Path) -> bool:
    """Whether it can be written to, or made."""
    there = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    return os.access(there, os.W_OK)
