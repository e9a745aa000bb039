"""Error against how much of the object is hidden: ICP baseline, vision, touch and both, on simulated grasps.

Every cell draws new grasps, views and noise. Starts are 16 degrees and 33 mm off in random directions (T1 section 4.3).
Three kinds of scenes: a grasping hand whose joints are known, in `clean` and in `lab` noise; and loose fingers that no
model tells of (`lab`), with five scattered contacts. A success is an ADD-S below 5 mm, modulo symmetry.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import Any

import numpy as np

from fusion.benchmarks.tables import BenchSettings, Claim, Column, Rate, Report, Spread, Table, own_seed

METHODS = ("icp", "icp_segmented", "vision", "touch", "fused")


@dataclass(frozen=True)
class Scene:
    """noise preset; what hides the object ("hand" or "fingers"); title of its table."""

    noise: str
    occluder: str
    title: str


SCENES = (
    Scene("clean", "hand", "a hand of known joints, clean: independent depth noise"),
    Scene(
        "lab",
        "hand",
        "a hand of known joints, lab: depth bias 2 mm, scale 0.5 %, calibration 2 mm / 0.3 deg, joints 0.3 deg",
    ),
    Scene("lab", "fingers", "loose fingers of which nothing is known, lab"),
)
OBJECTS = ("mug", "drill", "bottle", "hammer", "bust")
LEVELS = (0.0, 0.3, 0.6, 0.8)
FINGER_LEVELS = (0.0, 0.3, 0.6, 0.8, 0.9)


def run(settings: BenchSettings) -> Report:
    """Tables of success, median error, verdicts, calibration and time by scene, level and method."""
    trials = settings.count(10, quick=2)
    report = Report(
        "occlusion",
        "Error against the hidden share of the object, from a start 16 degrees and 33 mm off",
        f"{len(OBJECTS)} objects x {trials} frames a cell",
        settings.seed,
    )
    for scene in SCENES:
        _scene(report, scene, trials, settings)
    return report


def frames_of(name: str, scene: Scene, level: float, trials: int, seed: int) -> list[Any]:
    """Up to `trials` frames; a grasp that cannot hide so much is drawn anew from another seed, three times."""
    from scenes import library
    from scenes.errors import InputError
    from scenes.hand_generation import five_finger_hand
    from scenes.synthesis import synthesize_frames

    hand = five_finger_hand() if scene.occluder == "hand" else None
    made: list[Any] = []
    refused = 0
    while len(made) < trials and refused < 3:
        own = own_seed(seed, name, scene.noise, scene.occluder, level, len(made), refused)
        try:
            made += synthesize_frames(library.make(name), hand, 1, level, noise=scene.noise, seed=own)
        except InputError:
            refused += 1
    return made


def _scene(report: Report, scene: Scene, trials: int, settings: BenchSettings) -> None:
    from fusion.compare import compare_frame
    from fusion.judging import Judge
    from scenes import library

    table = Table(
        scene.title,
        [
            Column("hidden %", 0),
            Column("method"),
            Column("frames", 0),
            Column("ADD-S < 5 mm"),
            Column("median ADD-S mm"),
            Column("90 % mm"),
            Column("rotation deg"),
            Column("ok / ambiguous / lost"),
            Column("wrong but ok", 0),
            Column("NEES / 6"),
            Column("time ms", 0),
        ],
        note="Medians. Times with everything compiled. A calibrated covariance has a median NEES / 6 of 0.89.",
    )
    levels = LEVELS if scene.occluder == "hand" else FINGER_LEVELS
    cells = [(level, name) for level in levels for name in OBJECTS]
    rows: dict[tuple[float, str], list[Any]] = defaultdict(list)
    warm = False
    for level, name in settings.progress(cells, len(cells), f"{scene.noise}, {scene.occluder}"):
        judge = Judge(library.make(name))
        judge.model.field  # noqa: B018  (built before anything is timed)
        for frame in frames_of(name, scene, level, trials, settings.seed):
            if not warm:
                compare_frame(frame, judge, METHODS)
                warm = True
            for row in compare_frame(frame, judge, METHODS, settings.seed):
                rows[level, row.method].append(row)
    for level in levels:
        for method in METHODS:
            found = rows[level, method]
            error = np.array([row.errors.add_s for row in found if row.errors])
            if not len(error):
                continue
            verdicts = [sum(row.verdict == word for row in found) for word in ("ok", "ambiguous", "lost")]
            nees = [row.errors.nees / 6.0 for row in found if row.errors]
            table.add(
                100 * level,
                method,
                len(found),
                Rate.of(error < 0.005),
                1e3 * float(np.median(error)),
                1e3 * float(np.quantile(error, 0.9)),
                float(np.degrees(np.median([row.errors.rotation for row in found if row.errors]))),
                " / ".join(map(str, verdicts)) if method not in ("icp", "icp_segmented") else None,
                sum(row.verdict == "ok" and e > 0.005 for row, e in zip(found, error)) if "icp" not in method else None,
                Spread.of(nees).median if np.isfinite(nees).any() else None,
                float(np.median([row.time_ms for row in found])),
            )
    report.tables.append(table)
    _claims(report, scene, rows)


def _claims(report: Report, scene: Scene, rows: dict[tuple[float, str], list[Any]]) -> None:
    def median(level: float, method: str) -> float:
        return 1e3 * float(np.median([row.errors.add_s for row in rows[level, method]] or [np.nan]))

    def success(level: float) -> float:
        return float(np.mean([row.errors.add_s < 0.005 for row in rows[level, "fused"]] or [np.nan]))

    if scene.occluder != "hand":
        return
    if scene.noise == "lab":
        report.claims += [
            Claim("lab, 60 % hidden: fused success", success(0.6), 0.95, True),
            Claim("lab, 80 % hidden: fused success", success(0.8), 0.90, True),
            Claim("lab, 60 % hidden: fused median ADD-S (mm)", median(0.6, "fused"), 2.0, False),
            Claim("lab, 80 % hidden: fused median ADD-S (mm)", median(0.8, "fused"), 3.0, False),
            Claim("lab, 80 %: ICP on the crop over fused", median(0.8, "icp") / median(0.8, "fused"), 4.0, True),
            Claim(
                "lab, 80 %: segmented ICP over fused", median(0.8, "icp_segmented") / median(0.8, "fused"), 1.0, True
            ),
        ]
    else:
        report.claims += [
            Claim("clean, 60 % hidden: fused median ADD-S (mm)", median(0.6, "fused"), 0.5, False),
            Claim("clean, 80 % hidden: fused median ADD-S (mm)", median(0.8, "fused"), 1.0, False),
        ]
