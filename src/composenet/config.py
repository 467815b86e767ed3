"""All parameters, as frozen dataclasses: validated, written beside every result.

Values marked [paper] are those of Mueller et al., CVPR 2021.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import ConfigDict, Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from composenet.errors import ConfigError
from composenet.files import write_atomic

_STRICT = ConfigDict(extra="forbid", allow_inf_nan=False)
Positive = Annotated[float, Field(gt=0)]
Share = Annotated[float, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=1)]


@dataclass(frozen=True, config=_STRICT)
class VolumeConfig:
    """How a frame becomes a volume."""

    voxel_size_m: Positive = 0.05
    """edge of a surface voxel, metres"""
    max_depth_m: Positive = 5.5
    """depth beyond this is dropped, and what was remembered there while it is in view"""
    min_pixels: Count = 2
    """a voxel hit by fewer depth pixels is noise"""
    truncation_m: Positive = 0.15
    """truncation of the signed distance field"""
    memory_frames: Annotated[int, Field(ge=0, le=2**30 - 1)] = 900
    """surfaces that none of the last so many frames saw are forgotten; 0: each frame alone
    [paper]"""
    memory_reach_m: Positive = 3.0
    """how far beyond the bounds of what is seen the remembered surface is looked at"""


@dataclass(frozen=True, config=_STRICT)
class NetworkConfig:
    """Sizes of the network."""

    backbone_channels: tuple[Count, ...] = (16, 48, 64, 96, 128)
    """channels at strides 1, 2, 4, 8, 16 (bottleneck 1/16 [paper])"""
    backbone_blocks: tuple[Count, ...] = (1, 1, 2, 2, 2)
    """residual blocks at each stride, before and again after the bottleneck"""
    object_channels: tuple[Count, Count, Count] = (24, 48, 96)
    """channels of the object network at 1/2, 1/4, 1/8 of the crop"""
    crop_cells: Annotated[int, Field(ge=8, multiple_of=8)] = 32
    """cells a side of the fixed grid each box is sampled on; halved three times"""
    crop_margin: Annotated[float, Field(ge=1)] = 1.25
    """the crop is the proposal grown by this factor"""
    occupancy_threshold: Annotated[float, Field(gt=0, lt=1)] = 0.4
    """a cell counts as filled from this probability on"""


@dataclass(frozen=True, config=_STRICT)
class DetectionConfig:
    """Proposals from voxel predictions."""

    use_tracks: bool = True
    """look again where tracks were last; False: each frame finds its objects alone [paper]"""
    objectness_threshold: Share = 0.5
    mean_shift_steps: Count = 20
    """[paper]"""
    mean_shift_radius_voxels: Positive = 5.0
    """the paper's 8 merges neighbours"""
    min_cluster_voxels: Count = 20
    """smaller clusters are dropped; the paper's 50 drop most objects of few pixels"""
    max_proposals: Count = 30
    min_score: Share = 0.3
    """a cluster of less mean objectness, and a box of less quality, is dropped"""
    duplicate_iou: Share = 0.25
    """of two corrected boxes that overlap more than this, the weaker is dropped"""


@dataclass(frozen=True, config=_STRICT)
class TrackingConfig:
    """Association over time."""

    use_correspondences: bool = True
    """second pass by canonical IoU; False is the paper's "no corr." """
    use_completion: bool = True
    """False: only observed cells carry geometry; the paper's "no compl." """
    box_iou_gate: Share = 0.3
    """a proposal continues a track whose box it overlaps by this much [paper]"""
    same_class_iou_gate: Share = 0.02
    """by this much where both are of one class; 0.3: as the others [paper]"""
    kept_place_share: Share = 0.3
    """and only if the proposal holds this share of the surface remembered in the track's box, where
    else the track's object still stands; 0: whatever stands there [paper]"""
    canonical_iou_gate: Share = 0.3
    """[paper]"""
    running_mean_weight: Positive = 4.0
    """old : new = 4 : 1 [paper]"""
    min_score: Share = 0.3
    """a weaker proposal is left out of tracking"""
    min_birth_score: Share = 0.5
    """a weaker proposal may continue a track but starts none"""
    min_confidence: Share = 0.7
    """a track is told of from the frame on in which its confidence reaches this"""
    keep_confidence: Share = 0.7
    """until it is seen with less confidence than this, or than min_confidence if that is lower"""
    duplicate_iou: Share = 0.25
    """of two proposals of one class whose boxes overlap more than this, the weaker is dropped; one
    in the place of a track counts as stronger"""
    max_speed_m_per_frame: Positive = 0.35
    """the canonical pass matches nothing that would have moved faster than this"""
    reach_slack_m: Positive = 0.3
    """added to that way: noise of the centres"""
    max_reach_m: Positive = 1.2
    """no canonical match is farther from the last place, however long ago it was"""
    still_share: Share = 0.04
    """a centre that moves by less than this share of its box's horizontal diagonal stands still,
    and its boxes are averaged"""
    steady_weight: Positive = 3.0
    """the boxes before weigh together at most as much as this many certain ones"""
    expected_visible_share: Share = 0.5
    """an unseen track with less of its surface in open view is occluded, else lost"""
    occluded_decay: Share = 0.98
    """factor on the confidence for each frame that a track is occluded"""
    lost_decay: Share = 0.9
    """factor on the confidence for each frame that a track is lost"""
    end_after_frames: Count = 900
    """a track unseen for this many tracked frames has ended"""
    end_after_visible_misses: Count = 30
    """a track unseen for this many tracked frames in which it should have been visible has ended"""
    offline: bool = False
    """look back from the end of the recording: where camera poses are known and surfaces are
    remembered at every frame once more, with what all others saw, and over all tracks in the
    paper's second pass"""


@dataclass(frozen=True, config=_STRICT)
class Config:
    """Everything needed to track a recording."""

    volume: VolumeConfig = VolumeConfig()
    network: NetworkConfig = NetworkConfig()
    detection: DetectionConfig = DetectionConfig()
    tracking: TrackingConfig = TrackingConfig()


def to_dict(config: Any) -> dict[str, Any]:
    """Plain dictionary of any configuration dataclass."""
    return dataclasses.asdict(config)


def flat(data: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested names joined by dots."""
    result: dict[str, Any] = {}
    for name, value in data.items():
        nested = isinstance(value, Mapping)
        result |= flat(value, f"{prefix}{name}.") if nested else {prefix + name: value}
    return result


def from_dict(data: dict[str, Any], kind: type = Config) -> Any:
    """Validated configuration of the given kind.

    Raises ConfigError naming the field, what it holds and what was expected.
    """
    try:
        return TypeAdapter(kind).validate_python(data)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise ConfigError(f"configuration field {where!r}: {first['msg']}") from None


def load(path: Path | str, kind: type = Config) -> Any:
    """Configuration from a JSON file. Raises ConfigError naming it."""
    try:
        data = json.loads(Path(path).read_text())
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: not a readable JSON configuration ({error})") from None
    try:
        return from_dict(data, kind)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None


def dump(config: Any, path: Path) -> None:
    """Write the configuration as JSON, whole or not at all. Raises DataError."""
    write_atomic(path, (json.dumps(to_dict(config), indent=2) + "\n").encode())
