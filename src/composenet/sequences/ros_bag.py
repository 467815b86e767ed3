"""Messages of a ROS recording (ROS 1 or 2), by the rosbags library; images in them."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from io import BytesIO
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from composenet.errors import ConfigError, SequenceError
from composenet.sequences import rvl

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
DEPTH_ENCODINGS = ("16UC1", "mono16", "32FC1")
_COLOR_CHANNELS = {"rgb8": (0, 1, 2), "bgr8": (2, 1, 0), "8UC3": (2, 1, 0)}
_COLOR_CHANNELS |= {"rgba8": (0, 1, 2), "bgra8": (2, 1, 0), "8UC4": (2, 1, 0)}
_DEPTH_MODES = ("I;16", "I;16B", "I", "F")
_PNG = b"\x89PNG"
_HEADER_BYTES = 12  # of compressedDepth: a number, and two by which 32FC1 is made of 16 bits


class Bag:
    """A recording whose messages are read in any order."""

    def __init__(self, path: Path) -> None:
        """Raises ConfigError where the library is not installed, SequenceError where it cannot
        read the file."""
        try:
            from rosbags.highlevel import AnyReader
            from rosbags.typesys import Stores, get_typestore
        except ImportError:
            raise ConfigError(
                f"{path}: reading ROS recordings needs rosbags: install it with "
                "`pip install 'composenet[ros]'`"
            ) from None
        self.path = path
        self._lock = Lock()
        try:
            store = get_typestore(Stores.ROS2_HUMBLE)  # for recordings without message types
            self._reader = AnyReader([path], default_typestore=store)
            self._reader.open()
        except Exception as error:  # of many kinds on corrupt bytes
            advice = (
                "one that was cut short can be mended by `rosbag reindex` or `ros2 bag reindex`"
            )
            if "open database" in str(error) and set("#?%") & set(str(path.absolute())):
                advice = "a .db3 file is not found where its path has '#', '?' or '%': rename it"
            raise SequenceError(
                f"{path}: not a ROS recording that can be read ({_said(error)}); {advice}"
            ) from None

    @cached_property
    def topics(self) -> dict[str, str]:
        """Types of messages by topic, of topics that have any."""
        return {c.topic: c.msgtype for c in self._reader.connections if c.msgcount}

    def messages(
        self, topics: Collection[str], start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[tuple[str, int, Any]]:
        """(topic, time of recording, message) in the order of these times, from start_ns until
        before stop_ns, for one thread at a time. Raises SequenceError from the first that cannot
        be read on."""
        chosen = [c for c in self._reader.connections if c.topic in topics]
        if not chosen:
            return
        try:
            for connection, time_ns, data in self._reader.messages(chosen, start_ns, stop_ns):
                message = self._reader.deserialize(data, connection.msgtype)
                yield connection.topic, time_ns, message
        except Exception as error:  # of many kinds on corrupt bytes
            raise SequenceError(f"{self.path}: damaged ({_said(error)})") from None

    def first(self, topic: str) -> Any:
        """The topic's first message. Raises SequenceError."""
        for _, _, message in self.messages([topic]):
            return message
        raise SequenceError(f"{self.path}: no message of {topic} can be read")

    def at(self, topic: str, time_ns: int) -> list[Any]:
        """The topic's messages of that time of recording. Threads take turns. Raises
        SequenceError."""
        with self._lock:
            return [message for *_, message in self.messages([topic], time_ns, time_ns + 1)]


def _said(error: Exception) -> str:
    words = " ".join(str(error).split())
    return f"{type(error).__name__}: {words[:120]}" if words else type(error).__name__


@dataclass(frozen=True)
class BagImage:
    """An image message. time_ns: when it was recorded, number: which of those of that time.
    known_size: width, height; None where the image cannot be read."""

    bag: Bag
    topic: str
    time_ns: int
    number: int
    known_size: tuple[int, int] | None

    def open(self) -> Image.Image:
        """Depth as 16 bits, in the recording's units or millimetres; else colour. Raises
        SequenceError."""
        messages = self.bag.at(self.topic, self.time_ns)
        if self.number >= len(messages):
            raise SequenceError("image is missing")
        message = messages[self.number]
        return decoded(message) if _is_plain(message) else unpacked(message)


def is_depth(message: Any) -> bool:
    """Whether the image message holds depth, or 16 bits that may be depth."""
    if _is_plain(message):
        return message.encoding in DEPTH_ENCODINGS
    if _is_rvl(message):
        return True
    with suppress(SequenceError):
        return _packed_image(message)[0].mode in _DEPTH_MODES
    return False


def is_color(message: Any) -> bool:
    """Whether the image message holds colour that can be read."""
    if _is_plain(message):
        return message.encoding in _COLOR_CHANNELS
    if _is_rvl(message):
        return False
    with suppress(SequenceError):
        return _packed_image(message)[0].mode in ("RGB", "RGBA", "P")
    return False


def known_size(message: Any) -> tuple[int, int] | None:
    """(width, height) of an image message, None where it cannot be read."""
    if _is_plain(message):
        return int(message.width), int(message.height)
    with suppress(SequenceError):
        if _is_rvl(message):
            return rvl.size(bytes(message.data[_HEADER_BYTES:]))
        return _packed_image(message)[0].size
    return None


def _is_plain(message: Any) -> bool:
    return hasattr(message, "encoding")


def _is_rvl(message: Any) -> bool:
    return "rvl" in message.format.lower()


def decoded(message: Any) -> Image.Image:
    """A plain image message. Raises SequenceError."""
    kind = message.encoding
    depth = kind in DEPTH_ENCODINGS
    if not depth and kind not in _COLOR_CHANNELS:
        raise SequenceError(f"image is encoded as {kind!r}, which cannot be read")
    size = {"32FC1": 4, "16UC1": 2, "mono16": 2}.get(kind, 4 if "4" in kind or "a8" in kind else 3)
    try:
        step = message.step or size * message.width
        rows = np.asarray(message.data, np.uint8).reshape(message.height, step)
        pixels = np.ascontiguousarray(rows[:, : size * message.width])
        if pixels.shape[1] < size * message.width:
            raise SequenceError("image is truncated or corrupt")
        if not depth:
            channels = pixels.reshape(message.height, message.width, size)
            return Image.fromarray(channels[..., list(_COLOR_CHANNELS[kind])])
        order = ">" if message.is_bigendian else "<"
        if kind == "32FC1":
            return _millimetres(pixels.view(f"{order}f4"))
        return Image.fromarray(pixels.view(f"{order}u2").astype(np.uint16))
    except (ValueError, TypeError):
        raise SequenceError("image is truncated or corrupt") from None


def unpacked(message: Any) -> Image.Image:
    """A compressed image message. Raises SequenceError."""
    image, quantised = _packed_image(message)
    try:
        if image.mode == "F":
            return _millimetres(np.array(image))
        if not (quantised and message.format.startswith("32FC1")):
            return image
        scale, offset = np.frombuffer(bytes(message.data[4:_HEADER_BYTES]), "<f4")
        steps = np.array(image, np.float32)
        with np.errstate(divide="ignore", invalid="ignore"):
            return _millimetres(np.where(steps > 0, scale / (steps - offset), 0.0))
    except (ValueError, OSError):
        raise SequenceError("image is truncated or corrupt") from None


def _packed_image(message: Any) -> tuple[Image.Image, bool]:
    """The file within the message, its header read, and whether what `compressedDepth` adds stands
    before it. Raises SequenceError."""
    data = bytes(message.data)
    if _is_rvl(message):
        return Image.fromarray(rvl.decoded(data[_HEADER_BYTES:])), True
    added = data[_HEADER_BYTES:].startswith(_PNG) and not data.startswith(_PNG)
    try:
        return Image.open(BytesIO(data[_HEADER_BYTES if added else 0 :])), added
    except Exception:  # decoders raise many kinds on corrupt bytes
        raise SequenceError("image is corrupt or of an unknown kind") from None


def _millimetres(depth_m: NDArray) -> Image.Image:
    """16 bits of it, 0 where nothing was measured."""
    known = np.isfinite(depth_m) & (depth_m > 0) & (depth_m < 65.534)
    return Image.fromarray(np.rint(np.where(known, depth_m, 0.0) * 1000).astype(np.uint16))
