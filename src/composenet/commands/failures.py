"""Where a system fails: its worst frames, with the true and the tracked boxes drawn in."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from PIL import Image

from composenet.commands.scoring import ScoredSequence, true_cameras
from composenet.geometry.box import OrientedBox
from composenet.geometry.camera import resize_camera
from composenet.metrics.clear import FrameErrors
from composenet.metrics.evaluate import SEEN_STATES, posed_truths
from composenet.metrics.objects import PosedTruth
from composenet.records import CLASS_NAMES, Frame, TrackedObject
from composenet.sequences import open_sequence
from composenet.view.figures import ColoredBox, base_image, draw_boxes

PICTURES = 3
WIDTH = 480
LEGEND = (
    "Boxes of the ground truth are green where the object is found, yellow where it is missed, "
    "violet where it is found under a new identity, and grey where too little of it is seen to "
    "count; tracked boxes are red where MOTA counts a false positive, else blue."
)
_FOUND, _MISSED, _SWITCHED, _IGNORED = (40, 160, 70), (214, 150, 0), (160, 60, 200), (150, 150, 150)
_FALSE, _RIGHT = (214, 40, 50), (60, 110, 240)


@dataclass(frozen=True)
class Failure:
    """One frame of a sequence, and what MOTA counts against the system there."""

    folder: Path
    frame: int
    errors: FrameErrors

    @property
    def caption(self) -> str:
        """Where it is and what went wrong."""
        errors = self.errors
        counts = {
            "missed": len(errors.missed),
            "false": len(errors.false),
            "of changed identity": len(errors.switched),
        }
        wrong = ", ".join(f"{count} {name}" for name, count in counts.items() if count)
        return f"{self.folder.name}, frame {self.frame}: {wrong}"


def worst_frames(
    scored: Mapping[Path, ScoredSequence], count: int = PICTURES
) -> tuple[Failure, ...]:
    """The frames with most errors, by sequence folder: first the worst of each sequence, then the
    second worst of each, and so on; frames without errors are none."""
    ranked: list[tuple[int, Failure]] = []
    for folder, sequence in scored.items():
        failures = [Failure(folder, i, e) for i, e in enumerate(sequence.errors) if e.count]
        failures.sort(key=lambda failure: -failure.errors.count)
        ranked += enumerate(failures)
    ranked.sort(key=lambda item: (item[0], -item[1].errors.count))
    return tuple(failure for _, failure in ranked[:count])


def picture(failure: Failure, scored: ScoredSequence) -> Image.Image | None:
    """The frame's image with its boxes; None where the frame cannot be read."""
    frame = frame_of(failure.folder, failure.frame, scored)
    if frame is None:
        return None
    boxes = [
        *_true_boxes(posed_truths(scored.truth(failure.folder))[failure.frame], failure.errors),
        *_tracked_boxes(scored.tracked[failure.frame], failure.errors),
    ]
    return frame_with_boxes(frame, boxes)


def frame_of(folder: Path, index: int, scored: ScoredSequence) -> Frame | None:
    """A frame of the sequence, its camera where it truly is in the world of what was tracked; None
    where it cannot be read."""
    frame = next((frame for frame in open_sequence(folder) if frame.index == index), None)
    if frame is None:
        return None
    (T_source_camera,) = true_cameras(folder, [frame.name])
    return replace(frame, T_world_camera=scored.T_world_source @ T_source_camera)


def frame_with_boxes(frame: Frame, boxes: Sequence[ColoredBox]) -> Image.Image:
    """The frame's image, WIDTH pixels wide, with the boxes drawn in."""
    height = round(WIDTH * frame.camera.height / frame.camera.width)
    camera = resize_camera(frame.camera, WIDTH, height)
    image = Image.fromarray(base_image(frame)).resize((WIDTH, height), Image.Resampling.BICUBIC)
    draw_boxes(image, camera, frame.T_world_camera, boxes)
    return image


def _true_boxes(present: Sequence[PosedTruth], errors: FrameErrors) -> Iterator[ColoredBox]:
    for item in present:
        T, gt_id = item.placed.T_world_object, item.truth.gt_id
        box = OrientedBox(T[:3, 3], T[:3, :3], item.truth.extents_m)
        label = f"true {CLASS_NAMES[item.truth.class_id]}"
        if gt_id in errors.missed:
            yield ColoredBox(box, _MISSED, label)
        elif gt_id in errors.switched:
            yield ColoredBox(box, _SWITCHED, label)
        elif item.placed.visible_pixels > 0:
            yield ColoredBox(box, _IGNORED if item.ignored else _FOUND)


def _tracked_boxes(tracked: Sequence[TrackedObject], errors: FrameErrors) -> Iterator[ColoredBox]:
    for entry in tracked:
        S = entry.S_world_canonical
        box = OrientedBox(S.t, S.R, entry.extents_m)
        if entry.track_id in errors.false and entry.state in SEEN_STATES:
            yield ColoredBox(box, _FALSE, f"{entry.class_name} {entry.track_id}")
        elif entry.state in SEEN_STATES:
            yield ColoredBox(box, _RIGHT)
