"""What the commands say, word for word: brackets and colons in a path are no markup."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.text import Text


def say(console: Console, line: str) -> None:
    """One line, not wrapped."""
    console.print(Text(line), soft_wrap=True)


def warn(console: Console, line: str) -> None:
    """One line that begins with a yellow `warning`."""
    console.print(Text.assemble(("warning", "yellow"), f" {line}"), soft_wrap=True)


def warn_of_cad(console: Console, folder: Path) -> None:
    """What of a folder of meshes is not used. Raises DataError where nothing can be."""
    from composenet.synth.cad import left_out, load_library

    load_library(folder)
    if others := left_out(folder):
        warn(console, f"{folder}: {', '.join(others)} left out, which is none of the ten classes")
