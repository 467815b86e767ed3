"""The command line as a command of the program, or one line on what is wrong with it."""

from __future__ import annotations

import contextlib
import io
import sys
from collections.abc import Callable, Mapping
from typing import Any

import tyro
from pydantic import TypeAdapter, ValidationError

from composenet import __version__

DESCRIPTION = (
    "Finds, completes, poses and tracks furniture in RGB-D video. `composenet --version` prints "
    "the version."
)


def parse_command(commands: Mapping[str, Callable[..., Any]]) -> Any:
    """The command that the arguments ask for, by its name in `commands`. A mistake in them is said
    in one line, too."""
    if sys.argv[1:] == ["--version"]:
        print(f"composenet {__version__}")
        sys.exit(0)
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            command = tyro.extras.subcommand_cli_from_dict(
                dict(commands),
                prog="composenet",
                description=DESCRIPTION,
                config=(tyro.conf.OmitArgPrefixes,),
            )
        TypeAdapter(type(command)).validate_python(vars(command))
        return command
    except SystemExit as stop:
        if stop.code:
            print(f"composenet: {_one_line(said.getvalue())}", file=sys.stderr)
        raise
    except ValidationError as error:
        first = error.errors()[0]
        option = str(first["loc"][0]).replace("_", "-")
        print(f"composenet: --{option} {first['input']}: {first['msg']}", file=sys.stderr)
        sys.exit(2)


def _one_line(box: str) -> str:
    """The message drawn in a box with its title in the frame; what follows a rule is help."""
    lines = [line.strip(" ╭╮╰╯│") for line in box.splitlines()]
    title, *body = [line.strip(" ─") for line in lines] or [""]
    rules = [n for n, line in enumerate(body) if not line]
    message = " ".join(" ".join(body[: rules[0] if rules else None]).split())
    return f"{title.lower()}: {message} (composenet COMMAND --help explains)"
