"""Who keeps an object's identity when it leaves the view and comes back, moved or not, and how MOTA
goes with time.

python benchmarks/returns.py SCORES --data DATA [--numbers SCORES/returns.json]
    [--image SCORES/returns.jpg] [--one full] [--other no-corr]

SCORES is the --out folder of `composenet eval` or `composenet bench` over DATA: every row of its
results.json is measured. The image shows objects that moved while away: as they were last seen and
as they come back, with the identities that two of the rows give them. Open only folders that you
trust: what SCORES keeps of each sequence is a pickle.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from figures import read_scores
from gains import captioned, pasted
from PIL import Image

from composenet.commands.failures import frame_of, frame_with_boxes
from composenet.commands.scoring import ScoredSequence, sequence_folders
from composenet.geometry.box import OrientedBox
from composenet.metrics.evaluate import posed_truths, tracking_frames
from composenet.metrics.records import MATCH_GATE_M
from composenet.metrics.returns import Outcome, Return, returns
from composenet.synth.sequence_folder import read_truth
from composenet.view.figures import ColoredBox, track_color

MOVED_M = MATCH_GATE_M
"""An object that comes back farther than this from where it left has moved."""
PARTS = 5
"""MOTA is also told of as many equal parts of the sequences, one after the other."""
PICTURES = 3


@dataclass(frozen=True)
class Case:
    """A return as two rows had it."""

    folder: Path
    one: Return
    other: Return


def main(
    scores: Annotated[Path, tyro.conf.Positional],
    data: Path,
    numbers: Path | None = None,
    image: Path | None = None,
    one: str = "full",
    other: str = "no-corr",
) -> None:
    """Print and write the numbers; draw the picture."""
    image, numbers = image or scores / "returns.jpg", numbers or scores / "returns.json"
    folders = sequence_folders(data)
    run, first = read_scores(scores, folders, one)
    kept = {one: first, other: read_scores(scores, folders, other)[1]}
    for name in run["variants"].keys() - kept.keys():
        kept[name] = read_scores(scores, folders, name)[1]
    found = {
        name: {f: returns_of(f, item) for f, item in row.items()} for name, row in kept.items()
    }
    table = {name: summary([r for own in row.values() for r in own]) for name, row in found.items()}
    for name, row in sorted(table.items()):
        row["mota_by_part"] = mota_by_part(kept[name])
        print(f"{name}: {row}")
    cases = chosen(found[one], found[other])
    if cases:
        sheet(cases, {one: kept[one], other: kept[other]}).save(image, quality=85)
    command = f"python benchmarks/returns.py {scores} --data {data}"
    result = {
        **{key: run[key] for key in ("data", "commit", "seed", "weights", "hardware", "date")},
        "command": f"{command} --one {one} --other {other}",
        "sequences": len(folders),
        "objects": sum(counted_objects(folder) for folder in folders),
        "objects_that_return": sum(len({r.gt_id for r in own}) for own in found[one].values()),
        "moved_m": MOVED_M,
        "rows": table,
    }
    numbers.write_text(json.dumps(result, indent=2) + "\n")
    print(f"wrote {numbers}" + (f" and {image}" if cases else ""))


def counted_objects(folder: Path) -> int:
    """How many objects of the sequence count in any frame."""
    truth = read_truth(folder)
    return len({g for f in tracking_frames(truth, [()] * len(truth.frames)) for g in f.gt_ids})


def returns_of(folder: Path, item: ScoredSequence) -> tuple[Return, ...]:
    """The returns of one sequence."""
    truth = item.truth(folder)
    return returns(truth, item.tracked)


def summary(found: Sequence[Return]) -> dict[str, Any]:
    """How many returns of objects at rest, and of those that moved, by outcome; kept_share: of
    those with a track before and after, null without any."""

    def counted(part: list[Return]) -> dict[str, Any]:
        counts = Counter(item.outcome for item in part)
        known = counts[Outcome.KEPT] + counts[Outcome.CHANGED]
        share = round(counts[Outcome.KEPT] / known, 3) if known else None
        return {outcome.value: counts[outcome] for outcome in Outcome} | {"kept_share": share}

    return {
        "at_rest": counted([item for item in found if item.moved_m <= MOVED_M]),
        "moved": counted([item for item in found if item.moved_m > MOVED_M]),
    }


def mota_by_part(scored: dict[Path, ScoredSequence]) -> list[float | None]:
    """MOTA, percent, pooled over the first, second, ... part of all sequences; null where no object
    counts."""
    errors, objects = [0] * PARTS, [0] * PARTS
    for folder, item in scored.items():
        present = posed_truths(read_truth(folder))
        for index, (things, wrong) in enumerate(zip(present, item.errors, strict=True)):
            part = PARTS * index // len(present)
            errors[part] += wrong.count
            objects[part] += sum(not thing.ignored for thing in things)
    return [
        round(100 * (1 - e / n), 2) if n else None for e, n in zip(errors, objects, strict=True)
    ]


def chosen(
    ones: dict[Path, tuple[Return, ...]], others: dict[Path, tuple[Return, ...]]
) -> list[Case]:
    """Objects that moved and whose identity the one keeps and the other does not, the farthest
    moved of each of the first sequences."""
    cases: dict[Path, Case] = {}
    for folder, own in ones.items():
        for a, b in zip(own, others.get(folder, own), strict=True):
            better = a.outcome is Outcome.KEPT and b.outcome is Outcome.CHANGED
            farthest = cases[folder].one.moved_m if folder in cases else MOVED_M
            if better and a.moved_m > farthest:
                cases[folder] = Case(folder, a, b)
    return list(cases.values())[:PICTURES]


def sheet(cases: Sequence[Case], rows: dict[str, dict[Path, ScoredSequence]]) -> Image.Image:
    """A row for each case: the object as it was last seen, then as it comes back by either."""
    lines = []
    for case in cases:
        (name, own), (other_name, others) = rows.items()
        one, other = own[case.folder], others[case.folder]
        assert case.one.before is not None and case.one.after is not None
        assert case.other.after is not None
        left = _when(one, case.one.before, range(case.one.left, -1, -1))
        back = _when(one, case.one.after, range(case.one.back, len(one.tracked)))
        later = _when(other, case.other.after, range(case.other.back, len(other.tracked)))
        lines.append(
            [
                _tile(case.folder, one, left, case.one.before, f"{case.folder.name} frame {left}"),
                _tile(case.folder, one, back, case.one.after, f"{name}: frame {back}"),
                _tile(case.folder, other, later, case.other.after, f"{other_name}: frame {later}"),
            ]
        )
    return pasted(lines)


def _when(scored: ScoredSequence, track_id: int, places: range) -> int:
    """The first of these frames in which the track sees its object."""
    return next(
        i for i in places for e in scored.tracked[i] if e.track_id == track_id and e.observed
    )


def _tile(
    folder: Path, scored: ScoredSequence, place: int, track_id: int, caption: str
) -> Image.Image:
    """A frame with the boxes of what is seen; that of one track thick and with its name."""
    frame = frame_of(folder, place, scored)
    assert frame is not None
    boxes = []
    for entry in scored.tracked[place]:
        S, name = entry.S_world_canonical, f"{entry.class_name} {entry.track_id}"
        red, green, blue = track_color(entry.track_id).tolist()
        label = name if entry.track_id == track_id else ""
        if entry.observed:
            box = OrientedBox(S.t, S.R, entry.extents_m)
            boxes.append(ColoredBox(box, (red, green, blue), label))
    return captioned(frame_with_boxes(frame, boxes), caption)


if __name__ == "__main__":
    tyro.cli(main)
