"""Depth and face images of triangle meshes by a z-buffer.

Every pixel centre is a ray; a triangle covers it when the ray passes on the same side of
its three edge planes (homogeneous rasterisation: no triangle needs to be cut at the near
plane). Faces are drawn from both sides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from composenet.geometry.transform import apply_T
from composenet.records import Camera, FloatArray
from composenet.synth.shape import Material, Shape

NEAR_M = 0.05
PATTERNS = ("plain", "wood", "fabric", "checker", "stripes")


@dataclass(frozen=True)
class Mesh:
    """Several shapes as one set of triangles; each keeps its own coordinates.

    vertices: (V, 3) float32 in the axes of vertex_instance: (V,) int32. faces: (F, 3) int32.
    face_instance, face_material: (F,) int32. Of each material: color (M, 3) float32, pattern
    (M,) int32 into PATTERNS, pattern_m (M,) float32 metres, shininess (M,) float32.
    """

    vertices: NDArray[np.float32]
    vertex_instance: NDArray[np.int32]
    faces: NDArray[np.int32]
    face_instance: NDArray[np.int32]
    face_material: NDArray[np.int32]
    color: NDArray[np.float32]
    pattern: NDArray[np.int32]
    pattern_m: NDArray[np.float32]
    shininess: NDArray[np.float32]


@dataclass(frozen=True)
class Buffers:
    """What the z-buffer saw. depth_m: (H, W) float32, 0 where nothing is. face: (H, W) int32,
    -1 where nothing is. points_camera: (V, 3) float32, the transformed vertices."""

    depth_m: NDArray[np.float32]
    face: NDArray[np.int32]
    points_camera: NDArray[np.float32]


def assemble(shapes: Sequence[Shape]) -> Mesh:
    """All that images show of the shapes as one mesh; instance i is shapes[i]."""
    vertex_counts = [len(shape.vertices) for shape in shapes]
    face_counts = [np.count_nonzero(shape.drawn) for shape in shapes]
    first_vertex = np.cumsum([0, *vertex_counts])
    first_material = np.cumsum([0, *(len(shape.materials) for shape in shapes)])
    instances = np.arange(len(shapes), dtype=np.int32)
    materials: list[Material] = [m for shape in shapes for m in shape.materials]
    return Mesh(
        vertices=np.concatenate([s.vertices for s in shapes]).astype(np.float32),
        vertex_instance=np.repeat(instances, vertex_counts),
        faces=np.concatenate(
            [s.faces[s.drawn] + k for s, k in zip(shapes, first_vertex, strict=False)]
        ).astype(np.int32),
        face_instance=np.repeat(instances, face_counts),
        face_material=np.concatenate(
            [s.face_material[s.drawn] + k for s, k in zip(shapes, first_material, strict=False)]
        ).astype(np.int32),
        color=np.array([m.color for m in materials], dtype=np.float32),
        pattern=np.array([PATTERNS.index(m.pattern) for m in materials], dtype=np.int32),
        pattern_m=np.array([m.pattern_m for m in materials], dtype=np.float32),
        shininess=np.array([m.shininess for m in materials], dtype=np.float32),
    )


def draw(mesh: Mesh, T_camera_instance: FloatArray, camera: Camera) -> Buffers:
    """Z-buffer of the mesh with instance i at T_camera_instance[i]: (N, 4, 4)."""
    points = _transform(mesh.vertices, mesh.vertex_instance, np.float64(T_camera_instance))
    depth = np.full((camera.height, camera.width), np.inf, dtype=np.float32)
    face = np.full((camera.height, camera.width), -1, dtype=np.int32)
    _fill(points, mesh.faces, *focal(camera), depth, face)
    depth[face < 0] = 0.0
    return Buffers(depth, face, points)


def silhouette_pixels(
    points_camera: FloatArray, faces: NDArray[np.int32], camera: Camera, widths: float = 2.0
) -> int:
    """Pixels that a mesh alone would cover if the image reached `widths` image widths and
    heights further on each side. points_camera: (V, 3); faces: (F, 3)."""
    fx, fy, cx, cy = focal(camera)
    front = points_camera[:, 2] > NEAR_M
    if not front.any():
        return 0
    reach = np.array([widths * camera.width, widths * camera.height])
    size = np.array([camera.width, camera.height], dtype=np.float64)
    low, high = -reach, size - 1 + reach
    if front.all():
        uv = points_camera[:, :2] / points_camera[:, 2:] * [fx, fy] + [cx, cy]
        low, high = np.maximum(low, uv.min(axis=0)), np.minimum(high, uv.max(axis=0))
    low, high = np.floor(low), np.ceil(high)
    if (high < low).any():
        return 0
    width, height = (high - low + 1).astype(int)
    depth = np.full((height, width), np.inf, dtype=np.float32)
    face = np.full((height, width), -1, dtype=np.int32)
    _fill(np.float32(points_camera), faces, fx, fy, cx - low[0], cy - low[1], depth, face)
    return int(np.count_nonzero(face >= 0))


def share_seen(shape: Shape, T_camera_shape: FloatArray, visible: int, camera: Camera) -> float:
    """How many of the pixels that a shape would have alone and whole are visible, 0..1."""
    if not visible:
        return 0.0
    points = apply_T(T_camera_shape, shape.vertices.astype(np.float64))
    return min(
        1.0, visible / max(silhouette_pixels(points, shape.faces[shape.drawn], camera), visible)
    )


def surface(mesh: Mesh, buffers: Buffers, camera: Camera) -> NDArray[np.float32]:
    """(H, W, 3) float32: cosine of the angle of incidence, brightness (0..1) and shininess of
    the surface at each pixel; zeros where nothing is."""
    brightness = mesh.color @ np.array([0.3, 0.5, 0.2], dtype=np.float32)
    return _surface(
        buffers.points_camera,
        mesh.faces,
        mesh.face_material,
        brightness,
        mesh.shininess,
        buffers.face,
        *focal(camera),
    )


def focal(camera: Camera) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy in pixels."""
    K = camera.K
    return float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])


@numba.njit(cache=True, nogil=True)
def _transform(vertices, instance, T):  # type: ignore[no-untyped-def]
    out = np.empty_like(vertices)
    for v in range(len(vertices)):
        M = T[instance[v]]
        x, y, z = vertices[v, 0], vertices[v, 1], vertices[v, 2]
        for k in range(3):
            out[v, k] = M[k, 0] * x + M[k, 1] * y + M[k, 2] * z + M[k, 3]
    return out


@numba.njit(cache=True, nogil=True)
def _screen_box(a, b, c, fx, fy, cx, cy):  # type: ignore[no-untyped-def]
    """Box of the part of a triangle beyond the near plane: its vertices there and the points
    where its edges cross the plane."""
    u0, u1, v0, v1 = np.inf, -np.inf, np.inf, -np.inf
    for k in range(3):
        p = a if k == 0 else (b if k == 1 else c)
        q = b if k == 0 else (c if k == 1 else a)
        if p[2] >= NEAR_M:
            u, v = fx * p[0] / p[2] + cx, fy * p[1] / p[2] + cy
            u0, u1, v0, v1 = min(u0, u), max(u1, u), min(v0, v), max(v1, v)
        if (p[2] >= NEAR_M) != (q[2] >= NEAR_M):
            s = (NEAR_M - p[2]) / (q[2] - p[2])
            u = fx * (p[0] + s * (q[0] - p[0])) / NEAR_M + cx
            v = fy * (p[1] + s * (q[1] - p[1])) / NEAR_M + cy
            u0, u1, v0, v1 = min(u0, u), max(u1, u), min(v0, v), max(v1, v)
    return u0, u1, v0, v1


@numba.njit(cache=True, nogil=True)
def _edge(p, q, fx, fy, cx, cy):  # type: ignore[no-untyped-def]
    """Plane through the camera and an edge, as a function of the pixel: value = x u + y v + z."""
    ex = (p[1] * q[2] - p[2] * q[1]) / fx
    ey = (p[2] * q[0] - p[0] * q[2]) / fy
    ez = p[0] * q[1] - p[1] * q[0]
    return ex, ey, ez - ex * cx - ey * cy


@numba.njit(cache=True, nogil=True)
def _inside(row, slope, first, last):  # type: ignore[no-untyped-def]
    """The pixels first .. last without most of those at the ends where row + slope u < 0."""
    if slope == 0:
        return first, last
    zero = int(min(max(-row / slope, -1.0), 1e6))
    return (max(first, zero - 1), last) if slope > 0 else (first, min(last, zero + 1))


@numba.njit(cache=True, nogil=True)
def _fill(points, faces, fx, fy, cx, cy, depth, face):  # type: ignore[no-untyped-def]
    height, width = depth.shape
    for f in range(len(faces)):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        if points[i, 2] < NEAR_M and points[j, 2] < NEAR_M and points[k, 2] < NEAR_M:
            continue
        a = (float(points[i, 0]), float(points[i, 1]), float(points[i, 2]))
        b = (float(points[j, 0]), float(points[j, 1]), float(points[j, 2]))
        c = (float(points[k, 0]), float(points[k, 1]), float(points[k, 2]))
        u_min, u_max, v_min, v_max = _screen_box(a, b, c, fx, fy, cx, cy)
        if u_max < 0 or v_max < 0 or u_min > width - 1 or v_min > height - 1:
            continue
        u0, u1 = int(np.ceil(max(u_min, 0.0))), int(np.floor(min(u_max, width - 1.0)))
        v0, v1 = int(np.ceil(max(v_min, 0.0))), int(np.floor(min(v_max, height - 1.0)))
        if u0 > u1 or v0 > v1:
            continue
        ax, ay, az = _edge(b, c, fx, fy, cx, cy)
        bx, by, bz = _edge(c, a, fx, fy, cx, cy)
        gx, gy, gz = _edge(a, b, fx, fy, cx, cy)
        # Six times the volume of the tetrahedron (camera, a, b, c).
        volume = (
            a[0] * (b[1] * c[2] - b[2] * c[1])
            + a[1] * (b[2] * c[0] - b[0] * c[2])
            + a[2] * (b[0] * c[1] - b[1] * c[0])
        )
        if volume == 0.0:
            continue
        s = 1.0 if volume > 0 else -1.0
        for v in range(v0, v1 + 1):
            ra, rb, rg = s * (ay * v + az), s * (by * v + bz), s * (gy * v + gz)
            first, last = _inside(ra, s * ax, *_inside(rb, s * bx, *_inside(rg, s * gx, u0, u1)))
            for u in range(first, last + 1):
                wa, wb, wg = ra + s * ax * u, rb + s * bx * u, rg + s * gx * u
                if wa < 0 or wb < 0 or wg < 0:
                    continue
                w = wa + wb + wg
                if w * depth[v, u] > s * volume and s * volume >= NEAR_M * w:
                    depth[v, u] = s * volume / w
                    face[v, u] = f


@numba.njit(cache=True, nogil=True)
def _cross(points, faces, f):  # type: ignore[no-untyped-def]
    """Normal of a face, either way, and its length, which is never zero."""
    i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
    px, py, pz = (
        points[j, 0] - points[i, 0],
        points[j, 1] - points[i, 1],
        points[j, 2] - points[i, 2],
    )
    qx, qy, qz = (
        points[k, 0] - points[i, 0],
        points[k, 1] - points[i, 1],
        points[k, 2] - points[i, 2],
    )
    nx, ny, nz = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
    return nx, ny, nz, np.sqrt(nx * nx + ny * ny + nz * nz) + 1e-20


@numba.njit(cache=True, nogil=True)
def _cosine(normal, x, y):  # type: ignore[no-untyped-def]
    nx, ny, nz, length = normal
    return (nx * x + ny * y + nz) / (length * np.sqrt(x * x + y * y + 1))


@numba.njit(cache=True, nogil=True)
def face_normal(points, faces, f, x, y):  # type: ignore[no-untyped-def]
    """Unit normal of a face turned towards the camera, and the cosine of incidence of the
    ray (x, y, 1)."""
    normal = _cross(points, faces, f)
    cosine = _cosine(normal, x, y)
    nx, ny, nz, length = normal
    s = -1.0 if cosine > 0 else 1.0
    return s * nx / length, s * ny / length, s * nz / length, abs(cosine)


@numba.njit(cache=True, nogil=True)
def _surface(points, faces, face_material, brightness, shininess, face, fx, fy, cx, cy):  # type: ignore[no-untyped-def]
    height, width = face.shape
    out = np.zeros((height, width, 3), dtype=np.float32)
    before, normal = -1, _cross(points, faces, 0)
    for v in range(height):
        for u in range(width):
            f = face[v, u]
            if f < 0:
                continue
            if f != before:
                before, normal = f, _cross(points, faces, f)
            out[v, u, 0] = abs(_cosine(normal, (u - cx) / fx, (v - cy) / fy))
            out[v, u, 1] = brightness[face_material[f]]
            out[v, u, 2] = shininess[face_material[f]]
    return out
