"""Fitted kitchens: flush rows, sinks let in, cupboards at their height."""

import numpy as np
import pytest

from composenet.synth.furniture import make_furniture
from composenet.synth.furniture.clutter import make_clutter, make_small_clutter
from composenet.synth.furniture.kitchen_units import (
    base_unit,
    inset_sink,
    random_style,
    sink_unit,
    wall_cupboard,
)
from composenet.synth.kitchen import fit_kitchen
from composenet.synth.placement import Layout
from composenet.synth.room import make_room
from composenet.synth.shape import Shape
from composenet.synth.solid import union_of


def kitchen(seed: int, cad_share: float = 0.0) -> Layout:
    rng = np.random.default_rng(seed)

    def make(class_name: str) -> Shape:
        if "clutter" in class_name:
            return (make_clutter if class_name == "clutter" else make_small_clutter)(rng)
        return make_furniture(class_name, rng)

    layout = Layout(make_room(rng, (4.0, 3.6)), rng, cad_share)
    fit_kitchen(layout, make, 6)
    return layout


@pytest.mark.parametrize("seed", range(6))
def test_an_inset_sink_does_not_meet_its_cabinet(seed: int) -> None:
    rng = np.random.default_rng(seed)
    style = random_style(rng)
    cabinet, sink, between = inset_sink(rng, style, float(rng.uniform(0.6, 1.4)))
    assert (cabinet.class_name, sink.class_name) == ("cabinet", "sink")
    unit, basin = union_of(cabinet), union_of(sink)
    assert unit is not None and basin is not None
    assert (unit ^ basin.translate(between)).volume() < 1e-8
    bottom = -cabinet.extents_m[2] / 2  # the rim lies on the worktop, the bowl below it
    low = between[2] - sink.extents_m[2] / 2
    assert bottom + 0.3 < low < bottom + style.height - 0.1
    assert low + sink.extents_m[2] > bottom + style.height


def test_units_of_one_kitchen_fit_together() -> None:
    rng = np.random.default_rng(3)
    style = random_style(rng)
    for width in (0.45, 0.8, 1.3):
        for unit in (base_unit(rng, style, width), inset_sink(rng, style, width + 0.2)[0]):
            assert unit.extents_m[2] == pytest.approx(style.height, abs=1e-5)
        assert base_unit(rng, style, width).extents_m[1] == pytest.approx(
            width, abs=0.02
        )  # a knob of an open door
        assert sink_unit(rng, style, width).class_name == "sink"
    hung = wall_cupboard(rng, style, 0.8)
    assert hung.class_name == "cabinet" and 1.3 <= hung.mount_m <= 1.5


def test_rows_stand_flush_at_the_wall() -> None:
    flush = sinks = hung = 0
    for seed in range(12):
        layout = kitchen(seed)
        assert 1 <= len(layout.furniture) <= 6
        low = [i for i in layout.items if i.on_floor]
        for k, a in enumerate(low):
            for b in low[k + 1 :]:
                if a.yaw == b.yaw:
                    across = np.array([-np.sin(a.yaw), np.cos(a.yaw)])
                    apart = abs(np.subtract(a.xyz, b.xyz)[:2] @ across)
                    gap = apart - (a.extents_m[1] + b.extents_m[1]) / 2
                    assert gap > 1e-4
                    flush += gap < 0.003
        sinks += sum(i.shape.class_name == "sink" for i in layout.items)
        hung += sum(i.span_m[0] > 1.2 for i in layout.items)
    assert flush >= 20 and sinks >= 7 and hung >= 6


def test_meshes_may_stand_in_the_row() -> None:
    for seed in range(3):
        styles = {i.shape.style for i in kitchen(seed, cad_share=1.0).items}
        assert not styles & {"sink_base", "inset", "wall_cupboard"}
