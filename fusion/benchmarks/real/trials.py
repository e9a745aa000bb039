"""Every method on recorded frames: with and without the mask, without a start and from starts near and far.

- palpate: `estimate`, by vision: there is nothing else in these frames
- icp: point-to-plane on the usual crop around the start; without a start from the mask's middle, unturned
- icp_segmented: the same on the points that our segmentation leaves to the object
- fpfh_ransac: features, RANSAC, ICP on the segmented points; only where there is no start
- small_gicp: generalised ICP from the start on the segmented points
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.printing.tables import own_seed
from fusion.benchmarks.real.frames import Recorded
from fusion.truth.compare import compare_frame
from scenes.geometry import poses
from scenes.recordings.frames import Frame
from vision.look.look import object_points
from vision.published import registration

Array = NDArray[np.float64]

OURS = "palpate"
METHODS = (OURS, "icp", "icp_segmented", "fpfh_ransac", "small_gicp")
# Our own names of methods in `fusion.truth.compare`.
COMPARED = {OURS: "vision", "icp": "icp", "icp_segmented": "icp_segmented"}


@dataclass(frozen=True)
class Start:
    """name; angle (rad, None: no start) and distance (m) of starts from the reference."""

    name: str
    angle: float | None
    distance: float = 0.0

    @property
    def words(self) -> str:
        """As claims and headings name it."""
        return "no start" if self.angle is None else "at reference" if self.once else self.name

    @property
    def once(self) -> bool:
        """Nothing is drawn: one try says it."""
        return self.angle == 0.0


NO_START = Start("none", None)
AT_REFERENCE = Start("reference", 0.0)
# What a tracker or a detector leaves, and what T1 section 4.3 starts from.
STARTS = (
    NO_START,
    Start("10 mm, 5°", float(np.deg2rad(5.0)), 0.010),
    Start("33 mm, 16°", float(np.deg2rad(16.0)), 0.033),
    AT_REFERENCE,
)


@dataclass(frozen=True)
class Trial:
    """One method on one frame from one start.

    mask: whether the method was given it; number: of the try; add_s (m), nees: NaN without truth; residual (m) and
    overlap of the mask; verdict "" of a method that does not judge itself; true: the truth is known; prior (4, 4):
    where it started; seed: of the method's own chance.
    """

    frame: str
    mask: bool
    start: Start
    method: str
    number: int
    pose: Array
    add_s: float
    residual: float
    overlap: float
    wrong: bool
    time_ms: float
    verdict: str = ""
    nees: float = float("nan")
    true: bool = False
    prior: Array | None = None
    seed: int = 0


def methods_of(start: Start, mask: bool) -> tuple[str, ...]:
    """What is asked in a case: local methods need a start, or a mask whose middle stands in for one."""
    if start.once:
        return (OURS, "icp")
    if start.angle is not None:
        return tuple(m for m in METHODS if m != "fpfh_ransac" and _there(m))
    return (OURS, "icp", "fpfh_ransac") if mask else (OURS, "fpfh_ransac")


def _there(method: str) -> bool:
    return method in COMPARED or method in registration.available()


def warm_up(one: Recorded) -> None:
    """Compiles what is compiled at its first use: times would tell of the compiler."""
    for start in (NO_START, AT_REFERENCE):
        if start.angle is not None and one.reference is None:
            continue
        frame = replace(one.frame, prior=None if start.angle is None else one.reference)
        for method in METHODS:
            if _there(method) and (frame.prior is not None or method not in registration.LOCAL):
                trial(one, frame, start, method)


def trials(one: Recorded, starts: Iterable[Start], count: int, seed: int) -> Iterator[Trial]:
    """Every case of one frame, `count` tries each. A start is the same with and without mask, and for all methods."""
    for start in starts:
        if start.angle is not None and one.reference is None:
            continue
        for number in range(1 if start.once else count):
            drawn = own_seed(seed, one.name, start.name, number)
            prior = None
            if start.angle is not None and one.reference is not None:
                rng = np.random.default_rng(drawn)
                prior = poses.displaced(one.reference, start.angle, start.distance, one.model.centroid, rng)
            for mask in (True, False):
                frame = replace(one.frame, prior=prior, mask=one.frame.mask if mask else None)
                for method in methods_of(start, mask):
                    yield trial(one, frame, start, method, number, drawn)


def trial(one: Recorded, frame: Frame, start: Start, method: str, number: int = 0, seed: int = 0) -> Trial:
    """One method on one frame, from its prior if it has one; judged with the mask, whether or not the method had it."""
    verdict, nees = "", float("nan")
    if method in COMPARED:
        row = compare_frame(frame, one.judge, (COMPARED[method],), seed)[0]
        pose, verdict, spent = row.pose, row.verdict if method == OURS else "", row.time_ms
        add_s = row.errors.add_s if row.errors else float("nan")
        nees = row.errors.nees if row.errors else float("nan")
    else:
        began = time.perf_counter()
        points = object_points(frame, one.model, frame.prior)
        pose = registration.register(method, points, one.model, frame.prior, seed)
        spent = 1e3 * (time.perf_counter() - began)
        add_s = one.judge.errors(pose, one.truth).add_s if one.truth is not None else float("nan")
    residual, overlap = one.residual(pose), one.overlap(pose)
    wrong = one.wrong(add_s, residual, overlap)
    kept = frame.mask is not None, start, method, number, pose, add_s, residual, overlap, wrong, spent, verdict, nees
    return Trial(one.name, *kept, one.truth is not None, frame.prior, seed)
