"""Colour images: procedural patterns in object coordinates under sun, lamp and ambient light."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from composenet.records import Camera, FloatArray
from composenet.synth.render import Buffers, Mesh, face_normal, focal

SKY = (205, 220, 235)


@dataclass(frozen=True)
class Light:
    """sun: (3,) unit vector towards the sun, world. lamp: (3,) world position. Strengths >= 0."""

    sun: FloatArray
    lamp: FloatArray
    ambient: float = 0.45
    sun_strength: float = 0.35
    lamp_strength: float = 0.5


def shade(
    mesh: Mesh,
    buffers: Buffers,
    T_camera_instance: FloatArray,
    T_world_camera: FloatArray,
    camera: Camera,
    light: Light,
) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 colour of what `render.draw` saw from the same poses."""
    T_camera_world = np.linalg.inv(T_world_camera)
    return _shade(
        buffers.points_camera,
        mesh.faces,
        mesh.face_instance,
        mesh.face_material,
        (mesh.color, mesh.pattern, mesh.pattern_m, mesh.shininess),
        buffers.depth_m,
        buffers.face,
        np.linalg.inv(T_camera_instance).astype(np.float32),
        focal(camera),
        (T_camera_world[:3, :3] @ light.sun).astype(np.float32),
        (T_camera_world[:3, :3] @ light.lamp + T_camera_world[:3, 3]).astype(np.float32),
        T_camera_world[:3, 2].astype(np.float32),
        (light.ambient, light.sun_strength, light.lamp_strength),
    )


@numba.njit(cache=True, nogil=True, inline="always")
def _hash(i, j, k):  # type: ignore[no-untyped-def]
    h = np.uint32(i * 374761393 + j * 668265263 + k * 1440662683)
    h = np.uint32((h ^ (h >> np.uint32(13))) * np.uint32(1274126177))
    return np.float32((h ^ (h >> np.uint32(16))) & np.uint32(65535)) * np.float32(1 / 65535)


@numba.njit(cache=True, nogil=True)
def _value_noise(x, y, z):  # type: ignore[no-untyped-def]
    """Smooth noise in 0..1 with period about 1."""
    i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    a, b, c = x - i, y - j, z - k
    a, b, c = a * a * (3 - 2 * a), b * b * (3 - 2 * b), c * c * (3 - 2 * c)
    low = _hash(i, j, k) * (1 - a) + _hash(i + 1, j, k) * a
    low += (_hash(i, j + 1, k) * (1 - a) + _hash(i + 1, j + 1, k) * a - low) * b
    high = _hash(i, j, k + 1) * (1 - a) + _hash(i + 1, j, k + 1) * a
    high += (_hash(i, j + 1, k + 1) * (1 - a) + _hash(i + 1, j + 1, k + 1) * a - high) * b
    return low + (high - low) * c


@numba.njit(cache=True, nogil=True)
def _pattern(kind, x, y, z):  # type: ignore[no-untyped-def]
    """Factor on the base colour at a point given in pattern periods."""
    if kind == 1:  # wood: wavering lines along the grain, planks of different tone
        noise = _value_noise(x * 1.5, y * 0.4, z * 1.5)
        ring = np.sin(np.float32(6.28) * (x * 3 + z * 3 + 2 * noise))
        plank = _hash(int(np.floor(x)), 7, int(np.floor(z)))
        return 0.82 + 0.09 * ring + 0.16 * plank
    if kind == 2:  # fabric: fine weave and soft blotches
        weave = np.sin(np.float32(12.56) * (x + y)) * np.sin(np.float32(12.56) * (y + z))
        return 0.86 + 0.1 * weave + 0.16 * (_value_noise(x * 3, y * 3, z * 3) - 0.5)
    if kind == 3:
        even = (int(np.floor(x)) + int(np.floor(y)) + int(np.floor(z))) % 2 == 0
        return 1.05 if even else 0.7
    if kind == 4:
        return 1.05 if (x + y) - np.floor(x + y) < 0.5 else 0.75
    return 0.95 + 0.08 * (_value_noise(x * 2, y * 2, z * 2) - 0.5)


@numba.njit(cache=True, nogil=True, inline="always")
def _power_16(x):  # type: ignore[no-untyped-def]
    x = x * x
    x = x * x
    x = x * x
    return x * x


@numba.njit(cache=True, nogil=True, inline="always")
def _lighting(point, normal, cosine, sun, lamp, up, strengths):  # type: ignore[no-untyped-def]
    """(diffuse light, highlight) at a point of the camera frame."""
    lx, ly, lz = lamp[0] - point[0], lamp[1] - point[1], lamp[2] - point[2]
    square = lx * lx + ly * ly + lz * lz + np.float32(1e-6)
    at_lamp = (normal[0] * lx + normal[1] * ly + normal[2] * lz) / np.sqrt(square)
    at_lamp = max(np.float32(0), at_lamp)
    at_sun = max(np.float32(0), normal[0] * sun[0] + normal[1] * sun[1] + normal[2] * sun[2])
    facing_up = normal[0] * up[0] + normal[1] * up[1] + normal[2] * up[2]
    lit = strengths[0] * (0.8 + 0.2 * facing_up) + strengths[1] * at_sun + 0.15 * cosine
    lit += strengths[2] * at_lamp * min(1.5, 6.0 / (1 + square))
    return lit, 0.35 * (_power_16(cosine) + _power_16(at_lamp))


@numba.njit(cache=True, nogil=True, inline="always")
def _row(T, i, x, y, z):  # type: ignore[no-untyped-def]
    return T[i, 0] * x + T[i, 1] * y + T[i, 2] * z + T[i, 3]


@numba.njit(cache=True, nogil=True)
def _shade(  # type: ignore[no-untyped-def]
    points,
    faces,
    face_instance,
    face_material,
    materials,
    depth,
    face,
    to_object,
    intrinsics,
    sun,
    lamp,
    up,
    strengths,
):
    colors, patterns, periods, shininess = materials
    fx, fy, cx, cy = intrinsics
    height, width = face.shape
    out = np.empty((height, width, 3), dtype=np.uint8)
    for v in range(height):
        y = np.float32((v - cy) / fy)
        for u in range(width):
            f = face[v, u]
            if f < 0:
                out[v, u, 0], out[v, u, 1], out[v, u, 2] = SKY
                continue
            x, z = np.float32((u - cx) / fx), depth[v, u]
            nx, ny, nz, cosine = face_normal(points, faces, f, x, y)
            k, m = face_instance[f], face_material[f]
            px, py, s = z * x, z * y, np.float32(1) / periods[m]
            # A hair off the faces, which often lie on the border of two squares of a pattern.
            ox = _row(to_object[k], 0, px, py, z) * s + np.float32(1e-3)
            oy = _row(to_object[k], 1, px, py, z) * s + np.float32(1e-3)
            oz = _row(to_object[k], 2, px, py, z) * s + np.float32(1e-3)
            lit, gloss = _lighting((px, py, z), (nx, ny, nz), cosine, sun, lamp, up, strengths)
            factor = _pattern(patterns[m], ox, oy, oz) * lit
            for i in range(3):
                value = min(1.0, max(0.0, colors[m, i] * factor + gloss * shininess[m]))
                out[v, u, i] = int(255 * np.sqrt(value * np.sqrt(value)))
    return out
