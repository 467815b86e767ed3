"""The depth cameras fail the way they say."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from composenet.records import Camera
from composenet.synth.sensor import (
    EDGE_STEP,
    Sensor,
    SensorKind,
    _edge_step,
    _near_edges,
    as_stored,
    measure,
    sample_sensor,
)

CAMERA = Camera(np.array([[280.0, 0, 159.5], [0, 280.0, 119.5], [0, 0, 1]]), 320, 240)
QUIET = Sensor(
    kind=SensorKind.STRUCTURED_LIGHT,
    range_m=(0.4, 7.0),
    baseline_m=0.07,
    disparity_step_px=1 / 16,
    disparity_noise_px=0.03,
    phase_noise=0.002,
    lateral_px=0.0,
    grazing_cosine=0.1,
    loss=0.0,
    edge_loss=0.0,
    warp=0.0,
)
TOF = replace(QUIET, kind=SensorKind.TIME_OF_FLIGHT)


def wall(
    depth_m: float, cosine: float = 1.0, brightness: float = 0.7, shininess: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    depth = np.full((240, 320), depth_m, dtype=np.float32)
    surface = np.empty((240, 320, 3), dtype=np.float32)
    surface[:] = cosine, brightness, shininess
    return depth, surface


def look(sensor: Sensor, depth: np.ndarray, surface: np.ndarray, seed: int = 0) -> np.ndarray:
    return measure(sensor, depth, surface, CAMERA, np.random.default_rng(seed))


@pytest.mark.parametrize("sensor", [QUIET, TOF])
def test_noise_grows_with_depth_and_is_unbiased(sensor: Sensor) -> None:
    spread = []
    for z in (1.0, 2.0, 4.0):
        seen = look(sensor, *wall(z))
        assert (seen > 0).all()
        assert np.median(seen) == pytest.approx(z, rel=0.02)
        spread.append(np.std(seen - z))
    assert spread[1] > 1.8 * spread[0]
    assert spread[2] > 2.5 * spread[1]
    assert spread[2] < 0.15


def test_disparity_is_quantised() -> None:
    near = np.unique(look(replace(QUIET, disparity_noise_px=0.0), *wall(1.0)))
    far = np.unique(look(replace(QUIET, disparity_noise_px=0.02), *wall(4.0)))
    assert len(near) < 10
    # A step of 1/16 px at 4 m is z^2 / (f b) / 16 = 2.6 cm, f = 560 px at 640 pixels' width.
    assert np.diff(far).min() == pytest.approx(16 / (560 * 0.07) / 16, rel=0.1)


@pytest.mark.parametrize("sensor", [QUIET, TOF])
def test_out_of_range_and_nothing_give_no_depth(sensor: Sensor) -> None:
    for z in (0.0, 0.2, 9.0):
        assert not look(sensor, *wall(z)).any()


@pytest.mark.parametrize("sensor", [QUIET, TOF])
def test_grazing_dark_and_shiny_surfaces_vanish(sensor: Sensor) -> None:
    assert not look(sensor, *wall(2.0, cosine=0.03)).any()
    lossy = replace(sensor, loss=0.8)
    good = np.mean(look(lossy, *wall(3.0)) > 0)
    assert good > 0.99
    assert np.mean(look(lossy, *wall(3.0, brightness=0.03)) > 0) < 0.6
    assert np.mean(look(lossy, *wall(5.0, brightness=0.2, shininess=1.0)) > 0) < good


def step_scene() -> tuple[np.ndarray, np.ndarray]:
    """A panel at 1.5 m before a wall at 3 m."""
    depth, surface = wall(3.0)
    depth[60:180, 100:220] = 1.5
    return depth, surface


def test_projector_shadow_lies_on_one_side() -> None:
    """Its width is the difference of the disparities: f b (1/1.5 - 1/3) = 6.5 px."""
    seen = look(QUIET, *step_scene())
    row = seen[120] == 0
    assert 5 <= row.sum() <= 8
    assert row[93:107].sum() == row.sum() or row[213:230].sum() == row.sum()


def test_flying_pixels_only_with_time_of_flight() -> None:
    depth, surface = step_scene()
    between = [
        np.count_nonzero((seen > 1.7) & (seen < 2.7))
        for seen in (look(QUIET, depth, surface), look(TOF, depth, surface))
    ]
    assert between[0] == 0
    assert between[1] > 100


def test_edges_lose_depth_and_wander() -> None:
    depth, surface = step_scene()
    lossy = look(replace(TOF, edge_loss=0.6), depth, surface)
    assert np.count_nonzero(lossy[60:180, 99:101] == 0) > 60
    assert np.count_nonzero(lossy[100:140, 130:190] == 0) == 0
    wandering = look(replace(TOF, lateral_px=1.4), depth, surface)
    assert np.count_nonzero(wandering[60:180, 96:100] < 1.7) > 5


def test_every_sampled_camera_sees_most_of_a_plain_room() -> None:
    kinds = set()
    for seed in range(20):
        sensor = sample_sensor(np.random.default_rng(seed))
        kinds.add(sensor.kind)
        seen = look(sensor, *wall(2.5, cosine=0.8), seed)
        assert np.mean(seen > 0) > 0.95
        assert np.median(seen) == pytest.approx(2.5, rel=0.03)
    assert kinds == set(SensorKind)


def test_depth_is_whole_millimetres_and_repeats() -> None:
    first, second = look(TOF, *wall(2.0), seed=3), look(TOF, *wall(2.0), seed=3)
    np.testing.assert_array_equal(first, second)
    np.testing.assert_array_equal(as_stored(first), first)
    assert first.dtype == np.float32


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 0.1))
def test_no_edge_is_passed_over(seed: int, roughness: float) -> None:
    """Pixels that are not near an edge, by the quick test, have no step to any neighbour."""
    rng = np.random.default_rng(seed)
    depth = rng.choice([1.0, 1.5, 4.0], (12, 16)) * (1 + roughness * rng.random((12, 16)))
    depth[rng.random((12, 16)) < 0.1] = 0
    depth = depth.astype(np.float32)
    near = _near_edges(depth)
    for v, u in np.argwhere(depth > 0):
        assert near[v, u] or _edge_step(depth, v, u)[0] <= EDGE_STEP


def test_no_plain_wall_is_near_an_edge() -> None:
    slanted = wall(2.0)[0] * np.linspace(1, 2, 320, dtype=np.float32)
    near = _near_edges(slanted)
    assert not near[1:-1, 1:-1].any() and near[0].all() and near[:, -1].all()
