"""Is an answer as sure as it is right? NEES, coverage and verdicts over a thousand simulated grasps.

Every frame is another grasp, view and draw of all errors. The NEES of a right covariance has the chi-square
distribution of as many degrees of freedom as the pose has: six, one less for an object that is round about an axis
(Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, section 5.4). Its p-region
then holds the truth with probability p: the reliability curve.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.frames.occlusion import Scene, frames_of
from fusion.benchmarks.printing.charts import Chart
from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Quantile, Rate, Report, Table
from scenes.threads import VARIABLE, thread_count

Array = NDArray[np.float64]

OBJECTS = ("mug", "drill", "bottle", "hammer", "bust", "box", "l_block", "light_bulb")
LEVELS = (0.0, 0.3, 0.6, 0.8, 0.9)
NOISES = ("clean", "lab")
SENSES = {"fused": ("vision", "touch"), "vision": ("vision",), "touch": ("touch",)}
# ADD-S (m) beyond which an answer is wrong, as everywhere.
WRONG = 0.005
# Regions whose coverage is told, and those of the curve.
REGIONS = (0.5, 0.9, 0.95, 0.99)
CURVE = (*(k / 20 for k in range(1, 20)), 0.99)


@dataclass(frozen=True)
class Answered:
    """One answer against the truth: share is the chi-square probability of its NEES, per_dof its NEES per degree."""

    noise: str
    level: float
    sense: str
    add_s: float
    per_dof: float
    share: float
    verdict: str


def run(settings: BenchSettings) -> Report:
    """Tables by preset and hidden share, by verdict, and by sense; the reliability curve."""
    trials = settings.count(13, quick=1)
    objects = settings.objects or tuple(settings.some(OBJECTS, 1))
    cells = [(name, noise, level) for noise in NOISES for level in settings.some(LEVELS, 3) for name in objects]
    report = Report(
        "calibration",
        "Is an answer as sure as it is right? Starts 16 degrees and 33 mm off, no mask, a hand of known joints",
        f"{len(cells) * trials} frames at most: {len(objects)} objects x {trials} a cell, each its own draw",
        settings.seed,
    )
    answers: list[Answered] = []
    work = _parallel([(*cell, trials, settings.seed) for cell in cells])
    for found in settings.progress(work, len(cells), "cells"):
        answers += found
    answers.sort(key=lambda a: (a.noise, a.level, a.sense, a.add_s, a.share))
    _by_level(report, answers, settings)
    _by_verdict(report, answers, settings)
    _curve(report, answers)
    return report


def answer_cell(name: str, noise: str, level: float, trials: int, seed: int) -> list[Answered]:
    """All answers to the frames of one cell. Fewer frames where grasps cannot hide so much."""
    from scipy.stats import chi2

    from fusion import estimate
    from fusion.truth.errors import Judge
    from scenes.synthesis import library

    judge = Judge(library.make(name))
    model, out = judge.model, []
    lost = 3 if model.symmetries.is_spherical else min(1, len(model.symmetries.axes))
    for frame in frames_of(name, Scene(noise, "hand", ""), level, trials, seed):
        truth = frame.camera_from_object_truth
        if truth is None:
            continue
        for sense, use in SENSES.items():
            answer = estimate(frame, model, use=use, seed=seed)
            errors = judge.errors(answer.pose, truth, answer.covariance)
            share = float(chi2.cdf(errors.nees, 6 - lost)) if np.isfinite(errors.nees) else 1.0
            out.append(Answered(noise, level, sense, errors.add_s, errors.nees / (6 - lost), share, answer.verdict))
    return out


def _parallel(cells: list[tuple[str, str, float, int, int]]) -> Iterator[list[Answered]]:
    """Cells as they are done, one thread a process: what is measured here is no time."""
    workers = thread_count()
    if workers == 1 or len(cells) == 1:
        yield from (answer_cell(*cell) for cell in cells)
        return
    before = os.environ.get(VARIABLE)
    os.environ[VARIABLE] = "1"
    try:
        with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
            waiting = [pool.submit(answer_cell, *cell) for cell in cells]
            for done in as_completed(waiting):
                yield done.result()
    finally:
        if before is None:
            del os.environ[VARIABLE]
        else:
            os.environ[VARIABLE] = before


def _row(found: list[Answered]) -> list[object]:
    ratio, share = np.array([a.per_dof for a in found]), np.array([a.share for a in found])
    wrong = [a.verdict == "ok" and a.add_s > WRONG for a in found]
    return [
        len(found),
        Quantile.of([a.add_s for a in found], 1e3),
        Rate.of([a.add_s < WRONG for a in found]),
        float(np.mean(ratio)),
        _trimmed(ratio),
        *(Rate.of(share <= p) for p in REGIONS),
        " / ".join(str(sum(a.verdict == word for a in found)) for word in ("ok", "ambiguous", "lost")),
        Rate.of(wrong),
    ]


def _trimmed(values: Array) -> float:
    """Mean without the largest hundredth: a few answers in another mode outweigh a thousand otherwise."""
    return float(np.sort(values)[: max(1, int(np.ceil(0.99 * len(values))))].mean())


def _columns(first: list[Column]) -> list[Column]:
    middle = [Column("frames", 0), Column("ADD-S mm"), Column("< 5 mm"), Column("NEES / dof"), Column("99 % of them")]
    return [*first, *middle, *(Column(f"{p:.0%} region") for p in REGIONS), Column("ok / amb. / lost"), Column("wrong")]


NOTE = (
    "NEES / dof: mean, 1 is right; 99 % of them: without the largest hundredth. Regions: share of the truths that they"
    " hold. wrong: said ok with an ADD-S above 5 mm."
)


def _by_level(report: Report, answers: list[Answered], settings: BenchSettings) -> None:
    for sense in SENSES:
        table = Table(sense, _columns([Column("noise"), Column("hidden %")]), note=NOTE)
        mine = [a for a in answers if a.sense == sense]
        for noise in NOISES:
            for level in LEVELS:
                found = [a for a in mine if (a.noise, a.level) == (noise, level)]
                if found:
                    table.add(noise, f"{level:.0%}", *_row(found))
            found = [a for a in mine if a.noise == noise]
            if found:
                table.add(noise, "all", *_row(found))
        if not mine:
            continue
        table.add("both", "all", *_row(mine))
        report.tables.append(table)
        settings.show(table)
    fused = [a for a in answers if a.sense == "fused"]
    ratio = float(np.mean([a.per_dof for a in fused]))
    held = float(np.mean([a.share <= 0.95 for a in fused]))
    report.claims += [
        Claim("fused: mean NEES / dof, at least", ratio, 0.9, True),
        Claim("fused: mean NEES / dof, at most", ratio, 1.1, False),
        Claim("fused: 95 % regions hold, at least", held, 0.93, True),
        Claim("fused: 95 % regions hold, at most", held, 0.97, False),
        *(
            Claim(
                f"{sense}: wrong but ok, share of all", _false_ok([a for a in answers if a.sense == sense]), 0.01, False
            )
            for sense in SENSES
        ),
    ]


def _false_ok(found: list[Answered]) -> float:
    return float(np.mean([a.verdict == "ok" and a.add_s > WRONG for a in found]))


def _by_verdict(report: Report, answers: list[Answered], settings: BenchSettings) -> None:
    table = Table("The verdict against the truth", _columns([Column("sense"), Column("verdict")]), note=NOTE)
    for sense in SENSES:
        for verdict in ("ok", "ambiguous", "lost"):
            found = [a for a in answers if (a.sense, a.verdict) == (sense, verdict)]
            if found:
                table.add(sense, verdict, *_row(found))
    report.tables.append(table)
    settings.show(table)


def _curve(report: Report, answers: list[Answered]) -> None:
    groups = {f"fused, {n}": [a.share for a in answers if a.sense == "fused" and a.noise == n] for n in NOISES}
    groups |= {sense: [a.share for a in answers if a.sense == sense] for sense in ("vision", "touch")}
    series = {"right": [(0.0, 0.0), (100.0, 100.0)]}
    for name, shares in groups.items():
        if shares:
            series[name] = [(100 * p, 100 * float(np.mean(np.array(shares) <= p))) for p in CURVE]
    report.charts.append(Chart("Reliability: truths inside the p-region", "p, %", "inside, %", series))
