"""How fast one device is: the distance field of a frame, a sparse convolution, training steps, a
tracked frame by stage. On CUDA also how much of the step the device is busy.

python benchmarks/device_speed.py [--device cuda] [--batch-frames 16] [--out FILE.json]
"""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro
from torch.profiler import ProfilerActivity, profile

from composenet.metrics.report import RunInfo
from composenet.network.sparse import build_pyramid, gather, submanifold_conv
from composenet.network.weights import default_weights, weights_id
from composenet.pipeline import load_tracker, select_device
from composenet.sequences import open_sequence
from composenet.synth.dataset import DEFAULT_OPTIONS, write_split
from composenet.synth.scene import SceneOptions
from composenet.timings import summarise_timings
from composenet.training.config import Parts, TrainingConfig
from composenet.training.data import SceneSource, samples_of_scene
from composenet.training.loop import RunOptions, Trainer
from composenet.training.processes import Group
from composenet.training.targets import Sample, TrainingBatch, collate_samples
from composenet.volume.tsdf import dense_tsdf

SEED = 1
REPEATS = 20


def milliseconds(work: Callable[[], object], device: torch.device, repeats: int = REPEATS) -> float:
    """Median time of one call, after three that do not count."""
    times = []
    for _ in range(3 + repeats):
        start = time.perf_counter()
        work()
        if device.type == "cuda":
            torch.cuda.synchronize(device)
        times.append(1e3 * (time.perf_counter() - start))
    return float(np.median(times[3:]))


def field_ms(device: torch.device) -> float:
    """96 x 96 x 48 voxels of 5 cm from 640 x 480 pixels."""
    g = torch.Generator().manual_seed(SEED)
    depth = (1 + 3 * torch.rand(480, 640, generator=g)).to(device)
    K = torch.tensor([[525.0, 0, 319.5], [0, 525.0, 239.5], [0, 0, 1]], device=device)
    T = torch.tensor([[0, -1.0, 0, 2.4], [0, 0, -1, 1.2], [1, 0, 0, 0], [0, 0, 0, 1]])
    T = T.to(device)
    return milliseconds(lambda: dense_tsdf(depth, K, T, (96, 96, 48), 0.05, 0.15), device)


def wavy_surface(side: int, device: torch.device) -> torch.Tensor:
    """(side^2, 4) voxels of one batch."""
    steps = torch.arange(side)
    x, y = torch.meshgrid(steps, steps, indexing="ij")
    z = (10 + 6 * torch.sin(x / 9) * torch.cos(y / 7)).long()
    return torch.stack([torch.zeros_like(x), x, y, z], dim=-1).view(-1, 4).to(device)


def gather_ms(device: torch.device, side: int = 600) -> float:
    """What a convolution of 32 channels reads on a surface of side^2 voxels, as many as 40 frames
    have."""
    table = build_pyramid(wavy_surface(side, device), 1, 1)[0].table
    features = torch.randn(len(table), 32, generator=torch.Generator().manual_seed(SEED)).to(device)
    return milliseconds(lambda: gather(features, table), device)


def convolution_ms(device: torch.device) -> dict[str, float]:
    """32 to 32 channels on 10,000 voxels of a wavy surface."""
    coords = wavy_surface(100, device)
    level = build_pyramid(coords, 1, 1)[0]
    g = torch.Generator().manual_seed(SEED)
    features, weight = (
        torch.randn(*shape, generator=g).to(device).requires_grad_(True)
        for shape in ((len(coords), 32), (27, 32, 32))
    )

    def forward() -> torch.Tensor:
        return submanifold_conv(features, weight, level)

    return {
        "table": milliseconds(lambda: build_pyramid(coords, 1, 1), device),
        "forward": milliseconds(forward, device),
        "forward and backward": milliseconds(lambda: forward().sum().backward(), device),
    }


def samples_of(index: int) -> list[Sample]:
    """Those of one training scene."""
    config = TrainingConfig(frames_per_scene=16)
    return list(samples_of_scene(SceneSource().scene(index), config, np.random.default_rng(index)))


def batches_of(frames: int, count: int, workers: int) -> list[TrainingBatch]:
    """Batches of mixed scenes."""
    scenes = range(-(-frames * count // 14))
    if workers > 1:
        with get_context("spawn").Pool(workers) as pool:
            lists = pool.map(samples_of, scenes)
    else:
        lists = [samples_of(i) for i in scenes]
    samples = [s for own in lists for s in own]
    order = np.random.default_rng(SEED).permutation(len(samples))
    picked = [[samples[i] for i in order[k::count][:frames]] for k in range(count)]
    return [collate_samples(each) for each in picked]


def training_ms(
    parts: Parts, batches: Sequence[TrainingBatch], device: torch.device
) -> dict[str, float]:
    """Of a step with these parts."""
    config = TrainingConfig(parts=parts, seed=SEED, joint_from_step=0)
    turn = iter(range(10**9))
    with tempfile.TemporaryDirectory() as folder:
        options = RunOptions(Path(folder), start_from=default_weights())
        trainer = Trainer(config, options, Group(0, 1, device))

        def step() -> object:
            return trainer.step(batches[next(turn) % len(batches)], 1e-4)

        step_ms = milliseconds(step, device, REPEATS if device.type == "cuda" else 3)
        frames = batches[0].volume.size
        found = {"step": step_ms, "frames_per_second": 1e3 * frames / step_ms}
        if device.type == "cuda":
            torch.cuda.reset_peak_memory_stats(device)
            with profile(activities=[ProfilerActivity.CUDA]) as record:
                for _ in range(3):
                    step()
                torch.cuda.synchronize(device)
            kernels = [
                e for e in record.events() if e.device_type == torch.autograd.DeviceType.CUDA
            ]
            found["busy"] = sum(e.device_time for e in kernels) / 3e3
            found["kernels"] = len(kernels) / 3
            found["memory_gib"] = torch.cuda.max_memory_allocated(device) / 2**30
    return {name: round(value, 2) for name, value in found.items()}


def tracking_ms(device: torch.device, frames: int) -> dict[str, float]:
    """Medians by stage over one validation sequence, 320 x 240 pixels, but for its first frames."""
    with tempfile.TemporaryDirectory() as folder:
        write_split("val", 1, Path(folder), options=SceneOptions(frames=frames))
        tracker = load_tracker(device=str(device))
        times = [tracker(frame).timings_ms for frame in open_sequence(Path(folder) / "val_00000")]
    return {t.stage: round(t.median_ms, 2) for t in summarise_timings(times[3:])}


def main(
    device: str = "auto",
    batch_frames: int = 16,
    batches: int = 8,
    workers: int = 1,
    threads: int | None = None,
    training: tuple[Parts, ...] = ("detector", "objects", "apart"),
    frames: int = DEFAULT_OPTIONS.frames,
    out: Path | None = None,
) -> None:
    """Milliseconds on one device (auto, cpu, cuda or cuda:N). workers: processes that make the
    samples beforehand. training: which parts learn. frames: of the sequence that is tracked."""
    chosen = select_device(device)
    if threads:
        torch.set_num_threads(threads)
    made = batches_of(batch_frames, batches, workers)
    found: dict[str, Any] = {}

    def note(name: str, value: Any) -> None:
        found[name] = value
        print(name, value, flush=True)

    note("distance_field_ms", round(field_ms(chosen), 3))
    note("convolution_ms", {k: round(v, 3) for k, v in convolution_ms(chosen).items()})
    if chosen.type == "cuda":  # on the CPU a convolution needs none
        note("gather_ms", round(gather_ms(chosen), 3))
    note("tracking_ms", tracking_ms(chosen, frames))
    note("training_ms", {parts: training_ms(parts, made, chosen) for parts in training})
    if out is not None:
        command = f"python benchmarks/device_speed.py --device {device}"
        command += f" --batch-frames {batch_frames} --batches {batches}"
        command += f" --workers {workers}" + (f" --threads {threads}" if threads else "")
        command += f" --frames {frames} --training {' '.join(training)}"
        info = asdict(
            RunInfo("val_00000 and training scenes", SEED, command, weights_id(default_weights()))
        )
        info["torch"] = torch.__version__
        out.write_text(json.dumps(info | found, indent=2) + "\n")


if __name__ == "__main__":
    tyro.cli(main)
