"""The processes of a training run, and how they are told to stop."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import dataclass
from typing import Any, Self

import torch
from torch.distributed import ReduceOp, all_reduce, destroy_process_group, init_process_group
from torch.utils.data import DataLoader, IterableDataset

from composenet.pipeline import select_device

PREFETCHED = 4
"""Batches that a worker makes ahead."""


@dataclass(frozen=True)
class Group:
    """The processes that train together (torchrun sets the environment)."""

    rank: int
    size: int
    device: torch.device

    @staticmethod
    def start(device: str) -> Group:
        """Join the group, if there is one, and choose this process's device."""
        rank, size = int(os.environ.get("RANK", 0)), int(os.environ.get("WORLD_SIZE", 1))
        chosen = select_device(device)
        if chosen.type == "cuda":
            chosen = select_device(f"cuda:{chosen.index or os.environ.get('LOCAL_RANK', 0)}")
            torch.cuda.set_device(chosen)
        if size > 1:
            init_process_group("nccl" if chosen.type == "cuda" else "gloo")
        return Group(rank, size, chosen)

    def largest(self, value: float) -> float:
        """The largest of the processes' values, the same in all of them."""
        if self.size == 1:
            return value
        shared = torch.tensor(value, dtype=torch.float64, device=self.device)
        all_reduce(shared, ReduceOp.MAX)
        return shared.item()

    def stop(self) -> None:
        """Leave the group."""
        if self.size > 1:
            destroy_process_group()


class StopRequest:
    """Set by ctrl-C or a termination signal; the step under way is finished first.

    A second ctrl-C stops at once, but not within a second of the first: torchrun passes on the
    signal that the terminal has already sent.
    """

    def __init__(self) -> None:
        self.asked_at: float | None = None

    def __enter__(self) -> Self:
        names = (signal.SIGINT, signal.SIGTERM)
        self._before = {name: signal.signal(name, self._ask) for name in names}
        return self

    def __exit__(self, *_: object) -> None:
        for name, handler in self._before.items():
            signal.signal(name, handler)

    def _ask(self, *_: object) -> None:
        if self.asked_at is None:
            self.asked_at = time.monotonic()
        elif time.monotonic() - self.asked_at > 1:
            raise KeyboardInterrupt


def leave_signals_to_parent(_worker: int) -> None:
    """In a worker: what asks to stop mostly reaches the whole process group, but the parent
    decides. It may have to end a worker by the same signal, which therefore counts from a second
    after the first on (earlier it is the same one, passed on; see `StopRequest`)."""
    first_at = list[float]()

    def end_the_second_time(*_: object) -> None:
        if first_at and time.monotonic() - first_at[0] > 1:
            os._exit(1)
        first_at.append(time.monotonic())

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, end_the_second_time)


def batches_of(stream: IterableDataset[Any], workers: int) -> DataLoader[Any]:
    """The batches of a stream, made in worker processes (0: in this one)."""
    return DataLoader(
        stream,
        batch_size=None,
        num_workers=workers,
        prefetch_factor=PREFETCHED if workers else None,
        worker_init_fn=leave_signals_to_parent,
    )
