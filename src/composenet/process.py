"""How the program's processes wait, keep their memory, and end together."""

from __future__ import annotations

import ctypes
import os
import platform
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import connection, get_context, parent_process


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


@contextmanager
def worker_pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Worker processes that die of ctrl-C without a word, and with this process whatever ends it;
    after an exception nothing more is begun, and what is under way is waited for. They are fresh:
    forking one that has threads (torch) may hang."""
    pool = ProcessPoolExecutor(workers, get_context("spawn"), initializer=_begin_worker)
    try:
        yield pool
    except BaseException:
        pool.shutdown(cancel_futures=True)  # once: a second time without would undo it
        raise
    pool.shutdown()


def _begin_worker() -> None:
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    assert parent is not None
    connection.wait([parent.sentinel])
    os._exit(1)
