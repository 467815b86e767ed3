"""ROS recordings: `.bag` of ROS 1, of ROS 2 `.mcap`, `.db3` or a folder with `metadata.yaml`; also
what a RealSense camera's own software records.

```
depth      sensor_msgs/Image (16UC1, mono16: millimetres, 32FC1: metres) or CompressedImage
colour     likewise, rgb8, bgr8, rgba8, bgra8 or a JPEG or PNG; nearest in time, at most 0.02 s
camera     sensor_msgs/CameraInfo of the depth image
poses      tf: where the depth image's frame is in the world, interpolated
```
Times are those of the images' headers.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from composenet.errors import SequenceError
from composenet.records import FloatArray
from composenet.sequences import ros_bag
from composenet.sequences.images import ImageSource
from composenet.sequences.registered import RegisteredColor
from composenet.sequences.ros_bag import Bag, BagImage
from composenet.sequences.ros_transforms import Transforms, name, seconds
from composenet.sequences.source import (
    Source,
    SourceFrame,
    checked_K,
    posed,
    read_gravity,
    without_colour,
)
from composenet.sequences.tum import MAX_GAP_S, nearest

SUFFIXES = (".bag", ".mcap", ".db3")
_UNITS = "/option/Depth_Units/value"  # of RealSense's software
_MILLIMETRE = 1e-3
_ON_COLOUR = re.compile("aligned|registered")


def matches(path: Path) -> bool:
    """Whether it is called as ROS recordings are."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file()
    return path.is_file() and path.suffix.lower() in SUFFIXES


def read_source(path: Path, depth_topic: str | None = None) -> Source:
    """The recording. depth_topic: of which camera, by default the one that suits best. Raises
    SequenceError, and ConfigError where the library for it is not installed."""
    bag, warnings = Bag(path), list[str]()
    topic = _depth_topic(bag, depth_topic, warnings)
    color_topic = _nearest_topic(topic, _image_topics(bag, ros_bag.is_color))
    images = _images(bag, topic, color_topic, warnings)
    if not images[topic]:
        raise SequenceError(f"{path}: no depth image of {topic} can be read")
    transforms = _transforms(bag, warnings)
    camera = name(bag.first(topic).header.frame_id)
    K, units_m = _intrinsics(bag, topic, warnings), _depth_units_m(bag, topic)
    frames = [
        SourceFrame(index, f"{stamp_s:.6f}", depth, timestamp_s=stamp_s)
        for index, (stamp_s, depth) in enumerate(images[topic])
    ]
    if color_topic:
        registration = _registration(bag, transforms, camera, color_topic, K, units_m)
        frames = _coloured(frames, images[color_topic], color_topic, registration, warnings)
    has_poses = transforms.is_world(camera)
    if has_poses:
        frames = [_with_pose(frame, transforms, camera) for frame in frames]
    elif transforms.moves(camera):
        warnings.append(
            f"the camera's place, {camera!r}, is known in {transforms.root(camera)!r} alone, which "
            "by its name is a part of what carries it, and not the world"
        )
    return Source(
        path=path,
        frames=tuple(frames),
        has_poses=has_poses,
        K=K,
        intrinsics_file=f"a camera_info topic beside {topic}",
        poses_file=f"tf, from a world to {camera!r}",
        depth_scale=1 / units_m,
        gravity=read_gravity(path.parent),
        warnings=tuple(warnings),
    )


def _images(
    bag: Bag, topic: str, color_topic: str | None, warnings: list[str]
) -> dict[str, list[tuple[float, BagImage]]]:
    """Of both topics times and images, in order of time."""
    found: dict[str, list[tuple[float, BagImage]]] = {t: [] for t in (topic, color_topic) if t}
    try:
        for of, time_ns, message in bag.messages(list(found)):
            try:
                size = ros_bag.image_size(message)
            except SequenceError:
                size = (0, 0)  # what is wrong with it is said when it is read
            alike = [image for _, image in found[of][-1:] if image.time_ns == time_ns]
            number = alike[0].number + 1 if alike else 0
            stamp_s = seconds(message.header.stamp) or 1e-9 * time_ns
            found[of].append((stamp_s, BagImage(bag, of, time_ns, number, size)))
    except SequenceError as error:
        warnings.append(f"{error}: what comes before is taken")
    return {of: sorted(images, key=lambda image: image[0]) for of, images in found.items()}


def _with_pose(frame: SourceFrame, transforms: Transforms, camera: str) -> SourceFrame:
    assert frame.timestamp_s is not None
    T = transforms.T_root_frame(camera, frame.timestamp_s)
    return posed(frame, T, f"no transform from {transforms.root(camera)!r} to it at that time")


# --- topics ---------------------------------------------------------------------------------


def _image_topics(bag: Bag, kind: Callable[[Any], bool]) -> list[str]:
    """Topics whose first image is of that kind."""
    found = []
    for topic, type in sorted(bag.topics.items()):
        if type in (ros_bag.IMAGE, ros_bag.COMPRESSED):
            with suppress(SequenceError):  # none of its images can be read
                if kind(bag.first(topic)):
                    found.append(topic)
    return found


def _depth_topic(bag: Bag, wanted: str | None, warnings: list[str]) -> str:
    """The depth images that are asked for. By default those which the driver has brought onto the
    colour images, else rectified ones; of these such as are not compressed."""
    found = _image_topics(bag, ros_bag.is_depth)
    if wanted is not None:
        if wanted in found:
            return wanted
        raise SequenceError(
            f"{bag.path}: no depth images of {wanted}; there are {_listed(found or ['none'])}"
        )
    if not found:
        kinds = sorted({type for type in bag.topics.values()})
        raise SequenceError(
            f"{bag.path}: no topic with depth images ({', '.join(ros_bag.DEPTH_ENCODINGS)}) in it, "
            f"only {_listed(kinds) or 'nothing'}"
        )

    def worth(topic: str) -> tuple[bool, bool, bool, int]:
        compressed = bag.topics[topic] == ros_bag.COMPRESSED
        return bool(_ON_COLOUR.search(topic)), "rect" in topic, not compressed, -len(topic)

    best = max(found, key=worth)
    others = [topic for topic in found if _camera_of(topic) != _camera_of(best)]
    if others:
        warnings.append(f"depth of {best} is taken; --depth-topic chooses {_listed(others)}")
    return best


def _camera_of(topic: str) -> str:
    """The topic without how its images are sent."""
    return topic.removesuffix("/compressedDepth").removesuffix("/compressed")


def _listed(names: list[str]) -> str:
    return ", ".join(names[:6]) + (f" and {len(names) - 6} more" if len(names) > 6 else "")


def _nearest_topic(topic: str, others: list[str]) -> str | None:
    """Of these the one that shares the most of the topic's name from its beginning."""

    def shared(other: str) -> int:
        pairs = list(zip(topic.split("/"), other.split("/"), strict=False))
        return next((k for k, (a, b) in enumerate(pairs) if a != b), len(pairs))

    compressed = "/compressed"
    return max(others, key=lambda o: (shared(o), not o.endswith(compressed)), default=None)


# --- camera and transforms ------------------------------------------------------------------


def _intrinsics(bag: Bag, topic: str, warnings: list[str]) -> NDArray[np.float64] | None:
    """Of a topic's images: K, or of rectified ones that of the projection."""
    infos = [t for t, type in bag.topics.items() if type == ros_bag.CAMERA_INFO]
    info_topic = _nearest_topic(topic, sorted(infos))
    if info_topic is None:
        return None
    info = bag.first(info_topic)
    K = np.array(info.k if hasattr(info, "k") else info.K, float).reshape(3, 3)
    P = np.array(info.p if hasattr(info, "p") else info.P, float).reshape(3, 4)
    lens = np.abs(np.array(info.d if hasattr(info, "d") else info.D, float))
    if "rect" in topic and P[0, 0] > 0:
        K = P[:, :3]
    elif lens.size and lens.max() > 1e-3:
        warnings.append(
            f"{info_topic} says that the lens distorts {topic}, which is left as it is: "
            "rectified images are better"
        )
    try:
        return checked_K(bag.path, K)
    except SequenceError:
        return None


def _depth_units_m(bag: Bag, topic: str) -> float:
    """Metres a step of 16-bit depth: millimetres, but for what RealSense's software says."""
    told = [t for t in bag.topics if t.endswith(_UNITS)]
    units = _nearest_topic(topic, told)
    if units is None:
        return _MILLIMETRE
    try:
        metres = float(bag.first(units).data)
    except ValueError:
        return _MILLIMETRE
    return metres if 1e-6 < metres < 1 else _MILLIMETRE


def _transforms(bag: Bag, warnings: list[str]) -> Transforms:
    topics = [t for t, type in bag.topics.items() if type in ros_bag.TRANSFORMS]
    told = []
    try:
        for topic, _, message in bag.messages(topics):
            told += [(stamped, topic.endswith("static")) for stamped in message.transforms]
    except SequenceError as error:
        warnings.append(f"{error}: transforms before that are taken")
    return Transforms(told)


# --- colour ---------------------------------------------------------------------------------

Registration = Callable[[ImageSource, BagImage], ImageSource]
"""Brings a colour image onto a depth image."""


def _registration(
    bag: Bag,
    transforms: Transforms,
    depth_frame: str,
    color_topic: str,
    K_depth: FloatArray | None,
    units_m: float,
) -> Registration | None:
    """How it is done, None where the recording does not say how the cameras stand."""
    header = bag.first(color_topic).header
    color_frame = name(header.frame_id)
    if color_frame and color_frame == depth_frame:
        return lambda depth, color: color
    T_color_depth = transforms.T_between(color_frame, depth_frame, seconds(header.stamp))
    K_color = _intrinsics(bag, color_topic, [])
    if T_color_depth is None or K_color is None or K_depth is None:
        return None
    return lambda depth, color: RegisteredColor(
        depth, color, K_depth, K_color, T_color_depth, units_m
    )


def _coloured(
    frames: list[SourceFrame],
    colors: list[tuple[float, BagImage]],
    topic: str,
    registration: Registration | None,
    warnings: list[str],
) -> list[SourceFrame]:
    """The frames, each with the colour image nearest in time."""
    if registration is None:
        warnings.append(
            f"colour of {topic} is left out: its images are not those of the depth camera, and "
            "nothing says how the two cameras stand to each other"
        )
        return frames
    at_s = np.array([frame.timestamp_s for frame in frames])
    places = nearest(at_s, np.array([stamp_s for stamp_s, _ in colors]))
    coloured = [
        replace(frame, color=registration(frame.depth, colors[place][1]))
        if place >= 0 and frame.depth is not None
        else frame
        for frame, place in zip(frames, places, strict=True)
    ]
    warnings += without_colour(coloured, f"{topic} has none within {MAX_GAP_S} s of them")
    return coloured
