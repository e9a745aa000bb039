"""Time against error with every method's budget swept: which points nobody beats in both, as a table and a chart.

Time is the processor's, all methods on one thread, of a warm call: what a method prepares once an object, and what is
compiled, is done before, for everybody.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fusion.benchmarks.printing.charts import Chart
from fusion.benchmarks.printing.one_thread import one_thread
from fusion.benchmarks.printing.tables import Column, Quantile, Rate, Table

Array = NDArray[np.float64]
C = TypeVar("C")
A = TypeVar("A")

# Draws of a Gaussian error whose median a bound is.
DRAWS = 200


@dataclass(frozen=True)
class Method(Generic[C, A]):
    """A method at one budget: solve(case, seed) -> its answer. most: a slow one does the first so many cases only."""

    name: str
    budget: str
    solve: Callable[[C, int], A]
    most: int | None = None


@dataclass(frozen=True)
class Point:
    """One method at one budget over n trials: processor ms (n,), errors (n,) mm, successes (n,)."""

    method: str
    budget: str
    ms: Array
    error: Array
    success: NDArray[np.bool_]

    @property
    def place(self) -> tuple[float, float]:
        """Median time (ms) and median error (mm)."""
        return float(np.median(self.ms)), float(np.median(self.error))


def measure(
    methods: Sequence[Method[C, A]],
    cases: Sequence[C],
    key: Callable[[C], str],
    judge: Callable[[C, A], tuple[float, bool]],
    seed: int,
    progress: Callable[..., Iterator[Any]],
    what: str,
) -> list[Point]:
    """Every method on every case, on one thread; judge(case, answer) -> error (mm), success.

    The first case of each key (its object) is done twice, to compile and to prepare what is made once an object.
    """
    points = []
    with one_thread():
        for method in progress(methods, len(methods), what):
            prepared: set[str] = set()
            ms, judged = [], []
            for case in cases[: method.most]:
                if key(case) not in prepared:
                    prepared.add(key(case))
                    method.solve(case, seed)
                begin = time.process_time()
                answer = method.solve(case, seed)
                ms.append(1e3 * (time.process_time() - begin))
                judged.append(judge(case, answer))
            error, success = zip(*judged, strict=True)
            points.append(Point(method.name, method.budget, np.array(ms), np.array(error), np.array(success)))
    return points


def swept(methods: Sequence[Method[C, A]], quick: bool) -> Sequence[Method[C, A]]:
    """All of them; when in a hurry the first budget of each method."""
    return list({method.name: method for method in reversed(methods)}.values())[::-1] if quick else methods


def least_error(covariances: Sequence[ArrayLike], measured: Callable[[int, Array], Array]) -> float:
    """Median error (mm) of Gaussian errors with the least covariances (6, 6) there can be, one a case: Cramér-Rao.

    measured(case, delta (d, 6)) -> the error (m) (d,) that displacements (rotation vector, displacement) make.
    """
    rng = np.random.default_rng(0)
    errors = []
    for number, covariance in enumerate(covariances):
        values, vectors = np.linalg.eigh(np.asarray(covariance, dtype=np.float64))
        delta = (rng.normal(size=(DRAWS, 6)) * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
        errors.append(measured(number, delta))
    return float(1e3 * np.median(np.concatenate(errors)))


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
            Column("processor ms", 1),
            Column("median error mm", 3),
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
        error = Quantile.of(point.error)
        found.add(
            point.method,
            point.budget,
            len(point.error),
            Quantile.of(point.ms),
            error,
            f"{error.low:.2f}-{error.high:.2f}",
            rate,
            "{:.0f}-{:.0f} %".format(*(100 * x for x in rate.interval)),
            "*" if is_best else "",
        )
    return found


def chart(title: str, points: Sequence[Point], bound: float | None = None) -> Chart:
    """Median error against median time, a line a method from its smallest budget to its largest, the front of points
    that nobody beats, and the Cramér-Rao bound (mm) as a level line.
    """
    series: dict[str, list[tuple[float, float]]] = {}
    for point in points:
        series.setdefault(point.method, []).append(point.place)
    best = frontier([point.place for point in points])
    front = sorted(point.place for point, is_best in zip(points, best, strict=True) if is_best)
    level = bound if bound is not None and math.isfinite(bound) else None
    return Chart(
        title, "median processor time, ms", "median error, mm", series, log_x=True, log_y=True, front=front, level=level
    )
