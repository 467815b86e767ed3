"""`composenet train`: learn from generated scenes, resumable and bounded in time."""

from __future__ import annotations

import os
from pathlib import Path

from rich.console import Console

from composenet.commands.terminal import say, warn, warn_of_cad
from composenet.errors import DataError


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
    data_share: float,
    cad: Path | None,
    cad_share: float,
    start_from: Path | None,
) -> int:
    """The command."""
    from composenet.training.config import training_config
    from composenet.training.data import SceneSource
    from composenet.training.disk import disk_scene, other_splits
    from composenet.training.loop import RunOptions, train

    first_process = os.environ.get("RANK", "0") == "0"
    if data is not None and cad is not None and data_share == 1:
        raise DataError(
            "--cad is for generated scenes, not for those of --data; leave one out, or let "
            "--data-share leave some to be generated"
        )
    if data is None and data_share < 1:
        raise DataError("--data-share is of the sequences of --data; give their folder")
    if data is not None:
        disk_scene(data, 0)  # that nothing is there is said before anything is learned
    if data is not None and first_process and (others := other_splits(data)):
        warn(
            Console(),
            f"{data} holds sequences of {' and '.join(others)}: what was learned from them cannot "
            "be measured on them",
        )
    if cad is not None and first_process:
        warn_of_cad(Console(), cad)
    options = RunOptions(
        out=out,
        max_minutes=max_minutes,
        max_steps=max_steps,
        device=device,
        workers=workers,
        threads=threads,
        start_from=start_from,
    )
    source = SceneSource(cad_dir=cad, cad_share=cad_share, data_dir=data, data_share=data_share)
    weights = train(training_config(config) if config else None, options, source)
    if first_process:
        done = f"wrote {weights}; try it: composenet demo --weights {weights}"
        say(Console(), done if weights.exists() else "stopped before the first step: wrote nothing")
    return 0
