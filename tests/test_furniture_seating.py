"""Chairs, tables, desks, sofas and clutter: closed, of real sizes, repeatable, as symmetric as
they say."""

from __future__ import annotations

import time
from collections.abc import Callable

import manifold3d as m3
import numpy as np
import pytest

from composenet.records import Symmetry
from composenet.synth.furniture import chairs, clutter, curves, desks, sofas, tables
from composenet.synth.furniture.clutter_small import SMALL
from composenet.synth.occupancy import occupancy
from composenet.synth.shape import Shape

Builder = Callable[[np.random.Generator], Shape]

STYLES: dict[tuple[str, str], Builder] = {
    (class_name, style): builder
    for module in (chairs, tables, desks, sofas, clutter)
    for class_name, styles in module.STYLES.items()
    for style, builder in styles.items()
} | {("small clutter", style): builder for style, builder in SMALL.items()}

# least and largest depth (X), width (Y) and height (Z) in metres
SIZES = {
    "chair": ((0.28, 0.28, 0.42), (1.25, 1.1, 1.45)),
    "table": ((0.25, 0.28, 0.28), (1.6, 3.3, 1.15)),
    "desk": ((0.38, 0.65, 0.65), (2.0, 2.0, 1.6)),
    "sofa": ((0.6, 1.0, 0.5), (2.8, 3.8, 1.35)),
    "clutter": ((0.03, 0.1, 0.08), (2.3, 2.3, 2.5)),
    "small clutter": ((0.01, 0.05, 0.01), (0.55, 0.6, 0.51)),
}
LEAST_STYLES = {"chair": 8, "table": 8, "desk": 5, "sofa": 6, "clutter": 20, "small clutter": 10}
TURNS = {Symmetry.TWO: (2,), Symmetry.FOUR: (1, 2, 3), Symmetry.INF: (1,)}

every_style = pytest.mark.parametrize(
    ("class_name", "style"), list(STYLES), ids=["/".join(key) for key in STYLES]
)


def _build(class_name: str, style: str, seed: int) -> Shape:
    return STYLES[class_name, style](np.random.default_rng(seed))


@every_style
def test_shapes_are_closed_and_of_real_size(class_name: str, style: str) -> None:
    low, high = map(np.array, SIZES[class_name])
    for seed in range(6):
        shape = _build(class_name, style, seed)
        assert shape.class_name == class_name.split()[-1]
        assert (shape.extents_m >= low).all() and (shape.extents_m <= high).all(), shape.extents_m
        assert 12 <= len(shape.faces) <= 2600
        assert np.isfinite(shape.vertices).all()
        for part in np.unique(shape.face_part):
            faces = shape.faces[shape.face_part == part].astype(np.uint32)
            used, compact = np.unique(faces, return_inverse=True)
            mesh = m3.Mesh(shape.vertices[used], compact.reshape(-1, 3).astype(np.uint32))
            solid = m3.Manifold(mesh)
            assert solid.status() == m3.Error.NoError
            assert solid.volume() > 0, "faces look inwards"


@every_style
def test_the_seed_decides(class_name: str, style: str) -> None:
    first, again, other = (_build(class_name, style, seed) for seed in (7, 7, 8))
    assert np.array_equal(first.vertices, again.vertices)
    assert np.array_equal(first.faces, again.faces)
    assert first.materials == again.materials
    assert first.vertices.shape != other.vertices.shape or not np.allclose(
        first.vertices, other.vertices, atol=1e-3
    )


def _turned_iou(shape: Shape, angle: float) -> float:
    """IoU of the shape with itself turned about +Z, on a grid that holds both."""
    around = np.array([(np.cos(angle), -np.sin(angle)), (np.sin(angle), np.cos(angle))])
    turned = shape.vertices.copy()
    turned[:, :2] = turned[:, :2] @ around.T.astype(np.float32)
    reach = float(np.linalg.norm(shape.vertices[:, :2], axis=1).max())
    half = np.array([reach, reach, shape.extents_m[2] / 2])
    pins = np.array([-half, half], dtype=np.float32)  # keep both grids on the same box
    sides = []
    for points in (shape.vertices, turned):
        count = len(points)
        sides.append(
            occupancy(
                Shape(
                    shape.class_name,
                    shape.style,
                    shape.symmetry,
                    np.concatenate([points, pins]),
                    np.concatenate([shape.faces, [[count, count, count + 1]]]).astype(np.int32),
                    np.append(shape.face_part, shape.face_part.max() + 1).astype(np.int32),
                    np.append(shape.face_material, 0).astype(np.int32),
                    shape.materials,
                ),
                32,
            )
        )
    both, either = (sides[0] & sides[1]).sum(), (sides[0] | sides[1]).sum()
    return float(both / either)


@every_style
def test_declared_symmetry_is_true(class_name: str, style: str) -> None:
    for seed in range(4):
        shape = _build(class_name, style, seed)
        for turns in TURNS.get(shape.symmetry, ()):
            assert _turned_iou(shape, turns * np.pi / 2) > 0.9, (seed, shape.symmetry)
        if shape.symmetry is Symmetry.INF:  # cells of thin walls differ where grids cross
            assert _turned_iou(shape, np.pi / 6) > 0.8, seed


def test_symmetries_of_tables_by_their_tops() -> None:
    kinds = {
        style: {_build("table", style, seed).symmetry for seed in range(20)}
        for style in tables.STYLES["table"]
    }
    assert kinds["dining"] == kinds["trestle"] == kinds["oval"] == {Symmetry.TWO}
    assert kinds["square"] <= {Symmetry.FOUR, Symmetry.NONE}
    assert Symmetry.INF in kinds["round_pedestal"]
    assert kinds["round_legs"] == {Symmetry.FOUR, Symmetry.NONE}


def test_every_class_has_its_styles() -> None:
    for class_name, least in LEAST_STYLES.items():
        assert sum(name == class_name for name, _ in STYLES) >= least


@pytest.mark.parametrize("style", ["kitchen_slatted", "shell", "office", "parsons", "wing"])
def test_backs_of_chairs_are_behind(style: str) -> None:
    for seed in range(5):
        points = _build("chair", style, seed).vertices
        upper = points[points[:, 2] > 0.7 * points[:, 2].max()]
        assert upper[:, 0].mean() < -0.05


def test_random_clutter_is_clutter() -> None:
    rng = np.random.default_rng(0)
    styles = {clutter.make_clutter(rng).style for _ in range(60)}
    assert len(styles) > 15
    for _ in range(40):
        shape = clutter.make_small_clutter(rng)
        assert shape.class_name == "clutter" and shape.extents_m[2] < 0.51


def test_shapes_are_cheap() -> None:
    times = []
    for builder in STYLES.values():
        start = time.process_time()
        builder(np.random.default_rng(1))
        times.append(time.process_time() - start)
    assert np.median(times) < 0.02


def test_plate_and_post_have_the_volumes_of_their_boxes() -> None:
    y, z = np.linspace(-0.2, 0.2, 5)[:, None], np.linspace(0, 0.5, 4)[None]
    flat = np.stack(np.broadcast_arrays(0.0, y, z), axis=-1)
    assert curves.plate(flat, 0.02).volume() == pytest.approx(0.4 * 0.5 * 0.02)
    assert curves.post([(0, 0, 0), (0.3, 0, 1)], 0.05).volume() == pytest.approx(0.05**2)
    slab = curves.soft_slab([(0, 0), (1, 0), (1, 1), (0, 1)], 0.4, 0.1, 0.0)
    assert slab.volume() == pytest.approx(0.1)


def test_bent_path_keeps_its_ends_and_cuts_its_corners() -> None:
    path = curves.bent_path([(0, 0, 0), (0, 0, 1), (1, 0, 1)], 0.2, steps=4)
    assert path[0] == pytest.approx((0, 0, 0)) and path[-1] == pytest.approx((1, 0, 1))
    gaps = np.linalg.norm(path - np.array([0, 0, 1]), axis=1)
    assert gaps.min() == pytest.approx(0.2 / np.sqrt(8))
