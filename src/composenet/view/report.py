"""report.html: one self-contained page about a run, for a person."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image

from composenet import __version__
from composenet.files import write_atomic
from composenet.predictions import PredictedSequence
from composenet.records import CLASS_NAMES
from composenet.timings import WHOLE_FRAME, StageTiming
from composenet.view.figures import track_hex
from composenet.view.meshes import last_observed, simplified
from composenet.view.plots import top_view_of
from composenet.view.report_page import SCRIPT, STYLE
from composenet.view.report_svg import (
    TIMELINE_WIDTH,
    TopViewDrawing,
    state_legend,
    timeline_svg,
    timeline_x,
)

MAX_SCENE_FACES = 60_000
"""faces of all meshes together in the page's 3D view"""


@dataclass(frozen=True)
class Picture:
    """The overlay of one frame. position: of the frame in the run (not its index)."""

    position: int
    image: Image.Image


def write_report(
    path: Path,
    run: PredictedSequence,
    meshes: Mapping[int, trimesh.Trimesh],
    pictures: Sequence[Picture],
    timings: Sequence[StageTiming],
) -> None:
    """Write the page. meshes: of each track id, closed, world frame, metres."""
    drawing = TopViewDrawing(top_view_of(run))
    title = escape(run.sequence or "recording")
    body = "".join(
        [
            f"<h1>{title}</h1>",
            f'<p class="soft">Furniture tracked by composenet {escape(__version__)}'
            f"{_provenance(run)}</p>",
            _facts(run, meshes, timings),
            _warnings(run),
            _overlays_and_top_view(run, pictures, drawing),
            _timeline(run),
            _scene(run, meshes),
            _tables(run, timings),
        ]
    )
    data = json.dumps(_page_data(run, pictures, drawing)).replace("</", "<\\/")
    page = (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{title} - composenet</title><style>{STYLE}</style></head>"
        f'<body><main>{body}</main><script type="application/json" id="run-data">{data}</script>'
        f"<script>{SCRIPT}</script></body></html>\n"
    )
    write_atomic(path, page.encode(errors="replace"))  # a folder's name may be in no known encoding


def _provenance(run: PredictedSequence) -> str:
    parts = [f"weights {run.weights_id}"] if run.weights_id else []
    parts += [f"commit {run.commit}"] if run.commit else []
    return "".join(f" · {escape(part)}" for part in parts)


def _facts(
    run: PredictedSequence,
    meshes: Mapping[int, trimesh.Trimesh],
    timings: Sequence[StageTiming],
) -> str:
    whole = next((t for t in timings if t.stage == WHOLE_FRAME), None)
    facts = [
        (f"{len(run.frames):,}", "frames"),
        (str(len(run.histories)), "tracks"),
        (str(len(meshes)), "completed meshes"),
        (f"{whole.median_ms / 1000:.2f} s" if whole else "not timed", "a frame, median"),
    ]
    if not run.complete:
        facts.append(("interrupted", "results up to the last frame"))
    cells = "".join(f'<div class="fact"><b>{a}</b><span>{b}</span></div>' for a, b in facts)
    return f'<div class="facts">{cells}</div>'


def _warnings(run: PredictedSequence) -> str:
    if not run.warnings:
        return ""
    items = "".join(f"<li>{escape(text)}</li>" for text in run.warnings)
    return f'<section class="warn" role="note"><h2>Notes</h2><ul>{items}</ul></section>'


def _overlays_and_top_view(
    run: PredictedSequence, pictures: Sequence[Picture], drawing: TopViewDrawing
) -> str:
    last = len(pictures) - 1
    overlays = (
        '<img id="picture" alt="Overlay of one frame">'
        '<div class="slider"><label for="slider">Frame</label>'
        f'<input id="slider" type="range" min="0" max="{last}" value="{last // 2}" step="1">'
        '<output id="shown" for="slider"></output></div>'
        '<p class="soft small">Completed meshes over the image, fainter where something hides '
        "them; thin boxes are not seen in this frame; the tick points to the front.</p>"
    )
    return (
        '<div class="pair"><section><h2>Frames</h2>'
        f"{overlays if pictures else '<p>No frames.</p>'}</section>"
        f"<section><h2>From above</h2>{drawing.svg(run)}"
        '<p class="soft small">World x to the right, y up. Boxes at their last seen place, '
        "thin lines where they came from; grey is the camera.</p></section></div>"
    )


def _timeline(run: PredictedSequence) -> str:
    return (
        "<section><h2>Tracks over time</h2>"
        f'<div class="scroll" tabindex="0" role="region" aria-label="Timeline of track states">'
        f"{timeline_svg(run)}</div>{state_legend()}</section>"
    )


def _scene(run: PredictedSequence, meshes: Mapping[int, trimesh.Trimesh]) -> str:
    """3D view of the completed meshes and the camera path, by plotly."""
    import plotly.graph_objects as go

    figure = go.Figure()
    path = np.array([frame.T_world_camera[:3, 3] for frame in run.frames]).reshape(-1, 3)
    x, y, z = path.T.astype(np.float32)
    line = {"color": "#7d8693", "width": 4}
    figure.add_trace(go.Scatter3d(x=x, y=y, z=z, mode="lines", line=line, name="camera path"))
    for track_id, mesh in meshes.items():
        small = _decimated(mesh, MAX_SCENE_FACES // len(meshes))
        x, y, z = small.vertices.T.astype(np.float32)
        i, j, k = small.faces.T.astype(np.uint32)
        name = f"{track_id} {CLASS_NAMES[run.class_ids[track_id]]}"
        light = {"ambient": 0.72, "diffuse": 0.5, "specular": 0.05, "roughness": 0.9}
        figure.add_trace(
            go.Mesh3d(
                x=x, y=y, z=z, i=i, j=j, k=k, color=track_hex(track_id), flatshading=True,
                lighting=light, name=name, hoverinfo="name", showlegend=True,
            )
        )  # fmt: skip
    axis = {"backgroundcolor": "#f5f7fa", "gridcolor": "#dde2e9", "zeroline": False}
    names = {"xaxis": "x, m", "yaxis": "y, m", "zaxis": "z, m"}
    figure.update_layout(
        scene={
            "aspectmode": "data",
            "camera": {"eye": _viewpoint(run), "center": {"z": -0.15}},
            **{key: {**axis, "title": {"text": text}} for key, text in names.items()},
        },
        margin={"l": 0, "r": 0, "t": 0, "b": 0},
        legend={"itemsizing": "constant", "x": 0, "y": 1, "bgcolor": "rgba(255,255,255,0.7)"},
        paper_bgcolor="rgba(0,0,0,0)",
    )
    html = figure.to_html(
        full_html=False,
        include_plotlyjs="inline",
        default_height="540px",
        div_id="scene",
        config={"displayModeBar": False, "responsive": True},
    )
    return (
        "<section><h2>Completed furniture</h2>"
        '<div role="img" aria-label="3D view of the completed meshes and the camera path">'
        f'{html}</div><p class="soft small">Each mesh at its last seen pose. Drag to turn, scroll '
        "to zoom, click a name to hide it. Simplified here; meshes/ has them whole.</p></section>"
    )


def _viewpoint(run: PredictedSequence) -> dict[str, float]:
    """From above, on the side that the recording camera mostly looked from."""
    forward = sum((frame.T_world_camera[:2, 2] for frame in run.frames), np.zeros(2))
    length = float(np.linalg.norm(forward))
    x, y = -1.25 * forward / length if length > 0 else (-1.0, -0.75)
    return {"x": float(x), "y": float(y), "z": 0.8}


def _decimated(mesh: trimesh.Trimesh, max_faces: int) -> trimesh.Trimesh:
    tolerance = 0.004 * float(np.linalg.norm(mesh.extents))
    small = simplified(mesh, tolerance)
    while len(small.faces) > max_faces and tolerance < 0.1:
        tolerance *= 2
        small = simplified(mesh, tolerance)
    return small


def _tables(run: PredictedSequence, timings: Sequence[StageTiming]) -> str:
    return f'<div class="triple">{_track_table(run)}{_timing_table(timings)}</div>'


def _track_table(run: PredictedSequence) -> str:
    rows = []
    for track_id, history in run.histories.items():
        entry = last_observed(history)
        sizes = " x ".join(f"{size:.2f}" for size in entry.extents_m)
        seen = sum(e.observed for e in history)
        ply = run.mesh_files.get(track_id)
        link = (
            f'<a href="{escape(ply)}">ply</a> <a href="{escape(ply[:-3])}glb">glb</a>'
            if ply
            else "none"
        )
        rows.append(
            f'<tr><td><span class="dot" style="background:{track_hex(track_id)}"></span>'
            f"{track_id} {CLASS_NAMES[run.class_ids[track_id]]}</td>"
            f'<td class="n">{history[0].frame_index}-{history[-1].frame_index}</td>'
            f'<td class="n">{seen}</td><td class="n">{sizes}</td>'
            f'<td class="n">{100 * entry.confidence:.0f} %</td>'
            f"<td>{history[-1].state.value}</td><td>{link}</td></tr>"
        )
    return (
        "<section><h2>Tracks</h2><div class='scroll'><table><thead><tr><th scope='col'>track</th>"
        "<th scope='col' class='n'>frames</th><th scope='col' class='n'>seen in</th>"
        "<th scope='col' class='n'>depth x width x height, m</th>"
        "<th scope='col' class='n'>confidence</th><th scope='col'>last state</th>"
        f"<th scope='col'>mesh</th></tr></thead><tbody>{''.join(rows)}</tbody></table></div>"
        "</section>"
    )


def _timing_table(timings: Sequence[StageTiming]) -> str:
    rows = "".join(
        f'<tr><td>{escape(t.stage)}</td><td class="n">{t.median_ms:,.1f}</td>'
        f'<td class="n">{t.p95_ms:,.1f}</td><td class="n">{t.n:,}</td></tr>'
        for t in timings
    )
    return (
        "<section><h2>Time by stage</h2><table><thead><tr><th scope='col'>stage</th>"
        "<th scope='col' class='n'>median, ms</th><th scope='col' class='n'>95 %, ms</th>"
        f"<th scope='col' class='n'>frames</th></tr></thead><tbody>{rows}</tbody></table></section>"
    )


def _page_data(
    run: PredictedSequence, pictures: Sequence[Picture], drawing: TopViewDrawing
) -> dict[str, object]:
    """What the page's script needs: the pictures and where they are in the drawings."""
    items = []
    for picture in pictures:
        frame = run.frames[picture.position]
        names = [f"{e.track_id} {e.class_name} {e.state.value}" for e in frame.objects]
        items.append(
            {
                "frame": frame.index,
                "alt": f"Frame {frame.index}: {', '.join(names) or 'no tracks'}",
                "jpeg": _jpeg(picture.image),
                "timeline_x": round(timeline_x(picture.position + 0.5, len(run.frames)), 1),
                "eye": drawing.eye(frame.T_world_camera),
            }
        )
    return {"pictures": items, "timeline_width": TIMELINE_WIDTH}


def _jpeg(image: Image.Image) -> str:
    data = io.BytesIO()
    image.convert("RGB").save(data, "JPEG", quality=82)
    return base64.b64encode(data.getvalue()).decode()
