"""Room programmes: which furniture a kind of room holds and how it stands together."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from composenet.errors import DataError
from composenet.records import CLASS_NAMES
from composenet.synth.kitchen import fit_kitchen
from composenet.synth.placement import Layout
from composenet.synth.room import make_room
from composenet.synth.shape import Shape
from composenet.synth.workplace import dress, fit_desks

MakeShape = Callable[[str], Shape]  # class name, "clutter" or "small clutter" -> shape
MIN_FURNITURE, MAX_FURNITURE, MIN_CLUTTER = 3, 9, 3
MOST_TRIES = 200
"""Rooms that are tried; of ordinary furniture few are not enough."""

ROOM_KINDS = {  # share, shortest and longest side in metres
    "living": (0.13, (3.8, 7.5)),
    "bedroom": (0.13, (3.2, 5.5)),
    "bathroom": (0.2, (3.0, 4.8)),
    "kitchen": (0.16, (2.9, 5.2)),
    "dining": (0.07, (3.4, 6.5)),
    "office": (0.12, (3.4, 7.0)),
    "mixed": (0.19, (4.0, 8.0)),
}
TRAINING_KINDS = {**ROOM_KINDS, "workplace": (0.16, (3.4, 7.5)), "crowded": (0.12, (3.4, 7.0))}
"""Training has rooms that are fuller of things too; their shares come on top."""
_THINGS, _FULLER = 5, {"crowded": 14}
"""Fewer small things than that lie on a piece of furniture."""


def furnish(
    rng: np.random.Generator, make: MakeShape, cad_share: float = 0.0, training: bool = False
) -> Layout:
    """A room with 3-9 pieces of furniture and at least 3 other things. cad_share: share of
    meshes in what `make` returns. training: of all kinds of rooms. Raises DataError where
    nothing fits."""
    kinds = TRAINING_KINDS if training else ROOM_KINDS
    share = np.array([kind[0] for kind in kinds.values()])
    for _ in range(MOST_TRIES):
        kind = str(rng.choice(list(kinds), p=share / share.sum()))
        size = rng.uniform(*kinds[kind][1], 2)
        layout = Layout(make_room(rng, (float(size[0]), float(size[1]))), rng, cad_share)
        _PROGRAMMES[kind](layout, make)
        _fill(layout, make, kind)
        if len(layout.furniture) < MIN_FURNITURE:
            continue
        _add_clutter(layout, make, _FULLER.get(kind, _THINGS))
        if len(layout.items) - len(layout.furniture) >= MIN_CLUTTER:
            return layout
    raise DataError(
        f"none of {MOST_TRIES} rooms has space for {MIN_FURNITURE} pieces of this furniture; "
        "are the meshes in metres?"
    )


def _full(layout: Layout) -> bool:
    return len(layout.furniture) >= MAX_FURNITURE


def _add(
    layout: Layout,
    make: MakeShape,
    class_name: str,
) -> int | None:
    """One piece where its kind usually stands; its index, or None where there is no room."""
    if _full(layout):
        return None
    wall = class_name not in ("chair", "table") and layout.rng.random() < 0.92
    for _ in range(2):
        shape = make(class_name)
        if layout.against_wall(shape) if wall else layout.free(shape):
            return len(layout.items) - 1
    return None


def _some(layout: Layout, make: MakeShape, class_name: str, low: int, high: int) -> None:
    for _ in range(int(layout.rng.integers(low, high + 1))):
        _add(layout, make, class_name)


def _desk_with_chair(layout: Layout, make: MakeShape) -> None:
    desk = _add(layout, make, "desk")
    if desk is not None and layout.rng.random() < 0.85 and not _full(layout):
        layout.tuck(desk, make("chair"), 0.0, float(layout.rng.normal(0, 0.1)))


def _table_with_chairs(layout: Layout, make: MakeShape, most: int = 6) -> None:
    """Two chairs or more of one kind around a table high enough to sit at, most of them pushed
    below it."""
    shape = _fitting(make, "table", _to_sit_at)
    if _full(layout) or not (layout.free(shape, 0.5) or layout.free(shape, 0.15)):
        return
    table = len(layout.items) - 1
    chair = _fitting(make, "chair", _to_dine_on)
    seats = layout.seats(table, chair)
    wanted = min(int(layout.rng.integers(2, most + 1)), MAX_FURNITURE - len(layout.furniture))
    for k in layout.rng.permutation(len(seats)):
        angle, aside = seats[k]
        if wanted > 0:
            wanted -= layout.tuck(table, chair, angle, aside + layout.rng.normal(0, 0.03))


def _to_sit_at(table: Shape) -> bool:
    return bool(0.66 < table.extents_m[2] < 0.9 and table.extents_m[:2].min() > 0.55)


def _to_dine_on(chair: Shape) -> bool:
    return bool(chair.extents_m[:2].max() < 0.68 and chair.extents_m[2] < 1.15)


def _fitting(make: MakeShape, class_name: str, fits: Callable[[Shape], bool]) -> Shape:
    """The first of a few shapes that fits, or the last."""
    for _ in range(6):
        shape = make(class_name)
        if fits(shape):
            break
    return shape


def _sofa_group(layout: Layout, make: MakeShape) -> None:
    sofa = _add(layout, make, "sofa")
    if sofa is None or _full(layout):
        return
    if layout.rng.random() < 0.75:
        layout.beside(sofa, make("table"), 0.0, float(layout.rng.uniform(0.25, 0.5)), 0.0)


def _bed_with_cabinet(layout: Layout, make: MakeShape) -> None:
    bed = _add(layout, make, "bed")
    if bed is None or _full(layout) or layout.rng.random() < 0.4:
        return
    angle = float(layout.rng.choice([-1, 1]) * np.pi / 2)
    cabinet = make("cabinet")
    if max(cabinet.extents_m) < 1.0 and not cabinet.mount_m:
        layout.beside(bed, cabinet, angle, 0.08, -angle)


def _living(layout: Layout, make: MakeShape) -> None:
    _sofa_group(layout, make)
    if layout.rng.random() < 0.4:
        _sofa_group(layout, make)
    _some(layout, make, "bookshelf", 0, 2)
    _some(layout, make, "cabinet", 0, 2)
    _some(layout, make, "chair", 0, 2)
    if layout.rng.random() < 0.4:
        _table_with_chairs(layout, make)


def _bedroom(layout: Layout, make: MakeShape) -> None:
    for _ in range(int(layout.rng.integers(1, 3))):
        _bed_with_cabinet(layout, make)
    _some(layout, make, "cabinet", 0, 2)
    _some(layout, make, "bookshelf", 0, 1)
    if layout.rng.random() < 0.5:
        _desk_with_chair(layout, make)
    _some(layout, make, "chair", 0, 1)


def _bathroom(layout: Layout, make: MakeShape) -> None:
    _some(layout, make, "bathtub", 1, 2)
    _some(layout, make, "sink", 1, 2)
    _some(layout, make, "toilet", 1, 2)
    _some(layout, make, "cabinet", 0, 1)
    _some(layout, make, "chair", 0, 1)


def _kitchen(layout: Layout, make: MakeShape) -> None:
    eat_in = layout.rng.random() < 0.8
    fit_kitchen(layout, make, int(layout.rng.integers(3, 7)) if eat_in else 7)
    if eat_in:
        _table_with_chairs(layout, make)


def _dining(layout: Layout, make: MakeShape) -> None:
    _table_with_chairs(layout, make)
    _some(layout, make, "cabinet", 1, 2)
    _some(layout, make, "sink", 0, 1)
    _some(layout, make, "bookshelf", 0, 1)


def _office(layout: Layout, make: MakeShape) -> None:
    for _ in range(int(layout.rng.integers(1, 4))):
        _desk_with_chair(layout, make)
    _some(layout, make, "bookshelf", 0, 2)
    _some(layout, make, "cabinet", 0, 1)
    if layout.rng.random() < 0.3:
        _add(layout, make, "sofa")


def _workplace(layout: Layout, make: MakeShape) -> None:
    desks: list[int] = []
    for _ in range(int(layout.rng.integers(1, 3))):
        most = min(int(layout.rng.integers(1, 5)), (MAX_FURNITURE - len(layout.furniture)) // 2)
        desks += fit_desks(layout, make, most)
    _some(layout, make, "bookshelf", 0, 2)
    _some(layout, make, "cabinet", 0, 2)
    _some(layout, make, "table", 0, 1)
    for desk in desks:
        dress(layout, make, desk)


def _crowded(layout: Layout, make: MakeShape) -> None:
    """Sitting groups and more tables, most of them in a room with a sofa."""
    if layout.rng.random() < 0.7:
        _sofa_group(layout, make)
    for _ in range(int(layout.rng.integers(1, 3))):
        _chairs_around(layout, make)
    _some(layout, make, "table", 0, 2)
    _some(layout, make, "cabinet", 0, 1)


def _chairs_around(layout: Layout, make: MakeShape) -> None:
    """One to four chairs of a kind around a table of any height, turned to it more or less."""
    if _full(layout) or not layout.free(make("table"), 0.1):
        return
    table, chair = len(layout.items) - 1, make("chair")
    for angle in layout.rng.permutation(4)[: int(layout.rng.integers(1, 5))] * np.pi / 2:
        if not _full(layout):
            gap, turn = layout.rng.uniform(0.03, 0.4), layout.rng.normal(0, 0.3)
            layout.beside(table, chair, float(angle), float(gap), float(np.pi + turn))


def _fill(layout: Layout, make: MakeShape, kind: str) -> None:
    """More of the room's own furniture where its floor is large."""
    floor_m2 = layout.room.size_m[0] * layout.room.size_m[1]
    wanted = min(MAX_FURNITURE, int(floor_m2 / layout.rng.uniform(3.0, 6.0)))
    for _ in range(wanted - len(layout.furniture)):
        _add(layout, make, str(layout.rng.choice(_MORE[kind])))


_MORE = {
    "living": ("sofa", "bookshelf", "cabinet", "chair", "table"),
    "bedroom": ("bed", "cabinet", "bookshelf", "desk", "sofa"),
    "bathroom": ("bathtub", "sink", "toilet", "cabinet"),
    "kitchen": ("chair", "cabinet", "bookshelf"),
    "dining": ("table", "chair", "cabinet", "sink", "sofa"),
    "office": ("desk", "bookshelf", "cabinet", "table", "sofa"),
    "mixed": CLASS_NAMES,
    "workplace": ("bookshelf", "cabinet", "sofa", "table", "chair"),
    "crowded": ("chair", "table", "sofa", "bookshelf", "cabinet"),
}

# Classes that other rooms hold often stand here seldom.
_MIXED = {"chair": 0.5, "cabinet": 0.5, "bathtub": 1.2, "desk": 1.3, "sofa": 1.4}


def _mixed(layout: Layout, make: MakeShape) -> None:
    share = np.array([_MIXED.get(name, 1.0) for name in CLASS_NAMES])
    wanted = int(layout.rng.integers(5, 10))
    for class_name in layout.rng.choice(CLASS_NAMES, wanted, p=share / share.sum()):
        _add(layout, make, str(class_name))


_PROGRAMMES: dict[str, Callable[[Layout, MakeShape], None]] = {
    "living": _living,
    "bedroom": _bedroom,
    "bathroom": _bathroom,
    "kitchen": _kitchen,
    "dining": _dining,
    "office": _office,
    "mixed": _mixed,
    "workplace": _workplace,
    "crowded": _crowded,
}


def _add_clutter(layout: Layout, make: MakeShape, most: int) -> None:
    """Small things on furniture, fewer than `most` on each, and lamps, plants, boxes on the
    floor."""
    holders = [i for i in layout.furniture if layout.items[i].shape.class_name in _HOLDERS]
    for index in holders:
        for _ in range(int(layout.rng.integers(0, most))):
            layout.on_top(index, make("small clutter"))
    on_floor = 0
    wanted = int(layout.rng.integers(2, 6))
    for _ in range(3 * wanted):
        shape = make("clutter")
        at_wall = shape.style in _AT_WALL or layout.rng.random() < 0.5
        placed = layout.against_wall(shape) if at_wall else layout.free(shape)
        on_floor += placed
        if on_floor >= wanted:
            return


_HOLDERS = ("table", "desk", "cabinet", "bookshelf")
_AT_WALL = ("curtain", "radiator", "picture", "refrigerator", "oven", "washing_machine")
