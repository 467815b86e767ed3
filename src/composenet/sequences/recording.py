"""Any recording as a lazy sequence of levelled frames."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from composenet.errors import SequenceError
from composenet.geometry.camera import subsample_camera, subsampled
from composenet.geometry.transform import apply_T, inverse_T
from composenet.records import Camera, Frame
from composenet.sequences import checks
from composenet.sequences.formats import read_source
from composenet.sequences.images import ImageSource, image_size, read_color, read_depth
from composenet.sequences.leveling import (
    CAMERA_UP,
    CameraLeveler,
    level_world,
    merge,
    surface_of,
)
from composenet.sequences.odometry import Odometry
from composenet.sequences.options import SequenceOptions
from composenet.sequences.registration import ColorCamera, find_color_camera
from composenet.sequences.source import Source, SourceFrame, counted, make_K

_SAMPLES = 16  # frames that the depth's scale, the up direction and the floor are taken from
_SOON = (3, 12)  # so many frames on, by its length, depth must still fit by the poses
Watch = Callable[[Sequence[SourceFrame]], Iterable[SourceFrame]]


class RecordedSequence:
    """Frames of a recording, read one at a time; made by `open_sequence`.

    name: the folder's, or the file's without its suffix. camera: of the frames yielded (after
    subsampling). has_poses: False where every frame is in its camera's own levelled frame.
    own_poses: whether the poses are the recording's, not those of odometry. T_level_source: (4, 4),
    maps the world of the poses (with odometry that of the first frame) to the levelled one;
    identity without poses. Iterate as often as wanted; frames come in order, `Frame.index` counts
    the recording's frames, skipped ones included.
    """

    def __init__(
        self,
        source: Source,
        options: SequenceOptions,
        stride: int,
        max_frames: int | None,
        watch: Watch = iter,
    ) -> None:
        path = source.path.resolve()
        self.name = path.stem if path.is_file() else path.name
        source = source.without_poses() if options.odometry else source
        self.own_poses = source.has_poses
        self.has_poses = self.own_poses or options.odometry
        self._source, self._options = source, options
        self._skipped: dict[int, tuple[str, str]] = {}
        self._colorless: dict[int, tuple[str, str]] = {}
        if options.levelled and not self.own_poses:
            raise SequenceError(
                f"{source.path}: --levelled tells of the world of the recording's poses, and "
                + ("--odometry does without" if options.odometry else "it has none")
            )
        self._depth_scale = options.depth_scale or source.depth_scale
        usable = (frame for frame in source.frames[::stride] if self._usable(frame))
        self._frames = list(islice(usable, max_frames))
        soon = max(_SOON[0], min(_SOON[1], stride * len(self._frames) // 4))
        self._soon = max(1, soon // stride)
        full = self._common_camera()
        self._factor = math.ceil(full.width / options.max_width)
        self.camera = subsample_camera(full, self._factor)
        self._full = full
        self._notes = [*source.warnings, *checks.camera_notes(full)]
        self._color_camera = self._find_color_camera()
        if options.odometry:
            self._follow_camera(watch)
        self._drop_lost_cameras()
        self._notes += checks.check_steps(source.path, self._frames)
        samples = self._read_samples()
        self._notes += checks.check_depth(source.path, samples, self._depth_scale)
        self._notes += checks.pose_notes(self._pairs(samples), self.camera)
        self._level(samples)

    def __len__(self) -> int:
        """Number of frames that iteration tries; unreadable images found on the way are fewer."""
        return len(self._frames)

    @property
    def recorded(self) -> int:
        """Number of frames that the recording has, skipped ones and those between strides included:
        every `Frame.index` is below it."""
        return len(self._source.frames)

    def __iter__(self) -> Iterator[Frame]:
        """Frames in order. Raises SequenceError when not one of them could be read."""
        return self._read(self._frames)

    def __reversed__(self) -> Iterator[Frame]:
        """The same frames from the last to the first. Raises SequenceError as above, and for a
        recording without poses, whose frames are levelled one after the other."""
        if not self.has_poses:
            raise SequenceError(f"{self._source.path}: without poses frames come in order only")
        return self._read(self._frames[::-1])

    def _read(self, entries: Sequence[SourceFrame]) -> Iterator[Frame]:
        leveler = self._camera_leveler
        found = False
        for entry in entries:
            try:
                depth_m = self._read_depth_m(entry)
            except SequenceError as error:
                self._skip(entry, str(error))
                continue
            if self.has_poses:
                assert entry.T_source_camera is not None
                T_world_camera = self.T_level_source @ entry.T_source_camera
            else:
                leveler, T_world_camera = leveler.level(surface_of(depth_m, self.camera))
            found = True
            yield Frame(
                index=entry.index,
                depth_m=depth_m,
                camera=self.camera,
                T_world_camera=T_world_camera,
                color=self._read_color(entry, depth_m),
                timestamp_s=entry.timestamp_s,
                name=entry.name,
                pose_known=self.has_poses,
            )
        if not found:
            raise self._nothing_left()

    def odometry(self) -> Odometry:
        """What finds its camera's way, knowing how well colour lies on the depth images. Raises
        ConfigError where its library is not installed."""
        found_by_edges = self._color_camera is not None and self._source.color_camera is None
        return Odometry(rough_color=found_by_edges)

    @property
    def skipped(self) -> list[tuple[str, str]]:
        """(frame name, reason) of every frame left out so far, in order."""
        return [self._skipped[index] for index in sorted(self._skipped)]

    @property
    def skipped_indices(self) -> tuple[int, ...]:
        """`Frame.index` that each of these would have, in order."""
        return tuple(sorted(self._skipped))

    @property
    def warnings(self) -> list[str]:
        """What a user should know, one line each: doubts, and counts of what was left out."""
        lines = list(self._notes)
        for what, entries in (("skipped", self._skipped), ("without colour", self._colorless)):
            for reason in dict.fromkeys(reason for _, reason in entries.values()):
                names = [entries[i][0] for i in sorted(entries) if entries[i][1] == reason]
                lines.append(counted(names, f"{what}: {reason}"))
        return lines

    def _usable(self, frame: SourceFrame) -> bool:
        if frame.problem:
            self._skip(frame, frame.problem)
        return not frame.problem

    def _skip(self, frame: SourceFrame, reason: str) -> None:
        self._skipped[frame.index] = (frame.name, reason)

    def _common_camera(self) -> Camera:
        """The camera of the commonest depth size; frames of another size are skipped."""
        sizes: dict[int, tuple[int, int]] = {}
        for frame in self._frames:
            try:
                assert frame.depth is not None
                sizes[frame.index] = image_size(frame.depth)
            except SequenceError as error:
                self._skip(frame, f"depth {error}")
        if not sizes:
            raise self._nothing_left()
        (width, height), _ = Counter(sizes.values()).most_common(1)[0]
        for frame in self._frames:
            w, h = sizes.get(frame.index, (width, height))
            if (w, h) != (width, height):
                self._skip(frame, f"depth is {w}x{h}, the others are {width}x{height}")
        self._frames = [frame for frame in self._frames if frame.index not in self._skipped]
        given = self._options.intrinsics
        K = self._source.K if given is None else make_K(*given)
        return checks.check_camera(self._source, K, width, height)

    def _follow_camera(self, watch: Watch) -> None:
        """Give every frame a pose by odometry; the frames where it loses the camera are skipped.
        Where more frames are left than it has placed, as after a first one of a hand, it begins
        anew with them, and what places most is kept."""
        checks.check_depth(self._source.path, self._read_samples(), self._depth_scale)
        most, left = list[SourceFrame](), self._frames
        while len(left) > len(most):
            posed, left = self._followed(watch(left))
            most = max(most, posed, key=len)
        placed = {frame.index for frame in most}
        for frame in self._frames:
            if frame.index not in placed and frame.index not in self._skipped:
                reason = "odometry lost the camera: it shows too little of what was seen"
                self._skip(frame, reason)
        if not most:
            raise self._nothing_left()
        self._frames = most
        self._notes.append("camera poses are from odometry, which drifts")

    def _followed(
        self, frames: Iterable[SourceFrame]
    ) -> tuple[list[SourceFrame], list[SourceFrame]]:
        """The frames that odometry places, with their poses, and those after the last of them; none
        where it places none. What cannot be read is skipped."""
        odometry, followed, before = self.odometry(), list[SourceFrame](), None
        for frame in frames:
            try:
                depth_m = self._read_depth_m(frame)
                anew = frame.color != before  # one that comes twice would say that nothing moved
                color, before = self._read_color(frame, depth_m) if anew else None, frame.color
                odometry(depth_m, self.camera, color)
            except SequenceError as error:
                self._skip(frame, str(error))
            else:
                followed.append(frame)
        way = odometry.way()
        placed = [place for place, T in enumerate(way) if T is not None]
        posed = [replace(followed[place], T_source_camera=way[place]) for place in placed]
        return posed, followed[placed[-1] + 1 :] if placed else []

    def _drop_lost_cameras(self) -> None:
        for frame in checks.lost_cameras(self._source.path, self._frames):
            self._skip(frame, f"camera is over {checks.MAX_SPAN_M:,.0f} m from the others")
        self._frames = [frame for frame in self._frames if frame.index not in self._skipped]

    def _read_samples(self) -> dict[int, NDArray[np.float32]]:
        """Depth of up to 16 readable frames spread over the recording, by place in it."""
        places = np.linspace(0, len(self._frames) - 1, min(_SAMPLES, len(self._frames)))
        samples = {}
        for place in np.round(places).astype(int):
            try:
                samples[int(place)] = self._read_depth_m(self._frames[place], far_m=np.inf)
            except SequenceError as error:
                self._skip(self._frames[place], str(error))
        if not samples:
            raise self._nothing_left()
        return samples

    def _pairs(
        self, samples: dict[int, NDArray[np.float32]]
    ) -> Iterator[tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float64]]]:
        """Samples and the depth soon after each, with T_later_earlier; none without poses or where
        they are known to be right."""
        if not self._source.has_poses or self._source.levelled:
            return
        for place, depth_m in samples.items():
            if place + self._soon >= len(self._frames):
                continue
            earlier, later = self._frames[place], self._frames[place + self._soon]
            assert earlier.T_source_camera is not None and later.T_source_camera is not None
            try:
                later_m = self._read_depth_m(later, far_m=np.inf)
            except SequenceError as error:
                self._skip(later, str(error))
                continue
            yield depth_m, later_m, inverse_T(later.T_source_camera) @ earlier.T_source_camera

    def _level(self, samples: dict[int, NDArray[np.float32]]) -> None:
        surfaces = {place: surface_of(depth, self.camera) for place, depth in samples.items()}
        self.T_level_source = np.eye(4)
        self._camera_leveler = CameraLeveler()
        if not self.has_poses:
            self._notes.append(
                "no camera poses: every frame is tracked in its camera's own levelled frame, "
                "so objects at rest move when the camera does; poses belong in "
                f"{self._source.poses_file}, or --odometry finds them"
            )
            if self._source.gravity is not None:
                self._notes.append("the direction of gravity is of no use without camera poses")
            self._camera_leveler = CameraLeveler.from_samples(list(surfaces.values()))
        elif not self._source.levelled:
            T_source = np.stack([f.T_source_camera for f in self._frames])  # type: ignore[misc]
            T_near_source, notes = checks.nearer(T_source[:, :3, 3])
            self._notes += notes
            if self._options.levelled:
                self.T_level_source = T_near_source
                return
            T_all = T_near_source @ T_source
            merged = merge([s.moved(T_all[p]) for p, s in surfaces.items()])
            up = (T_all[:, :3, :3] @ CAMERA_UP).mean(axis=0)
            may_stand = checks.may_stand_on(float(np.median(T_source[:, 2, 3])))
            own_floor_m = float(T_near_source[2, 3]) if may_stand and self.own_poses else None
            gravity = self._source.gravity
            T_level_near, notes = level_world(merged, up, gravity, own_floor_m)
            self._notes += notes
            centers = apply_T(T_level_near, T_all[:, :3, 3])
            self._notes += checks.floor_notes(centers, gravity is not None)
            if gravity is None:
                self._notes += checks.upright_notes(T_all)
            self.T_level_source = T_level_near @ T_near_source

    def _read_depth_m(self, frame: SourceFrame, far_m: float | None = None) -> NDArray[np.float32]:
        """Depth (H, W), metres, subsampled, 0 beyond `far_m`. Raises SequenceError with the
        reason alone."""
        assert frame.depth is not None
        try:
            raw = read_depth(frame.depth)
        except SequenceError as error:
            raise SequenceError(f"depth {error}".replace("depth depth", "depth")) from None
        if raw.shape != (self._full.height, self._full.width):
            raise SequenceError("depth image changed its size while it was read")
        depth_m = subsampled(raw, self._factor).astype(np.float32)
        depth_m /= self._depth_scale
        depth_m[depth_m > (self._options.max_depth_m if far_m is None else far_m)] = 0
        if not depth_m.any():
            raise SequenceError("depth image holds no measurement")
        return depth_m

    def _read_color(
        self, frame: SourceFrame, depth_m: NDArray[np.float32]
    ) -> NDArray[np.uint8] | None:
        """Colour (H, W, 3) of a frame's depth image; None where there is none that can be read."""
        rgb = self._read_stretched(frame)
        if rgb is None or self._color_camera is None:
            return rgb
        return self._color_camera.onto(rgb, depth_m, self.camera)

    def _read_stretched(self, frame: SourceFrame) -> NDArray[np.uint8] | None:
        """The colour image stretched to the depth's size; None likewise."""
        if frame.color is None:
            return None
        try:
            return read_color(frame.color, self.camera.width, self.camera.height)
        except SequenceError as error:
            self._colorless[frame.index] = (frame.name, str(error))
            return None

    def _find_color_camera(self) -> ColorCamera | None:
        """The camera of colour images that are of another, as the recording or, with a note, their
        edges say."""
        files = [frame.color for frame in self._frames if frame.color is not None]
        if self._source.levelled or not files:
            return None
        size = next(filter(None, map(_size_if_readable, files)), None)
        if size is None:
            return None
        to = (self.camera.width, self.camera.height)
        if self._source.color_camera is not None:
            return self._source.color_camera.stretched(size, to)
        images = []
        for place, depth_m in self._read_samples().items():
            rgb = self._read_stretched(self._frames[place])
            if rgb is not None:
                depth_m[depth_m > self._options.max_depth_m] = 0
                images.append((depth_m, rgb))
        found = find_color_camera(images, self.camera, size[0] * to[1] / (size[1] * to[0]))
        if found is not None:
            off = found.pixels_off(self.camera) * self._factor
            self._notes.append(
                f"colour is of another camera, up to {off:.0f} pixels off: it is brought onto the "
                "depth images as its edges say"
            )
        return found

    def _nothing_left(self) -> SequenceError:
        name, reason = self.skipped[0]
        poses = all(reason.startswith(("pose", "no pose")) for _, reason in self.skipped)
        way_out = f"; {self._source.poses_file} expected, --odometry finds poses" if poses else ""
        return SequenceError(
            f"{self._source.path}: none of its frames can be used "
            f"({len(self._skipped)} tried; {name}: {reason}){way_out}"
        )


def _size_if_readable(source: ImageSource) -> tuple[int, int] | None:
    with suppress(SequenceError):
        return image_size(source)
    return None


def open_sequence(
    path: Path | str,
    *,
    stride: int = 1,
    max_frames: int | None = None,
    options: SequenceOptions | None = None,
    watch: Watch = iter,
) -> RecordedSequence:
    """A recording as levelled frames, whatever its format (told from what the folder holds).

    Every `stride`-th frame is read, at most `max_frames` of those that are usable. The levelled
    world is the recording's own, turned by the smallest rotation that makes it z-up and shifted
    along z so that the floor is z = 0 (rules in `leveling`); it is taken from up to 16 frames
    spread over the recording. With `options.odometry` every frame's images are read at once to find
    the camera's way; `watch` goes round them meanwhile, such as a progress bar.

    Raises SequenceError with one line that says what is missing and what to do when the
    recording cannot be used at all; single bad frames are skipped and reported in
    `warnings` and `skipped`.
    """
    path = Path(path)
    if stride < 1 or (max_frames is not None and max_frames < 1):
        raise SequenceError(f"stride {stride} and max-frames {max_frames} must be 1 or more")
    options = options or SequenceOptions()
    source = read_source(path, options.depth_topic)
    return RecordedSequence(source, options, stride, max_frames, watch)
