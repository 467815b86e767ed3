"""What a device could not do, as an error that a user can act on."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager

from composenet.errors import DeviceError

_OUT_OF_MEMORY = re.compile(r"out of memory|not enough memory|can't allocate memory", re.I)
_OF_CUDA = re.compile(r"CUDA error|cuDNN error", re.I)


@contextmanager
def device_errors(frame_name: str) -> Iterator[None]:
    """Around the work on one frame. Raises DeviceError naming it."""
    try:
        yield
    except (RuntimeError, MemoryError) as error:
        reason = " ".join(str(error).split("\n")[0].split())
        if isinstance(error, MemoryError) or _OUT_OF_MEMORY.search(reason):
            raise DeviceError(
                f"frame {frame_name}: out of memory; give `composenet track` a smaller "
                "--max-width or --max-depth-m, or --device cpu"
            ) from None
        if _OF_CUDA.search(reason):
            raise DeviceError(f"frame {frame_name}: {reason}; try --device cpu") from None
        raise
