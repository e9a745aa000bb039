"""Time against error with every method's budget swept: which points nobody beats in both, as a table and a chart."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fusion.benchmarks.charts import Chart
from fusion.benchmarks.tables import Column, Rate, Table

Array = NDArray[np.float64]

# Resamplings of a bootstrap interval.
RESAMPLED = 2000


@dataclass(frozen=True)
class Point:
    """One method at one budget over n trials: milliseconds (n,), errors (n,) mm, successes (n,)."""

    method: str
    budget: str
    ms: Array
    error: Array
    success: NDArray[np.bool_]

    @property
    def place(self) -> tuple[float, float]:
        """Median time (ms) and median error (mm)."""
        return float(np.median(self.ms)), float(np.median(self.error))


def bootstrap_median(values: ArrayLike, seed: int = 0) -> tuple[float, float]:
    """95 % interval of the median by resampling (Efron 1979); NaN without finite values."""
    array = np.asarray(values, dtype=np.float64)
    array = array[np.isfinite(array)]
    if not len(array):
        return math.nan, math.nan
    draws = np.random.default_rng(seed).integers(len(array), size=(RESAMPLED, len(array)))
    low, high = np.quantile(np.median(array[draws], axis=1), [0.025, 0.975])
    return float(low), float(high)


def frontier(places: Sequence[tuple[float, float]]) -> list[bool]:
    """For each (time, error): that no other is at least as fast and as near, and better in one."""
    return [
        all(math.isfinite(x) for x in one)
        and not any(b[0] <= one[0] and b[1] <= one[1] and b != one for b in places if all(map(math.isfinite, b)))
        for one in places
    ]


def table(title: str, points: Sequence[Point], success: str, note: str = "") -> Table:
    """A row a point; `success` names what counts as one."""
    found = Table(
        title,
        [
            Column("method"),
            Column("budget"),
            Column("trials", 0),
            Column("ms", 1),
            Column("median error mm"),
            Column("95 %"),
            Column(success),
            Column("95 % "),
            Column("best in its time"),
        ],
        note=note,
    )
    best = frontier([point.place for point in points])
    for point, is_best in zip(points, best, strict=True):
        rate = Rate.of(point.success)
        low, high = bootstrap_median(point.error)
        found.add(
            point.method,
            point.budget,
            len(point.error),
            *point.place,
            f"{low:.2f}-{high:.2f}",
            rate,
            "{:.0f}-{:.0f} %".format(*(100 * x for x in rate.interval)),
            "*" if is_best else "",
        )
    return found


def chart(title: str, points: Sequence[Point], bound: float | None = None) -> Chart:
    """Median error against median time, a line a method from its smallest budget to its largest, and the Cramer-Rao
    bound (mm) as a level line.
    """
    series: dict[str, list[tuple[float, float]]] = {}
    for point in points:
        series.setdefault(point.method, []).append(point.place)
    if bound is not None and math.isfinite(bound):
        times = [place[0] for places in series.values() for place in places]
        series["Cramér-Rao bound"] = [(min(times), bound), (max(times), bound)]
    return Chart(title, "median time, ms", "median error, mm", series, log_x=True, log_y=True)
