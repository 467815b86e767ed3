"""A folder of furniture meshes in two parts, one to train with and one that training never sees.

python benchmarks/cad_parts.py CAD --out runs/cad_parts

Of each class every second mesh, in name order, goes to OUT/unseen, the others to OUT/trained. These
are links; CAD stays as it is. A class of one mesh is in OUT/trained alone.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import tyro

from composenet.errors import ComposenetError, DataError
from composenet.synth.cad import load_library


def main(cad: Annotated[Path, tyro.conf.Positional], out: Path) -> None:
    """cad: CLASS/*.{obj,ply,off,stl,glb}. out: folder to make. Raises DataError where it is."""
    if out.exists():
        raise DataError(f"{out}: is there already, with other parts perhaps; give another --out")
    for class_name, files in load_library(cad.resolve()).items():
        for i, file in enumerate(files):
            link = out / ("unseen" if i % 2 else "trained") / class_name / file.name
            link.parent.mkdir(parents=True, exist_ok=True)
            link.symlink_to(file)
    for part in ("trained", "unseen"):
        counts = {name: len(files) for name, files in load_library(out / part).items()}
        print(f"{out / part}: {sum(counts.values())} meshes {counts}")


if __name__ == "__main__":
    try:
        tyro.cli(main)
    except ComposenetError as error:
        sys.exit(f"cad_parts: {error}")
