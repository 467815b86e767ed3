"""`composenet view`: show what `track` wrote."""

from __future__ import annotations

import webbrowser
from pathlib import Path

from rich.console import Console

from composenet.commands.terminal import say
from composenet.errors import DataError


def run_view(result: Path, *, replay: bool) -> int:
    """The command."""
    console = Console()
    if replay:
        from composenet.view.replay import serve_replay

        path = result / "replay.rrd"
        if not path.is_file():
            raise DataError(
                f"{path}: no replay; install composenet[viz] and track the recording again"
            )
        serve_replay(path, console)
        return 0
    page = result / "report.html"
    if not page.is_file():
        raise DataError(f"{page}: no report; is {result} a finished result of `composenet track`?")
    say(console, f"opening {page}")
    if not webbrowser.open(page.resolve().as_uri()):
        say(console, "no browser here: open the file yourself")
    return 0
