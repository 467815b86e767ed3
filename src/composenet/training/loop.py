"""The training loop: plain, resumable, bounded in time; one process or many."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path

import torch
from rich.console import Console
from torch import nn
from torch.distributed import all_reduce, destroy_process_group, init_process_group
from torch.nn.parallel import DistributedDataParallel
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from torch.utils.data import DataLoader

from composenet.network.weights import load_weights, save_weights
from composenet.training.checkpoint import Progress, load_checkpoint, save_checkpoint
from composenet.training.config import TrainingConfig
from composenet.training.data import SceneSource, SceneStream, fixed_batches
from composenet.training.step import LossModule, weighted_sum
from composenet.training.targets import TrainingBatch
from composenet.training.validation import validate


@dataclass(frozen=True)
class RunOptions:
    """How long, where and how a run goes."""

    out: Path
    max_minutes: float = 60.0
    max_steps: int | None = None
    workers: int = 1
    threads: int | None = None
    device: str = "auto"
    save_every_minutes: float = 5.0
    validate_every_minutes: float = 15.0
    validation_scenes: int = 8
    start_from: Path | None = None
    """weights to begin a new run from"""


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
        if device == "auto":
            device = "cuda" if torch.cuda.is_available() else "cpu"
        if device == "cuda":
            device = f"cuda:{os.environ.get('LOCAL_RANK', 0)}"
            torch.cuda.set_device(device)
        if size > 1:
            init_process_group("nccl" if device.startswith("cuda") else "gloo")
        return Group(rank, size, torch.device(device))

    def any(self, flag: bool) -> bool:
        """True in all processes if True in one."""
        if self.size == 1:
            return flag
        value = torch.tensor(float(flag), device=self.device)
        all_reduce(value)
        return value.item() > 0

    def stop(self) -> None:
        """Leave the group."""
        if self.size > 1:
            destroy_process_group()


class Trainer:
    """State of one run: network, moving average, optimiser, progress."""

    def __init__(self, config: TrainingConfig, options: RunOptions, group: Group) -> None:
        self.options, self.group = options, group
        self.checkpoint_path = options.out / "checkpoint.pt"
        torch.manual_seed(config.seed)
        resumed = load_checkpoint(self.checkpoint_path) if self.checkpoint_path.exists() else None
        self.config = config
        self.progress = resumed["progress"] if resumed else Progress()
        self.module = LossModule(config).to(group.device)
        if options.start_from and not resumed:
            start, _, _ = load_weights(options.start_from)
            self.module.network.load_state_dict(start.state_dict())
        self.average = AveragedModel(
            self.module.network,
            multi_avg_fn=get_ema_multi_avg_fn(config.ema_decay),
            use_buffers=True,
        )
        self.optimizer = torch.optim.Adam(
            self.module.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay
        )
        if resumed:
            self.module.load_state_dict(resumed["model"])
            self.average.load_state_dict(resumed["average"])
            self.optimizer.load_state_dict(resumed["optimizer"])
        self.model: nn.Module = self.module
        if group.size > 1:
            self.model = DistributedDataParallel(self.module, find_unused_parameters=True)
        self.generator = torch.Generator().manual_seed(config.seed + self.progress.step)

    def step(self, batch: TrainingBatch, rate: float) -> dict[str, float]:
        """One optimiser step; the losses and errors as numbers."""
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        joint = self.progress.step >= self.config.joint_from_step
        losses, errors = self.model(batch.to(self.group.device), joint, self.generator)
        total = weighted_sum(losses, self.config)
        self.optimizer.zero_grad(set_to_none=True)
        total.backward()
        norm = nn.utils.clip_grad_norm_(self.module.parameters(), self.config.gradient_clip)
        if torch.isfinite(norm):
            self.optimizer.step()
            self.average.update_parameters(self.module.network)
        self.progress.step += 1
        self.progress.frames += batch.volume.size * self.group.size
        values = {name: float(value.detach()) for name, value in losses.items()}
        values["total"], values["gradient_norm"] = float(total.detach()), float(norm)
        if len(errors.rotation_deg):
            values["rotation_deg"] = float(errors.rotation_deg.median())
            values["completion_iou"] = float(errors.completion_iou.mean())
        return values

    def save(self) -> None:
        """Checkpoint and, beside it, the averaged weights."""
        if self.group.rank:
            return
        save_checkpoint(
            self.checkpoint_path,
            self.config,
            self.progress,
            self.module.state_dict(),
            self.average.state_dict(),
            self.optimizer.state_dict(),
        )
        notes = {
            "steps": self.progress.step,
            "frames": self.progress.frames,
            "training_minutes": round(self.progress.seconds / 60, 1),
            "device": str(self.group.device.type),
            "seed": self.config.seed,
        }
        network = self.average.module
        save_weights(network, self.config.model, self.options.out / "weights.safetensors", notes)


def learning_rate(config: TrainingConfig, steps_done: int, run_share: float) -> float:
    """Warm-up over the first steps of all, constant, then linear to zero at the run's end."""
    rate = config.learning_rate * min(1.0, (steps_done + 1) / config.rate_warmup_steps)
    if config.decay_share > 0:
        rate *= min(1.0, max(0.01, (1 - run_share) / config.decay_share))
    return rate


class _StopRequest:
    """Set by ctrl-C or a termination signal; the step under way is finished first."""

    def __init__(self) -> None:
        self.asked = False
        for name in (signal.SIGINT, signal.SIGTERM):
            signal.signal(name, self._ask)

    def _ask(self, *_: object) -> None:
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True


def train(config: TrainingConfig, options: RunOptions, source: SceneSource) -> Path:
    """Train until --max-minutes, --max-steps or ctrl-C; returns the weights' path."""
    group = Group.start(options.device)
    if options.threads:
        torch.set_num_threads(options.threads)
    options.out.mkdir(parents=True, exist_ok=True)
    trainer = Trainer(config, options, group)
    log = _Log(options, quiet=group.rank > 0)
    try:
        _run(trainer, options, source, log)
    finally:
        trainer.save()
        log.close()
        group.stop()
    return options.out / "weights.safetensors"


def _run(trainer: Trainer, options: RunOptions, source: SceneSource, log: _Log) -> None:
    stop, start = _StopRequest(), time.monotonic()
    progress, seconds_before = trainer.progress, trainer.progress.seconds
    validation = fixed_batches(
        SceneSource("val", source.cad_dir, source.cad_share, source.data_dir),
        trainer.config,
        options.validation_scenes,
    )
    stream = SceneStream(
        source, trainer.config, progress.scenes, trainer.group.rank, trainer.group.size
    )
    loader = DataLoader(
        stream,
        batch_size=None,
        num_workers=options.workers,
        prefetch_factor=4 if options.workers else None,
    )
    last_save = last_validation = time.monotonic()
    steps_before = progress.step
    batches = iter(loader)
    while True:
        now = time.monotonic()
        share = (now - start) / 60 / options.max_minutes
        if options.max_steps:
            share = max(share, (progress.step - steps_before) / options.max_steps)
        if trainer.group.any(stop.asked or share >= 1):
            break
        batch = next(batches)
        waited = time.monotonic() - now
        rate = learning_rate(trainer.config, progress.step, share)
        values = trainer.step(batch, rate)
        progress.seconds = seconds_before + time.monotonic() - start
        progress.scenes += _scenes_per_step(trainer.config, trainer.group.size)
        log.step(progress, values, rate, waited, time.monotonic() - now, share)
        if time.monotonic() - last_save > 60 * options.save_every_minutes:
            trainer.save()
            last_save = time.monotonic()
        if time.monotonic() - last_validation > 60 * options.validate_every_minutes:
            log.validation(progress, _validate(trainer, validation))
            last_validation = time.monotonic()
    log.validation(progress, _validate(trainer, validation))


def _scenes_per_step(config: TrainingConfig, processes: int) -> int:
    """An upper bound, so that a resumed run never draws a scene twice."""
    return processes * -(-config.batch_frames // max(1, config.frames_per_scene - 1))


def _validate(trainer: Trainer, batches: list[TrainingBatch]) -> dict[str, float]:
    if trainer.group.rank:
        return {}
    return validate(trainer.average.module, batches, trainer.config, trainer.group.device)


class _Log:
    """A line a step to log.csv-like text, TensorBoard where installed, a line now and then."""

    def __init__(self, options: RunOptions, quiet: bool) -> None:
        self.console = Console(quiet=quiet)
        self.file = None if quiet else (options.out / "steps.log").open("a")
        self.board = None if quiet else _tensorboard(options.out)
        self.options, self.last, self.mean = options, 0.0, {}

    def step(
        self,
        progress: Progress,
        values: dict[str, float],
        rate: float,
        waited: float,
        took: float,
        share: float,
    ) -> None:
        if self.file is None:
            return
        shown = values | {"rate": rate, "wait_s": waited, "step_s": took}
        line = " ".join(f"{name}={value:.4g}" for name, value in shown.items())
        self.file.write(f"step={progress.step} {line}\n")
        for name, value in shown.items():
            self.mean[name] = 0.98 * self.mean.get(name, value) + 0.02 * value
            if self.board and progress.step % 20 == 0:
                self.board.add_scalar(f"train/{name}", value, progress.step)
        if time.monotonic() - self.last > 20:
            self.last = time.monotonic()
            self.file.flush()
            frames_a_second = progress.frames / max(progress.seconds, 1e-9)
            left = (1 - share) * self.options.max_minutes
            self.console.print(
                f"step {progress.step}  loss {self.mean['total']:.3f}  "
                f"iou {self.mean.get('completion_iou', 0):.2f}  "
                f"rotation {self.mean.get('rotation_deg', 180):.0f} deg  "
                f"{frames_a_second:.1f} frames/s  waiting {100 * self.mean['wait_s'] / self.mean['step_s']:.0f}%  "
                f"up to {left:.0f} min left",
                highlight=False,
            )

    def validation(self, progress: Progress, values: dict[str, float]) -> None:
        if self.file is None or not values:
            return
        line = "  ".join(f"{name} {value:.3g}" for name, value in values.items())
        self.console.print(f"validation at step {progress.step}: {line}", highlight=False)
        self.file.write(f"validation step={progress.step} {line}\n")
        self.file.flush()
        for name, value in values.items():
            if self.board:
                self.board.add_scalar(f"validation/{name}", value, progress.step)

    def close(self) -> None:
        if self.file is not None:
            self.file.close()
        if self.board:
            self.board.close()


def _tensorboard(out: Path):
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        return None
    return SummaryWriter(str(out / "tensorboard"))
