"""ROS recordings for tests, written by the rosbags library."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

KINDS = ("bag", "mcap", "sqlite3")


@dataclass
class Recording:
    """Messages to be written: (topic, seconds of recording, kind, fields)."""

    kind: str
    messages: list[tuple[str, float, Any]] = field(default_factory=list)

    def __post_init__(self) -> None:
        store = Stores.ROS1_NOETIC if self.kind == "bag" else Stores.ROS2_HUMBLE
        self.store = get_typestore(store)
        if self.kind == "bag":
            transforms = "geometry_msgs/TransformStamped[] transforms"
            self.store.register(get_types_from_msg(transforms, "tf2_msgs/msg/TFMessage"))

    def new(self, name: str, **fields: Any) -> Any:
        """A message of that type."""
        return self.store.types[name](**fields)

    def header(self, time_s: float, frame: str) -> Any:
        seconds = int(time_s)
        stamp = self.new(
            "builtin_interfaces/msg/Time",
            sec=seconds,
            nanosec=int(np.rint(1e9 * (time_s - seconds))),
        )
        more = {"seq": 0} if self.kind == "bag" else {}
        return self.new("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **more)

    def image(
        self, topic: str, time_s: float, frame: str, pixels: np.ndarray, encoding: str, late_s=0.0
    ) -> None:
        """A plain image; pixels (H, W) or (H, W, C)."""
        height, width = pixels.shape[:2]
        data = np.frombuffer(np.ascontiguousarray(pixels).tobytes(), np.uint8)
        message = self.new(
            "sensor_msgs/msg/Image",
            header=self.header(time_s, frame),
            height=height,
            width=width,
            encoding=encoding,
            is_bigendian=int(pixels.dtype.byteorder == ">"),
            step=len(data) // height,
            data=data,
        )
        self.messages.append((topic, time_s + late_s, message))

    def packed(self, topic: str, time_s: float, frame: str, data: bytes, format: str) -> None:
        """A compressed image."""
        message = self.new(
            "sensor_msgs/msg/CompressedImage",
            header=self.header(time_s, frame),
            format=format,
            data=np.frombuffer(data, np.uint8),
        )
        self.messages.append((topic, time_s, message))

    def info(
        self,
        topic: str,
        frame: str,
        K: np.ndarray,
        size: tuple[int, int],
        P: np.ndarray | None = None,
        lens: Sequence[float] = (0.0,) * 5,
    ) -> None:
        """What a camera says of itself."""
        named = str.upper if self.kind == "bag" else str.lower
        P = np.hstack([K, np.zeros((3, 1))]) if P is None else P
        numbers = {"d": np.array(lens), "k": K.ravel(), "r": np.eye(3).ravel(), "p": P.ravel()}
        message = self.new(
            "sensor_msgs/msg/CameraInfo",
            header=self.header(0.0, frame),
            width=size[0],
            height=size[1],
            distortion_model="plumb_bob",
            binning_x=0,
            binning_y=0,
            roi=self.new(
                "sensor_msgs/msg/RegionOfInterest",
                x_offset=0,
                y_offset=0,
                height=0,
                width=0,
                do_rectify=False,
            ),
            **{named(key): value.astype(float) for key, value in numbers.items()},
        )
        self.messages.append((topic, 0.0, message))

    def transform(
        self, time_s: float, parent: str, child: str, T: np.ndarray, topic: str = "/tf"
    ) -> None:
        """T_parent_child, (4, 4)."""
        x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat()
        stamped = self.new(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(time_s, parent),
            child_frame_id=child,
            transform=self.new(
                "geometry_msgs/msg/Transform",
                translation=self.new("geometry_msgs/msg/Vector3", x=T[0, 3], y=T[1, 3], z=T[2, 3]),
                rotation=self.new("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
            ),
        )
        message = self.new("tf2_msgs/msg/TFMessage", transforms=[stamped])
        self.messages.append((topic, time_s, message))

    def text(self, topic: str, data: str) -> None:
        self.messages.append((topic, 0.0, self.new("std_msgs/msg/String", data=data)))

    def write(self, folder: Path, name: str = "robot", topics: Iterable[str] | None = None) -> Path:
        """The recording's file (`.bag`) or folder."""
        path = folder / (f"{name}.bag" if self.kind == "bag" else name)
        if self.kind == "bag":
            writer: Any = Writer1(path)
        else:
            plugin = StoragePlugin.MCAP if self.kind == "mcap" else StoragePlugin.SQLITE3
            writer = Writer2(path, version=9, storage_plugin=plugin)
        pack = self.store.serialize_ros1 if self.kind == "bag" else self.store.serialize_cdr
        with writer:
            connections = {}
            for topic, time_s, message in sorted(self.messages, key=lambda m: m[1]):
                kind = message.__msgtype__
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=self.store)
                writer.write(connections[topic], int(np.rint(1e9 * time_s)), pack(message, kind))
        return path


def png(pixels: np.ndarray) -> bytes:
    """The bytes of an image file."""
    out = BytesIO()
    Image.fromarray(pixels).save(out, "PNG")
    return out.getvalue()


def rvl(pixels: np.ndarray) -> bytes:
    """Depth compressed by RVL, by the paper's words: groups of three bits, one after the other."""
    groups: list[int] = []

    def write(number: int) -> None:
        while number > 7:
            groups.append(8 | number & 7)
            number >>= 3
        groups.append(number)

    rest, before = pixels.ravel().tolist(), 0
    while rest:
        without = next((i for i, depth in enumerate(rest) if depth), len(rest))
        measured = rest[without:]
        count = next((i for i, depth in enumerate(measured) if not depth), len(measured))
        write(without)
        write(count)
        for depth in measured[:count]:
            step, before = depth - before, depth
            write(2 * step if step >= 0 else -2 * step - 1)
        rest = measured[count:]
    groups += [0] * (-len(groups) % 8)
    words = [
        int("".join(f"{g:x}" for g in groups[i : i + 8]), 16) for i in range(0, len(groups), 8)
    ]
    height, width = pixels.shape
    return np.array([width, height, *words], "<u4").tobytes()


def packed_depth(
    pixels: np.ndarray,
    scale: float = 0.0,
    offset: float = 0.0,
    compressed: Callable[[np.ndarray], bytes] = png,
) -> bytes:
    """As `compressedDepth` sends it."""
    numbers = np.array([scale, offset], "<f4").tobytes()
    return bytes(4) + numbers + compressed(pixels)
