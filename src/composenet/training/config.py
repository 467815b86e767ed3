"""Parameters of training."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Annotated, Literal, cast

from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from composenet.config import Config, Count, Positive, Share, load

_STRICT = ConfigDict(extra="forbid", allow_inf_nan=False)
Weight = Annotated[float, Field(ge=0)]

Parts = Literal["all", "apart", "detector", "boxes", "objects"]
"""What of the network a run trains (`TrainingConfig.parts`)."""


@dataclass(frozen=True, config=_STRICT)
class LossWeights:
    """Weights of the losses [paper, where it gives one]."""

    objectness: Weight = 1.0
    center: Weight = 0.1
    extent: Weight = 0.1
    classes: Weight = 1.0
    completion: Weight = 4.0
    overlap: Weight = 1.0
    correspondence: Weight = 4.0
    rotation: Weight = 0.2
    translation: Weight = 0.1
    scale: Weight = 0.1
    fit_place: Weight = 2.0
    box: Weight = 1.0
    place: Weight = 2.0
    quality: Weight = 1.0
    box_class: Weight = 1.0
    heading: Weight = 1.0


@dataclass(frozen=True, config=_STRICT)
class TrainingConfig:
    """One training run. The learning rate is constant after a warm-up and falls to a hundredth
    over the last decay_share of --max-minutes, so that every run ends with usable weights and can
    be continued."""

    model: Config = Config()
    weights: LossWeights = LossWeights()
    batch_frames: Count = 2
    """[paper]"""
    learning_rate: Positive = 2e-3
    """the paper's 1e-3 learns slower in runs this short"""
    weight_decay: Weight = 0.0
    """in Adam's gradient; the paper's 1e-5 silenced a third of the channels (`training.silent`)"""
    rate_warmup_steps: Count = 200
    decay_share: Share = 0.35
    parts: Parts = "all"
    """what learns; `apart` is all of it, but the voxel features learn nothing from the object
    network; the detector alone costs a fifth of a whole step on a CPU, and the second look at boxes
    alone, or the object network alone, sees voxel features that are held fixed"""
    joint_from_step: Annotated[int, Field(ge=0)] = 3200
    """until then the object network learns on jittered true boxes with the features held fixed,
    afterwards end to end and on the detector's own proposals too (the paper's two stages)"""
    max_crops: Count = 4
    """objects a frame that are completed and posed (paper: up to 10 proposals)"""
    gradient_clip: Positive = 5.0
    ema_decay: Share = 0.999
    frames_per_scene: Count = 16
    min_visible_pixels: Count = 50
    """objects with fewer are no target"""
    seed: Annotated[int, Field(ge=0)] = 0
    """runs of different seeds meet different scenes"""


def training_config(source: Path) -> TrainingConfig:
    """A configuration of the package by its name (`paper`), or that of a JSON file.

    Raises ConfigError.
    """
    shipped = Path(str(resources.files("composenet") / "configs" / f"{source.name}.json"))
    named = source == Path(source.name) and shipped.is_file()
    return cast(TrainingConfig, load(shipped if named else source, TrainingConfig))
