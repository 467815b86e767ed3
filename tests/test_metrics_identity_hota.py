"""IDF1 and HOTA: tables, slow references, laws."""

import itertools

import numpy as np
import pytest

from composenet.metrics.hota import ALPHAS, hota_scores
from composenet.metrics.identity import identity_scores
from composenet.metrics.records import TrackingFrame
from metric_cases import line, random_frames

TABLE = {  # name: gt, tracks, idtp idfn idfp, DetA, AssA
    "perfect": ("AAAA/BBBB", "aaaa/bbbb", (8, 0, 0), 1, 1),
    "half found": ("AAAA", "aa..", (2, 2, 0), 0.5, 0.5),
    "split in halves": ("AAAA", "aabb", (2, 2, 2), 1, 0.5),
    "two joined": ("AA../..BB", "aa../..aa", (2, 2, 2), 1, 0.5),
    "twice as long": ("AA..", "aaaa", (2, 0, 2), 0.5, 0.5),
    "nothing found": ("AA", "..", (0, 2, 0), 0, 0),
    "nothing there": ("..", "aa", (0, 0, 2), 0, 0),
}


@pytest.mark.parametrize("name", TABLE)
def test_table(name):
    gts, tracks, counts, det_a, ass_a = TABLE[name]
    frames = line(gts, tracks)
    ids, hota = identity_scores(frames), hota_scores(frames)
    assert (ids.idtp, ids.idfn, ids.idfp) == counts
    assert (hota.det_a, hota.ass_a) == pytest.approx((det_a, ass_a))
    assert hota.hota == pytest.approx(np.sqrt(det_a * ass_a))


def test_alphas():
    assert len(ALPHAS) == 19
    assert (ALPHAS[0], ALPHAS[-1]) == pytest.approx((0.05, 0.95))


def test_localisation_decides_at_which_alphas_a_match_counts():
    """5 cm of a 25 cm gate: similarity 0.9, so 18 of 19 alphas are met."""
    hota = hota_scores([TrackingFrame(np.array([1]), np.array([7]), np.array([[0.05]]))])
    assert hota.tp.tolist() == [1] * 18 + [0]
    assert hota.hota == pytest.approx(18 / 19)
    assert hota.similarity_sum[0] == pytest.approx(0.9)


def test_sequences_add_up_weighted_by_matches():
    together = hota_scores(line("AA", "aa")) + hota_scores(line("AAAAAA", "aaabbb"))
    assert together.ass_a == pytest.approx((2 * 1 + 6 * 0.5) / 8)
    ids = identity_scores(line("AA", "aa")) + identity_scores(line("AAAAAA", "aaabbb"))
    assert ids.idf1 == pytest.approx(2 * 5 / (2 * 5 + 3 + 3))


def slow_idtp(frames, gate) -> int:
    """Best one-to-one map of identities, by trying all."""
    gts = sorted({i for f in frames for i in f.gt_ids.tolist()})
    tracks = sorted({i for f in frames for i in f.track_ids.tolist()})
    best = 0
    for choice in itertools.permutations([*tracks, *[None] * len(gts)], len(gts)):
        mapped = dict(zip(gts, choice, strict=True))
        best = max(
            best,
            sum(
                mapped[g] == p and f.distance_m[i, j] < gate
                for f in frames
                for i, g in enumerate(f.gt_ids.tolist())
                for j, p in enumerate(f.track_ids.tolist())
            ),
        )
    return best


def slow_hota(frames, gate) -> float:
    """The paper's definition with loops over pairs and alphas; assignments by trying all."""
    pairs = [
        (t, g, p, max(0.0, 1 - f.distance_m[i, j] / (2 * gate)))
        for t, f in enumerate(frames)
        for i, g in enumerate(f.gt_ids.tolist())
        for j, p in enumerate(f.track_ids.tolist())
    ]
    gt_count = {g: sum(g in f.gt_ids for f in frames) for _, g, _, _ in pairs}
    track_count = {p: sum(p in f.track_ids for f in frames) for _, _, p, _ in pairs}
    soft: dict[tuple[int, int], float] = {}
    for t, g, p, s in pairs:
        rivals = sum(x for u, h, q, x in pairs if u == t and (h == g or q == p))
        soft[g, p] = soft.get((g, p), 0.0) + (s / rivals if rivals > 1e-15 else 0.0)
    align = {k: v / (gt_count[k[0]] + track_count[k[1]] - v) for k, v in soft.items()}
    chosen = []
    for t, f in enumerate(frames):
        here = {(g, p): s for u, g, p, s in pairs if u == t}
        gts, tracks = f.gt_ids.tolist(), f.track_ids.tolist()
        best, best_value = [], -1.0
        for choice in set(itertools.permutations([*tracks, *[None] * len(gts)], len(gts))):
            picks = [(g, p) for g, p in zip(gts, choice, strict=True) if p is not None]
            value = sum(align[k] * here[k] for k in picks)
            if value > best_value:
                best, best_value = [(*k, here[k]) for k in picks], value
        chosen += best
    total_gt = sum(len(f.gt_ids) for f in frames)
    total_track = sum(len(f.track_ids) for f in frames)
    values = []
    for alpha in ALPHAS:
        hits = [(g, p) for g, p, s in chosen if s >= alpha]
        association = 0.0
        for g, p in hits:
            tpa = hits.count((g, p))
            association += tpa / (gt_count[g] + track_count[p] - tpa)
        det_a = len(hits) / (total_gt + total_track - len(hits))
        values.append(np.sqrt(det_a * association / max(1, len(hits))))
    return float(np.mean(values))


@pytest.mark.parametrize("seed", range(8))
def test_against_slow_references(seed):
    frames = random_frames(np.random.default_rng(seed), objects=3, tracks=3, count=6)
    assert identity_scores(frames).idtp == slow_idtp(frames, 0.25)
    assert hota_scores(frames).hota == pytest.approx(slow_hota(frames, 0.25), abs=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_names_and_order_change_nothing(seed):
    rng = np.random.default_rng(seed)
    frames = random_frames(rng)
    names = rng.permutation(1000)
    shuffled = [
        TrackingFrame(names[f.gt_ids][::-1], names[f.track_ids], f.distance_m[::-1]) for f in frames
    ]
    assert identity_scores(frames) == identity_scores(shuffled)
    assert hota_scores(frames).hota == pytest.approx(hota_scores(shuffled).hota)
