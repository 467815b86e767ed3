"""Two pictures of an evaluation, and their numbers: is a confidence right as often as it says, and
do objects that are completed better track better?

python benchmarks/figures.py SCORES --data DATA [--variant full] [--out SCORES]
    [--numbers SCORES/figures.json]

SCORES is the --out folder of `composenet eval --data DATA`. Open only folders that you trust: what
it keeps of each sequence is a pickle.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import matplotlib
import numpy as np
import tyro
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from composenet.commands.score_cache import kept_sequences
from composenet.commands.scoring import ScoredSequence, sequence_folders
from composenet.errors import DataError
from composenet.metrics.calibration import Calibration, Judged, calibration, judged_tracks
from composenet.metrics.evaluate import aggregate, bootstrap_interval

GROUPS = 5
"""parts of equal size that the sequences fall into, by completion, at most"""
GROUP_SIZE = 4
"""sequences in such a part, at least"""
_BLUE, _ORANGE, _GREY = "#2f6fb0", "#d97b29", "#8a8a8a"


@dataclass(frozen=True)
class SequencePoint:
    """One sequence. completion_iou: mean over its tracks that match an object, 0..1."""

    name: str
    tracks: int
    completion_iou: float
    mota: float


@dataclass(frozen=True)
class Group:
    """Sequences of like completion: means, and the 95 % interval of the MOTA (bootstrap)."""

    sequences: int
    completion_iou: float
    mota: float
    low: float
    high: float


def main(
    scores: Annotated[Path, tyro.conf.Positional],
    data: Path,
    variant: str = "full",
    out: Path | None = None,
    numbers: Path | None = None,
) -> None:
    """Write calibration.png and mota_completion.png to `out`, and their numbers."""
    out, numbers = out or scores, numbers or scores / "figures.json"
    matplotlib.use("Agg")
    run, scored = read_scores(scores, sequence_folders(data), variant)
    if not any(item.completions for item in scored.values()):
        raise DataError(f"{scores}: no track of {variant} matches an object; nothing to draw")
    tracks = calibration(Judged.joined([judged(folder, item) for folder, item in scored.items()]))
    detections = calibration(judged_detections(list(scored.values())))
    points = sequence_points(scored)
    groups = grouped(points)
    where = f"{run['data']}, {len(scored)} sequences, {variant}"
    out.mkdir(parents=True, exist_ok=True)
    draw_calibration(tracks, detections, where, out / "calibration.png")
    draw_completion(points, groups, where, out / "mota_completion.png")
    result = {
        **{key: run[key] for key in ("data", "commit", "seed", "weights", "hardware", "date")},
        "command": f"python benchmarks/figures.py {scores} --data {data} --variant {variant}",
        "variant": variant,
        "sequences": len(scored),
        "calibration": {"tracks": as_json(tracks), "detections": as_json(detections)},
        "mota_completion": {
            "rank_correlation": rank_correlation(points),
            "groups": [vars(group) for group in groups],
            "sequences": [vars(point) for point in points],
        },
    }
    numbers.parent.mkdir(parents=True, exist_ok=True)
    numbers.write_text(json.dumps(result, indent=2, allow_nan=False) + "\n")
    print(
        f"expected calibration error: tracks {tracks.error:.3f}, detections {detections.error:.3f}"
    )
    print(f"wrote {out / 'calibration.png'}, {out / 'mota_completion.png'} and {numbers}")


def read_scores(
    scores: Path, folders: list[Path], variant: str
) -> tuple[dict[str, Any], dict[Path, ScoredSequence]]:
    """results.json of an evaluation and what it kept of each sequence. Raises DataError where
    something is missing or the two are not of one run."""
    try:
        run = json.loads((scores / "results.json").read_text())
        expected = run["variants"][variant]
    except (OSError, ValueError, KeyError) as error:
        reason = " ".join(str(error).split())
        raise DataError(f"{scores}/results.json: no results of {variant} ({reason})") from None
    known = {name for f in folders[:1] for name in (f.name, f.resolve().parent.name)}
    if known and run["data"] not in known:
        raise DataError(
            f"{scores}: made with the sequences of {run['data']}, not with those of "
            f"{folders[0].resolve().parent}"
        )
    by_name = {folder.name: folder for folder in folders}
    kept = {
        by_name[name]: item
        for name, kind, item in kept_sequences(scores / "sequences")
        if kind == variant and name in by_name
    }
    again = f"run `composenet eval --out {scores}` once more"
    if len(kept) != expected["sequences"]:
        raise DataError(f"{scores}: {len(kept)} of {expected['sequences']} sequences kept; {again}")
    mota = 100 * aggregate({path.name: item.scores for path, item in kept.items()}).mota_mean
    if not math.isclose(mota, expected["mota_mean"], abs_tol=1e-5):
        raise DataError(f"{scores}: results.json and the kept sequences are of two runs; {again}")
    return run, kept


def judged(folder: Path, item: ScoredSequence) -> Judged:
    """The tracks of one sequence against its ground truth."""
    truth = item.truth(folder)
    return judged_tracks(truth, item.tracked)


def judged_detections(scored: list[ScoredSequence]) -> Judged:
    """Detections of single frames; right at box IoU 0.25 and equal class, those of ignored objects
    left out."""
    objects = [item.scores.objects for item in scored if item.scores.objects is not None]
    parts = [each.box25 for item in objects for each in item.classes]
    return Judged.joined([Judged(part.scores, part.correct) for part in parts])


def sequence_points(scored: dict[Path, ScoredSequence]) -> list[SequencePoint]:
    """One point a sequence in which a track matches an object."""
    points = []
    for folder, item in scored.items():
        ious = [track.volume_iou for track in item.completions]
        mota = item.scores.clear.mota
        if ious and not math.isnan(mota):
            points.append(SequencePoint(folder.name, len(ious), float(np.mean(ious)), mota))
    return points


def grouped(points: list[SequencePoint]) -> list[Group]:
    """Sequences in order of their completion, cut into parts of equal size."""
    ordered = sorted(points, key=lambda point: point.completion_iou)
    count = max(1, min(GROUPS, len(ordered) // GROUP_SIZE))
    result = []
    for part in np.array_split(np.arange(len(ordered)), count):
        motas = np.array([ordered[i].mota for i in part])
        completion = float(np.mean([ordered[i].completion_iou for i in part]))
        interval = bootstrap_interval(motas)
        result.append(Group(len(part), completion, float(motas.mean()), *interval))
    return result


def rank_correlation(points: list[SequencePoint]) -> float | None:
    """Spearman's, of completion and MOTA; None where it is undefined."""
    from scipy.stats import spearmanr

    if len(points) < 3:
        return None
    value = float(spearmanr([p.completion_iou for p in points], [p.mota for p in points])[0])
    return None if math.isnan(value) else value


def as_json(result: Calibration) -> dict[str, Any]:
    """Plain numbers, null in empty bins."""

    def plain(values: Any) -> list[float | None]:
        return [None if math.isnan(value) else round(float(value), 6) for value in values]

    return {
        "expected_calibration_error": plain([result.error])[0],
        "edges": plain(result.edges),
        "counts": result.counts.tolist(),
        "confidence": plain(result.confidence),
        "share_right": plain(result.share_right),
    }


def draw_calibration(tracks: Calibration, detections: Calibration, where: str, path: Path) -> None:
    """Share right by confidence, and below how many there are."""
    figure, axes = plt.subplots(
        2, 2, figsize=(8, 5), sharex=True, height_ratios=(3, 1), layout="constrained"
    )
    columns = (
        (tracks, "a track in a frame", "class equal, centre within 25 cm"),
        (detections, "a detection in a frame", "class equal, box IoU at least 0.25"),
    )
    for (above, below), (values, name, rule) in zip(axes.T, columns, strict=True):
        _reliability(above, values)
        above.set_title(
            f"{name} (n = {values.counts.sum()})\nexpected calibration error {values.error:.3f}",
            fontsize=10,
        )
        above.set_ylabel(f"share right\n({rule})", fontsize=9)
        width = np.diff(values.edges)
        below.bar(values.edges[:-1], values.counts, width, align="edge", color=_GREY, ec="white")
        below.set_xlabel("confidence" if values is tracks else "score")
        below.set_ylabel("how many", fontsize=9)
    figure.suptitle(where, fontsize=9, color=_GREY)
    _save(figure, path)


def _reliability(axes: Axes, values: Calibration) -> None:
    full = values.counts > 0
    axes.plot([0, 1], [0, 1], "--", color=_GREY, lw=1, label="as often as it says")
    width = np.diff(values.edges)[full]
    axes.bar(
        values.edges[:-1][full],
        values.share_right[full],
        width,
        align="edge",
        color=_BLUE,
        alpha=0.35,
        ec="white",
    )
    axes.plot(values.confidence[full], values.share_right[full], "o-", color=_BLUE, ms=4)
    axes.set(xlim=(0, 1), ylim=(0, 1))
    axes.legend(loc="upper left", fontsize=8, frameon=False)


def draw_completion(
    points: list[SequencePoint], groups: list[Group], where: str, path: Path
) -> None:
    """A dot a sequence; means of groups of sequences with their intervals."""
    sizes = sorted({group.sequences for group in groups})
    size = " or ".join(map(str, sizes))
    figure, axes = plt.subplots(figsize=(6, 4.2), layout="constrained")
    axes.plot(
        [p.completion_iou for p in points],
        [100 * p.mota for p in points],
        "o",
        color=_BLUE,
        alpha=0.4,
        ms=5,
        label="a sequence",
    )
    motas = np.array([[group.mota, group.low, group.high] for group in groups]).reshape(-1, 3) * 100
    axes.errorbar(
        [group.completion_iou for group in groups],
        motas[:, 0],
        yerr=np.abs(motas[:, 1:].T - motas[:, 0]),
        fmt="s-",
        color=_ORANGE,
        capsize=3,
        label=f"mean of {size} sequences, 95 % interval",
    )
    axes.set_xlabel("completion: volume IoU, mean over the sequence's tracks")
    axes.set_ylabel("MOTA, %")
    axes.grid(alpha=0.25)
    axes.legend(fontsize=8, frameon=False)
    axes.set_title(where, fontsize=9, color=_GREY)
    _save(figure, path)


def _save(figure: Any, path: Path) -> None:
    figure.savefig(path, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    tyro.cli(main)
