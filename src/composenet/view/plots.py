"""Pictures of a whole recording or data set: top view, contact sheet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from composenet.predictions import PredictedSequence
from composenet.records import CLASS_NAMES, FloatArray, TrackedObject, TrackState
from composenet.view.figures import track_color

_STROKE = 3  # pixels of white around a label


@dataclass(frozen=True)
class TopView:
    """A recording seen from above; all coordinates world x, y in metres.

    camera_path: (N, 2). paths: of each track id (K, 2), its boxes' centres while observed.
    outlines: of each track id (4, 2), the oriented box at its last observed pose.
    fronts: of each track id (2, 2), from that box's centre to the middle of its front.
    low, high: (2,) bounds of everything, with a margin.
    """

    camera_path: NDArray[np.float64]
    paths: dict[int, NDArray[np.float64]]
    outlines: dict[int, NDArray[np.float64]]
    fronts: dict[int, NDArray[np.float64]]
    low: NDArray[np.float64]
    high: NDArray[np.float64]


def top_view_of(run: PredictedSequence, margin_m: float = 0.4) -> TopView:
    """Lay out the top view of a result."""
    camera_path = np.array([f.T_world_camera[:2, 3] for f in run.frames]).reshape(-1, 2)
    paths, outlines, fronts = {}, {}, {}
    for track_id, history in run.histories.items():
        seen = [entry for entry in history if entry.observed] or list(history[-1:])
        paths[track_id] = np.array([entry.box.center[:2] for entry in seen])
        outlines[track_id], fronts[track_id] = _footprint(seen[-1])
    everything = np.concatenate([camera_path, *paths.values(), *outlines.values()])
    if len(everything) == 0:
        everything = np.zeros((1, 2))
    low, high = everything.min(axis=0) - margin_m, everything.max(axis=0) + margin_m
    return TopView(camera_path, paths, outlines, fronts, low, high)


def _footprint(entry: TrackedObject) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    S, half = entry.S_world_canonical, np.asarray(entry.extents_m) / 2
    square = np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]]) * half
    outline = square @ np.asarray(S.R).T + S.t
    front = np.array([[0, 0, 0], [1, 0, 0]]) * half @ np.asarray(S.R).T + S.t
    return outline[:, :2], front[:, :2]


def top_view(run: PredictedSequence, width: int = 900) -> Image.Image:
    """Picture from above: x to the right, y up, a 1 m grid; camera path in grey, each track's
    path and last footprint in its colour."""
    view = top_view_of(run)
    size = view.high - view.low
    scale = width / size[0]
    image = Image.new("RGB", (width, max(1, round(size[1] * scale))), "white")
    draw = ImageDraw.Draw(image)

    def at(points: FloatArray) -> list[tuple[float, float]]:
        xy = (np.atleast_2d(points) - view.low) * scale
        return [(float(x), float(image.height - y)) for x, y in xy]

    _draw_grid(draw, view, scale, image)
    _draw_path(draw, at(view.camera_path), (130, 138, 148), 2)
    font = ImageFont.load_default(15)
    for track_id, path in view.paths.items():
        color = tuple(int(c) for c in track_color(track_id))
        draw.polygon(at(view.outlines[track_id]), outline=color, width=2)
        draw.line(at(view.fronts[track_id]), fill=color, width=3)
        _draw_path(draw, at(path), color, 2)
        text = f"{track_id} {CLASS_NAMES[run.class_ids[track_id]]}"
        x, y = at(path[-1])[0]
        half = font.getlength(text) / 2 + _STROKE
        x = min(max(x, half), width - half)
        draw.text(
            (x, y - 6),
            text,
            fill=color,
            font=font,
            anchor="mb",
            stroke_width=_STROKE,
            stroke_fill="white",
        )
    return image


def _draw_grid(draw: ImageDraw.ImageDraw, view: TopView, scale: float, image: Image.Image) -> None:
    font = ImageFont.load_default(11)
    for x in range(int(np.ceil(view.low[0])), int(np.floor(view.high[0])) + 1):
        u = (x - view.low[0]) * scale
        draw.line([(u, 0), (u, image.height)], fill=(232, 235, 239))
        draw.text((u + 2, image.height - 2), f"{x} m", fill=(150, 156, 165), font=font, anchor="lb")
    for y in range(int(np.ceil(view.low[1])), int(np.floor(view.high[1])) + 1):
        v = image.height - (y - view.low[1]) * scale
        draw.line([(0, v), (image.width, v)], fill=(232, 235, 239))
        draw.text((2, v - 2), f"{y} m", fill=(150, 156, 165), font=font, anchor="lb")


def _draw_path(
    draw: ImageDraw.ImageDraw,
    points: list[tuple[float, float]],
    color: tuple[int, ...],
    width: int,
) -> None:
    if not points:
        return
    draw.line(points, fill=color, width=width, joint="curve")
    x, y = points[0]
    draw.ellipse((x - 4, y - 4, x + 4, y + 4), outline=color, fill="white", width=2)
    x, y = points[-1]
    draw.ellipse((x - 4, y - 4, x + 4, y + 4), fill=color)


def contact_sheet(
    images: Sequence[Image.Image | NDArray[np.uint8]],
    labels: Sequence[str] = (),
    columns: int = 4,
    cell: tuple[int, int] = (240, 180),
) -> Image.Image:
    """Pictures in rows, each fitted into a cell (width, height), with a label below."""
    rows = -(-len(images) // columns)
    line = 18 if labels else 0
    sheet = Image.new("RGB", (columns * (cell[0] + 4), rows * (cell[1] + line + 4)), "white")
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(13)
    for n, item in enumerate(images):
        picture = (item if isinstance(item, Image.Image) else Image.fromarray(item)).convert("RGB")
        picture = picture.copy()
        picture.thumbnail(cell)
        x, y = n % columns * (cell[0] + 4) + 2, n // columns * (cell[1] + line + 4) + 2
        offset = ((cell[0] - picture.width) // 2, (cell[1] - picture.height) // 2)
        sheet.paste(picture, (x + offset[0], y + offset[1]))
        if n < len(labels):
            middle = (x + cell[0] // 2, y + cell[1])
            draw.text(middle, labels[n], fill=(40, 44, 52), font=font, anchor="ma")
    return sheet


def state_segments(
    history: Sequence[TrackedObject], positions: dict[int, int]
) -> list[tuple[int, int, TrackState]]:
    """Runs of equal state as (first position, last position, state).

    positions: of each frame index, its place in the recording.
    """
    segments: list[tuple[int, int, TrackState]] = []
    for entry in history:
        place = positions[entry.frame_index]
        if segments and segments[-1][2] is entry.state and segments[-1][1] == place - 1:
            segments[-1] = (segments[-1][0], place, entry.state)
        else:
            segments.append((place, place, entry.state))
    return segments
