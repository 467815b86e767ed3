"""Training of the baselines' Mask R-CNN: streamed frames, resumable, bounded in time."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from rich.console import Console
from torch import Tensor, nn
from torch.nn.functional import cross_entropy, interpolate

from composenet.baselines.mask_rcnn import NAME
from composenet.baselines.mask_rcnn_data import (
    FRAMES_PER_SCENE,
    POOL_FRAMES,
    FrameStream,
    MaskSample,
)
from composenet.baselines.mask_rcnn_network import (
    FINEST_STRIDE,
    FIRST_LABEL,
    MaskRCNN,
    MaskRcnnConfig,
    make_network,
    save_network,
)
from composenet.config import from_dict, to_dict
from composenet.errors import WeightsError
from composenet.pipeline import select_device
from composenet.records import CLASS_NAMES
from composenet.synth.scene import SceneOptions
from composenet.training.checkpoint import Progress, read_state, write_state
from composenet.training.processes import PREFETCHED, StopRequest, batches_of
from composenet.training.schedule import scheduled_rate

FORMAT = "composenet.mask_rcnn_checkpoint/2"
WARMUP_STEPS = 150
DECAY_SHARE = 0.5
"""the rate falls to a hundredth over this last part of a run, which so ends with usable weights"""
WEIGHT_DECAY = 1e-4
GRADIENT_CLIP = 5.0
SAY_EVERY_S, SAVE_EVERY_S = 20.0, 300.0


@dataclass(frozen=True)
class TrainingOptions:
    """How long, where and how a run goes. resume: go on from the checkpoint in `out`."""

    out: Path
    max_minutes: float = 60.0
    max_steps: int | None = None
    batch_frames: int = 2
    learning_rate: float = 1e-3
    workers: int = 1
    threads: int | None = None
    device: str = "auto"
    seed: int = 0
    resume: bool = False


class Trainer:
    """State of one run: network, optimiser, progress."""

    def __init__(self, config: MaskRcnnConfig, options: TrainingOptions) -> None:
        self.options, self.config, self.progress = options, config, Progress()
        self.checkpoint_path = options.out / "checkpoint.pt"
        self.device = select_device(options.device)
        torch.manual_seed(options.seed)
        stored = self._stored()
        if stored:
            self.config = from_dict(stored["config"], MaskRcnnConfig)
            self.progress = Progress(**stored["progress"])
        self.network = make_network(self.config).to(self.device).train()
        self.semantic = SemanticLoss(self.network, self.config).to(self.device)
        self.parameters = [*self.network.parameters(), *self.semantic.parameters()]
        self.optimizer = torch.optim.AdamW(
            self.parameters, lr=options.learning_rate, weight_decay=WEIGHT_DECAY
        )
        if stored:
            self.network.load_state_dict(stored["network"])
            self.semantic.load_state_dict(stored["semantic"])
            self.optimizer.load_state_dict(stored["optimizer"])

    def step(self, batch: list[MaskSample], rate: float) -> dict[str, float]:
        """One optimiser step; the losses as numbers."""
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        images = [sample.image.to(self.device) for sample in batch]
        losses = self.network(images, [sample.target(self.device) for sample in batch])
        losses["loss_semantic"] = self.semantic()
        total = torch.stack(list(losses.values())).sum()
        self.optimizer.zero_grad(set_to_none=True)
        total.backward()
        norm = nn.utils.clip_grad_norm_(self.parameters, GRADIENT_CLIP)
        if torch.isfinite(norm):
            self.optimizer.step()
        self.progress.step += 1
        self.progress.frames += len(batch)
        values = {name.removeprefix("loss_"): float(v.detach()) for name, v in losses.items()}
        return values | {"total": float(total.detach())}

    def save(self) -> Path:
        """Checkpoint and weights, each written atomically."""
        state = {
            "format": FORMAT,
            "config": to_dict(self.config),
            "progress": asdict(self.progress),
            "network": self.network.state_dict(),
            "semantic": self.semantic.state_dict(),
            "optimizer": self.optimizer.state_dict(),
        }
        write_state(self.checkpoint_path, state)
        notes = self.progress.notes(self.device, self.options.seed)
        path = self.options.out / NAME
        save_network(self.network, self.config, path, notes)
        return path

    def _stored(self) -> dict[str, Any] | None:
        path = self.checkpoint_path
        if self.options.resume != path.exists():
            raise WeightsError(
                f"{path}: no checkpoint to go on from; leave --resume out"
                if self.options.resume
                else f"{path}: a run has begun here; give --resume to go on, or another --out"
            )
        if not self.options.resume:
            return None
        keys = {"config", "progress", "network", "semantic", "optimizer"}
        return read_state(path, FORMAT, keys)


class SemanticLoss(nn.Module):
    """What class every pixel is of, read from the finest level of the pyramid: a loss beside Mask
    R-CNN's own, so that a backbone that starts from nothing learns from all pixels of a frame and
    not from its few proposals alone. Gone once training is over."""

    def __init__(self, network: MaskRCNN, config: MaskRcnnConfig) -> None:
        super().__init__()
        n_labels = FIRST_LABEL + len(CLASS_NAMES)
        self.classify = nn.Conv2d(config.pyramid_channels, n_labels, 1)
        self._targets: list[dict[str, Tensor]] = []
        self._finest = torch.empty(0)
        network.transform.register_forward_hook(self._keep_targets)
        network.backbone.register_forward_hook(self._keep_finest)

    def _keep_targets(self, _module: nn.Module, _inputs: object, output: tuple) -> None:
        self._targets = output[1] or []

    def _keep_finest(self, _module: nn.Module, _inputs: object, pyramid: dict[str, Tensor]) -> None:
        self._finest = pyramid["0"]

    def forward(self) -> Tensor:
        """Mean cross entropy over the pixels of the frames that the network saw last."""
        logits = interpolate(
            self.classify(self._finest), scale_factor=FINEST_STRIDE, mode="bilinear"
        )
        losses = []
        for image, target in zip(logits, self._targets, strict=True):
            labels = (target["labels"][:, None, None] * target["masks"]).sum(dim=0)
            height, width = labels.shape
            losses.append(cross_entropy(image[None, :, :height, :width], labels[None]))
        return torch.stack(losses).mean()


def train(config: MaskRcnnConfig, options: TrainingOptions, scenes: SceneOptions) -> Path:
    """Train until max_minutes, max_steps or ctrl-C; the path of the weights. Raises WeightsError
    where a run cannot begin or go on."""
    if options.threads:
        torch.set_num_threads(options.threads)
    options.out.mkdir(parents=True, exist_ok=True)
    trainer = Trainer(config, options)
    with StopRequest() as stop, Log(options.out) as log:
        try:
            _run(trainer, _batches(trainer, scenes), stop, log)
        finally:
            path = trainer.save()
    return path


def _run(
    trainer: Trainer, batches: Iterator[list[MaskSample]], stop: StopRequest, log: Log
) -> None:
    options, progress = trainer.options, trainer.progress
    start = saved = time.monotonic()
    seconds_before, steps_before = progress.seconds, progress.step
    while not stop.asked_at:
        now = time.monotonic()
        share = (now - start) / 60 / options.max_minutes
        if options.max_steps:
            share = max(share, (progress.step - steps_before) / options.max_steps)
        if share >= 1:
            break
        batch = next(batches)
        waited = time.monotonic() - now
        rate = scheduled_rate(
            options.learning_rate, WARMUP_STEPS, DECAY_SHARE, progress.step, share
        )
        values = trainer.step(batch, rate)
        progress.scenes += -(-len(batch) // FRAMES_PER_SCENE)
        progress.seconds = seconds_before + time.monotonic() - start
        values |= {"rate": rate, "wait_s": waited, "step_s": time.monotonic() - now}
        log.step(progress, values, (1 - share) * options.max_minutes)
        if time.monotonic() - saved > SAVE_EVERY_S:
            trainer.save()
            saved = time.monotonic()


def _batches(trainer: Trainer, scenes: SceneOptions) -> Iterator[list[MaskSample]]:
    """Batches from the workers. Counts the scenes that those draw ahead, so that a resumed run
    never draws one twice."""
    options, progress = trainer.options, trainer.progress
    stream = FrameStream(options.batch_frames, progress.scenes, options.seed, scenes)
    ahead = POOL_FRAMES + (1 + PREFETCHED) * options.batch_frames
    progress.scenes += -(-ahead // FRAMES_PER_SCENE) * max(1, options.workers)
    return iter(batches_of(stream, options.workers))


class Log:
    """A line a step to steps.log, a line now and then to the terminal."""

    def __init__(self, out: Path) -> None:
        self._file = (out / "steps.log").open("a")
        self._console = Console()
        self._mean: dict[str, float] = {}
        self._said = 0.0

    def __enter__(self) -> Log:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def step(self, progress: Progress, values: dict[str, float], minutes_left: float) -> None:
        """Note one step."""
        line = " ".join(f"{name}={value:.4g}" for name, value in values.items())
        self._file.write(f"step={progress.step} {line}\n")
        for name, value in values.items():
            if math.isfinite(value):
                self._mean[name] = 0.98 * self._mean.get(name, value) + 0.02 * value
        if time.monotonic() - self._said < SAY_EVERY_S:
            return
        self._said = time.monotonic()
        self._file.flush()
        names = ("total", "objectness", "classifier", "box_reg", "mask", "semantic")
        losses = "  ".join(f"{name} {self._mean.get(name, math.nan):.3f}" for name in names)
        waiting = 100 * self._mean["wait_s"] / self._mean["step_s"]
        self._console.print(
            f"step {progress.step}  {losses}  {self._mean['step_s']:.1f} s a step, waiting "
            f"{waiting:.0f}%  up to {minutes_left:.0f} min left",
            highlight=False,
            soft_wrap=True,
        )
