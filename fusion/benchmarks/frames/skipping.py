"""What is not done where a scene does not need it: time and error with every stage run, with those skipped that change
nothing, and with those that a tolerance makes needless; from scenes in plain sight to hidden ones.
"""

from __future__ import annotations

import time
from collections import defaultdict
from dataclasses import dataclass, replace

import numpy as np

from fusion.benchmarks.families.making import frames_of
from fusion.benchmarks.families.table import FAMILIES, TUNED_OBJECTS
from fusion.benchmarks.printing.one_thread import one_thread
from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Quantile, Rate, Report, Table
from fusion.estimation.answer import Estimate
from fusion.truth.errors import Errors

# noise preset, hidden share; the first ones are easy
SCENES = (("clean", 0.0), ("lab", 0.0), ("clean", 0.3), ("lab", 0.3), ("lab", 0.6), ("lab", 0.8))
EASY = 2
# What a gripper needs to approach (m, rad): more than the errors that all pixels of a frame share, which only the
# joint solution tells from none.
TOLERANCE = (0.005, float(np.deg2rad(5.0)))
EVERYTHING, SKIPPING, TOLERANT = "everything", "skipping", "skipping, 5 mm 5 deg"
METHODS = (EVERYTHING, SKIPPING, TOLERANT)


@dataclass
class _Found:
    answers: list[Estimate]
    errors: list[Errors]
    seconds: list[float]


def run(settings: BenchSettings) -> Report:
    """One table a scene and planner; the start is 16 degrees and 33 mm off."""
    trials = settings.count(10, quick=1)
    objects = settings.objects or tuple(settings.some(TUNED_OBJECTS, 1))
    report = Report(
        "skipping",
        "Time and error with everything done, and with what a scene does not need left out",
        f"{len(objects)} objects x {trials} frames a scene",
        settings.seed,
    )
    table = Table(
        "from a start 16 degrees and 33 mm off",
        [
            Column("scene"),
            Column("planner"),
            Column("frames", 0),
            Column("median ADD-S mm"),
            Column("mean ADD-S mm"),
            Column("< 5 mm"),
            Column("NEES / 6"),
            Column("starts", 0),
            Column("solved together"),
            Column("touched"),
            Column("median cpu ms", 1),
            Column("times faster", 1),
        ],
        note="NEES: median, 0.89 is calibrated. Starts: median looked at. Solved together, touched: share of frames in"
        " which that stage ran. Processor time on one thread, all compiled, each frame through all planners in turn;"
        " everything: all 320 starts, touch and every descent, a walk from all of them.",
    )
    for number, (noise, hidden) in enumerate(SCENES):
        with one_thread():
            found = _scene(noise, hidden, objects, trials, settings)
        name = f"{noise}, {hidden:.0%} hidden"
        base = _time(found[EVERYTHING])
        for method in METHODS:
            one = found[method]
            if not one.answers:
                continue
            add_s = 1e3 * np.array([e.add_s for e in one.errors])
            table.add(
                name,
                method,
                len(add_s),
                Quantile.of(add_s),
                float(add_s.mean()),
                Rate.of(add_s < 5.0),
                Quantile.of([e.nees / 6 for e in one.errors]),
                float(np.median([_starts(a) for a in one.answers])),
                Rate.of([_ran(a, "solve together") for a in one.answers]),
                Rate.of([_ran(a, "feel") for a in one.answers]),
                _time(one),
                base / _time(one),
            )
        if number < EASY and found[EVERYTHING].answers:
            _claims(report, name, found)
    report.tables.append(table)
    settings.show(table)
    return report


def _scene(
    noise: str, hidden: float, objects: tuple[str, ...], trials: int, settings: BenchSettings
) -> dict[str, _Found]:
    """Every frame through every planner, in turn."""
    from fusion.estimation.estimate import estimate
    from fusion.estimation.search.modes import PlanSettings
    from fusion.estimation.settings import EstimateSettings
    from fusion.truth.errors import Judge
    from scenes.synthesis import library

    quick = EstimateSettings()
    whole = replace(quick, plan=PlanSettings(skipping=False))
    ways = {EVERYTHING: (whole, None), SKIPPING: (quick, None), TOLERANT: (quick, TOLERANCE)}
    found: dict[str, _Found] = defaultdict(lambda: _Found([], [], []))
    for name in settings.progress(objects, len(objects), f"{noise}, {hidden:.0%}"):
        model = library.make(name)
        judge = Judge(model)
        for i, made in enumerate(frames_of(FAMILIES[noise], hidden, trials, settings.seed, (name,))):
            frame, truth = made.frame, made.frame.camera_from_object_truth
            assert truth is not None
            for method, (how, tolerance) in ways.items():
                if i == 0:  # compiles and loads before anything is timed
                    estimate(frame, model, tolerance=tolerance, settings=how)
                begin = time.process_time()
                answer = estimate(frame, model, tolerance=tolerance, seed=settings.seed, settings=how)
                found[method].seconds.append(time.process_time() - begin)
                error = judge.errors(answer.pose, truth, answer.covariance)
                found[method].answers.append(answer)
                found[method].errors.append(error)
    return found


def _claims(report: Report, name: str, found: dict[str, _Found]) -> None:
    def median(method: str) -> float:
        return float(np.median([e.add_s for e in found[method].errors]))

    report.claims += [
        Claim(f"{name}: error, skipping over everything", median(SKIPPING) / median(EVERYTHING), 1.05, False),
        Claim(f"{name}: time, everything over skipping", _time(found[EVERYTHING]) / _time(found[SKIPPING]), 3.0, True),
        Claim(f"{name}: time, everything over tolerant", _time(found[EVERYTHING]) / _time(found[TOLERANT]), 3.0, True),
    ]


def _time(found: _Found) -> float:
    return 1e3 * float(np.median(found.seconds or [np.nan]))


def _ran(answer: Estimate, stage: str) -> bool:
    return any(s.name == stage and s.ran for s in answer.trace)


def _starts(answer: Estimate) -> int:
    """Starts that the search looked at, from its line in the trace ("32 of 320 starts")."""
    words = next((s.why for s in answer.trace if s.name == "search" and s.ran), "0").split()
    return int(words[0]) if words and words[0].isdigit() else 0
