"""Replay of a run for the rerun viewer: images, boxes, meshes, paths, states on one timeline."""

from __future__ import annotations

import contextlib
import importlib.util
import io
import shlex
import socket
import threading
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import trimesh
from PIL import Image
from rich.console import Console

from composenet.errors import DataError
from composenet.geometry.transform import quaternion_from_rotation
from composenet.records import FloatArray, Frame, TrackedObject, TrackState
from composenet.view.figures import STATE_COLORS, label_of, track_color

INSTALL_HINT = "no replay.rrd: rerun is not installed; pip install 'composenet[viz]' adds it"
OTHER_RERUN = (
    "no replay.rrd: the rerun that is installed does not fit; pip install 'composenet[viz]' brings "
    "one that does"
)
WEB_PORT, DATA_PORT = 9090, 9876
"""rerun's own: of its web viewer, and of what it shows"""
FLUSH_S = 60.0
"""Nothing writes longer than this but a full disk."""
_JPEG_QUALITY = 85
_TRAIL = 300
"""steps of a path that are shown behind the current frame"""


class Replay(Protocol):
    """Receives every frame as it is tracked, and the meshes at the end."""

    hint: str

    def add_frame(self, frame: Frame, tracked: Sequence[TrackedObject]) -> None: ...

    def finish(self, meshes: Mapping[int, trimesh.Trimesh]) -> None: ...

    def close(self) -> None: ...


class NoReplay:
    """Ignores everything. hint: why there is no replay, one line or empty."""

    def __init__(self, hint: str = "") -> None:
        self.hint = hint

    def add_frame(self, frame: Frame, tracked: Sequence[TrackedObject]) -> None:
        """Nothing."""

    def finish(self, meshes: Mapping[int, trimesh.Trimesh]) -> None:
        """Nothing."""

    def close(self) -> None:
        """Nothing."""


def open_replay(path: Path, name: str) -> Replay:
    """A replay that writes to `path`, or NoReplay with a hint where rerun is not installed, or
    another one than this program was made for."""
    if importlib.util.find_spec("rerun") is None:
        return NoReplay(INSTALL_HINT)
    try:
        return RerunReplay(path, name)
    except (ImportError, AttributeError, TypeError) as error:
        return NoReplay(f"{OTHER_RERUN} ({error})")


def serve_replay(path: Path, console: Console) -> None:
    """Show an .rrd file in the web viewer until ctrl-C. Raises DataError without rerun, or where
    its ports are taken."""
    if importlib.util.find_spec("rerun") is None:
        raise DataError("rerun is not installed: pip install 'composenet[viz]' adds it")
    for port in (WEB_PORT, DATA_PORT):
        if not _is_free(port):
            raise DataError(
                f"port {port} is taken, by another viewer perhaps: end that, or use free ports "
                f"with `rerun --new --web-viewer --web-viewer-port 0 {shlex.quote(str(path))}`"
            )
    import rerun

    stream = rerun.RecordingStream("composenet", send_properties=False)
    address = stream.serve_grpc(grpc_port=DATA_PORT)
    stream.log_file_from_path(path)
    rerun.serve_web_viewer(web_port=WEB_PORT, connect_to=address)
    console.print(f"the viewer is at http://localhost:{WEB_PORT}; ctrl-C ends it", highlight=False)
    with contextlib.suppress(KeyboardInterrupt):
        threading.Event().wait()


def _is_free(port: int) -> bool:
    """Asked beforehand, since rerun goes on without its data where only that port is taken."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("0.0.0.0", port))
        except OSError:
            return False
    return True


class RerunReplay:
    """Writes an .rrd file while tracking. One timeline, `frame`.

    world/camera (colour, depth), world/boxes, world/tracks/ID (pose) with mesh below,
    world/paths/ID, states/ID.
    """

    hint = ""

    def __init__(self, path: Path, name: str) -> None:
        import rerun

        self._rr, self._path = rerun, path
        self._stream = rerun.RecordingStream("composenet")
        self._stream.save(path, default_blueprint=self._blueprint())
        self._stream.set_log_time_enabled(False)
        self._stream.set_log_tick_enabled(False)
        self._stream.send_recording_name(name.encode(errors="replace").decode())
        self._stream.log("world", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self._paths: dict[str, deque[FloatArray]] = {}
        self._entities: dict[int, str] = {}
        self._first: dict[int, int] = {}
        self._last: dict[int, int] = {}
        self._states: dict[int, TrackState] = {}  # of the tracks told of in the newest frame
        self._newest = 0

    def add_frame(self, frame: Frame, tracked: Sequence[TrackedObject]) -> None:
        """Log one frame and its tracks."""
        self._stream.set_time("frame", sequence=frame.index)
        self._log_camera(frame)
        alive = [entry for entry in tracked if entry.state is not TrackState.ENDED]
        self._log_boxes(alive)
        self._newest = frame.index
        for track_id in self._states.keys() - {entry.track_id for entry in tracked}:
            reset = self._rr.StateChange(state="")  # told of no more: a gap, not the last state
            self._stream.log(self._entities[track_id], reset)
            del self._states[track_id]
        for entry in tracked:
            self._log_state(entry)
        for entry in alive:
            self._log_pose(entry)

    def finish(self, meshes: Mapping[int, trimesh.Trimesh]) -> None:
        """Log each track's mesh (canonical coordinates) for the frames it lived, and close."""
        rr = self._rr
        for track_id, mesh in meshes.items():
            if track_id not in self._first:
                continue
            shape = rr.Mesh3D(
                vertex_positions=mesh.vertices.astype(np.float32),
                triangle_indices=mesh.faces,
                vertex_normals=mesh.vertex_normals.astype(np.float32),
                albedo_factor=track_color(track_id).tolist(),
            )
            self._stream.set_time("frame", sequence=self._first[track_id])
            self._stream.log(f"world/tracks/{track_id}/mesh", shape)
            if self._last[track_id] < self._newest:
                self._stream.set_time("frame", sequence=self._last[track_id] + 1)
                self._stream.log(f"world/tracks/{track_id}/mesh", rr.Clear(recursive=False))
        self.close()

    def close(self) -> None:
        """Write out what was logged; nothing can be added afterwards. Raises DataError where it
        cannot be written; the stream is then left alone, as it would wait for ever."""
        try:
            self._stream.flush(timeout_sec=FLUSH_S)
        except RuntimeError as error:
            raise DataError(
                f"{self._path}: cannot be written ({error}); is the disk full?"
            ) from None
        self._stream.disconnect()

    def _log_camera(self, frame: Frame) -> None:
        rr, camera, T = self._rr, frame.camera, frame.T_world_camera
        pose = rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3])
        pinhole = rr.Pinhole(
            image_from_camera=camera.K,
            resolution=[camera.width, camera.height],
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=0.3,
        )
        self._stream.log("world/camera", pose, pinhole)
        depth_mm = np.clip(np.round(frame.depth_m * 1000), 0, 65535).astype(np.uint16)
        depth = rr.EncodedDepthImage(
            _encoded(depth_mm, "PNG"), media_type="image/png", meter=1000.0
        )
        self._stream.log("world/camera/depth", depth)
        if frame.color is not None:
            color = rr.EncodedImage(contents=_encoded(frame.color, "JPEG"), media_type="image/jpeg")
            self._stream.log("world/camera/color", color)
        else:  # else the last one would be shown
            self._stream.log("world/camera/color", rr.Clear(recursive=False))
        self._log_path("world/paths/camera", T[:3, 3], [130, 138, 148])

    def _log_boxes(self, alive: Sequence[TrackedObject]) -> None:
        rr = self._rr
        boxes = rr.Boxes3D(
            centers=[entry.S_world_canonical.t for entry in alive],
            half_sizes=[np.asarray(entry.extents_m) / 2 for entry in alive],
            quaternions=[
                rr.Quaternion(xyzw=np.roll(quaternion_from_rotation(e.S_world_canonical.R), -1))
                for e in alive
            ],
            colors=[track_color(entry.track_id) for entry in alive],
            labels=[f"{label_of(entry)} {100 * entry.confidence:.0f} %" for entry in alive],
            fill_mode="MajorWireframe",
            radii=[0.012 if entry.observed else 0.004 for entry in alive],
        )
        self._stream.log("world/boxes", boxes)

    def _log_pose(self, entry: TrackedObject) -> None:
        S, track_id = entry.S_world_canonical, entry.track_id
        self._first.setdefault(track_id, entry.frame_index)
        self._last[track_id] = entry.frame_index
        pose = self._rr.Transform3D(translation=S.t, mat3x3=np.asarray(S.R) * S.scale_m)
        self._stream.log(f"world/tracks/{track_id}", pose)
        if entry.observed:
            color = track_color(track_id).tolist()
            self._log_path(f"world/paths/{track_id}", entry.box.center, color)

    def _log_path(self, entity: str, point: FloatArray, color: list[int]) -> None:
        trail = self._paths.setdefault(entity, deque(maxlen=_TRAIL))
        trail.append(np.array(point))
        if len(trail) > 1:
            line = self._rr.LineStrips3D([np.stack(trail)], colors=[color], radii=[0.008])
            self._stream.log(entity, line)

    def _log_state(self, entry: TrackedObject) -> None:
        rr = self._rr
        first_name = f"states/track_{entry.track_id}_{entry.class_name}"
        new = entry.track_id not in self._entities
        entity = self._entities.setdefault(entry.track_id, first_name)
        if new:
            style = rr.StateConfiguration(
                values=[state.value for state in TrackState],
                labels=[state.value for state in TrackState],
                colors=[int(STATE_COLORS[state][1:] + "ff", 16) for state in TrackState],
            )
            self._stream.log(entity, style, static=True)
        if self._states.get(entry.track_id) is not entry.state:
            self._stream.log(entity, rr.StateChange(state=entry.state.value))
            self._states[entry.track_id] = entry.state

    def _blueprint(self) -> Any:
        rrb = self._rr.blueprint
        world = rrb.Spatial3DView(origin="world", name="World")
        color = rrb.Spatial2DView(
            origin="world/camera", name="Colour", contents=["$origin/color", "world/boxes"]
        )
        depth = rrb.Spatial2DView(origin="world/camera/depth", name="Depth")
        states = rrb.StateTimelineView(origin="states", name="States")
        images = rrb.Vertical(color, depth, states)
        return rrb.Blueprint(rrb.Horizontal(world, images, column_shares=[3, 2]))


def _encoded(image: np.ndarray, kind: str) -> bytes:
    data = io.BytesIO()
    Image.fromarray(image).save(data, kind, quality=_JPEG_QUALITY)
    return data.getvalue()
