"""A recording played to and fro: what a camera sees that walks the same way again and again.

python benchmarks/to_and_fro.py RECORDING --out runs/to_and_fro [--passes 6]

RECORDING is a plain folder (docs/recordings.md). Every second pass is backwards. These are links;
RECORDING stays as it is.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from composenet.errors import DataError
from composenet.sequences.folder import matched_frames


def main(recording: Annotated[Path, tyro.conf.Positional], out: Path, passes: int = 6) -> None:
    """out: folder to write, which must not be there."""
    if out.exists():
        raise DataError(f"{out}: is there already; give another --out folder")
    recording = recording.resolve()
    names = [frame.name for frame in matched_frames(recording)[0]]
    order = [name for k in range(passes) for name in (names[::-1] if k % 2 else names)]
    out.mkdir(parents=True)
    for item in recording.iterdir():
        if not item.is_dir():
            (out / item.name).symlink_to(item)
            continue
        (out / item.name).mkdir()
        files = {file.stem: file for file in item.iterdir()}
        for i, name in enumerate(order):
            if file := files.get(name):
                (out / item.name / f"{i:06d}{file.suffix}").symlink_to(file)
    print(f"{out}: {len(order)} frames")


if __name__ == "__main__":
    tyro.cli(main)
