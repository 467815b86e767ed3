"""Tracks, frames and reconstructions made by hand, for tests of what a user sees."""

from __future__ import annotations

import numpy as np

from composenet.geometry.transform import make_T, rotation_z
from composenet.records import Box, Camera, Frame, Similarity, TrackedObject, TrackState

CAMERA = Camera(K=np.array([[60.0, 0, 39.5], [0, 60.0, 29.5], [0, 0, 1]]), width=80, height=60)
# camera at the world's origin, 1 m up, looking along +x
LOOK_X = make_T(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), np.array([0.0, 0, 1]))


def centres() -> np.ndarray:
    """(64, 64, 64, 3) canonical cell centres."""
    axis = (np.arange(64) + 0.5) / 64 - 0.5
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)


def box_grid(extents_m: np.ndarray) -> np.ndarray:
    """Canonical reconstruction of a full box: (64, 64, 64) float32."""
    half = extents_m / np.linalg.norm(extents_m) / 2
    return (np.abs(centres()) <= half).all(axis=-1).astype(np.float32)


def make_object(
    track_id: int = 1,
    frame_index: int = 0,
    state: TrackState = TrackState.TRACKED,
    center: tuple[float, float, float] = (3.0, 0.0, 1.0),
    yaw: float = 0.3,
    extents: tuple[float, float, float] = (0.6, 1.2, 0.8),
) -> TrackedObject:
    R, extents_m, t = rotation_z(yaw), np.array(extents), np.array(center)
    return TrackedObject(
        track_id=track_id,
        frame_index=frame_index,
        class_id=track_id % 10,
        state=state,
        confidence=0.8,
        box=Box(t, np.abs(R) @ extents_m),
        S_world_canonical=Similarity(float(np.linalg.norm(extents_m)), R, t),
        extents_m=extents_m,
        observed=state in (TrackState.TRACKED, TrackState.RE_FOUND),
    )


def make_frame(index: int = 0, depth: float = 5.0, color: bool = True) -> Frame:
    image = np.full((60, 80, 3), 90, dtype=np.uint8) if color else None
    depth_m = np.full((60, 80), depth, dtype=np.float32)
    return Frame(index, depth_m, CAMERA, LOOK_X, image, timestamp_s=index / 30, name=f"{index:06d}")
