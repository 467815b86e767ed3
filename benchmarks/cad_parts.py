"""A folder of furniture meshes in two parts, one to train with and one that training never sees.

python benchmarks/cad_parts.py CAD --out runs/cad_parts

Of each class every second mesh, in name order, goes to OUT/unseen, the others to OUT/trained. These
are links; CAD stays as it is. A class of one mesh is in OUT/trained alone.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from composenet.synth.cad import load_library


def main(cad: Annotated[Path, tyro.conf.Positional], out: Path) -> None:
    """cad: CLASS/*.{obj,ply,off,stl,glb}. out: folder to write, replaced where it holds links."""
    for class_name, files in load_library(cad.resolve()).items():
        for i, file in enumerate(files):
            link = out / ("unseen" if i % 2 else "trained") / class_name / file.name
            link.parent.mkdir(parents=True, exist_ok=True)
            link.unlink(missing_ok=True)
            link.symlink_to(file)
    for part in ("trained", "unseen"):
        counts = {name: len(files) for name, files in load_library(out / part).items()}
        print(f"{out / part}: {sum(counts.values())} meshes {counts}")


if __name__ == "__main__":
    tyro.cli(main)
