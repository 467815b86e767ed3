"""Procedural furniture: closed parts, centred boxes, real sizes, seeds, declared symmetry."""

from __future__ import annotations

import time
from dataclasses import replace

import manifold3d as m3
import numpy as np
import pytest
from scipy.spatial import cKDTree

from composenet.records import CLASS_NAMES, Symmetry
from composenet.synth import cad
from composenet.synth.furniture import FURTHER_STYLES, STYLES, make_furniture, styles
from composenet.synth.occupancy import occupancy
from composenet.synth.shape import Material, Shape, ShapeBuilder

CASES = [(name, style) for name in (*CLASS_NAMES, "clutter") for style in styles(name)]

# low and high extents over x (depth), y (width), z (height), metres; doors may stand open
SIZES = {
    "bathtub": ((0.6, 1.0, 0.4), (2.0, 2.4, 2.1)),
    "bed": ((1.1, 0.6, 0.35), (2.8, 3.0, 2.4)),
    "bookshelf": ((0.15, 0.2, 0.5), (0.8, 2.1, 2.4)),
    "cabinet": ((0.15, 0.3, 0.3), (1.4, 2.8, 2.6)),
    "chair": ((0.3, 0.3, 0.4), (1.6, 1.3, 1.5)),
    "desk": ((0.3, 0.6, 0.6), (2.2, 2.4, 1.8)),
    "sink": ((0.25, 0.25, 0.7), (1.3, 2.0, 2.1)),
    "sofa": ((0.5, 1.0, 0.5), (2.6, 3.8, 1.4)),
    "table": ((0.25, 0.25, 0.25), (2.6, 3.2, 1.3)),
    "toilet": ((0.45, 0.3, 0.36), (1.0, 1.0, 2.2)),
}
TURNS = {Symmetry.TWO: (180,), Symmetry.FOUR: (90, 180), Symmetry.INF: (30, 90, 180)}


def shape_of(name: str, style: str, seed: int) -> Shape:
    return make_furniture(name, np.random.default_rng(seed), style)


def same(a: Shape, b: Shape) -> bool:
    return (
        np.array_equal(a.vertices, b.vertices)
        and np.array_equal(a.faces, b.faces)
        and a.materials == b.materials
    )


def turned_iou(shape: Shape, degrees: float) -> float:
    """IoU of the occupancy of the shape and of the shape turned about +Z."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]], dtype=np.float32)
    before = occupancy(shape, 48)
    after = occupancy(replace(shape, vertices=shape.vertices @ turn.T), 48)
    return float((before & after).sum() / (before | after).sum())


def test_every_class_has_at_least_four_styles() -> None:
    assert all(len(styles(name)) >= 4 for name in CLASS_NAMES)
    assert len(styles("cabinet")) >= 8


@pytest.mark.parametrize(("name", "style"), CASES)
def test_parts_are_closed_and_the_box_is_centred(name: str, style: str) -> None:
    for seed in range(2):
        shape = shape_of(name, style, seed)
        assert (shape.class_name, shape.watertight) == (name, True)
        assert len(shape.faces) <= 2500
        low, high = shape.vertices.min(axis=0), shape.vertices.max(axis=0)
        np.testing.assert_allclose(low, -high, atol=1e-5)
        for part in range(int(shape.face_part.max()) + 1):
            faces = shape.faces[shape.face_part == part]
            edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
            assert np.array_equal(  # each edge is walked once in each direction
                edges[np.lexsort(edges.T)], edges[:, ::-1][np.lexsort(edges[:, ::-1].T)]
            )
            corners = shape.vertices[faces].astype(np.float64)
            crosses = np.cross(corners[:, 1], corners[:, 2])
            assert np.einsum("ij,ij->", corners[:, 0], crosses) > 0  # faces look outwards


@pytest.mark.parametrize(("name", "style"), [case for case in CASES if case[0] in SIZES])
def test_sizes_are_realistic(name: str, style: str) -> None:
    low, high = SIZES[name]
    for seed in range(20, 26):
        shape = shape_of(name, style, seed)
        extents = shape.extents_m + np.array([0, 0, shape.mount_m])  # height above the floor
        assert np.all(extents >= low), (seed, extents)
        assert np.all(extents <= high), (seed, extents)


@pytest.mark.parametrize(("name", "style"), CASES)
def test_a_seed_fixes_the_shape_and_another_changes_it(name: str, style: str) -> None:
    assert same(shape_of(name, style, 7), shape_of(name, style, 7))
    others = [shape_of(name, style, seed).extents_m for seed in range(6)]
    assert len({tuple(np.round(extents, 4)) for extents in others}) == 6


@pytest.mark.parametrize(("name", "style"), [case for case in CASES if case[0] in SIZES])
def test_declared_symmetry_is_true(name: str, style: str) -> None:
    for seed in range(4):
        shape = shape_of(name, style, seed)
        for degrees in TURNS.get(shape.symmetry, ()):
            if degrees in (30, 90):
                assert abs(shape.extents_m[0] / shape.extents_m[1] - 1) < 0.02
            assert turned_iou(shape, degrees) > 0.9, (seed, degrees)


@pytest.mark.parametrize("name", CLASS_NAMES)
def test_what_looks_alike_from_behind_is_declared_so(name: str) -> None:
    """Where every corner has another one that half a turn brings to its place."""
    rng, alike = np.random.default_rng(5), 0
    for _ in range(250):
        shape = make_furniture(name, rng, further=True)
        corners = shape.vertices.astype(np.float64)
        away, _ = cKDTree(corners).query(corners * [-1, -1, 1])
        if away.max() < 1e-3:
            alike += 1
            assert shape.symmetry is not Symmetry.NONE, shape.style
    assert alike or name in ("bed", "cabinet", "sink", "sofa", "toilet")


@pytest.mark.parametrize(
    ("name", "symmetric", "not_at_all"),
    [
        ("table", 10, 0),
        ("bathtub", 3, 4),
        ("bookshelf", 2, 7),
        ("chair", 0, 10),
        ("desk", 0, 10),
        ("sofa", 0, 10),
    ],
)
def test_symmetry_of_meshes_is_found_by_their_solids(
    name: str, symmetric: int, not_at_all: int
) -> None:
    """That of generated furniture, which is known. A square table's corners may be round enough to
    be taken for round, and what only a drawer or the slope of a tub tells is taken for twofold."""
    rng, right, known = np.random.default_rng(6), 0, 0
    for _ in range(14):
        shape = make_furniture(name, rng)
        found = cad.symmetry_of(shape)
        known += shape.symmetry is not Symmetry.NONE
        if shape.symmetry is Symmetry.FOUR:
            assert found in (Symmetry.FOUR, Symmetry.INF), shape.style
        elif shape.symmetry is not Symmetry.NONE:
            assert found is shape.symmetry, shape.style
        else:
            right += found is Symmetry.NONE
    assert known >= symmetric and right >= not_at_all


@pytest.mark.parametrize(("wide_m", "symmetry"), [(0.495, "four"), (0.492, "four"), (0.47, "two")])
def test_what_fills_its_box_is_within_a_cell_of_itself(wide_m: float, symmetry: str) -> None:
    builder = ShapeBuilder()
    builder.add(m3.Manifold.cube([0.5, wide_m, 0.4]), Material((0.5, 0.5, 0.5)))
    assert cad.symmetry_of(builder.build("table", "block", Symmetry.NONE)) == symmetry


@pytest.mark.parametrize("name", ["bathtub", "sink", "toilet"])
def test_vessels_are_hollow(name: str) -> None:
    """Material is missing under the rim: the solid is well below its convex hull."""
    for style in styles(name):
        shape = shape_of(name, style, 3)
        hull = m3.Manifold.hull_points(shape.vertices.astype(np.float64)).volume()
        volume = occupancy(shape, 48).mean() * np.prod(shape.extents_m)
        assert volume < (0.7 if name == "bathtub" else 0.93) * hull, style


def test_the_fixed_splits_have_their_own_styles() -> None:
    """Only training draws from those that came later."""
    rng = np.random.default_rng(0)
    fixed = {make_furniture("desk", rng).style for _ in range(100)}
    drawn = {make_furniture("desk", rng, further=True).style for _ in range(100)}
    assert fixed <= set(STYLES["desk"])
    assert drawn & set(STYLES["desk"]) and drawn & set(FURTHER_STYLES["desk"])
    assert not set(STYLES["desk"]) & set(FURTHER_STYLES["desk"])


def test_unknown_names_are_refused() -> None:
    with pytest.raises(KeyError):
        make_furniture("piano", np.random.default_rng(0))
    with pytest.raises(KeyError):
        make_furniture("bed", np.random.default_rng(0), "hammock")


def test_making_furniture_is_quick() -> None:
    rng = np.random.default_rng(0)
    seconds = []
    for index in range(60):
        begin = time.process_time()
        make_furniture(CLASS_NAMES[index % 10], rng)
        seconds.append(time.process_time() - begin)
    assert np.median(seconds) < 0.03  # 3 ms on an idle core
