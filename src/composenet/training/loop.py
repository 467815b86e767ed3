"""The training loop: plain, resumable, bounded in time; one process or many."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel
from torch.optim.swa_utils import AveragedModel

from composenet.config import Config, flat, to_dict
from composenet.errors import ComposenetError, ConfigError, DataError, WeightsError
from composenet.files import held
from composenet.network.model import ComposeNet
from composenet.network.weights import load_weights, save_weights
from composenet.training.checkpoint import Progress, load_checkpoint, save_checkpoint
from composenet.training.config import TrainingConfig
from composenet.training.data import (
    LONGEST_WALK,
    POOL_FRAMES,
    SceneSource,
    SceneStream,
    fixed_batches,
)
from composenet.training.log import StepLog
from composenet.training.processes import PREFETCHED, Group, StopRequest, batches_of
from composenet.training.schedule import scheduled_rate
from composenet.training.step import LossModule, weighted_sum
from composenet.training.targets import TrainingBatch
from composenet.training.validation import validate

SCENES_OF_A_SEED = 1_000_000
"""A run draws its scenes from this many of its own, so that one that goes on from another's weights
with another seed meets new ones."""
MOST_NOT_TAKEN = 100
"""Steps in a row; a run that learns nothing ends."""


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
    """weights to begin a new run from; one that goes on has its own"""


class Trainer:
    """State of one run: network, moving average, optimiser, progress."""

    def __init__(self, config: TrainingConfig | None, options: RunOptions, group: Group) -> None:
        """config: None is that of the run where it has begun, else that of the weights to begin
        from, else the default. notes: what a user should know. Raises WeightsError, also for
        another configuration than the run's own."""
        self.options, self.group = options, group
        self.checkpoint_path = options.out / "checkpoint.pt"
        resumed = load_checkpoint(self.checkpoint_path) if self.checkpoint_path.exists() else None
        start = None
        self.notes: tuple[str, ...] = ()
        if resumed:
            _refuse_other(config, resumed["config"], self.checkpoint_path)
        elif options.start_from:
            start, own, _ = load_weights(options.start_from)
            config = config or TrainingConfig(model=own)
            self.notes = (
                *_differences(config.model, own, options.start_from),
                *_apart_at_first(config),
            )
        self.config = config = resumed["config"] if resumed else config or TrainingConfig()
        torch.manual_seed(config.seed)
        self.progress = resumed["progress"] if resumed else Progress()
        self.module = LossModule(config).to(group.device)
        if start is not None:
            with _fitting(cast(Path, options.start_from)):
                self.module.network.load_state_dict(start.state_dict())
        self.average = AveragedModel(
            self.module.network,
            multi_avg_fn=_warm_average(config.ema_decay),
            use_buffers=True,
        )
        self.optimizer = torch.optim.Adam(
            self.module.parameters(),
            lr=config.learning_rate,
            weight_decay=config.weight_decay,
            fused=group.device.type in ("cpu", "cuda") or None,  # None: torch chooses
        )
        if resumed:
            with _fitting(self.checkpoint_path):
                self.module.load_state_dict(resumed["model"])
                self.average.load_state_dict(resumed["average"])
                self.optimizer.load_state_dict(resumed["optimizer"])
        self.model: nn.Module = self.module
        if group.size > 1:
            self.model = DistributedDataParallel(self.module, find_unused_parameters=True)
        self.saved_step = self.progress.step
        self.not_taken = 0  # steps in a row, for gradients that are not finite
        own_seed = config.seed + self.progress.step + SCENES_OF_A_SEED * group.rank
        self.generator = torch.Generator().manual_seed(own_seed)

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
            self.not_taken = 0
        else:
            self._forget_batch()
            self.not_taken += 1
        self.progress.step += 1
        self.progress.frames += batch.volume.size * self.group.size
        told = losses | {"total": total, "gradient_norm": norm}
        if len(errors.rotation_deg):
            told["rotation_deg"] = errors.rotation_deg.median()
            told["completion_iou"] = errors.completion_iou.mean()
        numbers = torch.stack([value.detach() for value in told.values()]).tolist()
        return dict(zip(told, numbers, strict=True))

    @torch.no_grad()
    def _forget_batch(self) -> None:
        """After a step that cannot be taken: the normalisations' means have taken in its batch."""
        kept = self.average.module.buffers()
        for own, mean in zip(self.module.network.buffers(), kept, strict=True):
            own.copy_(mean)

    def save(self) -> None:
        """Checkpoint and, beside it, the averaged weights."""
        if self.group.rank == 0:
            self._write()
        self.saved_step = self.progress.step

    def _write(self) -> None:
        save_checkpoint(
            self.checkpoint_path,
            self.config,
            self.progress,
            self.module.state_dict(),
            self.average.state_dict(),
            self.optimizer.state_dict(),
        )
        notes = self.progress.notes(self.group.device, self.config.seed)
        path = self.options.out / "weights.safetensors"
        save_weights(self.averaged_network, self.config.model, path, notes)

    @property
    def averaged_network(self) -> ComposeNet:
        """The moving average of the network, which is what is kept and shown."""
        return cast(ComposeNet, self.average.module)


Tensors = tuple[Tensor, ...] | list[Tensor]


def _warm_average(decay: float) -> Callable[[Tensors, Tensors, Tensor | int], None]:
    """Exponential moving average, in place, whose memory is short at first: the start of a run
    leaves no trace in the weights of a short one."""

    def average(means: Tensors, values: Tensors, seen: Tensor | int) -> None:
        if means[0].is_floating_point():
            n = float(seen)
            torch._foreach_lerp_(means, values, 1 - min(decay, (1 + n) / (10 + n)))
        else:
            torch._foreach_copy_(means, values)

    return average


def _differences(model: Config, own: Config, path: Path) -> tuple[str, ...]:
    """What a run has otherwise than the weights of a file that it begins from."""
    there, here = flat(to_dict(own)), flat(to_dict(model))
    return tuple(
        f"{path} was made with {name} {there[name]}; this run has {value}"
        for name, value in here.items()
        if value != there[name]
    )


def _apart_at_first(config: TrainingConfig) -> tuple[str, ...]:
    """What a run that begins from weights should know of its first steps."""
    if not config.joint_from_step or config.parts in ("detector", "boxes"):
        return ()
    return (
        f"up to step {config.joint_from_step} poses are not taught, and objects on jittered true "
        'boxes; weights that have learned both go on best with "joint_from_step": 0',
    )


def _refuse_other(asked: TrainingConfig | None, own: TrainingConfig, path: Path) -> None:
    """Raises WeightsError where a run is to go on with another configuration than its own."""
    if asked is None or asked == own:
        return
    there, here = flat(to_dict(own)), flat(to_dict(asked))
    name = next(key for key in here if here[key] != there[key])
    raise WeightsError(
        f"{path}: a run has begun here with another configuration ({name} is {there[name]}, not "
        f"{here[name]}); leave --config out to go on with it, or begin anew from its weights with "
        "--start-from and another --out"
    )


@contextmanager
def _fitting(path: Path) -> Iterator[None]:
    """Raises WeightsError where the states of a file do not fit the configuration."""
    try:
        yield
    except (KeyError, ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())[:200]
        raise WeightsError(
            f"{path}: made with another configuration ({reason}); give the --config it was "
            "begun with, or another --out"
        ) from None


def learning_rate(config: TrainingConfig, steps_done: int, run_share: float) -> float:
    """The rate of one step (see `scheduled_rate`)."""
    return scheduled_rate(
        config.learning_rate, config.rate_warmup_steps, config.decay_share, steps_done, run_share
    )


def train(config: TrainingConfig | None, options: RunOptions, source: SceneSource) -> Path:
    """Train until --max-minutes, --max-steps or ctrl-C; returns the weights' path, where there are
    none if that came before the first step. config: see `Trainer`.

    Raises WeightsError where a checkpoint or weights cannot be used, DataError for bad data and
    where another run is writing to the folder.
    """
    group = Group.start(options.device)
    if options.threads:
        torch.set_num_threads(options.threads)
    options.out.mkdir(parents=True, exist_ok=True)
    _keep_weights(options.out)
    with nullcontext() if group.rank else held(options.out):
        trainer = Trainer(config, options, group)
        log = StepLog(options.out, options.max_minutes, quiet=group.rank > 0)
        if trainer.progress.step and options.start_from:
            log.say(f"goes on from {trainer.checkpoint_path}; --start-from is for a new --out")
        for note in (*trainer.notes, *_other_source(trainer.progress, source)):
            log.say(note)
        trainer.progress.source = source.told
        with StopRequest() as stop:
            try:
                _run(trainer, options, source, log, stop)
            finally:
                try:
                    if trainer.progress.step > trainer.saved_step:
                        trainer.save()
                finally:
                    log.close()
                    group.stop()
    return options.out / "weights.safetensors"


def _keep_weights(out: Path) -> None:
    """Raises WeightsError where a new run would replace weights that it does not go on from."""
    weights = out / "weights.safetensors"
    if weights.exists() and not (out / "checkpoint.pt").exists():
        raise WeightsError(
            f"{weights}: there is no checkpoint.pt beside it to go on from, and a new run would "
            f"replace it; give another --out, with --start-from {weights} to begin from it"
        )


def _other_source(progress: Progress, source: SceneSource) -> tuple[str, ...]:
    """What is to be said where a run goes on with other scenes than before."""
    before = progress.source
    return (f"goes on with {source.told}; before, it learned from {before}",) * (
        before not in ("", source.told)
    )


def _run(
    trainer: Trainer, options: RunOptions, source: SceneSource, log: StepLog, stop: StopRequest
) -> None:
    start = time.monotonic()
    progress, seconds_before = trainer.progress, trainer.progress.seconds
    validation = fixed_batches(
        SceneSource("val"),  # never what is learned from
        trainer.config,
        options.validation_scenes if trainer.group.rank == 0 else 0,
    )
    batches = _batches(trainer, options, source)
    last_save = last_validation = time.monotonic()
    steps_before = progress.step
    while True:
        now = time.monotonic()
        share = (now - start) / 60 / options.max_minutes
        if options.max_steps:
            share = max(share, (progress.step - steps_before) / options.max_steps)
        share = trainer.group.largest(1.0 if stop.asked_at else share)
        if share >= 1:
            break
        batch = next(batches)
        waited = time.monotonic() - now
        rate = learning_rate(trainer.config, progress.step, share)
        values = trainer.step(batch, rate)
        progress.seconds = seconds_before + time.monotonic() - start
        progress.scenes += _scenes_per_step(trainer.config, trainer.group.size)
        log.step(progress, values, rate, waited, time.monotonic() - now, share)
        if trainer.not_taken:
            log.say(f"step {progress.step} was not taken: its gradients are not finite")
        if trainer.not_taken >= MOST_NOT_TAKEN:
            raise ConfigError(
                f"{MOST_NOT_TAKEN} steps in a row were not taken, for their gradients are not "
                f"finite: begin anew from {options.out / 'weights.safetensors'} (--start-from, "
                "another --out) with a lower learning_rate"
            )
        if time.monotonic() - last_save > 60 * options.save_every_minutes:
            _save_or_tell(trainer, log)
            last_save = time.monotonic()
        if time.monotonic() - last_validation > 60 * options.validate_every_minutes:
            log.validation(progress, _validate(trainer, validation))
            last_validation = time.monotonic()
    if trainer.progress.step > trainer.saved_step:
        trainer.save()  # first: validation takes long, and may be cut off
    if not stop.asked_at:
        log.validation(progress, _validate(trainer, validation))


def _save_or_tell(trainer: Trainer, log: StepLog) -> None:
    """Save on the way: what does not work now may work the next time, and at the end it must."""
    try:
        trainer.save()
    except DataError as error:
        log.say(f"goes on, not saved: {error}")


def _batches(trainer: Trainer, options: RunOptions, source: SceneSource) -> Iterator[TrainingBatch]:
    """Batches from the workers. Counts the scenes that those draw before the first step."""
    config, group, progress = trainer.config, trainer.group, trainer.progress
    first = config.seed * SCENES_OF_A_SEED + progress.scenes
    stream = SceneStream(source, config, first, group.rank, group.size)
    loader = batches_of(stream, options.workers)
    ahead = _scenes_of(POOL_FRAMES, config, group.size)
    ahead += PREFETCHED * _scenes_per_step(config, group.size)
    progress.scenes += ahead * max(1, options.workers)
    try:
        yield from loader
    except ComposenetError as error:  # from a worker it comes with that one's traceback
        last = str(error).strip().splitlines()[-1]
        raise DataError(re.sub(r"^composenet\.errors\.\w+: ", "", last)) from None


def _scenes_per_step(config: TrainingConfig, processes: int) -> int:
    """An upper bound, so that a resumed run never draws a scene twice."""
    return _scenes_of(config.batch_frames, config, processes)


def _scenes_of(frames: int, config: TrainingConfig, processes: int) -> int:
    """How many scenes give so many frames to each process, at most: few samples are lost, but
    where every second frame is looked at there are no more than these."""
    least = min(config.frames_per_scene - 1, LONGEST_WALK // 2)
    return processes * -(-frames // max(1, least))


def _validate(trainer: Trainer, batches: list[TrainingBatch]) -> dict[str, float]:
    if trainer.group.rank:
        return {}
    return validate(trainer.averaged_network, batches, trainer.config, trainer.group.device)
