"""One picture of a result: frames with completed objects, and the room from above.

python examples/pictures.py RECORDING RESULT --out picture.png [--frames 6]
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from PIL import Image

import composenet
from composenet.errors import ComposenetError, DataError
from composenet.predictions import read_predictions
from composenet.records import TrackState
from composenet.sequences import SequenceOptions
from composenet.view.figures import ColoredMesh, overlay, track_color
from composenet.view.meshes import canonical_mesh, place
from composenet.view.plots import contact_sheet, top_view

DEFAULT_READING = SequenceOptions()


def main(
    recording: Annotated[Path, tyro.conf.Positional],
    result: Annotated[Path, tyro.conf.Positional],
    out: Path = Path("picture.png"),
    frames: int = 6,
    columns: int = 3,
    reading: Annotated[SequenceOptions, tyro.conf.arg(name="")] = DEFAULT_READING,
) -> None:
    """Draw what was seen in evenly spaced frames, and the top view on the right."""
    run = read_predictions(result)
    if not run.frames:
        raise DataError(f"{result}: no tracked frame in it; run `composenet track` again")
    meshes = {i: canonical_mesh(grid) for i, grid in run.canonical.items()}
    wanted = np.linspace(0, len(run.frames) - 1, frames).round().astype(int)
    records = {run.frames[i].index: run.frames[i] for i in wanted}
    pictures = []
    for frame in composenet.open_sequence(recording, options=reading):
        if frame.index not in records:
            continue
        seen = [
            entry
            for entry in records[frame.index].objects
            if entry.state in (TrackState.TRACKED, TrackState.RE_FOUND)
        ]
        placed = [
            ColoredMesh(place(mesh, entry.S_world_canonical), track_color(entry.track_id))
            for entry in seen
            if (mesh := meshes.get(entry.track_id)) is not None
        ]
        # the result's own world: of other frames the recording may be levelled slightly otherwise
        there = replace(frame, T_world_camera=records[frame.index].T_world_camera)
        pictures.append(overlay(there, seen, placed))
    if not pictures:
        raise DataError(f"{recording}: has none of the frames of {result}, of {run.sequence!r}")
    sheet = contact_sheet(pictures, columns=columns, cell=(400, 300))
    above = top_view(run, width=600)
    above = above.resize((round(above.width * sheet.height / above.height), sheet.height))
    joined = Image.new("RGB", (sheet.width + above.width, sheet.height), "white")
    joined.paste(sheet, (0, 0))
    joined.paste(above, (sheet.width, 0))
    out.parent.mkdir(parents=True, exist_ok=True)
    joined.save(out, quality=88)
    print(f"wrote {out}")


if __name__ == "__main__":
    try:
        tyro.cli(main)
    except (ComposenetError, OSError, ValueError) as error:
        sys.exit(f"pictures: {error}")
