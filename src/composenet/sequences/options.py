"""What a user may say about a recording that the recording does not say itself."""

from __future__ import annotations

from typing import Annotated

from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass
from tyro.constructors import PrimitiveConstructorSpec

from composenet.config import Count, Positive

Intrinsics = tuple[float, float, float, float]


def _parse(words: list[str]) -> Intrinsics:
    try:
        fx, fy, cx, cy = (float(word) for word in words[0].split(","))
    except ValueError:
        raise ValueError(f"{words[0]!r}: expected four numbers, fx,fy,cx,cy") from None
    return fx, fy, cx, cy


_COMMA_SEPARATED = PrimitiveConstructorSpec(
    nargs=1,
    metavar="FX,FY,CX,CY",
    instance_from_str=_parse,
    is_instance=lambda value: value is None or (isinstance(value, tuple) and len(value) == 4),
    str_from_instance=lambda value: [",".join(map(str, value)) if value else "None"],
)


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class SequenceOptions:
    """How to read a recording."""

    intrinsics: Annotated[Intrinsics | None, _COMMA_SEPARATED] = None
    """focal lengths and principal point of the depth images on disk, pixels; overrides the file"""
    depth_scale: Positive | None = None
    """depth units a metre: 1000 for millimetres; default: the format's own"""
    max_depth_m: Positive = 10.0
    """depth beyond this is no measurement; the tracker's own limit is volume.max_depth_m (5.5)"""
    odometry: bool = False
    """camera poses from the images themselves, not from the recording (needs
    composenet[odometry])"""
    levelled: bool = False
    """the world of the recording's poses has z up and its floor at z = 0: it is left so, where
    else the floor is sought in the images"""
    depth_topic: str | None = None
    """of a ROS recording: the depth images to use; default: those that lie on the colour images,
    else rectified ones"""
    max_width: Annotated[Count, Field(ge=16)] = 480
    """wider depth images are subsampled by the smallest whole factor that fits"""
