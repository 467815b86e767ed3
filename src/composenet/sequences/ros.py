"""ROS recordings: `.bag` of ROS 1, of ROS 2 `.mcap`, `.db3` or a folder with `metadata.yaml`; also
what a RealSense camera's own software records.

```
depth      sensor_msgs/Image (16UC1, mono16: millimetres, 32FC1: metres) or CompressedImage
colour     likewise, rgb8, bgr8, rgba8, bgra8 or a JPEG or PNG; at most 0.02 s apart
camera     sensor_msgs/CameraInfo of the depth image
poses      tf: where the depth image's frame is in the world, interpolated
```
Times are those of the images' headers.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from composenet.errors import SequenceError
from composenet.sequences import ros_bag
from composenet.sequences.registration import ColorCamera
from composenet.sequences.ros_bag import Bag, BagImage
from composenet.sequences.ros_transforms import Transforms, is_world_name, name, seconds
from composenet.sequences.source import (
    Source,
    SourceFrame,
    checked_K,
    posed,
    read_gravity,
    without_colour,
)
from composenet.sequences.stamps import MAX_GAP_S, paired_or_nearest

SUFFIXES = (".bag", ".mcap", ".db3")
_MILLIMETRE = 1e-3
_UNITS = re.compile("/option/Depth[_ ]Units/value$")  # of RealSense's software
_ON_COLOUR = re.compile("aligned|registered|depth_to_(color|rgb)")
_RECTIFIED = re.compile("(^|[/_])rect")
_OTHER_IMAGES = re.compile(
    "(^|[/_])(ir|infra|infrared|thermal|confidence|amplitude|intensity|label|segment)"
)
_INFO = re.compile("(/info)?/[^/]*$")  # what stands after the camera's name
_NO_FRAME = ("", "0")  # RealSense's software wrote "0" for all cameras


def matches(path: Path) -> bool:
    """Whether it is called as ROS recordings are."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file()
    return path.is_file() and path.suffix in SUFFIXES


def read_source(path: Path, depth_topic: str | None = None) -> Source:
    """The recording. depth_topic: of which camera, by default the one that suits best. Raises
    SequenceError, and ConfigError where the library for it is not installed."""
    bag, warnings = Bag(path), list[str]()
    topic = _depth_topic(bag, depth_topic, warnings)
    color_topic = _color_topic(bag, topic)
    images = _images(bag, topic, color_topic, warnings)
    if not images[topic]:
        raise SequenceError(f"{path}: no depth image of {topic} can be read")
    transforms = _transforms(bag, topic, warnings)
    camera = name(bag.first(topic).header.frame_id)
    K, units_m = _intrinsics(bag, topic, warnings), _depth_units_m(bag, topic)
    frames = [
        SourceFrame(index, f"{stamp_s:.6f}", depth, timestamp_s=stamp_s)
        for index, (stamp_s, depth) in enumerate(images[topic])
    ]
    color_camera = None
    if color_topic:
        frames = _coloured(frames, images[color_topic])
        color_camera = _color_camera(bag, transforms, camera, color_topic)
        warnings += without_colour(frames, f"{color_topic} has none within {MAX_GAP_S} s of them")
    has_poses = transforms.is_world(camera)
    if has_poses:
        frames = [_with_pose(frame, transforms, camera) for frame in frames]
    warnings += _world_notes(transforms, camera)
    return Source(
        path=path,
        frames=tuple(frames),
        has_poses=has_poses,
        K=K,
        intrinsics_file=f"a camera_info topic beside {topic}, of images of that size",
        poses_file=f"tf, from a world to {camera!r}",
        depth_scale=1 / units_m,
        color_camera=color_camera,
        gravity=read_gravity(path if path.is_dir() else path.parent),
        warnings=tuple(warnings),
    )


def _images(
    bag: Bag, topic: str, color_topic: str | None, warnings: list[str]
) -> dict[str, list[tuple[float, BagImage]]]:
    """Of both topics times and images, in order of time."""
    found: dict[str, list[tuple[float, BagImage]]] = {t: [] for t in (topic, color_topic) if t}
    try:
        for of, time_ns, message in bag.messages(list(found)):
            alike = [image for _, image in found[of][-1:] if image.time_ns == time_ns]
            number = alike[0].number + 1 if alike else 0
            stamp_s = seconds(message.header.stamp) or 1e-9 * time_ns
            image = BagImage(bag, of, time_ns, number, ros_bag.known_size(message))
            found[of].append((stamp_s, image))
    except SequenceError as error:
        warnings.append(f"{error}: what comes before is taken")
    return {of: sorted(images, key=lambda image: image[0]) for of, images in found.items()}


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
    """The depth images that are asked for. By default such as are called so; of these those which
    the driver has brought onto the colour images, else rectified ones; not compressed ones."""
    found = _image_topics(bag, ros_bag.is_depth)
    if wanted is not None:
        if wanted in found:
            return wanted
        raise SequenceError(
            f"{bag.path}: no depth images of {wanted}; there are {_listed(found or ['none'])}"
        )
    called = [topic for topic in found if not _OTHER_IMAGES.search(topic.lower())]
    if not called:
        kinds = sorted({type for type in bag.topics.values()})
        raise SequenceError(
            f"{bag.path}: no topic with depth images ({', '.join(ros_bag.DEPTH_ENCODINGS)}) in it, "
            f"only {_listed(found) or _listed(kinds) or 'nothing'}"
            + ("; --depth-topic takes one of them all the same" if found else "")
        )

    def worth(topic: str) -> tuple[bool, bool, bool, bool, bool, int]:
        low, plain = topic.lower(), bag.topics[topic] == ros_bag.IMAGE
        on_colour, rectified = bool(_ON_COLOUR.search(low)), bool(_RECTIFIED.search(low))
        by_name = topic.endswith("/compressedDepth")
        return "depth" in low, on_colour, rectified, plain, by_name, -len(topic)

    best = max(called, key=worth)
    others = [topic for topic in called if _camera_of(topic) != _camera_of(best)]
    if others:
        warnings.append(f"depth of {best} is taken; --depth-topic chooses {_listed(others)}")
    elif "depth" not in best.lower():
        warnings.append(f"16-bit images of {best} are taken for depth")
    return best


def _color_topic(bag: Bag, depth_topic: str) -> str | None:
    """Of the camera whose name is most like that of the depth images; rectified if there are such,
    not compressed ones."""

    def worth(topic: str) -> tuple[int, bool, bool]:
        plain = bag.topics[topic] == ros_bag.IMAGE
        return _shared(depth_topic, topic), bool(_RECTIFIED.search(topic.lower())), plain

    return max(_image_topics(bag, ros_bag.is_color), key=worth, default=None)


def _camera_of(topic: str) -> str:
    """The topic without how its images are sent."""
    return topic.removesuffix("/compressedDepth").removesuffix("/compressed")


def _shared(topic: str, other: str) -> int:
    """How many parts of two topics' names are the same from their beginning."""
    pairs = zip(topic.split("/"), other.split("/"), strict=False)
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))


def _listed(names: list[str]) -> str:
    return ", ".join(names[:6]) + (f" and {len(names) - 6} more" if len(names) > 6 else "")


# --- camera and transforms ------------------------------------------------------------------


def _intrinsics(bag: Bag, topic: str, warnings: list[str]) -> NDArray[np.float64] | None:
    """Of a topic's images: K, or of rectified ones that of the projection. None where no camera
    has its name or frame and images of its size."""
    image = bag.first(topic)
    frame, size = name(image.header.frame_id), ros_bag.known_size(image)
    found: list[tuple[int, str, Any]] = []
    for other, type in sorted(bag.topics.items()):
        if type != ros_bag.CAMERA_INFO:
            continue
        with suppress(SequenceError):
            info, shared = bag.first(other), _shared(topic, other)
            beside = shared >= len(_INFO.sub("", other).split("/"))
            same = frame not in _NO_FRAME and name(info.header.frame_id) == frame
            if (beside or same) and size in (None, (info.width, info.height)):
                found.append((shared, other, info))
    if not found:
        return None
    _, info_topic, info = max(found, key=lambda entry: entry[0])
    K, P = _numbers(info, "k").reshape(3, 3), _numbers(info, "p").reshape(3, 4)
    lens = np.abs(_numbers(info, "d"))
    if _RECTIFIED.search(topic.lower()) and P[0, 0] > 0:
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


def _numbers(info: Any, letter: str) -> NDArray[np.float64]:
    """A field of a camera's message, whose name is a capital in ROS 1."""
    return np.array(getattr(info, letter if hasattr(info, letter) else letter.upper()), float)


def _depth_units_m(bag: Bag, topic: str) -> float:
    """Metres a step of 16-bit depth: millimetres, but for what RealSense's software says."""
    told = sorted(t for t in bag.topics if _UNITS.search(t))
    units = max(told, key=lambda t: _shared(topic, t), default=None)
    if units is None:
        return _MILLIMETRE
    try:
        metres = float(bag.first(units).data)
    except (ValueError, SequenceError):
        return _MILLIMETRE
    return metres if 1e-6 < metres < 1 else _MILLIMETRE


def _transforms(bag: Bag, depth_topic: str, warnings: list[str]) -> Transforms:
    """Those of the robot whose name the depth images share, which may be none."""
    topics = [t for t, type in bag.topics.items() if type in ros_bag.TRANSFORMS]
    most = max((_shared(depth_topic, t) for t in topics), default=0)
    topics = [t for t in topics if _shared(depth_topic, t) == most]

    def told() -> Iterator[tuple[Any, bool]]:
        try:
            for topic, _, message in bag.messages(topics):
                for stamped in message.transforms:
                    yield stamped, topic.endswith("static")
        except SequenceError as error:
            warnings.append(f"{error}: transforms before that are taken")

    return Transforms(told())


def _with_pose(frame: SourceFrame, transforms: Transforms, camera: str) -> SourceFrame:
    assert frame.timestamp_s is not None
    T = transforms.T_root_frame(camera, frame.timestamp_s)
    lacking = "" if T is not None else transforms.lacking(camera, frame.timestamp_s)
    return posed(frame, T, f"no transform {lacking} at that time")


def _world_notes(transforms: Transforms, camera: str) -> list[str]:
    """What is taken for the world where that is not sure."""
    root = transforms.root(camera)
    if not transforms.moves(camera) or is_world_name(root):
        return []
    if transforms.is_world(camera):
        return [f"{root!r}, in which transforms place the camera, is taken for the world"]
    return [
        f"the camera's place, {camera!r}, is known in {root!r} alone, which by its name is a part "
        "of what carries it, and not the world"
    ]


# --- colour ---------------------------------------------------------------------------------


def _color_camera(
    bag: Bag, transforms: Transforms, depth_frame: str, color_topic: str
) -> ColorCamera | None:
    """Where the recording says that it is another; else None."""
    header = bag.first(color_topic).header
    color_frame, K = name(header.frame_id), _intrinsics(bag, color_topic, [])
    if K is None or color_frame in (*_NO_FRAME, depth_frame):
        return None
    T_color_depth = transforms.T_between(color_frame, depth_frame, seconds(header.stamp))
    return None if T_color_depth is None else ColorCamera(K, T_color_depth)


def _coloured(frames: list[SourceFrame], colors: list[tuple[float, BagImage]]) -> list[SourceFrame]:
    """The frames, each with the colour image of its time."""
    at_s = np.array([frame.timestamp_s for frame in frames])
    places = paired_or_nearest(at_s, np.array([stamp_s for stamp_s, _ in colors]))
    return [
        replace(frame, color=colors[place][1] if place >= 0 else None)
        for frame, place in zip(frames, places, strict=True)
    ]
