"""Processes that end together."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor

import pytest

from composenet.process import worker_pool

PARENT = """
import os, sys, time
from composenet.process import worker_pool

if __name__ == "__main__":
    with worker_pool(2) as pool:
        print(*{pool.submit(os.getpid).result() for _ in range(2)}, flush=True)
        pool.submit(time.sleep, 600).result()
"""


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    with open(f"/proc/{pid}/stat") as stat:
        return stat.read().rpartition(")")[2].split()[0] != "Z"


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="asks /proc whether processes live")
@pytest.mark.parametrize("name", ["SIGTERM", "SIGKILL", "SIGINT"])
def test_workers_end_with_the_process_that_began_them(name: str, tmp_path) -> None:
    script = tmp_path / "parent.py"
    script.write_text(PARENT)
    parent = subprocess.Popen(
        [sys.executable, script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip
    assert parent.stdout is not None and parent.stderr is not None
    workers = [int(pid) for pid in parent.stdout.readline().split()]
    assert workers and all(map(alive, workers))
    time.sleep(0.2)
    if name == "SIGINT":
        os.killpg(parent.pid, signal.SIGINT)  # as a terminal does
    else:
        os.kill(parent.pid, getattr(signal, name))
    deadline = time.monotonic() + 20
    while any(map(alive, workers)) and time.monotonic() < deadline:
        time.sleep(0.05)
    left = [pid for pid in workers if alive(pid)]
    for pid in left:
        os.kill(pid, signal.SIGKILL)
    assert not left
    assert parent.wait(20) != 0
    assert "SpawnProcess" not in parent.stderr.read()  # no traceback of a worker


def test_nothing_more_is_begun_after_an_exception(
    tmp_path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As when the program alone is told to stop, its workers not. The pool must be told once: a
    second time may undo the first, or not, as threads take turns."""
    told = []

    def shutdown(pool: ProcessPoolExecutor, *arguments: object, **named: object) -> None:
        told.append((arguments, named))
        really(pool, *arguments, **named)  # type: ignore[arg-type]

    really = ProcessPoolExecutor.shutdown
    monkeypatch.setattr(ProcessPoolExecutor, "shutdown", shutdown)
    with pytest.raises(KeyboardInterrupt), worker_pool(1) as pool:
        for index in range(30):
            pool.submit(_leave_a_mark, tmp_path / str(index))
        while not any(tmp_path.iterdir()):
            time.sleep(0.01)
        raise KeyboardInterrupt
    assert 0 < len(list(tmp_path.iterdir())) < 10
    assert told == [((), {"cancel_futures": True})]


def _leave_a_mark(path) -> None:
    path.touch()
    time.sleep(0.1)
