"""Where one variant of the tracker does better or worse than another: object by object, and a
picture of the frames in which they differ most.

python benchmarks/gains.py SCORES --data DATA [--one full] [--other no-compl]
    [--image SCORES/gain.jpg] [--numbers SCORES/gain.json]

SCORES is the --out folder of `composenet eval` or `composenet bench` over DATA, with both variants.
Open only folders that you trust: what it keeps of each sequence is a pickle.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from figures import read_scores
from PIL import Image, ImageDraw

from composenet.commands.failures import Failure, picture
from composenet.commands.scoring import ScoredSequence, sequence_folders
from composenet.metrics.clear import MATCH_GATE_M
from composenet.metrics.evaluate import SEEN_STATES, bootstrap_interval, posed_truths
from composenet.metrics.objects import PosedTruth
from composenet.records import CLASS_NAMES, TrackedObject

NEAR_M = 2 * MATCH_GATE_M
"""A track of the right class this near to a missed object is one in the wrong place."""
PICTURES = 3
"""Frames shown of each kind: where the one is ahead, and where the other is."""
CAPTION_PX = 16


@dataclass(frozen=True)
class Counted:
    """One object of one frame that counts. one, other: what became of it (see `outcome`).
    off_m: (2,) how far the nearest track of its class is, NaN where there is none."""

    class_id: int
    one: str
    other: str
    off_m: tuple[float, float]


@dataclass(frozen=True)
class Difference:
    """A frame; lead: errors that the other makes more than the one."""

    folder: Path
    frame: int
    lead: int


def outcome(item: PosedTruth, scored: ScoredSequence, frame: int) -> tuple[str, float]:
    """`found`, or why the object is missed: `place` (a track of its class is near, but over the
    gate away), `class` (one of another class is within the gate), `identity` (found under a new
    one), `nothing`; and the distance of the nearest track of its class, NaN without any."""
    errors, center = scored.errors[frame], item.placed.box.center
    seen = [entry for entry in scored.tracked[frame] if entry.state in SEEN_STATES]

    def nearest(tracks: list[TrackedObject]) -> float:
        return min((float(np.linalg.norm(t.box.center - center)) for t in tracks), default=np.nan)

    of_class = nearest([entry for entry in seen if entry.class_id == item.truth.class_id])
    if item.truth.gt_id in errors.switched:
        return "identity", of_class
    if item.truth.gt_id not in errors.missed:
        return "found", of_class
    if of_class <= NEAR_M:
        return "place", of_class
    return ("class" if nearest(seen) <= MATCH_GATE_M else "nothing"), of_class


def counted_objects(folder: Path, one: ScoredSequence, other: ScoredSequence) -> Iterator[Counted]:
    """Every object-frame of a sequence that counts."""
    truth = one.truth(folder)
    for frame, present in enumerate(posed_truths(truth)):
        for item in present:
            if not item.ignored:
                a, off_a = outcome(item, one, frame)
                b, off_b = outcome(item, other, frame)
                yield Counted(item.truth.class_id, a, b, (off_a, off_b))


def differences(
    one: dict[Path, ScoredSequence], other: dict[Path, ScoredSequence]
) -> list[Difference]:
    """Frames in which the variants make not equally many errors, the largest lead first."""
    found = [
        Difference(folder, i, b.count - a.count)
        for folder in one
        for i, (a, b) in enumerate(zip(one[folder].errors, other[folder].errors, strict=True))
        if a.count != b.count
    ]
    return sorted(found, key=lambda difference: -difference.lead)


def shown(ordered: list[Difference]) -> list[Difference]:
    """The best frame of each of the first sequences."""
    first: dict[Path, Difference] = {}
    for difference in ordered:
        first.setdefault(difference.folder, difference)
    return list(first.values())[:PICTURES]


def summary(items: list[Counted], leads: list[Difference]) -> dict[str, object]:
    """Plain numbers: what became of the objects, by class and reason, and how far off they are."""
    both = [item.off_m for item in items if item.one == item.other == "found"]
    medians = np.median(np.array(both).reshape(-1, 2), axis=0) if both else (np.nan, np.nan)
    only_one = [item for item in items if item.one == "found" != item.other]
    only_other = [item for item in items if item.other == "found" != item.one]

    def by(parts: list[str]) -> dict[str, int]:
        return dict(sorted(Counter(parts).items()))

    return {
        "objects": len(items),
        "found_by_both": len(both),
        "found_by_one_only": len(only_one),
        "found_by_other_only": len(only_other),
        "one_only_because_other": by([item.other for item in only_one]),
        "other_only_because_one": by([item.one for item in only_other]),
        "one_only_by_class": by([CLASS_NAMES[item.class_id] for item in only_one]),
        "other_only_by_class": by([CLASS_NAMES[item.class_id] for item in only_other]),
        "center_error_cm_of_found_by_both": [
            None if np.isnan(value) else round(100 * float(value), 2) for value in medians
        ],
        "frames_one_leads": sum(d.lead > 0 for d in leads),
        "frames_other_leads": sum(d.lead < 0 for d in leads),
        "errors_one_saves": sum(d.lead for d in leads),
    }


def gain(pairs: list[tuple[ScoredSequence, ScoredSequence]]) -> dict[str, object]:
    """By how many points of MOTA the first of each pair is ahead, and the 95 % interval of that:
    sequences differ more than variants do, so it is one of differences."""
    ahead = 100 * np.array([a.scores.clear.mota - b.scores.clear.mota for a, b in pairs])
    return {
        "mean": round(float(np.nanmean(ahead)), 2),
        "interval": [round(bound, 2) for bound in bootstrap_interval(ahead)],
    }


def sheet(
    chosen: list[Difference],
    runs: dict[str, dict[Path, ScoredSequence]],
) -> Image.Image:
    """A row a frame, a column a variant."""
    rows = []
    for difference in chosen:
        row = []
        for name, scored in runs.items():
            item = scored[difference.folder]
            failure = Failure(difference.folder, difference.frame, item.errors[difference.frame])
            image = picture(failure, item)
            assert image is not None
            row.append(captioned(image, f"{name}: {failure.caption}"))
        rows.append(row)
    return pasted(rows)


def captioned(image: Image.Image, caption: str) -> Image.Image:
    """The image with a line of text above it."""
    tile = Image.new("RGB", (image.width, image.height + CAPTION_PX), "white")
    tile.paste(image, (0, CAPTION_PX))
    ImageDraw.Draw(tile).text((3, 2), caption, fill="black")
    return tile


def pasted(rows: list[list[Image.Image]]) -> Image.Image:
    """Rows of equally many tiles of one size as one image."""
    width, height = rows[0][0].size
    out = Image.new("RGB", (len(rows[0]) * width, len(rows) * height), "white")
    for y, row in enumerate(rows):
        for x, tile in enumerate(row):
            out.paste(tile, (x * width, y * height))
    return out


def main(
    scores: Annotated[Path, tyro.conf.Positional],
    data: Path,
    one: str = "full",
    other: str = "no-compl",
    image: Path | None = None,
    numbers: Path | None = None,
) -> None:
    """Write the picture and the numbers."""
    image, numbers = image or scores / "gain.jpg", numbers or scores / "gain.json"
    folders = sequence_folders(data)
    run, first = read_scores(scores, folders, one)
    _, second = read_scores(scores, folders, other)
    first = {folder: item for folder, item in first.items() if folder in second}
    leads = differences(first, second)
    items = [item for f in first for item in counted_objects(f, first[f], second[f])]
    worst_first = [replace(d, lead=-d.lead) for d in reversed(leads)]
    ahead = [d for d in shown(leads) if d.lead > 0]
    behind = [d for d in shown(worst_first) if d.lead > 0]
    if chosen := [*ahead, *behind]:
        sheet(chosen, {one: first, other: second}).save(image, quality=80)
    result = {
        **{key: run[key] for key in ("data", "commit", "seed", "weights", "hardware", "date")},
        "command": f"python benchmarks/gains.py {scores} --data {data} --one {one} --other {other}",
        "sequences": len(first),
        "one": one,
        "other": other,
        "mota": {name: run["variants"][name]["mota_mean"] for name in (one, other)},
        "mota_gain": gain([(first[f], second[f]) for f in first]),
        **summary(items, leads),
    }
    numbers.write_text(json.dumps(result, indent=2) + "\n")
    print(json.dumps(result, indent=2))
    print(f"wrote {numbers}" + (f" and {image}" if chosen else "; no frame differs"))


if __name__ == "__main__":
    tyro.cli(main)
