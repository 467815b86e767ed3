"""`composenet synth`: write sequences of the generator, or print how hard they are."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from composenet.commands.terminal import say, warn_of_cad


def run_synth(
    out: Path | None,
    *,
    split: str,
    count: int,
    start: int,
    cad: Path | None,
    cad_share: float,
    image_size: tuple[int, int],
    frames: int,
    stats: bool,
    workers: int,
) -> int:
    """The command."""
    from composenet.errors import DataError
    from composenet.synth.dataset import measure_split, write_split
    from composenet.synth.scene import SceneOptions
    from composenet.synth.stats import as_table, class_counts, requirements

    console = Console()
    if out is None and not stats:
        raise DataError("nothing to do: give --out DIR to write sequences, or --stats")
    if cad is not None:
        warn_of_cad(console, cad)  # before anything is written
    options = SceneOptions(frames=frames, image_size=image_size, cad_dir=cad, cad_share=cad_share)
    if out is not None:
        folders = write_split(split, count, out, start, options, workers)
        say(console, f"{len(folders)} sequences in {out}")
    if stats:
        measured = measure_split(split, count, start, options, workers)
        console.print(as_table(requirements(measured)))
        counts = class_counts(measured)
        say(console, "tracks: " + ", ".join(f"{n} {c}" for n, c in counts.items()))
    return 0
