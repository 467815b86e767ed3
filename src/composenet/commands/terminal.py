"""What the commands say, word for word: brackets and colons in a path are no markup."""

from __future__ import annotations

from rich.console import Console
from rich.text import Text


def say(console: Console, line: str) -> None:
    """One line, not wrapped."""
    console.print(Text(line), soft_wrap=True)


def warn(console: Console, line: str) -> None:
    """One line that begins with a yellow `warning`."""
    console.print(Text.assemble(("warning", "yellow"), f" {line}"), soft_wrap=True)
