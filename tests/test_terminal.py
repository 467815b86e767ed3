"""What is said is said word for word, whatever it is."""

from __future__ import annotations

import io
import sys
import webbrowser
from pathlib import Path

import pytest
from rich.console import Console

from composenet import cli
from composenet.commands.progress import progress_bar
from composenet.commands.terminal import say, warn
from composenet.view.replay import INSTALL_HINT, NoReplay

ODD = "pip install 'composenet[viz]' :smile: [/red] \\[x]"


def test_a_line_is_said_as_it_is() -> None:
    text = io.StringIO()
    say(Console(file=text, width=20), ODD)
    warn(Console(file=text, width=20), ODD)
    assert text.getvalue() == f"{ODD}\nwarning {ODD}\n"


def test_the_progress_bar_shows_names_as_they_are() -> None:
    text = io.StringIO()
    console = Console(file=text, width=200, force_terminal=True, color_system=None)
    with progress_bar(console) as progress:
        progress.add_task("room[/a]", total=1, note="hall[b]")
    assert "room[/a]" in text.getvalue() and "hall[b]" in text.getvalue()


def said_by(capsys: pytest.CaptureFixture, monkeypatch, *arguments: object) -> str:
    """What the program prints to the end."""
    monkeypatch.setattr(sys, "argv", ["composenet", *map(str, arguments)])
    with pytest.raises(SystemExit) as stop:
        cli.main()
    assert not stop.value.code
    return capsys.readouterr().out


def test_folders_with_brackets(
    capsys, monkeypatch, recordings: Path, tiny_weights: Path, tmp_path: Path
) -> None:
    """`x[/y]` closes a style that nobody opened, `[viz]` opens one that there is none of."""
    monkeypatch.setattr("composenet.output.open_replay", lambda *_: NoReplay(INSTALL_HINT))
    out = tmp_path / "x[" / "y]" / "[viz]"
    options = ["--weights", tiny_weights, "--out", out]
    said = said_by(capsys, monkeypatch, "track", recordings / "val_00000", *options)
    assert f"open {out / 'report.html'}" in said
    assert f"warning {INSTALL_HINT}" in said and "'composenet[viz]'" in INSTALL_HINT
    monkeypatch.setattr(webbrowser, "open", lambda _: True)
    said = said_by(capsys, monkeypatch, "view", out)
    assert said == f"opening {out / 'report.html'}\n"
    data, scores = recordings / "val_00000", tmp_path / "z[" / "]"
    options = ["--predictions", out, "--out", scores]
    said = said_by(capsys, monkeypatch, "eval", "--data", data, *options)
    assert f"wrote {scores / 'results.json'}" in said


def test_synth_names_its_folder(capsys, monkeypatch, tmp_path: Path) -> None:
    out = tmp_path / "x[" / "y]"
    options = ["--frames", "1", "--image-size", "32", "32", "--out", out]
    assert said_by(capsys, monkeypatch, "synth", *options) == f"1 sequences in {out}\n"
