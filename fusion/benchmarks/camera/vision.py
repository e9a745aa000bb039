"""Vision alone: registration with and without a coarse start, against the methods others use, by hidden share.

Every object is held by a five-finger hand and seen by a depth camera; nothing is felt. `clean` frames come with the
object's mask, `lab` frames (depth bias 2 mm, scale 0.5 %, flying pixels, calibration 2 mm and 0.3 degrees) without.
All methods get the points that our segmentation leaves to the object (without a start with table, hand and clutter
taken away); its time is part of theirs. A success is an ADD-S
below 5 mm, modulo symmetry.
"""

from __future__ import annotations

import tempfile
import time
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fusion.benchmarks.camera import frames as vision_frames
from fusion.benchmarks.families.table import chosen
from fusion.benchmarks.printing.charts import Chart
from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Quantile, Rate, Report, Table
from fusion.benchmarks.strata import add_strata, cells_of, collect

if TYPE_CHECKING:
    from fusion.truth.errors import Judge
    from scenes.recordings.frames import Frame

Array = NDArray[np.float64]

OURS = "palpate"
SUCCESS = 0.005
# Success demanded at 0, 30, 60 and 80 % hidden: (noise, with a start) -> shares.
DEMANDS = {
    ("clean", False): (0.99, 0.98, 0.95, 0.75),
    ("lab", False): (0.97, 0.95, 0.88, 0.60),
    ("clean", True): (0.99, 0.99, 0.98, 0.92),
    ("lab", True): (0.98, 0.97, 0.93, 0.75),
}
# Methods that take seconds, and half a minute to prepare an object: on the first frame of a cell only, none in a hurry.
SLOW = ("ppf",)
# Frames of an object at each hidden share of a family.
FAMILY_TRIALS = 1
# Resamplings of a bootstrap interval.
RESAMPLED = 2000


@dataclass(frozen=True)
class Trial:
    """One method on one frame. add_s (m); nees per degree of freedom, NaN for a method without covariance; milliseconds
    by the clock, of the processor, and by the clock without the segmentation; verdict "" of a method that does not
    judge itself.
    """

    name: str
    add_s: float
    nees: float
    wall_ms: float
    cpu_ms: float
    after_ms: float
    verdict: str = ""


def run(settings: BenchSettings) -> Report:
    """Tables with and without a start, the settings of the peers, demands, and time against error."""
    from scenes.synthesis.hands import five_finger_hand

    if settings.family is not None:
        report = Report("vision", "Registration of what the camera sees, by family", "", settings.seed)
        report.trials = f"{settings.count(FAMILY_TRIALS, quick=1)} frames of an object at each hidden share"
        _families(report, settings)
        return report
    makers = vision_frames.objects(settings.objects or (("drill",) if settings.quick else None))
    count = settings.count(4, quick=1)
    report = Report(
        "vision",
        "Registration of what the camera sees, by hidden share",
        f"{len(makers)} objects x {count} frames a cell ({', '.join(makers)})",
        settings.seed,
    )
    hand = five_finger_hand()
    found: dict[tuple[Any, ...], list[Trial]] = defaultdict(list)
    cells = [(name, preset) for name in makers for preset in vision_frames.PRESETS]
    with tempfile.TemporaryDirectory() as spare:
        folder = Path(spare) if settings.folder is None else settings.folder / "captures"
        bench = _Bench(settings.seed, settings.quick)
        for name, preset in settings.progress(cells, len(cells), "vision"):
            model = makers[name]()
            model.field  # noqa: B018  (built before anything is timed)
            for level in vision_frames.LEVELS[1::2] if settings.quick else vision_frames.LEVELS:
                made = vision_frames.frames(folder, name, model, hand, preset, level, count, settings.seed)
                for (method, start), trial in bench.trials(name, model, made):
                    found[preset, start, level, method].append(trial)
    for start in (False, True):
        for preset in vision_frames.PRESETS:
            report.tables.append(_table(found, preset, start))
            report.charts.append(_chart(found, preset, start))
            _claims(report, found, preset, start)
    _families(report, replace(settings, objects=None))
    report.tables.append(_settings_table())
    from vision.published import registration as baselines

    if "small_gicp" not in baselines.available():
        report.tables[-1].note = "small_gicp is not installed (pip install 'palpate[peers]') and was left out."
    return report


def _families(report: Report, settings: BenchSettings) -> None:
    """Vision alone, ICP beside, on frames of the families, with a start and without."""
    trials = settings.count(FAMILY_TRIALS, quick=1)
    cells, missing = cells_of(chosen(settings.family), trials, settings)
    alone = ("icp", "vision")
    answers = collect([replace(cell, with_start=alone, without_start=alone) for cell in cells], settings)
    add_strata(report, answers, missing, settings)


class _Bench:
    """Runs methods on frames; the first run of each on an object is done twice: it compiles, or prepares the object."""

    def __init__(self, seed: int, quick: bool = False) -> None:
        self.seed, self.quick = seed, quick
        self._prepared: set[tuple[str, str, bool]] = set()

    def trials(self, name: str, model: Any, frames: list[Frame]) -> Iterable[tuple[tuple[str, bool], Trial]]:
        from fusion.truth.errors import Judge
        from vision.published import registration as baselines

        judge = Judge(model)
        methods = {False: (OURS, *baselines.GLOBAL), True: (OURS, *baselines.LOCAL)}
        for number, frame in enumerate(frames):
            for start in (False, True):
                seen = frame if start else replace(frame, prior=None)
                for method in methods[start]:
                    if method != OURS and method not in baselines.available():
                        continue
                    if method in SLOW and (number > 0 or self.quick):
                        continue
                    if (name, method, start) not in self._prepared:
                        self._prepared.add((name, method, start))
                        self.trial(name, method, seen, judge)
                    yield (method, start), self.trial(name, method, seen, judge)

    def trial(self, name: str, method: str, frame: Frame, judge: Judge) -> Trial:
        """One method on one frame, from its prior when it has one."""
        from fusion.estimation.estimate import estimate
        from vision.look.look import object_points
        from vision.published import registration as baselines

        truth = frame.camera_from_object_truth
        assert truth is not None
        wall, cpu = time.perf_counter(), time.process_time()
        if method == OURS:
            answer = estimate(frame, judge.model, use=("vision",), seed=self.seed)
            pose, covariance, verdict = answer.pose, answer.covariance, answer.verdict
            looking = sum(stage.ms for stage in answer.trace if stage.name == "look")
        else:
            points = object_points(frame, judge.model, frame.prior)
            looking = 1e3 * (time.perf_counter() - wall)
            pose = baselines.register(method, points, judge.model, frame.prior, self.seed)
            covariance, verdict = None, ""
        wall, cpu = 1e3 * (time.perf_counter() - wall), 1e3 * (time.process_time() - cpu)
        errors = judge.errors(pose, truth, covariance)
        symmetries = judge.model.symmetries
        freedom = 3 if symmetries.is_spherical else 6 - min(1, len(symmetries.axes))
        return Trial(name, errors.add_s, errors.nees / freedom, wall, cpu, wall - looking, verdict)


def bootstrap(values: ArrayLike, seed: int = 0) -> tuple[float, float]:
    """95 % interval of the mean by resampling (Efron 1979); NaN without finite values."""
    array = np.asarray(values, dtype=np.float64)
    array = array[np.isfinite(array)]
    if not len(array):
        return float("nan"), float("nan")
    rng = np.random.default_rng(seed)
    means = array[rng.integers(len(array), size=(RESAMPLED, len(array)))].mean(axis=1)
    low, high = np.quantile(means, [0.025, 0.975])
    return float(low), float(high)


def _table(found: dict[tuple[Any, ...], list[Trial]], preset: vision_frames.Preset, start: bool) -> Table:
    title = f"{preset.title}, {'from a start 16 degrees and 33 mm off' if start else 'no start'}"
    columns = [Column("hidden %", 0), Column("method"), Column("frames", 0), Column("ADD-S < 5 mm"), Column("95 %")]
    columns += [Column("generated"), Column("scanned"), Column("median ADD-S mm"), Column("90 % mm")]
    columns += [Column("ms", 0), Column("cpu ms", 0), Column("after segmentation ms", 0)]
    columns += [Column("NEES / dof"), Column("95 % "), Column("median", 2), Column("wrong but ok", 0)]
    note = (
        "Medians of times (segmentation included in ms and cpu ms); NEES / dof: mean over frames with its bootstrap"
        " interval, 1 is calibrated, and median, 0.89 is."
    )
    table = Table(title, columns, note=note)
    for level in vision_frames.LEVELS:
        for method in dict.fromkeys(key[3] for key in found if key[:2] == (preset, start)):
            trials = found.get((preset, start, level, method), [])
            if not trials:
                continue
            error = np.array([t.add_s for t in trials])
            good = error < SUCCESS
            scanned = np.array([t.name.startswith(vision_frames.SCANNED) for t in trials])
            nees = np.array([t.nees for t in trials])
            interval = bootstrap(nees)
            ours = np.isfinite(nees).any()
            table.add(
                100 * level,
                method,
                len(trials),
                Rate.of(good),
                _range(*Rate.of(good).interval, 100.0, 0),
                Rate.of(good[~scanned]),
                Rate.of(good[scanned]),
                Quantile.of(error, 1e3),
                Quantile.of(error, 1e3, 0.9),
                *(Quantile.of([getattr(t, n) for t in trials]) for n in ("wall_ms", "cpu_ms", "after_ms")),
                float(np.nanmean(nees)) if ours else None,
                _range(*interval, 1.0, 2) if ours else None,
                Quantile.of(nees) if ours else None,
                sum(t.verdict == "ok" and t.add_s >= SUCCESS for t in trials) if ours else None,
            )
    return table


def _range(low: float, high: float, scale: float, digits: int) -> str:
    return f"{scale * low:.{digits}f}-{scale * high:.{digits}f}"


def _chart(found: dict[tuple[Any, ...], list[Trial]], preset: vision_frames.Preset, start: bool) -> Chart:
    """Median time against the share that fails, a point a level: down and to the left is better."""
    series: dict[str, list[tuple[float, float]]] = defaultdict(list)
    for level in vision_frames.LEVELS:
        for key, trials in found.items():
            if key[:3] == (preset, start, level):
                cpu = float(np.median([t.cpu_ms for t in trials]))
                series[key[3]].append((cpu, 100 * float(np.mean([t.add_s >= SUCCESS for t in trials]))))
    what = "with a start" if start else "no start"
    title = f"{preset.title}, {what}: failures against time, 0 to 80 % hidden"
    return Chart(title, "median processor time, ms", "frames beyond 5 mm, %", series, log_x=True)


def _claims(
    report: Report, found: dict[tuple[Any, ...], list[Trial]], preset: vision_frames.Preset, start: bool
) -> None:
    what = f"{preset.title}, {'with a start' if start else 'no start'}"
    times = []
    for level, demand in zip(vision_frames.LEVELS, DEMANDS[preset.noise, start]):
        trials = found.get((preset, start, level, OURS), [])
        if not trials:
            continue
        share = float(np.mean([t.add_s < SUCCESS for t in trials]))
        report.claims.append(Claim(f"{what}, {100 * level:.0f} % hidden: success", share, demand, True))
        times += [t.after_ms if start else t.wall_ms for t in trials]
        if level <= 0.6 and start:
            nees = float(np.mean([t.nees for t in trials]))
            report.claims.append(Claim(f"{what}, {100 * level:.0f} % hidden: NEES / dof", nees, 0.8, True))
            report.claims.append(Claim(f"{what}, {100 * level:.0f} % hidden: NEES / dof", nees, 1.2, False))
    if times:
        limit, part = (15.0, "after segmentation") if start else (100.0, "whole")
        report.claims.append(Claim(f"{what}: median time (ms), {part}", float(np.median(times)), limit, False, 0))


def _settings_table() -> Table:
    from dataclasses import asdict

    from vision.published.icp import CloudIcpSettings
    from vision.published.registration import BaselineSettings

    table = Table("Settings of the peers", [Column("setting"), Column("value")])
    for name, value in {**asdict(BaselineSettings()), "icp from a start": asdict(CloudIcpSettings())}.items():
        parts = {f"{name}: {k}": v for k, v in value.items()} if isinstance(value, dict) else {name: value}
        for part, content in parts.items():
            table.add(part.replace("_", " "), str(content))
    return table
