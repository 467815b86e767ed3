"""Depth cameras: structured light and time of flight, as they really fail.

Structured light measures disparity: its noise grows with depth squared, disparity is
quantised, and surfaces the projector cannot see (behind foreground edges) have no depth.
Time of flight measures phase: noise grows where little light returns, and pixels on an edge
mix both surfaces (flying pixels). Both lose grazing, dark, shiny and far surfaces, in patches.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numba
import numpy as np
from numpy.typing import NDArray

from composenet.records import Camera, FloatArray

_NATIVE_WIDTH = 640
_PATCH_PX, _WINDOW_PX = 16, 8
"""What is lost together, and what a window of the pattern covers."""
EDGE_STEP = 0.04
"""Neighbouring pixels whose depths differ by a larger share lie on two surfaces."""


class SensorKind(StrEnum):
    STRUCTURED_LIGHT = "structured light"
    TIME_OF_FLIGHT = "time of flight"


@dataclass(frozen=True)
class Sensor:
    """One depth camera. Pixels (_px) are those of a 640 pixel wide image, whatever is drawn.

    range_m: nearest and farthest depth. baseline_m: projector to camera (structured light).
    disparity_step_px: quantisation. disparity_noise_px: standard deviation, alike over a few
    pixels, as windows that match a pattern overlap. phase_noise: standard deviation at 1 m on
    a white surface, metres (time of flight). lateral_px: how far edges wander. grazing_cosine:
    surfaces steeper than that return nothing. loss: 0..1, how readily dark and shiny surfaces
    vanish. edge_loss: share of pixels on depth edges without depth. warp: (4, 5) relative depth
    error over the image, smooth between these points and the same in every frame.
    """

    kind: SensorKind
    range_m: tuple[float, float]
    baseline_m: float
    disparity_step_px: float
    disparity_noise_px: float
    phase_noise: float
    lateral_px: float
    grazing_cosine: float
    loss: float
    edge_loss: float
    warp: NDArray[np.float32]


def sample_sensor(rng: np.random.Generator) -> Sensor:
    """A camera of either kind with its own faults."""
    (shape,) = rng.spawn(1)
    light = rng.random() < 0.65
    kind = SensorKind.STRUCTURED_LIGHT if light else SensorKind.TIME_OF_FLIGHT
    return Sensor(
        kind=kind,
        range_m=(float(rng.uniform(0.3, 0.5)), float(rng.uniform(6.0, 8.0))),
        baseline_m=float(rng.uniform(0.05, 0.08)),
        disparity_step_px=float(rng.choice([1 / 16, 1 / 8, 1 / 8])),
        disparity_noise_px=float(rng.uniform(0.01, 0.06)),
        phase_noise=float(rng.uniform(0.0002, 0.0008)),
        lateral_px=float(rng.uniform(0.6, 1.4)),
        grazing_cosine=float(rng.uniform(0.08, 0.2)),
        loss=float(rng.uniform(0.1, 0.8)),
        edge_loss=float(rng.uniform(0.1, 0.7)),
        warp=(rng.uniform(0.0, 0.008) * shape.uniform(-1, 1, (4, 5))).astype(np.float32),
    )


def measure(
    sensor: Sensor,
    clean_depth_m: NDArray[np.float32],
    surface: NDArray[np.float32],
    camera: Camera,
    rng: np.random.Generator,
) -> NDArray[np.float32]:
    """What the camera reports, in whole millimetres.

    clean_depth_m: (H, W), 0 = nothing there. surface: (H, W, 3) cosine of incidence,
    brightness and shininess (render.surface). Returns (H, W) float32 metres, 0 = no depth.
    """
    height, width = clean_depth_m.shape
    noise = rng.standard_normal((height, width), dtype=np.float32)
    chance, right, down = rng.random((3, height, width), dtype=np.float32)
    spread = (
        float(np.sqrt(12.0)) * sensor.lateral_px * width / _NATIVE_WIDTH
    )  # of even noise with that deviation
    patch_px, window_px = _PATCH_PX * width / _NATIVE_WIDTH, _WINDOW_PX * width / _NATIVE_WIDTH
    patches = rng.random(_cells(height, width, patch_px), dtype=np.float32)
    windows = rng.standard_normal(_cells(height, width, window_px), dtype=np.float32)
    focal = float(camera.K[0, 0])
    native_focal = focal * _NATIVE_WIDTH / width
    light = sensor.kind is SensorKind.STRUCTURED_LIGHT
    if light:
        lit = _projector_sees(clean_depth_m, focal * sensor.baseline_m)
    else:
        lit = np.ones((height, width), dtype=np.bool_)
    depth = _measure(
        clean_depth_m,
        surface,
        lit,
        noise,
        chance,
        spread * (right - 0.5),
        spread * (down - 0.5),
        (patches, windows, sensor.warp),
        (patch_px, window_px),
        light,
        sensor.range_m,
        (native_focal * sensor.baseline_m, sensor.disparity_step_px, sensor.disparity_noise_px),
        sensor.phase_noise,
        (sensor.grazing_cosine, sensor.loss, sensor.edge_loss),
    )
    return as_stored(depth)


def _cells(height: int, width: int, cell_px: float) -> tuple[int, int]:
    """Points of a coarse grid that reaches over the image."""
    return int(height / cell_px) + 2, int(width / cell_px) + 2


def as_stored(depth_m: FloatArray) -> NDArray[np.float32]:
    """Depth as a 16-bit millimetre image gives it back."""
    return (np.rint(depth_m * 1000.0) / 1000.0).astype(np.float32)


@numba.njit(cache=True, nogil=True)
def _projector_sees(depth, focal_baseline):  # type: ignore[no-untyped-def]
    """Whether the projector, at the baseline to the camera's right, sees each pixel: of all that
    lies in one of its columns in a row it reaches the nearest."""
    height, width = depth.shape
    lit = np.ones((height, width), dtype=np.bool_)
    nearest = np.empty(2 * width + 1, dtype=depth.dtype)
    for v in range(height):
        nearest[:] = np.inf
        for u in range(width):
            z = depth[v, u]
            if z * width > focal_baseline:  # nearer than any camera measures, or nothing at all
                k = int(width + u - focal_baseline / z)
                nearest[k] = min(nearest[k], z)
                nearest[k + 1] = min(nearest[k + 1], z)
        for u in range(width):
            z = depth[v, u]
            if z * width > focal_baseline:
                k = int(width + u - focal_baseline / z + 0.5)
                lit[v, u] = z <= nearest[k] * (1 + EDGE_STEP)
    return lit


@numba.njit(cache=True, nogil=True)
def _bilinear_row(grid, y, x, out):  # type: ignore[no-untyped-def]
    """A coarse grid between its cells: one row, y, at the columns x, into out."""
    i = min(int(y), grid.shape[0] - 2)
    a = y - i
    for u in range(len(x)):
        j = min(int(x[u]), grid.shape[1] - 2)
        b = x[u] - j
        top = grid[i, j] * (1 - b) + grid[i, j + 1] * b
        out[u] = top * (1 - a) + (grid[i + 1, j] * (1 - b) + grid[i + 1, j + 1] * b) * a


@numba.njit(cache=True, nogil=True)
def _edge_step(depth, v, u):  # type: ignore[no-untyped-def]
    """Largest relative depth step to a neighbour, and that neighbour's depth."""
    height, width = depth.shape
    z, step, other = depth[v, u], 0.0, depth[v, u]
    for dv, du in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        i, j = v + dv, u + du
        if 0 <= i < height and 0 <= j < width:
            difference = abs(depth[i, j] - z) / z
            if difference > step:
                step, other = difference, depth[i, j]
    return step, other


@numba.njit(cache=True, nogil=True)
def _near_edges(depth):  # type: ignore[no-untyped-def]
    """(H, W) bool: all pixels whose `_edge_step` is larger than EDGE_STEP, and few others; without
    a division or a branch."""
    height, width = depth.shape
    near = np.ones((height, width), dtype=np.bool_)
    for v in range(1, height - 1):
        for u in range(1, width - 1):
            z = depth[v, u]
            limit = np.float32(0.99 * EDGE_STEP) * z
            near[v, u] = (
                (abs(depth[v, u - 1] - z) >= limit)
                | (abs(depth[v, u + 1] - z) >= limit)
                | (abs(depth[v - 1, u] - z) >= limit)
                | (abs(depth[v + 1, u] - z) >= limit)
            )
    return near


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _by_disparity(z, cosine, normal, stereo, out):  # type: ignore[no-untyped-def]
    """Depth of a row from noisy disparity in whole steps; 0 where none is left."""
    focal_baseline, step_px, noise_px = stereo
    for u in range(len(out)):
        spread = noise_px * (1 + 0.5 * (1 - cosine[u]) / (cosine[u] + 0.1))
        disparity = focal_baseline / z[u] + spread * normal[u]
        disparity = np.rint(disparity / step_px) * step_px
        out[u] = focal_baseline / disparity if disparity > 0 else 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _by_phase(z, returned, normal, phase, out):  # type: ignore[no-untyped-def]
    """Depth of a row from noisy phase; returned: (W,) how much of the light."""
    for u in range(len(out)):
        out[u] = z[u] + phase * (0.5 + z[u] * z[u]) / np.sqrt(returned[u] + 0.05) * normal[u]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _measure(  # type: ignore[no-untyped-def]
    clean,
    surface,
    lit,
    noise,
    chance,
    right,
    down,
    grids,
    cells_px,
    light,
    limits,
    stereo,
    phase,
    losses,
):
    height, width = clean.shape
    grazing, loss, edge_loss = losses
    patches, windows, warps = grids
    patch_px, window_px = cells_px
    out = np.zeros((height, width), dtype=np.float32)
    columns = np.arange(width)
    in_patches, in_windows = columns / patch_px, columns / window_px
    fifths = columns / width * 3.99
    patch, warp, window = np.empty(width), np.empty(width), np.empty(width)
    # Of the row's pixels that return light: depth (else 0), cosine and light.
    met, cosines = np.empty(width), np.empty(width, dtype=np.float32)
    returns, normal, measured = np.empty(width), np.empty(width), np.empty(width)
    near_edge = _near_edges(clean)
    own, common = (0.3, 1.3) if light else (0.7, 0.9)
    for v in range(height):
        _bilinear_row(patches, v / patch_px, in_patches, patch)
        _bilinear_row(warps, v / height * 2.99, fifths, warp)
        _bilinear_row(windows, v / window_px, in_windows, window)
        for u in range(width):
            met[u] = 0.0
            # The same jitter decides depth and surface, so edges wander as a whole.
            i = min(max(int(np.rint(v + down[v, u])), 0), height - 1)
            j = min(max(int(np.rint(u + right[v, u])), 0), width - 1)
            if abs(clean[i, j] - clean[v, u]) < EDGE_STEP * clean[v, u]:
                i, j = v, u  # only edges wander; a slanted surface stays where it is
            z = clean[i, j]
            if z < limits[0] or z > limits[1] or not lit[i, j]:
                continue
            cosine, brightness, shininess = surface[i, j, 0], surface[i, j, 1], surface[i, j, 2]
            if cosine < grazing * (0.5 + chance[v, u]):
                continue
            returned = brightness * (0.3 + 0.7 * cosine) * (1 - 0.6 * shininess)
            needed = loss * 0.25 * (0.3 + z / limits[1]) ** 2
            if returned < needed * (0.3 + 1.4 * patch[u]):
                continue
            met[u], cosines[u], returns[u] = z * (1 + warp[u]), cosine, returned
            if not near_edge[i, j]:
                continue
            step, other = _edge_step(clean, i, j)
            if step > EDGE_STEP and chance[v, u] < edge_loss:
                met[u] = 0.0
            elif step > EDGE_STEP and other > 0 and not light:  # half of them, by half at most
                share = (chance[v, u] - edge_loss) / (1 - edge_loss) - 0.5
                met[u] += (other - met[u]) * max(share, 0.0)
        for u in range(width):
            normal[u] = common * window[u] + own * noise[v, u]
        if light:
            _by_disparity(met, cosines, normal, stereo, measured)
        else:
            _by_phase(met, returns, normal, phase, measured)
        for u in range(width):
            z = measured[u]
            kept = (met[u] > 0) & (z >= limits[0]) & (z <= limits[1])
            out[v, u] = z if kept else 0.0
    return out
