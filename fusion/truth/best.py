"""Which of several methods is best on the same frames, by how much, and whether the frames can tell.

Two methods are compared frame by frame: the difference of their errors on one frame says nothing of how hard the frame
is. The interval of its median is the bootstrap's percentile interval (Efron and Tibshirani, "An Introduction to the
Bootstrap", 1993, chapter 13); where captures are many they are drawn, not their frames, which resemble one another.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion.truth.compare import Row
from fusion.truth.errors import JudgeSettings, json_number

Array = NDArray[np.float64]

# Draws of the bootstrap, and the share of them that an interval holds.
DRAWS = 4000
CONFIDENCE = 0.95
# An interval of fewer frames than this is narrower by luck than it should be (0.5^5 of a sign test is above 2.5 %).
FEWEST = 6
# From so many captures on, captures are drawn instead of frames.
MANY_CAPTURES = 8
TRUTH = "ADD-S"
AGREEMENT = "distance of what was sensed from the surface"


@dataclass(frozen=True)
class Duel:
    """The best method against another: how many frames both have; median of the other's error less the best's (mm), its
    interval low to high; frames on which the best errs less; whether the interval leaves out 0.
    """

    other: str
    frames: int
    difference_mm: float
    low_mm: float
    high_mm: float
    better_on: int
    tells: bool

    def to_json(self) -> dict[str, Any]:
        """As named."""
        return json_number(vars(self))


@dataclass(frozen=True)
class Best:
    """method: the one of the least median error; measure: TRUTH, or AGREEMENT where no frame has ground truth;
    median_mm; duels with the others, the nearest first.
    """

    method: str
    measure: str
    median_mm: float
    duels: tuple[Duel, ...]

    def to_json(self) -> dict[str, Any]:
        """As named."""
        plain = {name: value for name, value in vars(self).items() if name != "duels"}
        return {**json_number(plain), "duels": [duel.to_json() for duel in self.duels]}


def find_best(rows: Iterable[Row], seed: int = 0) -> Best | None:
    """The best method of these rows; None when nothing can be measured. The same seed gives the same intervals."""
    kept = list(rows)
    with_truth = any(row.errors is not None for row in kept)
    scores: dict[str, dict[tuple[str, int], float]] = {}
    for row in kept:
        score = _truth_mm(row) if with_truth else _agreement_mm(row)
        if np.isfinite(score):
            scores.setdefault(row.method, {})[row.capture, row.frame] = score
    if not scores:
        return None
    medians = {method: float(np.median(list(found.values()))) for method, found in scores.items()}
    best = min(medians, key=lambda method: medians[method])
    duels = []
    for method in scores:
        both = sorted(set(scores[best]) & set(scores[method]))
        if method != best and both:
            differences = np.array([scores[method][key] - scores[best][key] for key in both])
            captures = np.unique([capture for capture, _ in both], return_inverse=True)[1]
            duels.append(_duel(method, differences, captures, seed))
    duels.sort(key=lambda duel: duel.difference_mm)
    return Best(best, TRUTH if with_truth else AGREEMENT, medians[best], tuple(duels))


def _truth_mm(row: Row) -> float:
    return float("nan") if row.errors is None else 1e3 * row.errors.add_s


def _agreement_mm(row: Row) -> float:
    """Root mean square of the cloud's and the contacts' distances, of those that there are.

    A point near the object that is none of its surface counts as far as an inlier may be: or a pose that leaves most of
    what was seen would be praised for the rest.
    """
    agreement, cap = row.agreement, JudgeSettings().inlier
    share = agreement.inliers
    inside = agreement.cloud if np.isfinite(agreement.cloud) else 0.0
    seen = share * inside + (1.0 - share) * cap if np.isfinite(share) else float("nan")
    parts = np.array([seen, agreement.contacts], dtype=np.float64)
    parts = parts[np.isfinite(parts)]
    return 1e3 * float(np.sqrt(np.mean(parts**2))) if len(parts) else float("nan")


def _duel(other: str, differences: Array, captures: NDArray[np.intp], seed: int) -> Duel:
    median, count = float(np.median(differences)), len(differences)
    low, high = interval(differences, captures, seed)
    tells = count >= FEWEST and (low > 0 or high < 0)
    return Duel(other, count, median, low, high, int((differences > 0).sum()), bool(tells))


def interval(differences: Array, groups: NDArray[np.intp], seed: int = 0) -> tuple[float, float]:
    """Bounds of the median of differences (n,); groups (n,) from 0: which of them were recorded together."""
    rng = np.random.default_rng(seed)
    number = int(groups.max()) + 1
    medians = np.zeros(DRAWS)
    if number >= MANY_CAPTURES:
        members = [differences[groups == i] for i in range(number)]
        for draw in range(DRAWS):
            medians[draw] = np.median(np.concatenate([members[i] for i in rng.integers(number, size=number)]))
    else:
        for begin in range(0, DRAWS, 500):  # pieces, so that thousands of frames fit the memory
            picked = rng.integers(len(differences), size=(min(500, DRAWS - begin), len(differences)))
            medians[begin : begin + 500] = np.median(differences[picked], axis=1)
    tail = 50.0 * (1.0 - CONFIDENCE)
    low, high = np.percentile(medians, [tail, 100.0 - tail])
    return float(low), float(high)


def sentences(best: Best) -> list[str]:
    """For a person: who is best, by how much over each other, and whether the frames can tell."""
    measure = best.measure if best.measure == TRUTH else f"no ground truth: {best.measure}"
    lines = [f"best: {best.method}, {measure} {best.median_mm:.2f} mm at the median"]
    lines += [f"  {_sentence(duel)}" for duel in best.duels]
    return lines


def _sentence(duel: Duel) -> str:
    said = f"{duel.difference_mm:.2f} mm less than {duel.other} ({duel.low_mm:.2f} to {duel.high_mm:.2f})"
    said += f", better on {duel.better_on} of {duel.frames} frames: "
    if duel.frames < FEWEST:
        return said + f"too few to tell ({FEWEST} at least)"
    return said + ("the frames can tell" if duel.tells else "they cannot tell these two apart")
