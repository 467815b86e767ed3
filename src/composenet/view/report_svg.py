"""The drawings of report.html as SVG: timeline of states and top view."""

from __future__ import annotations

from html import escape

import numpy as np

from composenet.predictions import PredictedSequence
from composenet.records import CLASS_NAMES, FloatArray, TrackState
from composenet.view.figures import STATE_COLORS, track_hex
from composenet.view.plots import TopView, state_segments

TIMELINE_WIDTH = 1180
_LEFT, _ROW, _TOP = 130, 24, 26
_MARGIN_RIGHT = 14
MIN_PATH_M = 0.3
"""shorter paths are jitter about one place"""
_LETTER = 7.6  # width of one, at most, in labels and numbers
_SHAPES: dict[TrackState, tuple[float, float]] = {  # top and height as shares of a row
    TrackState.TRACKED: (0.15, 0.70),
    TrackState.RE_FOUND: (0.05, 0.90),
    TrackState.OCCLUDED: (0.35, 0.30),
    TrackState.LOST: (0.42, 0.16),
    TrackState.ENDED: (0.30, 0.40),
}
_MEANING = {
    TrackState.TRACKED: "tracked: seen in this frame",
    TrackState.RE_FOUND: "re-found: seen again after an absence",
    TrackState.OCCLUDED: "occluded: hidden or outside the view",
    TrackState.LOST: "lost: should be in view, but is not seen",
    TrackState.ENDED: "ended: given up",
}


def timeline_x(position: float, frames: int) -> float:
    """Horizontal place of a frame's left edge in the timeline."""
    return _LEFT + position * (TIMELINE_WIDTH - _LEFT - _MARGIN_RIGHT) / max(frames, 1)


def timeline_svg(run: PredictedSequence) -> str:
    """Rows are tracks, columns frames; colour and height of a bar tell the state."""
    positions = {frame.index: n for n, frame in enumerate(run.frames)}
    count, histories = len(run.frames), run.histories
    height = _TOP + _ROW * len(histories) + 6
    parts = [_frame_ticks(run, height)]
    for row, (track_id, history) in enumerate(histories.items()):
        y = _TOP + row * _ROW
        name = f"{track_id} {CLASS_NAMES[run.class_ids[track_id]]}"
        parts.append(
            f'<rect x="0" y="{y + 6}" width="11" height="11" rx="3" fill="{track_hex(track_id)}"/>'
            f'<text x="18" y="{y + 16}" font-size="13.5" fill="#1d2330">{escape(name)}</text>'
        )
        for first, last, state in state_segments(history, positions):
            x, end = timeline_x(first, count), timeline_x(last + 1, count)
            top, tall = _SHAPES[state]
            span = f"frames {run.frames[first].index} to {run.frames[last].index}"
            parts.append(
                f'<rect x="{x:.1f}" y="{y + top * _ROW:.1f}" width="{max(end - x, 1):.1f}" '
                f'height="{tall * _ROW:.1f}" fill="{STATE_COLORS[state]}">'
                f"<title>{escape(name)}: {state.value}, {span}</title></rect>"
            )
    cursor = (
        f'<g id="cursor"><line y1="{_TOP - 8}" y2="{height}" stroke="#1d2330" stroke-width="1.5"/>'
        f'<path d="M-5 {_TOP - 14} h10 l-5 8 z" fill="#1d2330"/></g>'
    )
    return (
        f'<svg id="timeline" viewBox="0 0 {TIMELINE_WIDTH} {height}" role="img" '
        f'aria-label="State of {len(histories)} tracks over {count} frames">'
        f"{''.join(parts)}{cursor}</svg>"
    )


def _frame_ticks(run: PredictedSequence, height: float) -> str:
    count = len(run.frames)
    step = max(1, int(np.ceil(count / 12)))
    step = next((nice for nice in (1, 2, 5, 10, 20, 50, 100, 200, 500) if nice >= step), step)
    parts = []
    for n in range(0, count, step):
        x, name = timeline_x(n, count), str(run.frames[n].index)
        anchor = "end" if x + _LETTER * len(name) > TIMELINE_WIDTH else "start"
        parts.append(
            f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{_TOP - 4}" y2="{height}" stroke="#edf0f4"/>'
            f'<text x="{x:.1f}" y="{_TOP - 10}" font-size="12" text-anchor="{anchor}" '
            f'fill="#626b7a">{name}</text>'
        )
    return "".join(parts)


def state_legend() -> str:
    """What the bars of the timeline mean."""
    items = []
    for state, meaning in _MEANING.items():
        top, tall = _SHAPES[state]
        bar = f'<rect y="{12 * top:.1f}" width="22" height="{12 * tall:.1f}"'
        items.append(
            f'<span><svg viewBox="0 0 22 12" aria-hidden="true">{bar} '
            f'fill="{STATE_COLORS[state]}"/></svg>{meaning}</span>'
        )
    return f'<div class="legend">{"".join(items)}</div>'


class TopViewDrawing:
    """Top view as SVG: x right, y up, metres."""

    def __init__(self, view: TopView, width: float = 470, tallest: float = 560) -> None:
        size = np.maximum(view.high - view.low, 1e-6)
        self._view = view
        self._scale = float(min(width / size[0], tallest / size[1]))
        self._offset = np.array([(width - size[0] * self._scale) / 2, 0.0])
        self.width, self.height = width, float(size[1] * self._scale)

    def at(self, points: FloatArray) -> np.ndarray:
        """(..., 2) drawing coordinates of world x, y."""
        share = (np.asarray(points) - self._view.low) * self._scale
        flipped = np.stack([share[..., 0], self.height - share[..., 1]], axis=-1)
        return np.asarray(flipped + self._offset)

    def eye(self, T_world_camera: FloatArray) -> str:
        """SVG transform of the camera mark at a camera pose."""
        x, y = self.at(T_world_camera[:2, 3])
        forward = T_world_camera[:2, 2]
        turn = -np.degrees(np.arctan2(forward[1], forward[0]))
        return f"translate({x:.1f} {y:.1f}) rotate({turn:.1f})"

    def svg(self, run: PredictedSequence) -> str:
        """Grid, camera path and mark, and of each track its path and last footprint."""
        tracks = "".join(self._track(run, track_id) for track_id in self._view.paths)
        path = self._polyline(self._view.camera_path, "#7d8693", "2", "camera path")
        eye = (
            '<g id="eye"><path d="M0 0 L26 -15 L26 15 Z" fill="#7d8693" fill-opacity="0.25"/>'
            '<circle r="5" fill="#4d5562"/></g>'
        )
        return (
            f'<svg viewBox="0 0 {self.width:.0f} {self.height:.0f}" role="img" aria-label='
            f'"Top view: camera path and {len(self._view.paths)} tracks, 1 m grid">'
            f"{self._grid()}{path}{tracks}{eye}</svg>"
        )

    def _track(self, run: PredictedSequence, track_id: int) -> str:
        color, view = track_hex(track_id), self._view
        name = f"{track_id} {CLASS_NAMES[run.class_ids[track_id]]}"
        corners = " ".join(f"{x:.1f},{y:.1f}" for x, y in self.at(view.outlines[track_id]))
        x, y = self.at(view.outlines[track_id].mean(axis=0))
        half = _LETTER * len(name) / 2
        x = min(max(x, half), self.width - half)
        return (
            f'<g><title>{escape(name)}</title><polygon points="{corners}" fill="{color}" '
            f'fill-opacity="0.12" stroke="{color}" stroke-width="1.6"/>'
            + self._polyline(view.fronts[track_id], color, "3", f"front of {name}")
            + self._polyline(view.paths[track_id], color, "1.6", f"path of {name}")
            + self._start(view.paths[track_id], color)
            + f'<text x="{x:.1f}" y="{y - 7:.1f}" font-size="12.5" text-anchor="middle" '
            f'fill="{color}" stroke="#fff" stroke-width="3" paint-order="stroke" '
            f'font-weight="600">{escape(name)}</text></g>'
        )

    def _polyline(self, points: FloatArray, color: str, width: str, title: str) -> str:
        if len(points) == 0:
            return ""
        text = " ".join(f"{x:.1f},{y:.1f}" for x, y in self.at(points))
        return (
            f'<polyline points="{text}" fill="none" stroke="{color}" stroke-width="{width}" '
            f'stroke-linejoin="round"><title>{escape(title)}</title></polyline>'
        )

    def _start(self, points: FloatArray, color: str) -> str:
        """A ring where a path begins, if it leads anywhere."""
        reach = np.linalg.norm(np.asarray(points) - points[0], axis=1).max()
        if reach < MIN_PATH_M:
            return ""
        x, y = self.at(points[0])
        return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.2" fill="#fff" stroke="{color}"/>'

    def _grid(self) -> str:
        low, high, parts = self._view.low, self._view.high, []
        for x in range(int(np.ceil(low[0])), int(np.floor(high[0])) + 1):
            u = self.at(np.array([x, low[1]]))[0]
            parts.append(
                f'<line x1="{u:.1f}" x2="{u:.1f}" y1="0" y2="{self.height:.0f}" stroke="#e9ecf1"/>'
                f'<text x="{u + 3:.1f}" y="{self.height - 4:.0f}" font-size="11" '
                f'fill="#8b93a0">{x} m</text>'
            )
        for y in range(int(np.ceil(low[1])), int(np.floor(high[1])) + 1):
            v = self.at(np.array([low[0], y]))[1]
            parts.append(
                f'<line x1="0" x2="{self.width:.0f}" y1="{v:.1f}" y2="{v:.1f}" stroke="#e9ecf1"/>'
                f'<text x="3" y="{v - 3:.1f}" font-size="11" fill="#8b93a0">{y} m</text>'
            )
        return "".join(parts)
