"""What every comparison system is given and what it returns.

A system is made for one recording and called once a frame, in order, with the frame and the
instance masks of its image; it returns every living track as the same `TrackedObject` records
as our own tracker. It never sees ground truth but what the masks hold.

**Poses.** With `Cameras.GIVEN` the frames' `T_world_camera` are the recording's own. With
`Cameras.ESTIMATED` only that of the first frame is: later frames repeat it, and the system
tracks the camera itself, in the world that the first pose fixes.

**Trajectories.** These systems see surfaces, not whole objects, so where an object's centre lies
is unknown to them. `box.center` is any point fixed to the object, carried along by the estimated
motion, and `S_world_canonical` has the rotation since the track began in `R` and the same point
in `t` (`scale_m` is the diagonal of `extents_m`, the box seen so far). The benchmark moves that
point to the true centre at the track's first frame, as the paper grants, and the estimated motion
carries it on from there: see `start_shift`. `canonical` models are the system's own affair.

**States.** Only `tracked` and `re-found` claim that the object is seen in this frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from composenet.geometry.box import OrientedBox, aabb_of_oriented
from composenet.records import FloatArray, Frame, Similarity, TrackedObject, TrackState


class Cameras(StrEnum):
    """Where camera poses come from."""

    GIVEN = "given"
    ESTIMATED = "estimated"


@dataclass(frozen=True)
class InstanceMasks:
    """Furniture in one image, M pieces, as 2D detection sees it.

    masks: (M, H, W) bool, of the depth image's size; they may overlap. class_ids: (M,) int64.
    scores: (M,) float32 in 0..1. gt_ids: (M,) int64, unique, only for systems that are told the
    true identities; else None.
    """

    masks: NDArray[np.bool_]
    class_ids: NDArray[np.int64]
    scores: FloatArray
    gt_ids: NDArray[np.int64] | None = None

    @property
    def union(self) -> NDArray[np.bool_]:
        """(H, W) bool: any furniture. The rest is what a camera may be tracked against."""
        return np.asarray(self.masks.any(axis=0))


class MaskSource(Protocol):
    """The masks of a frame: true ones, or those of a network."""

    def __call__(self, frame: Frame) -> InstanceMasks: ...


class ComparisonSystem(Protocol):
    """Tracks one recording, frame by frame, looking at nothing to come."""

    def __call__(self, frame: Frame, masks: InstanceMasks) -> tuple[TrackedObject, ...]: ...


@dataclass(frozen=True)
class Row:
    """A system of the benchmark's table.

    make: a fresh system for a recording. masks: their source for a sequence folder, and torch's
    name of the device that its network runs on. weights: of these, if it has any; the file
    is part of what made the scores. told: what of the ground truth it is given beside the start of
    each track, for the table; None if nothing. starts_at_true_centre: whether each of its tracks is
    moved so that it begins at its object's true centre, as for systems that see surfaces only.
    """

    make: Callable[[Cameras], ComparisonSystem]
    masks: Callable[[Path, str], MaskSource]
    weights: Callable[[], Path] | None = None
    told: str | None = None
    starts_at_true_centre: bool = True


def unwrapped(make: Callable[..., Any]) -> Callable[..., Any]:
    """What a `functools.partial` calls."""
    return unwrapped(make.func) if isinstance(make, partial) else make


def surface_track(
    track_id: int,
    frame_index: int,
    class_id: int,
    state: TrackState | None,
    score: float,
    T_world_body: FloatArray,
    extents_m: FloatArray,
) -> TrackedObject:
    """The entry of a track whose box is centred at its body's origin (see above). state: None
    where this frame does not show it."""
    R, t = T_world_body[:3, :3], T_world_body[:3, 3]
    return TrackedObject(
        track_id=track_id,
        frame_index=frame_index,
        class_id=class_id,
        state=state or TrackState.OCCLUDED,
        confidence=score,
        box=aabb_of_oriented(OrientedBox(t, R, extents_m)),
        S_world_canonical=Similarity(float(np.linalg.norm(extents_m)), R, t),
        extents_m=extents_m,
        observed=state is not None,
    )
