"""Several trainings from the same weights beside each other, each alone and with a seed of its own,
and the mean of what they learned.

python benchmarks/train_together.py --start-from WEIGHTS --out DIR --seeds 1 2 --max-minutes 12
    [--config further] [--workers 7] [--threads 1] [--device cuda] [--mps]

DIR/SEED is a run's folder, DIR/SEED.log what it says, DIR/mean.safetensors the mean. The same
command once more goes on with all of them. ctrl-C ends all, with what they have learned so far.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path

import mean_weights
import tyro

from composenet.config import dump
from composenet.errors import ComposenetError, DataError
from composenet.training.config import training_config

MPS = "nvidia-cuda-mps-control"


def main(
    start_from: Path,
    out: Path,
    seeds: tuple[int, ...],
    max_minutes: float = 60.0,
    config: Path = Path("further"),
    workers: int = 1,
    threads: int | None = 1,
    device: str = "auto",
    max_steps: int | None = None,
    mps: bool = False,
) -> int:
    """Exit code. config: for all, but for the seed; workers and threads: of each; mps: let the
    kernels of all run beside each other on one NVIDIA GPU, where they would take turns."""
    if len(set(seeds)) != len(seeds) or not seeds:
        raise DataError(f"--seeds {seeds}: expected different numbers, one for each training")
    recipe = training_config(config)
    out.mkdir(parents=True, exist_ok=True)
    options = [f"--start-from={start_from}", f"--max-minutes={max_minutes}"]
    options += [f"--workers={workers}", f"--device={device}"]
    options += [f"--threads={threads}"] if threads else []
    options += [f"--max-steps={max_steps}"] if max_steps else []
    with _side_by_side() if mps else nullcontext():
        running = []
        for seed in seeds:
            dump(replace(recipe, seed=seed), out / f"{seed}.json")
            run = [f"--out={out / str(seed)}", f"--config={out / f'{seed}.json'}"]
            command = [sys.executable, "-m", "composenet", "train", *run, *options]
            with (out / f"{seed}.log").open("ab") as log:
                running.append(subprocess.Popen(command, stdout=log, stderr=log))
        try:
            codes = [process.wait() for process in running]
        except KeyboardInterrupt:  # each of them has it, too, and ends cleanly
            codes = [process.wait() for process in running]
    if any(codes):
        wrong = seeds[next(i for i, code in enumerate(codes) if code)]
        last = (out / f"{wrong}.log").read_text(errors="replace").strip().splitlines()[-1:]
        raise DataError(f"{out / str(wrong)}: {' '.join(last) or 'ended without a word'}")
    weights = tuple(out / str(seed) / "weights.safetensors" for seed in seeds)
    mean_weights.main(weights, out / "mean.safetensors")
    print(f"wrote {out / 'mean.safetensors'}")
    return 0


@contextmanager
def _side_by_side() -> Iterator[None]:
    """NVIDIA's multi-process service, for as long as it is wanted."""
    try:
        subprocess.run([MPS, "-d"], check=True)
    except (OSError, subprocess.CalledProcessError) as error:
        raise DataError(f"--mps: {MPS} does not start ({error}); leave --mps out") from None
    try:
        yield
    finally:
        subprocess.run([MPS], input=b"quit\n", check=False)


if __name__ == "__main__":
    try:
        sys.exit(tyro.cli(main))
    except ComposenetError as error:
        sys.exit(f"train_together: {error}")
