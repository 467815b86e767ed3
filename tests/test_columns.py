"""Shapes as columns: what fits below what."""

import manifold3d as m3
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from composenet.records import Symmetry
from composenet.synth.columns import columns_of, height_map, meet
from composenet.synth.furniture.parts import box
from composenet.synth.shape import Material, Shape, ShapeBuilder

GREY = Material((0.5, 0.5, 0.5))


def built(*parts: m3.Manifold) -> Shape:
    builder = ShapeBuilder()
    for part in parts:
        builder.add(part, GREY)
    return builder.build("table", "test", Symmetry.NONE)


def table() -> Shape:
    """1.2 x 0.8 m, 0.75 m high, legs of 6 cm in the corners."""
    legs = [box((0.06, 0.06, 0.7), (x, y, 0.35)) for x in (-0.57, 0.57) for y in (-0.37, 0.37)]
    return built(box((1.2, 0.8, 0.05), (0, 0, 0.725)), *legs)


@pytest.mark.parametrize(
    ("height", "x", "hits"),
    [
        (0.45, 0.0, False),  # below the top, between the legs
        (0.45, 0.55, True),  # in a leg's way
        (0.78, 0.0, True),  # higher than the top
        (0.78, 0.95, False),  # beside it
    ],
)
def test_a_block_and_a_table(height: float, x: float, hits: bool) -> None:
    block = built(box((0.4, 0.6, height), (0, 0, height / 2)))
    assert meet(columns_of(block), (x, 0.0, 0.0), columns_of(table()), (0.0, 0.0, 0.0)) is hits
    turned = meet(
        columns_of(block), (3.0, 1 + x, np.pi / 2), columns_of(table()), (3, 1, np.pi / 2)
    )
    assert turned is hits


@settings(max_examples=60)
@given(st.floats(-0.9, 0.9), st.floats(-0.7, 0.7), st.floats(-3.2, 3.2), st.floats(0.3, 0.9))
def test_never_misses_what_crosses(x: float, y: float, yaw: float, height: float) -> None:
    """Where columns keep apart, so do the solids."""
    a, b = table(), built(box((0.1, 0.5, height), (0, 0, height / 2)))
    apart = not meet(columns_of(b), (x, y, yaw), columns_of(a), (0, 0, 0))
    if apart:
        legs = [box((0.06, 0.06, 0.7), (p, q, 0.35)) for p in (-0.57, 0.57) for q in (-0.37, 0.37)]
        whole = m3.Manifold.batch_boolean(
            [box((1.2, 0.8, 0.05), (0, 0, 0.725)), *legs], m3.OpType.Add
        )
        block = box((0.1, 0.5, height), (0, 0, height / 2))
        block = block.rotate((0, 0, np.degrees(yaw))).translate((x, y, 0))
        assert (whole ^ block).volume() < 1e-9


def test_height_of_the_upper_side() -> None:
    tops, cell = height_map(table())
    np.testing.assert_allclose(tops, 0.375, atol=1e-6)
    np.testing.assert_allclose(cell, [0.05, 0.8 / 24], rtol=1e-5)
