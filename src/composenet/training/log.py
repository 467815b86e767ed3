"""What a training run says: a line a step to a file, TensorBoard, a line now and then."""

from __future__ import annotations

import math
import time
from pathlib import Path

from rich.console import Console

from composenet.training.checkpoint import Progress


class StepLog:
    """Writes steps.log and TensorBoard events to a folder; quiet: writes and says nothing."""

    def __init__(self, out: Path, minutes: float, quiet: bool) -> None:
        self.console = Console(quiet=quiet)
        self.file = None if quiet else (out / "steps.log").open("a")
        self.board = None if quiet else _tensorboard(out)
        self.minutes, self.last = minutes, 0.0
        self.mean: dict[str, float] = {}

    def say(self, line: str) -> None:
        """One line for whoever looks on."""
        self.console.print(line, highlight=False, markup=False, soft_wrap=True)

    def step(
        self,
        progress: Progress,
        values: dict[str, float],
        rate: float,
        waited: float,
        took: float,
        share: float,
    ) -> None:
        """Note one step. share: 0..1 of the run that was done before it."""
        if self.file is None:
            return
        shown = values | {"rate": rate, "wait_s": waited, "step_s": took}
        line = " ".join(f"{name}={value:.4g}" for name, value in shown.items())
        self.file.write(f"step={progress.step} {line}\n")
        for name, value in shown.items():
            if math.isfinite(value):  # of a step that was skipped it is not
                self.mean[name] = 0.98 * self.mean.get(name, value) + 0.02 * value
            if self.board and progress.step % 20 == 0:
                self.board.add_scalar(f"train/{name}", value, progress.step)
        if time.monotonic() - self.last > 20:
            self.last = time.monotonic()
            self.file.flush()
            frames_a_second = progress.frames / max(progress.seconds, 1e-9)
            waiting = 100 * self.mean["wait_s"] / self.mean["step_s"]
            left = (1 - share) * self.minutes
            self.console.print(
                f"step {progress.step}  loss {self.mean.get('total', math.nan):.3f}  "
                f"{self._objects()}"
                f"{frames_a_second:.1f} frames/s  waiting {waiting:.0f}%  "
                f"up to {left:.0f} min left",
                highlight=False,
                soft_wrap=True,
            )

    def _objects(self) -> str:
        """How completion and pose do; nothing where they are not learned."""
        names = {"completion_iou": "iou {:.2f}  ", "rotation_deg": "rotation {:.0f} deg  "}
        return "".join(t.format(self.mean[n]) for n, t in names.items() if n in self.mean)

    def validation(self, progress: Progress, values: dict[str, float]) -> None:
        """Note figures of a validation; nothing where there are none."""
        if self.file is None or not values:
            return
        line = "  ".join(f"{name} {value:.3g}" for name, value in values.items())
        self.console.print(
            f"validation on generated rooms at step {progress.step}: {line}",
            highlight=False,
            soft_wrap=True,
        )
        self.file.write(f"validation step={progress.step} {line}\n")
        self.file.flush()
        for name, value in values.items():
            if self.board:
                self.board.add_scalar(f"validation/{name}", value, progress.step)

    def close(self) -> None:
        """Write what is still held back."""
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
