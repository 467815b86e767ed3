"""The algorithm on one page: frame -> volume -> proposals -> objects -> tracks."""

from __future__ import annotations

import re
import time
import warnings
from collections.abc import Hashable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch

from composenet.config import Config, TrackingConfig, from_dict, to_dict
from composenet.detection import Proposals, propose, remembered, second_look
from composenet.errors import ConfigError, SequenceError
from composenet.network.batch import VolumeBatch, collate
from composenet.network.detection_head import VoxelFields
from composenet.network.model import ComposeNet
from composenet.network.weights import default_weights, load_weights
from composenet.objects import estimate_objects
from composenet.records import FloatArray, Frame, ObjectEstimate, Track, TrackedObject
from composenet.sequences.checks import WorldCheck
from composenet.tracking.tracker import Tracker
from composenet.volume.memory import Memory
from composenet.volume.voxels import Volume, voxelize


@dataclass(frozen=True)
class FrameResult:
    """What one frame gave. objects: every living track that is sure enough to be told of;
    estimates: the posed detections of the frame; timings_ms: by stage; doubt: what the user should
    know of the recording, said once, with the frame that gives reason to it."""

    objects: tuple[TrackedObject, ...]
    estimates: tuple[ObjectEstimate, ...]
    timings_ms: dict[str, float]
    doubt: str | None = None


@dataclass(frozen=True)
class Scene:
    """What the network makes of one frame before it looks at single objects."""

    volume: Volume
    batch: VolumeBatch
    fields: VoxelFields
    proposals: Proposals


@dataclass(frozen=True)
class Sight:
    """One frame as it looks whatever is tracked: trackers of one recording that differ only in
    config.tracking can share it. scene: None where the frame shows nothing. surface: (M, 3) points
    in the world, all surface that it and the frames before it saw and that it does not contradict.
    looked_at: posed detections and timings of the trackers that have followed, by what they asked
    for. doubt: of FrameResult."""

    frame: Frame
    scene: Scene | None
    surface: FloatArray
    timings_ms: dict[str, float]
    looked_at: dict[Hashable, tuple[tuple[ObjectEstimate, ...], dict[str, float]]]
    doubt: str | None = None


class ObjectTracker:
    """Tracks the furniture of one recording, frame by frame, looking at nothing to come."""

    def __init__(self, network: ComposeNet, config: Config, device: torch.device) -> None:
        self.network, self.config, self.device = network, config, device
        self._memory = Memory(config.volume.memory_frames)
        self._tracker = Tracker(config.tracking, config.volume.max_depth_m)
        self._world = WorldCheck()
        self._pose_known: bool | None = None  # whether the frames so far are in one world

    def __call__(self, frame: Frame) -> FrameResult:
        """Detect, complete, pose and associate the objects of the next frame. Raises SequenceError
        for a frame that does not come after the one before. Warns, once a process, where the
        frames' world seems not to have z up and its floor at z = 0; `doubt` says so always."""
        result = self.follow(self.look(frame))
        if result.doubt:
            warnings.warn(result.doubt, stacklevel=2)
        return result

    @torch.inference_mode()
    def look(self, frame: Frame) -> Sight:
        """The first half: volume, voxel fields, proposals. Raises SequenceError as `follow` does,
        before the frame leaves anything behind."""
        self._tracker.expect(frame.index)
        self._expect_one_kind(frame)
        doubt = self._world(frame)
        clock = _Clock(self.device)
        with clock("volume"):
            volume = voxelize(frame, self.config.volume, memory=self._memory)
        if volume is None:
            return Sight(frame, None, self._memory.surface.points, clock.milliseconds, {}, doubt)
        batch = collate([volume]).to(self.device)
        with clock("backbone"):
            fields = self.network.voxel_fields(batch)
        with clock("proposals"):
            (proposals,) = propose(fields, batch, self.config.detection)
        scene = Scene(volume, batch, fields, proposals)
        return Sight(frame, scene, self._memory.surface.points, clock.milliseconds, {}, doubt)

    def follow(self, sight: Sight) -> FrameResult:
        """The second half: a closer look at every proposal and at where tracks were last, their
        completion and pose, and the association with the tracks."""
        clock = _Clock(self.device)
        estimates, timings_ms = self._estimates(sight)
        with clock("association"):
            objects = self._tracker.update(sight.frame, estimates, sight.surface)
        timings_ms = sight.timings_ms | timings_ms | clock.milliseconds
        return FrameResult(objects, estimates, timings_ms, sight.doubt)

    def _expect_one_kind(self, frame: Frame) -> None:
        """Raises SequenceError for a frame whose world is unknown among others, or the reverse:
        tracks cannot be carried from one to the other."""
        if self._pose_known not in (None, frame.pose_known):
            raise SequenceError(
                f"frame {frame.index}: pose_known is {frame.pose_known}, but {self._pose_known} in "
                "the frames before; leave frames whose pose is not known out"
            )
        self._pose_known = frame.pose_known

    @torch.inference_mode()
    def _estimates(self, sight: Sight) -> tuple[tuple[ObjectEstimate, ...], dict[str, float]]:
        scene, detection = sight.scene, self.config.detection
        if scene is None:
            return (), {}
        last = self._tracker.boxes if detection.use_tracks else ()
        places = tuple((*box.center.tolist(), *box.extents.tolist()) for box in last)
        asked = (places, self.config.tracking.use_completion)
        if asked not in sight.looked_at:
            clock = _Clock(self.device)
            with clock("boxes"):
                found = scene.proposals
                found += remembered(last, scene.volume, found, detection)
                (proposals,) = second_look(
                    self.network, scene.fields, scene.batch, (found,), detection
                )
            with clock("objects"):
                estimates = estimate_objects(
                    self.network, scene.fields, scene.batch, scene.volume, proposals, self.config
                )
            sight.looked_at[asked] = estimates, clock.milliseconds
        return sight.looked_at[asked]

    @property
    def looks_twice(self) -> bool:
        """Whether `turn_back` is wanted: looking back on a recording of which it remembers more
        than one frame."""
        return self.config.tracking.offline and self.config.volume.memory_frames > 0

    def turn_back(self) -> None:
        """After the last frame: the recording is looked at once more, from its end to its start,
        with what volume.memory_frames around showed. Give the frames again in reverse; what is then
        said of a frame, and `tracks`, takes the place of what was said before. Raises SequenceError
        the second time."""
        self._tracker.turn_back()

    def tracks(self) -> tuple[Track, ...]:
        """All identities so far, as they were told of; with tracking.offline linked over the whole
        recording (the paper's second pass)."""
        return self._tracker.tracks()

    def restart(self, **tracking: Any) -> ObjectTracker:
        """A tracker for another recording with the same network. Keywords replace fields of
        config.tracking. Raises ConfigError."""
        changed = from_dict({**to_dict(self.config.tracking), **tracking}, TrackingConfig)
        return ObjectTracker(self.network, replace(self.config, tracking=changed), self.device)


def load_tracker(
    weights: Path | str | None = None,
    *,
    device: str = "auto",
    config: Config | None = None,
    **tracking: Any,
) -> ObjectTracker:
    """Tracker with the shipped weights or those of a file.

    device: "auto", "cpu", "cuda" or "cuda:N". config replaces the weights' own parameters
    (sizes of the network must agree); further keywords replace fields of config.tracking, such
    as use_completion=False. Raises WeightsError or ConfigError.
    """
    chosen = select_device(device)
    network, own, _ = load_weights(Path(weights) if weights else default_weights(), chosen)
    if config is not None and _learned_with(config) != _learned_with(own):
        raise ConfigError(
            "config.network, volume.voxel_size_m or volume.truncation_m does not fit the weights; "
            "leave them as the weights have them"
        )
    return ObjectTracker(network, config or own, chosen).restart(**tracking)


def _learned_with(config: Config) -> tuple[object, ...]:
    """What the weights are made for."""
    network = config.network
    return (
        network.backbone_channels,
        network.backbone_blocks,
        network.object_channels,
        network.crop_cells,
        network.crop_margin,
        config.volume.voxel_size_m,
        config.volume.truncation_m,
    )


def select_device(name: str) -> torch.device:
    """The torch device; "auto" takes CUDA where there is one. Raises ConfigError."""
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    if not re.fullmatch(r"cpu|cuda(:\d+)?", name):
        raise ConfigError(f"--device {name!r}: expected auto, cpu, cuda or cuda:N")
    device = torch.device(name)
    if device.type == "cuda" and (device.index or 0) >= torch.cuda.device_count():
        found = torch.cuda.device_count()
        raise ConfigError(f"--device {name}: this machine has {found} CUDA devices; use another")
    return device


class _Clock:
    """Milliseconds by stage."""

    def __init__(self, device: torch.device) -> None:
        self.milliseconds: dict[str, float] = {}
        self._device = device

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        if self._device.type == "cuda":
            torch.cuda.synchronize(self._device)
        self.milliseconds[stage] = 1e3 * (time.perf_counter() - start)
