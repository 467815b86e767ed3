"""Pictures of one frame: depth in colour, boxes with labels, completed meshes drawn over."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from composenet.geometry.box import OrientedBox
from composenet.geometry.camera import project, resize_camera
from composenet.geometry.transform import apply_T, inverse_T
from composenet.records import Camera, FloatArray, Frame, TrackedObject, TrackState

STATE_COLORS: dict[TrackState, str] = {
    TrackState.TRACKED: "#1f9e77",
    TrackState.RE_FOUND: "#3b6fd4",
    TrackState.OCCLUDED: "#e6a817",
    TrackState.LOST: "#cf3f4f",
    TrackState.ENDED: "#b4bac2",
}
NEAR_M = 0.05
HIDDEN_MARGIN_M = 0.10
"""a mesh this far behind the measured depth is drawn fainter: it was completed, not seen"""

_BOX_CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_BOX_EDGES = [(a, b) for a in range(8) for b in range(a) if (a ^ b) in (1, 2, 4)]
_FRONT_MARK = np.array([[0.0, 0.0, -0.5], [0.5, 0.0, -0.5]])
_DEPTH_STOPS = np.array(  # near to far: warm to cold, dark at the end
    [
        [253, 231, 176],
        [249, 176, 99],
        [222, 102, 92],
        [150, 59, 120],
        [78, 52, 124],
        [26, 36, 76],
    ],
    dtype=np.float64,
)


@dataclass(frozen=True)
class ColoredMesh:
    """A mesh in the world (metres) and its colour (3,) uint8."""

    mesh: trimesh.Trimesh
    color: NDArray[np.uint8]


@dataclass(frozen=True)
class ColoredBox:
    """A box in the world, its colour (0..255) and a text over it, if any."""

    box: OrientedBox
    color: tuple[int, int, int]
    label: str = ""


def track_color(track_id: int) -> NDArray[np.uint8]:
    """(3,) uint8 colour of a track: the same in every picture, far from its neighbours' hues."""
    hue = (0.58 + 0.618033988749895 * (track_id - 1)) % 1.0
    dark = 0.62 if 0.12 < hue < 0.5 else 0.78  # yellow and green look brighter than blue
    red, green, blue = colorsys.hsv_to_rgb(hue, 0.78 - 0.18 * (track_id % 2), dark + 0.08)
    return np.array([round(255 * c) for c in (red, green, blue)], dtype=np.uint8)


def track_hex(track_id: int) -> str:
    """track_color as #rrggbb."""
    return "#" + bytes(track_color(track_id)).hex()


def label_of(entry: TrackedObject) -> str:
    """Short text: id, class and, unless plainly tracked, the state."""
    text = f"{entry.track_id} {entry.class_name}"
    return text if entry.state is TrackState.TRACKED else f"{text} ({entry.state.value})"


def depth_to_color(depth_m: FloatArray, max_m: float | None = None) -> NDArray[np.uint8]:
    """(H, W, 3) uint8: near is light and warm, far dark and cold, missing (0) grey.

    max_m: depth of the far end; the 98th percentile of the image where not given.
    """
    valid = depth_m > 0
    if max_m is None:
        max_m = float(np.percentile(depth_m[valid], 98)) if valid.any() else 1.0
    share = np.clip(np.asarray(depth_m, dtype=np.float64) / max_m, 0, 1)
    stops = np.linspace(0, 1, len(_DEPTH_STOPS))
    image = np.stack([np.interp(share, stops, _DEPTH_STOPS[:, c]) for c in range(3)], axis=-1)
    image[~valid] = 128
    return image.astype(np.uint8)


def base_image(frame: Frame) -> NDArray[np.uint8]:
    """The colour image of a frame, or its depth in colour where it has none. (H, W, 3) uint8."""
    return depth_to_color(frame.depth_m) if frame.color is None else frame.color


def box_corners(entry: TrackedObject) -> NDArray[np.float64]:
    """(8, 3) corners of the oriented box, world, metres."""
    return _in_world(entry, _BOX_CORNERS)


def _in_world(entry: TrackedObject, shares: FloatArray) -> NDArray[np.float64]:
    S = entry.S_world_canonical
    return np.asarray((shares * entry.extents_m) @ np.asarray(S.R).T + S.t)


def draw_objects(
    image: Image.Image, camera: Camera, T_world_camera: FloatArray, objects: Sequence[TrackedObject]
) -> None:
    """Draw oriented boxes, an arrow to each front and labels of all but ended tracks.

    camera: of an image of this size. Objects not observed in this frame get thin lines.
    """
    draw = ImageDraw.Draw(image)
    T_camera_world = inverse_T(T_world_camera)
    font = ImageFont.load_default(max(11, image.height // 38))
    alive = [entry for entry in objects if entry.state is not TrackState.ENDED]
    labels = []
    for entry in sorted(alive, key=lambda e: e.observed):
        color = tuple(int(c) for c in track_color(entry.track_id))
        width = max(1, image.height // 200) if entry.observed else 1
        corners = apply_T(T_camera_world, box_corners(entry))
        _draw_edges(draw, camera, corners, color, width)
        mark = apply_T(T_camera_world, _in_world(entry, _FRONT_MARK))
        _draw_segment(draw, camera, mark, color, 2 * width)
        anchor = _label_anchor(corners, camera)
        if anchor is not None:
            labels.append((anchor, label_of(entry), color))
    taken: list[tuple[float, float, float, float]] = []
    for anchor, text, color in labels:
        taken.append(_draw_label(draw, anchor, text, color, font, taken))


def draw_boxes(
    image: Image.Image, camera: Camera, T_world_camera: FloatArray, boxes: Sequence[ColoredBox]
) -> None:
    """Draw oriented boxes; those with a label thicker and last. camera: of an image of this
    size."""
    draw = ImageDraw.Draw(image)
    font = ImageFont.load_default(max(11, image.height // 38))
    taken: list[tuple[float, float, float, float]] = []
    anchors = []
    for item in sorted(boxes, key=lambda item: bool(item.label)):
        in_world = (_BOX_CORNERS * item.box.extents) @ np.asarray(item.box.R).T + item.box.center
        corners = apply_T(inverse_T(T_world_camera), in_world)
        _draw_edges(draw, camera, corners, item.color, 2 if item.label else 1)
        anchors.append((_label_anchor(corners, camera), item))
    for anchor, item in anchors:
        if item.label and anchor is not None:
            taken.append(_draw_label(draw, anchor, item.label, item.color, font, taken))


def _draw_edges(
    draw: ImageDraw.ImageDraw,
    camera: Camera,
    corners: FloatArray,
    color: tuple[int, ...],
    width: int,
) -> None:
    for a, b in _BOX_EDGES:
        _draw_segment(draw, camera, corners[[a, b]], color, width)


def _draw_segment(
    draw: ImageDraw.ImageDraw,
    camera: Camera,
    ends: FloatArray,
    color: tuple[int, ...],
    width: int,
) -> None:
    """Line between two camera-frame points (2, 3), cut at the near plane."""
    near, far = ends[np.argsort(ends[:, 2])]
    if far[2] <= NEAR_M:
        return
    if near[2] < NEAR_M:
        near = near + (far - near) * (NEAR_M - near[2]) / (far[2] - near[2])
    uv = np.clip(project(np.stack([near, far]), camera), -1e5, 1e5)
    draw.line([(float(u), float(v)) for u, v in uv], fill=color, width=width)


def _label_anchor(corners: FloatArray, camera: Camera) -> tuple[float, float] | None:
    """Top middle of the visible part of a box in the image; None when it is outside."""
    front = corners[corners[:, 2] > NEAR_M]
    if len(front) == 0:
        return None
    uv = project(front, camera)
    size = np.array([camera.width - 1, camera.height - 1])
    low, high = np.maximum(uv.min(axis=0), 0), np.minimum(uv.max(axis=0), size)
    if (low >= high).any():
        return None
    return float((low[0] + high[0]) / 2), float(low[1])


def _draw_label(
    draw: ImageDraw.ImageDraw,
    anchor: tuple[float, float],
    text: str,
    color: tuple[int, ...],
    font: ImageFont.FreeTypeFont | ImageFont.ImageFont,
    taken: Sequence[tuple[float, float, float, float]],
) -> tuple[float, float, float, float]:
    """Draw above the anchor, further down where labels are already; returns its rectangle."""
    left, top, right, bottom = draw.textbbox((0, 0), text, font=font)
    width, height = right - left + 8, bottom - top + 6
    canvas_width, canvas_height = draw.im.size
    x = min(max(anchor[0] - width / 2, 0), canvas_width - width)
    y = max(anchor[1] - height, 0)
    for other in sorted(taken, key=lambda box: box[1]):
        if x < other[2] and other[0] < x + width and y < other[3] and other[1] < y + height:
            y = other[3] + 1
    y = min(y, canvas_height - height)
    draw.rounded_rectangle((x, y, x + width, y + height), radius=3, fill=color)
    draw.text((x + 4 - left, y + 3 - top), text, fill="white", font=font)
    return x, y, x + width, y + height


def overlay_meshes(
    image: NDArray[np.uint8],
    depth_m: FloatArray,
    camera: Camera,
    T_world_camera: FloatArray,
    meshes: Sequence[ColoredMesh],
) -> NDArray[np.uint8]:
    """Shaded meshes blended over an image (H, W, 3) of the camera's size.

    depth_m: (H, W) measured; where it lies in front of a mesh, the mesh is hidden and drawn
    fainter.
    """
    if not meshes:
        return image
    points, faces, face_color = _join(meshes, inverse_T(T_world_camera))
    depth, face = _z_buffer(points, faces, camera)
    hit = face >= 0
    corners = points[faces[face[hit]]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    view = corners.mean(axis=1)
    lengths = np.linalg.norm(normal, axis=1) * np.linalg.norm(view, axis=1)
    facing = np.abs(np.einsum("ij,ij->i", normal, view)) / np.maximum(lengths, 1e-12)
    shade = face_color[face[hit]] * (0.45 + 0.65 * facing)[:, None]
    hidden = (depth_m[hit] > 0) & (depth[hit] > depth_m[hit] + HIDDEN_MARGIN_M)
    alpha = np.where(hidden, 0.35, 0.7)[:, None]
    out = image.astype(np.float64)
    out[hit] = (1 - alpha) * out[hit] + alpha * np.minimum(shade, 255)
    return out.round().astype(np.uint8)


def _join(
    meshes: Sequence[ColoredMesh], T_camera_world: FloatArray
) -> tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.float64]]:
    """Camera-frame vertices, faces and face colours of all meshes together."""
    offsets = np.cumsum([0, *(len(item.mesh.vertices) for item in meshes)])
    vertices = np.concatenate([item.mesh.vertices for item in meshes])
    faces = [item.mesh.faces + k for item, k in zip(meshes, offsets[:-1], strict=True)]
    counts = [len(item.mesh.faces) for item in meshes]
    colors = np.repeat(np.stack([item.color for item in meshes]), counts, axis=0)
    points = apply_T(T_camera_world, vertices).astype(np.float32)
    return points, np.concatenate(faces).astype(np.int32), colors.astype(np.float64)


def _z_buffer(
    points_camera: NDArray[np.float32], faces: NDArray[np.int32], camera: Camera
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """(H, W) depth and face index (-1: none) of camera-frame triangles."""
    from composenet.synth.render import Mesh, draw

    mesh = Mesh(
        vertices=points_camera,
        vertex_instance=np.zeros(len(points_camera), dtype=np.int32),
        faces=faces,
        face_instance=np.zeros(len(faces), dtype=np.int32),
        face_material=np.zeros(len(faces), dtype=np.int32),
        color=np.ones((1, 3), dtype=np.float32),
        pattern=np.zeros(1, dtype=np.int32),
        pattern_m=np.ones(1, dtype=np.float32),
        shininess=np.zeros(1, dtype=np.float32),
    )
    buffers = draw(mesh, np.eye(4)[None], camera)
    return buffers.depth_m, buffers.face


def overlay(
    frame: Frame,
    objects: Sequence[TrackedObject],
    meshes: Sequence[ColoredMesh] = (),
    width: int = 640,
) -> Image.Image:
    """What a frame's tracks look like: image, completed meshes, boxes and labels.

    width: of the picture, pixels; the frame is scaled to it.
    """
    height = round(width * frame.camera.height / frame.camera.width)
    camera = resize_camera(frame.camera, width, height)
    scaled = Image.fromarray(base_image(frame)).resize((width, height), Image.Resampling.BICUBIC)
    depth = Image.fromarray(np.asarray(frame.depth_m, dtype=np.float32)).resize(
        (width, height), Image.Resampling.NEAREST
    )
    image = overlay_meshes(
        np.asarray(scaled), np.asarray(depth), camera, frame.T_world_camera, meshes
    )
    picture = Image.fromarray(image)
    draw_objects(picture, camera, frame.T_world_camera, objects)
    return picture
