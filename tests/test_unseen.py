"""Tops that depth cameras do not see: only images know of it, and only in training."""

from dataclasses import replace

import numpy as np
import pytest

from composenet.geometry.transform import make_T, rotation_z
from composenet.records import Camera, FloatArray
from composenet.synth import render, unseen
from composenet.synth.furniture import make_furniture, styles
from composenet.synth.furniture.parts import glass, wood
from composenet.synth.occupancy import occupancy
from composenet.synth.scene import generate_scene
from composenet.synth.sensor import SensorKind, measure, sample_sensor
from composenet.synth.shape import Shape

CAMERA = Camera(np.array([[140.0, 0, 79.5], [0, 140.0, 59.5], [0, 0, 1]]), 160, 120)


def from_above(height_m: float = 2.0) -> FloatArray:
    """T_camera_world of a camera that looks down from there."""
    return make_T(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, height_m]))


def all_clear(shape: Shape) -> Shape:
    return replace(shape, materials=tuple(replace(m, clear=True) for m in shape.materials))


def with_top(shape: Shape, **look: object) -> Shape:
    top = unseen.top_faces(shape)
    before = shape.materials[shape.face_material[np.flatnonzero(top)[0]]]
    return replace(
        shape,
        face_material=np.where(top, len(shape.materials), shape.face_material).astype(np.int32),
        materials=(*shape.materials, replace(before, **look)),  # type: ignore[arg-type]
    )


@pytest.mark.parametrize("style", ["dining", "round_legs", "coffee", "glass", "trestle"])
def test_the_top_is_the_board_that_covers_the_table(style: str) -> None:
    for seed in range(5):
        shape = make_furniture("table", np.random.default_rng(seed), style)
        top = unseen.top_faces(shape)
        points = shape.vertices[shape.faces[top]].reshape(-1, 3)
        assert np.allclose(points.max(axis=0)[2], shape.extents_m[2] / 2, atol=0.02)
        assert (np.ptp(points[:, :2], axis=0) > 0.9 * shape.extents_m[:2]).all()
        assert np.ptp(points[:, 2]) < 0.09
        assert not top.all()


def test_a_shape_without_a_board_has_no_top() -> None:
    shape = make_furniture("sofa", np.random.default_rng(0), styles("sofa")[0])
    thick = replace(shape, face_part=np.zeros_like(shape.face_part))
    assert not unseen.top_faces(thick).any()
    rng = np.random.default_rng(0)
    desks = [replace(thick, class_name="desk") for _ in range(60)]
    assert all(unseen.as_cameras_fail(desk, rng) is desk for desk in desks)


def test_images_look_through_clear_glass_and_truth_does_not() -> None:
    shape = make_furniture("table", np.random.default_rng(1), "dining")
    clear = with_top(shape, clear=True)
    assert np.array_equal(occupancy(clear), occupancy(shape))
    assert np.array_equal(clear.extents_m, shape.extents_m)
    floor = make_furniture("table", np.random.default_rng(2), "dining")  # anything below it
    below = make_T(np.eye(3), np.array([0.0, 0.0, -1.5]))
    T = from_above() @ np.stack([np.eye(4), below])
    opaque, through = (
        render.draw(render.assemble((s, floor)), T, CAMERA).depth_m for s in (shape, clear)
    )
    middle = (60, 80)
    assert opaque[middle] == pytest.approx(2.0 - shape.extents_m[2] / 2, abs=1e-3)
    assert through[middle] == pytest.approx(3.5 - floor.extents_m[2] / 2, abs=1e-3)
    alone = render.draw(render.assemble((floor,)), T[1:], CAMERA)
    kept = render.draw(render.assemble((clear, floor)), T, CAMERA).face
    legs = kept < np.count_nonzero(clear.drawn)
    assert np.array_equal(through[~legs], alone.depth_m[~legs])


def test_what_is_not_drawn_is_no_part_of_the_whole_silhouette() -> None:
    shape = make_furniture("table", np.random.default_rng(1), "dining")
    clear = with_top(shape, clear=True)
    visible = render.draw(render.assemble((clear,)), from_above(4.0)[None], CAMERA).face >= 0
    count = int(visible.sum())
    assert render.share_seen(clear, from_above(4.0), count, CAMERA) == pytest.approx(1.0)
    assert render.share_seen(shape, from_above(4.0), count, CAMERA) < 0.5


def test_faces_keep_their_shape_and_material_where_others_are_left_out() -> None:
    first = with_top(make_furniture("table", np.random.default_rng(3), "dining"), clear=True)
    second = make_furniture("chair", np.random.default_rng(4))
    mesh = render.assemble((first, second))
    one, other = (render.assemble((s,)) for s in (first, second))
    n = len(one.faces)
    assert n < len(first.faces) and len(mesh.faces) == n + len(second.faces)
    assert np.array_equal(mesh.faces[n:] - len(first.vertices), other.faces)
    assert np.array_equal(mesh.face_instance, np.repeat([0, 1], [n, len(second.faces)]))
    assert np.array_equal(mesh.color[mesh.face_material[n:]], other.color[other.face_material])


def test_a_whole_piece_of_clear_glass_is_nowhere() -> None:
    shape = all_clear(make_furniture("table", np.random.default_rng(5), "glass"))
    seen = make_furniture("chair", np.random.default_rng(6))
    T = np.tile(from_above(), (2, 1, 1))
    both = render.draw(render.assemble((shape, seen)), T, CAMERA)
    assert np.array_equal(
        both.depth_m, render.draw(render.assemble((seen,)), T[1:], CAMERA).depth_m
    )
    assert render.share_seen(shape, from_above(), 0, CAMERA) == 0.0


@pytest.mark.parametrize("kind", list(SensorKind))
def test_gloss_returns_no_depth(kind: SensorKind) -> None:
    rng = np.random.default_rng(7)
    sensor = replace(sample_sensor(rng), kind=kind, loss=0.45, edge_loss=0.0)
    depth = np.full((120, 160), 2.0, np.float32)
    shares = []
    for shininess in (0.3, 1.6, unseen._GLOSS[1]):
        surface = np.full((120, 160, 3), (0.7, 0.8, shininess), np.float32)
        got = measure(sensor, depth, surface, CAMERA, np.random.default_rng(8))
        shares.append(np.count_nonzero(got) / got.size)
    assert shares[0] > 0.95 > shares[1] > shares[2] == 0.0


def test_glass_is_told_from_what_is_painted() -> None:
    rng = np.random.default_rng(9)
    assert glass(rng).glass and not glass(rng).clear and not wood(rng).glass


def test_some_tables_and_desks_change_and_nothing_else_does() -> None:
    changed = {"table": 0, "desk": 0, "bed": 0}
    for class_name in changed:
        for seed in range(60):
            shape = make_furniture(class_name, np.random.default_rng(seed))
            if any(m.glass for m in shape.materials):
                continue
            for draw in range(5):
                after = unseen.as_cameras_fail(shape, np.random.default_rng((seed, draw)))
                changed[class_name] += after is not shape
                assert np.array_equal(after.vertices, shape.vertices)
                assert np.array_equal(after.faces, shape.faces)
                if after is not shape:
                    differ = after.face_material != shape.face_material
                    assert np.array_equal(differ, unseen.top_faces(shape))
                    assert np.array_equal(~after.drawn, differ) == after.materials[-1].clear
    assert 25 < changed["table"] < 70 and 12 < changed["desk"] < 50 and changed["bed"] == 0


def test_training_alone_has_them() -> None:
    def odd(split: str, index: int) -> int:
        shapes = generate_scene(split, index).shapes
        looks = [s.materials[m] for s in shapes for m in np.unique(s.face_material)]
        return sum(look.clear or look.shininess > 1 for look in looks)

    assert sum(odd("train", 7_000_000 + i) for i in range(20)) >= 3
    assert not any(odd("val", i) for i in range(20))


def test_turned_shapes_lose_the_same_faces() -> None:
    shape = make_furniture("table", np.random.default_rng(10), "dining")
    turned = replace(shape, vertices=np.float32(shape.vertices @ rotation_z(0.3).T))
    assert np.array_equal(unseen.top_faces(turned), unseen.top_faces(shape))
