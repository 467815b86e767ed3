"""CAD in two parts, of which training sees one."""

from __future__ import annotations

from pathlib import Path

import cad_parts
import pytest
import trimesh

from composenet.errors import DataError


def test_no_mesh_is_in_both_parts(tmp_path: Path) -> None:
    cad, out = tmp_path / "cad", tmp_path / "out"
    (cad / "chair").mkdir(parents=True)
    for name in "abcd":
        trimesh.creation.box().export(cad / "chair" / f"{name}.obj")
    cad_parts.main(cad, out)
    parts = [{p.name for p in (out / part / "chair").iterdir()} for part in ("trained", "unseen")]
    assert parts == [{"a.obj", "c.obj"}, {"b.obj", "d.obj"}]
    trimesh.creation.box().export(cad / "chair" / "aa.obj")  # all that follow change their part
    with pytest.raises(DataError, match="is there already"):
        cad_parts.main(cad, out)
