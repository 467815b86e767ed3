"""How this process waits and how it keeps its memory: for the program, not for the library."""

from __future__ import annotations

import ctypes
import os
import platform


def wait_asleep() -> None:
    """Let torch's threads sleep while they wait; to be called before torch is imported.

    By default they spin, and two programs on the same cores take each other's. With
    OMP_WAIT_POLICY=active in the environment they spin again: faster by a fifth for a program
    that has the cores to itself.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")


def keep_freed_memory() -> None:
    """Have the C library keep the memory of tensors that are done with for the next ones.

    By default glibc gives what is large back to the system at once, and clearing it anew takes a
    tenth of the time of tracking and training. MALLOC_TRIM_THRESHOLD_ in the environment decides
    instead where it is set. Other C libraries are left as they are.
    """
    if platform.libc_ver()[0] != "glibc" or "MALLOC_TRIM_THRESHOLD_" in os.environ:
        return
    libc = ctypes.CDLL(None)
    for number, name, size in ((-1, "TRIM", 2**31 - 1), (-3, "MMAP", 2**30)):  # malloc.h
        libc.mallopt(number, size)
        os.environ[f"MALLOC_{name}_THRESHOLD_"] = str(size)  # for processes that this one starts
