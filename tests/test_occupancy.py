"""Occupancy against volumes, a slow reference, thin things, overlaps and CAD."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import igl
import manifold3d as m3
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from composenet.records import Symmetry
from composenet.synth.furniture import make_furniture
from composenet.synth.furniture.parts import box, cushion, cylinder, revolve, rod
from composenet.synth.occupancy import occupancy
from composenet.synth.shape import Material, Shape, ShapeBuilder

CAD = Path(__file__).resolve().parents[2] / "shared" / "cad"
WHITE = Material((1.0, 1.0, 1.0))


def shape_of(*parts: m3.Manifold) -> Shape:
    builder = ShapeBuilder()
    for part in parts:
        builder.add(part, WHITE)
    return builder.build("table", "test", Symmetry.NONE)


def cell_centres(shape: Shape, cells: int) -> np.ndarray:
    axis = (np.arange(cells) + 0.5) / cells - 0.5
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    return (grid * shape.extents_m).reshape(-1, 3)


def reference(shape: Shape, cells: int) -> np.ndarray:
    """Cells whose centre is inside any part, by exact winding numbers."""
    inside = np.zeros(cells**3, dtype=bool)
    for part in range(int(shape.face_part.max()) + 1):
        faces = shape.faces[shape.face_part == part].astype(np.int64)
        vertices = shape.vertices.astype(np.float64)
        inside |= igl.winding_number(vertices, faces, cell_centres(shape, cells)) > 0.5
    return inside.reshape(cells, cells, cells)


def iou(a: np.ndarray, b: np.ndarray) -> float:
    return float((a & b).sum() / (a | b).sum())


def test_a_box_fills_its_own_box() -> None:
    assert occupancy(shape_of(box((1.0, 2.0, 0.5))), 16).all()


def test_axes_are_x_y_z() -> None:
    """A foot under the +x, -y, and a head over the whole: only that corner is solid below."""
    foot, head = box((0.5, 1.0, 1.0), (0.75, 0.5, 0.5)), box((1.0, 2.0, 1.0), (0.5, 1.0, 1.5))
    solid = occupancy(shape_of(foot, head), 8)
    expected = np.zeros((8, 8, 8), dtype=bool)
    expected[:, :, 4:] = True
    expected[4:, :4, :4] = True
    np.testing.assert_array_equal(solid, expected)


def test_volume_of_overlapping_parts_is_that_of_their_union() -> None:
    parts = [
        cushion((1, 1, 1)),
        cushion((1, 1, 1), (0.5, 0.3, 0.2)),
        box((1, 1, 1), (0.2, -0.4, 0.4)),
        box((1, 1, 1), (0.2, -0.4, 0.4)),  # twice the same
    ]
    shape = shape_of(*parts)
    union = m3.Manifold.batch_boolean(parts, m3.OpType.Add)
    volume = occupancy(shape).mean() * np.prod(shape.extents_m)
    assert volume == pytest.approx(union.volume(), rel=0.01)


def test_hollow_bowl_is_hollow() -> None:
    bowl = cylinder(0.5, 0.5) - cylinder(0.4, 0.5, (0, 0, 0.1))
    shape = shape_of(bowl)
    solid = occupancy(shape, 32)
    assert not solid[16, 16, 16:].any() and solid[16, 16, 0]
    assert solid.mean() * np.prod(shape.extents_m) == pytest.approx(bowl.volume(), rel=0.03)


@pytest.mark.parametrize("name", ["chair", "bathtub", "cabinet", "sofa"])
def test_agrees_with_the_slow_reference(name: str) -> None:
    shape = make_furniture(name, np.random.default_rng(5))
    fast = occupancy(shape, 16)
    share = reference(shape, 48).reshape(16, 3, 16, 3, 16, 3).mean(axis=(1, 3, 5))
    assert fast[share > 0.7].all()
    assert (fast & (share == 0)).sum() < 0.1 * fast.sum()  # what is thin falls between samples


@given(st.integers(0, 10_000))
@settings(max_examples=20)
def test_thin_boards_and_legs_never_vanish(seed: int) -> None:
    """Parts thinner than a cell or about as thin, turned anyhow: every centre line is marked."""
    rng = np.random.default_rng(seed)
    start, end = rng.uniform(-0.9, 0.9, (2, 3))
    frame = [box((0.02, 0.02, 0.02), corner) for corner in ((-1, -1, -1), (1, 1, 1))]
    shape = shape_of(
        *frame,
        rod(start, end, rng.uniform(0.008, 0.045)),
        box((0.6, 0.5, 0.004), rng.uniform(-0.5, 0.5, 3)),
    )
    solid = occupancy(shape, 32)
    line = start + (end - start) * np.linspace(0.05, 0.95, 40)[:, None]
    index = np.clip(np.floor((line / shape.extents_m + 0.5) * 32).astype(int), 1, 30)
    near = [solid[x - 1 : x + 2, y - 1 : y + 2, z - 1 : z + 2].any() for x, y, z in index]
    assert all(near)
    assert solid.any(axis=2).sum() >= 0.9 * (0.6 * 16) * (0.5 * 16)  # the board, seen from above


def test_order_of_parts_and_direction_do_not_matter() -> None:
    legs = [rod((x, y, 0), (x, y, 0.7), 0.02) for x in (-0.3, 0.3) for y in (-0.6, 0.6)]
    parts = [box((0.8, 1.4, 0.03), (0, 0, 0.7)), *legs]
    solid = occupancy(shape_of(*parts))
    np.testing.assert_array_equal(solid, occupancy(shape_of(*parts[::-1])))
    turned = occupancy(shape_of(*(part.rotate((0, 0, 180)) for part in parts)))
    assert iou(solid, turned[::-1, ::-1]) > 0.97


def test_round_things_have_the_right_volume() -> None:
    profile = [(0.0, 0.0), (0.5, 0.0), (0.2, 1.0), (0.0, 1.0)]
    shape = shape_of(revolve(profile, 48))
    volume = occupancy(shape).mean() * np.prod(shape.extents_m)
    assert volume == pytest.approx(np.pi / 3 * (0.25 + 0.1 + 0.04), rel=0.02)


def test_winding_path_agrees_with_rays_on_a_closed_shape() -> None:
    shape = shape_of(cushion((1, 2, 1)), box((0.5, 2.4, 0.5)))
    assert iou(occupancy(shape), occupancy(replace(shape, watertight=False))) > 0.93


def test_a_missing_face_leaves_the_solid() -> None:
    shape = shape_of(box((1, 1, 1)))
    lidless = replace(shape, faces=shape.faces[2:], watertight=False)
    assert occupancy(lidless, 16).mean() > 0.9


def test_a_lone_sheet_keeps_its_cells() -> None:
    block = shape_of(box((1, 1, 0.2), (0, 0, -0.4)), box((0.001, 1, 1), (0.2, 0, 0)))
    sheet = replace(block, watertight=False)
    solid = occupancy(sheet, 16)
    assert solid[11, :, 8].all() and not solid[3, :, 8].any()


@pytest.mark.parametrize(
    ("name", "low", "high"),
    [
        ("sofa/kenney_loungeSofa", 0.4, 0.7),
        ("table/kenney_table", 0.1, 0.3),
        ("bathtub/kenney_bathtub", 0.3, 0.6),
    ],
)
def test_cad_gives_a_plausible_solid(name: str, low: float, high: float) -> None:
    path = CAD / f"{name}.obj"
    if not path.exists():
        pytest.skip(f"no CAD sample at {path}")
    mesh = trimesh.load(path, force="mesh")
    vertices = mesh.vertices[:, [2, 0, 1]]
    vertices = vertices - (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    zeros = np.zeros(len(mesh.faces), dtype=np.int32)
    shape = Shape(
        name,
        "cad",
        Symmetry.NONE,
        vertices.astype(np.float32),
        mesh.faces.astype(np.int32),
        zeros,
        zeros,
        (WHITE,),
        watertight=False,
    )
    assert low < occupancy(shape).mean() < high
