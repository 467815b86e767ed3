"""Training's own rooms: desks that touch and are used, sitting groups, a camera at a desk."""

from collections.abc import Callable

import numpy as np
import pytest

from composenet.synth import furnish
from composenet.synth.camera_path import move_camera
from composenet.synth.collision import Item, inside
from composenet.synth.furniture import make_furniture
from composenet.synth.furniture.clutter import make_clutter, make_small_clutter
from composenet.synth.furniture.clutter_desk import keyboard
from composenet.synth.furniture.clutter_small import monitor
from composenet.synth.placement import Layout
from composenet.synth.room import make_room
from composenet.synth.scene import generate_scene
from composenet.synth.shape import Shape
from composenet.synth.workplace import dress, fit_desks, island

SCREENS = {"monitor", "picture_tube"}


def layout_and_source(seed: int, *, plain: bool = False) -> tuple[Layout, furnish.MakeShape]:
    """plain: desks whose tops are flat all over."""
    rng = np.random.default_rng(seed)

    def make(class_name: str) -> Shape:
        if "clutter" in class_name:
            return (make_clutter if class_name == "clutter" else make_small_clutter)(rng)
        style = "single_pedestal" if plain and class_name == "desk" else None
        return make_furniture(class_name, rng, style)

    return Layout(make_room(rng, (5.5, 5.0)), rng), make


def desks_of(layout: Layout) -> list[Item]:
    return [i for i in layout.items if i.shape.class_name == "desk"]


def forth_m(desk: Item, other: Item) -> float:
    """How far towards the sitter of a desk the middle of another thing is from its own."""
    forth = np.array([np.cos(desk.yaw), np.sin(desk.yaw)])
    return float(forth @ np.subtract(other.xyz, desk.xyz)[:2])


def gap_m(a: Item, b: Item) -> float:
    """Between two boxes that stand along the same directions, the larger of the two axes."""
    c, s = np.cos(a.yaw), np.sin(a.yaw)
    apart = np.abs(np.array([[c, s], [-s, c]]) @ np.subtract(b.xyz, a.xyz)[:2])
    return float((apart - (a.extents_m + b.extents_m)[:2] / 2).max())


def test_desks_stand_flush_in_rows_and_islands() -> None:
    flush = islands = 0
    for seed in range(30):
        layout, make = layout_and_source(seed)
        fit_desks(layout, make, 4)
        desks = desks_of(layout)
        assert len(desks) <= 4
        for k, a in enumerate(desks):
            for b in desks[k + 1 :]:
                assert abs(np.sin(a.yaw - b.yaw)) < 0.04
                assert gap_m(a, b) > 1e-4
                flush += gap_m(a, b) < 0.02
                if np.cos(a.yaw - b.yaw) < 0 and gap_m(a, b) < 0.02:  # at its back, not before it
                    assert forth_m(a, b) < -0.02
                    islands += 1
        for chair in (i for i in layout.items if i.shape.class_name == "chair"):
            desk = min(desks, key=lambda d: np.hypot(*np.subtract(d.xyz, chair.xyz)[:2]))
            assert forth_m(desk, chair) > 0
    assert flush >= 25 and islands >= 10


def test_no_desk_where_none_is_wanted() -> None:
    layout, make = layout_and_source(0)
    assert fit_desks(layout, make, 0) == [] and not layout.items


def test_four_desks_stand_back_to_back_and_side_by_side() -> None:
    whole = 0
    for seed in range(40):
        layout, make = layout_and_source(seed)
        desks = [layout.items[i] for i in island(layout, make("desk"), 4)]
        touching = [sum(gap_m(a, b) < 0.02 for b in desks if b is not a) for a in desks]
        whole += len(desks) == 4 and min(touching) >= 2
    assert whole >= 5


def test_screens_stand_at_the_back_and_look_at_the_sitter(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Layout, "on_top", lambda *_: False)  # screens and keyboards alone
    screens = keyboards = 0
    for seed in range(40):
        layout, make = layout_and_source(seed, plain=True)
        assert layout.free(make("desk"))
        dress(layout, make, 0)
        desk, *things = layout.items
        last = [t for t in things if t.shape.style in SCREENS]
        for thing in things:
            assert thing.support == 0
            assert thing.span_m[0] == pytest.approx(desk.span_m[1], abs=0.02)
        for screen in last:
            assert abs(screen.yaw - desk.yaw) < 0.8
            assert forth_m(desk, screen) - screen.extents_m[0] / 2 < -0.05
        for board in (t for t in things if t.shape.style == "keyboard"):
            assert any(0.1 < forth_m(screen, board) < 0.6 for screen in last)
            keyboards += 1
        screens += len(last)
    assert screens >= 40 and keyboards >= 15


def test_the_mouse_is_at_the_right_of_who_sits_there() -> None:
    """Who looks along -X with Z up has Y at the right."""
    mice = 0
    for seed in range(20):
        board = keyboard(np.random.default_rng(seed))
        tops = board.vertices[:, 2] > board.vertices[:, 2].max() - 1e-3
        if np.ptp(board.vertices[tops, 1]) < 0.05:  # the mouse is higher than the keys
            assert board.vertices[tops, 1].mean() > 0.1
            mice += 1
    assert mice >= 10


def test_nothing_is_set_beyond_an_edge_or_into_a_thing() -> None:
    layout, make = layout_and_source(1, plain=True)
    assert layout.free(make("desk"))
    screen = monitor(np.random.default_rng(0))
    deep, wide, _ = layout.items[0].extents_m
    assert not layout.on_top_at(0, screen, 0.0, wide / 2, 0.0)
    assert not layout.on_top_at(0, screen, deep / 2, 0.0, 0.0)
    assert layout.on_top_at(0, screen, 0.0, 0.0, 0.0)
    assert not layout.on_top_at(0, screen, 0.0, 0.05, 0.0)


def test_a_camera_at_a_desk_sees_it_from_nearby() -> None:
    """Of the rooms with a desk alone, in which a camera in training may be held at it."""
    near = seen = 0
    for seed in range(40):
        layout, make = layout_and_source(seed)
        if not layout.against_wall(make("desk")):
            continue
        paths = np.tile(np.array([layout.items[0].place]), (20, 1, 1))
        poses = move_camera(layout, paths, 0.5, training=True)
        away = poses[:, :2, 3] - paths[:, 0, :2]
        assert np.isfinite(poses).all()
        for x, y in poses[:, :2, 3]:
            assert inside(layout.room, (x, y, 0.0, 0.0, 0.0))
        turns = np.einsum("fij,fij->f", poses[1:, :3, :3], poses[:-1, :3, :3])
        assert np.degrees(np.arccos((turns - 1) / 2)).max() < 35
        if np.hypot(*away.T).max() < 1.9 and np.ptp(poses[:, :2, 3], axis=0).max() < 0.35:
            near += 1
            ahead = np.einsum("fi,fi->f", poses[:, :2, 2], -away) > 0
            seen += ahead.mean() > 0.8
    assert near >= 10 and seen >= 0.7 * near


def test_only_training_has_these_rooms(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []

    def programme(kind: str) -> Callable[[Layout, furnish.MakeShape], None]:
        def fill(layout: Layout, make: furnish.MakeShape) -> None:
            made.append(kind)
            furnish._mixed(layout, make)

        return fill

    for kind in ("workplace", "crowded"):
        monkeypatch.setitem(furnish._PROGRAMMES, kind, programme(kind))
    for index in range(12):
        generate_scene("val", index)
        generate_scene("test", index)
    assert made == []
    for index in range(30):
        generate_scene("train", index)
    assert set(made) == {"workplace", "crowded"}


def test_a_crowded_room_is_crowded() -> None:
    """More lies on its furniture than in other rooms."""
    on_top = {}
    for kind in ("crowded", "living"):
        things = []
        for seed in range(12):
            layout, make = layout_and_source(seed)
            furnish._PROGRAMMES[kind](layout, make)
            furnish._add_clutter(layout, make, furnish._FULLER.get(kind, furnish._THINGS))
            things.append(sum(i.support is not None for i in layout.items))
        on_top[kind] = np.mean(things)
    assert on_top["crowded"] > 1.8 * on_top["living"]


def test_chairs_look_at_their_table() -> None:
    chairs = 0
    for seed in range(20):
        layout, make = layout_and_source(seed)
        furnish._chairs_around(layout, make)
        table, *group = layout.items
        assert table.shape.class_name == "table"
        for chair in group:
            at_table = np.subtract(table.xyz, chair.xyz)[:2]
            front = np.array([np.cos(chair.yaw), np.sin(chair.yaw)])
            assert front @ at_table > 0
            chairs += 1
    assert chairs >= 25
