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
    _projector_sees,
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
    warp=np.zeros((4, 5), np.float32),
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


def test_projector_shadow_lies_on_the_wall_left_of_what_casts_it() -> None:
    """Its width is the difference of the disparities: f b (1/1.5 - 1/3) = 6.5 px."""
    clean, surface = step_scene()
    dark = look(QUIET, clean, surface)[120] == 0
    assert (clean[120][dark] == 3.0).all()
    assert np.flatnonzero(dark).tolist() in (list(range(93, 100)), list(range(94, 100)))


def test_a_leg_is_seen_and_casts_a_shadow_as_wide_as_itself() -> None:
    clean, surface = wall(3.0)
    clean[:, 150:154] = 1.5
    dark = look(QUIET, clean, surface)[120] == 0
    assert (clean[120][dark] == 3.0).all() and 4 <= dark.sum() <= 5
    assert abs(np.flatnonzero(dark).mean() - (151.5 - 6.5)) <= 1


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.floats(5.0, 40.0))
def test_the_projector_sees_what_no_other_pixel_hides(seed: int, focal_baseline: float) -> None:
    """Against all pairs of a row: a pixel is dark where a nearer one lies in its column, and lit
    where none does within a column."""
    rng = np.random.default_rng(seed)
    depth = np.repeat(rng.choice([0.0, 0.8, 1.5, 2.5, 4.0], 12), rng.integers(1, 12, 12))
    depth = depth.astype(np.float32)[None]
    lit = _projector_sees(depth, focal_baseline)[0]
    u = np.flatnonzero(depth[0] * depth.shape[1] > focal_baseline)
    z = depth[0, u].astype(np.float64)
    column = u - focal_baseline / z
    apart = np.abs(column[:, None] - column)
    nearer = z < z[:, None] / (1 + EDGE_STEP)
    assert not lit[u][(nearer & (apart < 0.49)).any(axis=1)].any()
    assert lit[u][~(nearer & (apart < 1.51)).any(axis=1)].all()


def test_flying_pixels_only_with_time_of_flight() -> None:
    depth, surface = step_scene()
    between = [
        np.count_nonzero((seen > 1.7) & (seen < 2.7))
        for seen in (look(QUIET, depth, surface), look(TOF, depth, surface))
    ]
    assert between[0] == 0
    assert between[1] > 100


@pytest.mark.parametrize("edge_loss", [0.0, 0.4, 0.7])
def test_flying_pixels_lie_between_and_nearer_to_their_own_surface(edge_loss: float) -> None:
    clean, surface = step_scene()
    sensor = replace(TOF, edge_loss=edge_loss, phase_noise=0.0)
    for column, own, other in ((99, 3.0, 1.5), (100, 1.5, 3.0)):
        rows = [look(sensor, clean, surface, seed)[61:179, column] for seed in range(5)]
        kept = np.concatenate(rows)
        assert np.mean(kept == 0) == pytest.approx(edge_loss, abs=0.08)
        share = (kept[kept > 0] - own) / (other - own)
        assert share.min() > -0.01 and share.max() < 0.51
        assert np.mean(share < 0.01) == pytest.approx(0.5, abs=0.12)


def test_the_warp_is_the_cameras_and_stays() -> None:
    sensor = replace(sample_sensor(np.random.default_rng(3)), kind=SensorKind.TIME_OF_FLIGHT)
    sensor = replace(sensor, phase_noise=0.0, loss=0.0)
    assert sensor.warp.shape == (4, 5) and 0 < np.abs(sensor.warp).max() <= 0.008
    first, second = (look(sensor, *wall(3.0), seed) for seed in range(2))
    np.testing.assert_array_equal(first, second)
    assert np.ptp(first) > 0.2 * 3 * np.ptp(sensor.warp)
    assert np.abs(first / 3 - 1).max() <= np.abs(sensor.warp).max() + 0.0005


def test_noise_is_as_coarse_whatever_is_drawn() -> None:
    """Neighbours that are as far apart in the view are as alike."""
    alike = []
    for factor in (1, 2):
        camera = Camera(CAMERA.K * [[factor], [factor], [1]], 320 * factor, 240 * factor)
        depth, surface = (a.repeat(factor, 0).repeat(factor, 1) for a in wall(3.0))
        seen = measure(QUIET, depth, surface, camera, np.random.default_rng(0)) - 3
        lag = 2 * factor
        alike.append(np.corrcoef(seen[:, lag:].ravel(), seen[:, :-lag].ravel())[0, 1])
    assert alike[0] > 0.4 and abs(alike[0] - alike[1]) < 0.08


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
