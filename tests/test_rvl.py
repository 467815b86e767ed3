"""Depth images compressed by RVL."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from composenet.errors import SequenceError
from composenet.sequences import rvl
from ros_recordings import rvl as compressed

IMAGES = hnp.arrays(
    np.uint16,
    hnp.array_shapes(min_dims=2, max_dims=2, max_side=12),
    elements=st.one_of(st.just(0), st.integers(0, 2**16 - 1)),
)


def test_by_hand() -> None:
    """3 without depth, 3 with: 5 (+5, so 10), 6 (+1, so 2), 4 (-2, so 3); 10 is 2 and 1 eights."""
    data = np.array([3, 2, 0x33A12300], "<u4").tobytes()
    assert rvl.size(data) == (3, 2)
    assert rvl.decoded(data).tolist() == [[0, 0, 0], [5, 6, 4]]


@given(IMAGES)
def test_images_come_back(image: np.ndarray) -> None:
    data = compressed(image)
    assert rvl.size(data) == image.shape[::-1]
    assert np.array_equal(rvl.decoded(data), image)


@given(IMAGES, st.data())
def test_a_cut_image_is_refused(image: np.ndarray, data: st.DataObject) -> None:
    image = image.copy()
    image[-1, -1] = 7  # else what is cut off may say nothing
    whole = compressed(image)
    words = data.draw(st.integers(0, len(whole) // 4 - 1))
    with pytest.raises(SequenceError, match="truncated or corrupt"):
        rvl.decoded(whole[: 4 * words])


@given(st.binary(max_size=200))
def test_any_bytes_are_an_image_or_refused(data: bytes) -> None:
    size = np.array([20, 10], "<u4").tobytes()
    try:
        assert rvl.decoded(size + data).shape == (10, 20)
    except SequenceError as error:
        assert "truncated or corrupt" in str(error)


@pytest.mark.parametrize("size", [(0, 4), (2**32 - 1, 2**32 - 1), (2**16, 2**16)])
def test_impossible_sizes_are_refused(size: tuple[int, int]) -> None:
    data = np.array([*size, 0, 0], "<u4").tobytes()
    with pytest.raises(SequenceError, match="claims to be"):
        rvl.decoded(data)
