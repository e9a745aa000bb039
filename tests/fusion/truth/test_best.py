"""Who is best is said with what the frames can tell, with and without ground truth."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from fusion.truth.best import AGREEMENT, FEWEST, MANY_CAPTURES, TRUTH, find_best, interval, sentences


def row(method, frame, add_s=None, cloud=np.nan, contacts=np.nan, capture="c", share=1.0):
    errors = None if add_s is None else SimpleNamespace(add_s=1e-3 * add_s)
    share = share if np.isfinite(cloud) else np.nan
    agreement = SimpleNamespace(cloud=1e-3 * cloud, contacts=1e-3 * contacts, inliers=share)
    return SimpleNamespace(capture=capture, frame=frame, method=method, errors=errors, agreement=agreement)


def rows(rng, offsets, frames=20, captures=1):
    """Frames differ much, methods by their offsets (mm) and a little more."""
    out = []
    for capture in range(captures):
        for frame in range(frames):
            hard = rng.uniform(1.0, 9.0)
            for method, offset in offsets.items():
                out.append(row(method, frame, hard + offset + 0.05 * rng.normal(), capture=f"c{capture}"))
    return out


def test_pairs_tell_what_medians_hide(rng):
    best = find_best(rows(rng, {"icp": 0.4, "fused": 0.0}), seed=1)
    assert (best.method, best.measure) == ("fused", TRUTH)
    (duel,) = best.duels
    assert duel.tells
    assert duel.low_mm < 0.4 < duel.high_mm
    assert duel.high_mm - duel.low_mm < 0.1
    assert duel.better_on == duel.frames == 20
    assert "the frames can tell" in sentences(best)[1]
    assert sentences(best)[0].startswith("best: fused, ADD-S")


def test_what_is_alike_is_not_told_apart(rng):
    best = find_best(rows(rng, {"a": 0.0, "b": 0.0, "worse": 2.0}, frames=12))
    near, far = best.duels
    assert far.other == "worse"
    assert far.tells
    assert not near.tells
    assert "cannot tell" in sentences(best)[1]


def test_few_frames_do_not_tell(rng):
    best = find_best(rows(rng, {"a": 0.0, "b": 3.0}, frames=FEWEST - 1))
    assert not best.duels[0].tells
    assert f"too few to tell ({FEWEST} at least)" in sentences(best)[1]
    alone = find_best(rows(rng, {"a": 0.0}, frames=2))
    assert alone.duels == ()


def test_the_same_seed_gives_the_same_interval(rng):
    made = rows(rng, {"a": 0.0, "b": 0.1})
    assert find_best(made, 3) == find_best(made, 3)
    assert find_best(made, 3) == find_best(list(reversed(made)), 3)


def test_without_truth_what_was_sensed_decides():
    made = [row(m, i, None, cloud, contacts) for i in range(8) for m, cloud, contacts in
            (("vision", 1.0, 5.0), ("touch", 4.0, 0.5), ("fused", 1.2, 0.8))]  # fmt: skip
    best = find_best(made)
    assert (best.method, best.measure) == ("fused", AGREEMENT)
    assert best.median_mm == pytest.approx(np.sqrt((1.2**2 + 0.8**2) / 2))
    assert "no ground truth" in sentences(best)[0]
    touch_only = [row("touch", 0, None, np.nan, 0.5)]
    assert find_best(touch_only).median_mm == pytest.approx(0.5)
    assert find_best([row("touch", 0)]) is None
    lazy = [row("lazy", i, None, 0.1, 0.8, share=0.1) for i in range(8)]  # near to the little that it explains
    assert find_best([*made, *lazy]).method == "fused"
    # one frame with truth: the others do not count
    assert find_best([*made, row("icp", 0, 3.0)]).method == "icp"


def test_intervals_hold_the_median_as_often_as_they_say():
    rng = np.random.default_rng(0)
    hits = 0
    for trial in range(100):
        low, high = interval(rng.exponential(size=25), np.zeros(25, dtype=np.intp), seed=trial)
        hits += low <= np.log(2.0) <= high
    assert 87 <= hits <= 100


def test_captures_are_drawn_where_they_are_many():
    """Frames of one capture are alike: twice as many of them make no interval narrower."""
    rng = np.random.default_rng(0)
    shift = rng.normal(size=MANY_CAPTURES + 4)

    def width(copies):
        values = np.repeat(shift, copies)
        low, high = interval(values, np.repeat(np.arange(len(shift)), copies))
        return high - low

    assert width(8) > 0.8 * width(1)
