"""`composenet train`: learn from generated scenes, resumable and bounded in time."""

from __future__ import annotations

import os
from pathlib import Path

from rich.console import Console

from composenet.commands.terminal import say


def run_train(
    *,
    out: Path,
    config: Path | None,
    max_minutes: float,
    max_steps: int | None,
    device: str,
    workers: int,
    threads: int | None,
    data: Path | None,
    cad: Path | None,
    cad_share: float,
    start_from: Path | None,
) -> int:
    """The command."""
    from composenet.training.config import training_config
    from composenet.training.data import SceneSource
    from composenet.training.loop import RunOptions, train

    options = RunOptions(
        out=out,
        max_minutes=max_minutes,
        max_steps=max_steps,
        device=device,
        workers=workers,
        threads=threads,
        start_from=start_from,
    )
    source = SceneSource(cad_dir=cad, cad_share=cad_share, data_dir=data)
    weights = train(training_config(config) if config else None, options, source)
    if os.environ.get("RANK", "0") == "0":
        done = f"wrote {weights}; try it: composenet demo --weights {weights}"
        say(Console(), done if weights.exists() else "stopped before the first step: wrote nothing")
    return 0
