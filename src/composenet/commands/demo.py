"""`composenet demo`: generate a sequence, track it with the shipped weights, score the result."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from composenet.commands.evaluate import score_folder
from composenet.commands.scoring import tall_table
from composenet.commands.terminal import say
from composenet.commands.track import INTERRUPTED_EXIT_CODE, summary, track_recording
from composenet.metrics.evaluate import aggregate
from composenet.metrics.report import RunInfo, sections, write_results
from composenet.sequences import open_sequence

DEMO_INDEX = 0
"""Which sequence of the validation split is shown: the first, whatever it gives."""


def run_demo(out: Path, *, device: str, frames: int, weights: Path | None = None) -> int:
    """The command. Everything it writes lies under `out`."""
    from composenet.pipeline import load_tracker
    from composenet.synth.dataset import write_split
    from composenet.synth.scene import SceneOptions

    console = Console()
    say(console, "1/3 generating a room with moving furniture and a hand-held RGB-D camera")
    options = SceneOptions(frames=frames)
    (recording,) = write_split("val", 1, out / "recording", DEMO_INDEX, options)
    say(console, "2/3 tracking it: detection, completion, pose, identity")
    sequence = open_sequence(recording)
    result = out / "result"
    run = track_recording(sequence, load_tracker(weights, device=device), result, console)
    if not run.complete:
        return INTERRUPTED_EXIT_CODE
    say(console, "3/3 scoring it against the generator's ground truth")
    scores = {"full": aggregate({recording.name: score_folder(recording, result).scores})}
    write_results(out / "results.json", RunInfo(f"val_{DEMO_INDEX:05d}", seed=0), scores)
    console.print(tall_table(sections(scores)[0]))
    say(console, summary(run, result))
    return 0
