"""What training costs in seconds of one core a frame: a sample of the generator, the network's
forward pass with its losses, and the rest of the step.

python benchmarks/training_budget.py [--parts detector] [--scenes 12] [--out FILE.json]
"""

from __future__ import annotations

import json
import tempfile
import time
from collections import defaultdict
from dataclasses import asdict
from pathlib import Path

import torch
import tyro

from composenet.metrics.report import RunInfo
from composenet.network.weights import default_weights, weights_id
from composenet.process import keep_freed_memory
from composenet.training.config import Parts, TrainingConfig
from composenet.training.data import POOL_FRAMES, SceneSource, SceneStream
from composenet.training.loop import RunOptions, Trainer
from composenet.training.processes import Group

SEED = 1
WARM_UP_BATCHES = 3


class Clock:
    """Seconds of this process's time, by name."""

    def __init__(self) -> None:
        self.seconds: defaultdict[str, float] = defaultdict(float)

    def start(self, name: str) -> None:
        """Begin to count."""
        self.seconds[name] -= time.process_time()

    def stop(self, name: str) -> None:
        """Count no further."""
        self.seconds[name] += time.process_time()


def main(
    parts: Parts = "detector",
    scenes: int = 12,
    out: Path | None = None,
) -> None:
    """Print the costs on the CPU, one thread, as they are for the program `composenet train`."""
    keep_freed_memory()
    torch.set_num_threads(1)
    config = TrainingConfig(parts=parts, seed=SEED, joint_from_step=0)
    stream = iter(SceneStream(SceneSource(), config, start=0))
    for _ in range(POOL_FRAMES // config.batch_frames):
        next(stream)  # while the pool fills a batch costs more scenes than later
    warm = [next(stream) for _ in range(WARM_UP_BATCHES)]
    count = scenes * config.frames_per_scene // config.batch_frames
    clock = Clock()
    with tempfile.TemporaryDirectory() as folder:
        options = RunOptions(Path(folder), start_from=default_weights())
        trainer = Trainer(config, options, Group(0, 1, torch.device("cpu")))
        for batch in warm:
            trainer.step(batch, rate=1e-4)
        trainer.module.register_forward_pre_hook(lambda *_: clock.start("forward"))
        trainer.module.register_forward_hook(lambda *_: clock.stop("forward"))
        for _ in range(count):
            clock.start("sample")
            batch = next(stream)
            clock.stop("sample")
            clock.start("step")
            trainer.step(batch, rate=1e-4)
            clock.stop("step")
    frames = count * config.batch_frames
    costs = {name: round(s / frames, 4) for name, s in clock.seconds.items()}
    costs["generator_share"] = round(costs["sample"] / (costs["sample"] + costs["step"]), 3)
    print("seconds of a core a frame:", costs)
    if out is not None:
        command = f"python benchmarks/training_budget.py --parts {parts} --scenes {scenes}"
        data = f"train, {scenes} scenes"
        info = asdict(RunInfo(data, SEED, command, weights_id(default_weights())))
        out.write_text(json.dumps(info | {"seconds_per_frame": costs}, indent=2) + "\n")


if __name__ == "__main__":
    tyro.cli(main)
