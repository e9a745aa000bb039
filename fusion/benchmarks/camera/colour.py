"""What colours are worth: the same frames with and without those of the outline, by family, recorded ones too; with
and without those that part what touches; and with and without those of a print.

Lateral error: how far the centroid is off across the camera's ray. Recorded frames are judged by how the outline
overlaps the mask that somebody drew, and by how far the mask's pixels lie from the surface.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.camera import parting, prints
from fusion.benchmarks.families.making import frames_of, judge_for, objects_of, why_not
from fusion.benchmarks.families.table import FAMILIES, RECORDED, Family, chosen
from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Quantile, Rate, Report, Table, own_seed
from fusion.benchmarks.real.frames import captures, folder
from fusion.benchmarks.strata import REGION, freedom
from fusion.estimation.answer import Estimate
from fusion.estimation.estimate import estimate
from fusion.estimation.settings import EstimateSettings
from scenes.errors import InputError
from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Frame

Array = NDArray[np.float64]

# Hidden shares that are asked: beyond, little of an outline is left.
MOST_HIDDEN = 0.6
# Families where nothing is said of others: those that may be tuned on, but not the one without an error to mend.
USUAL = ("d435", "dots", "lab", "loose", "desk")
# Start of a recorded frame: as far off (rad, m) as a tracker or a hand in view leaves it.
START = (float(np.deg2rad(5.0)), 0.010)
# What was asked: how much lower errors are on cameras imitated from their optics (a share), how far the centroid is
# off across the ray (m), processor time (ms), overlap with masks, residual of depth over that without.
OPTICAL = ("d435", "dots", "d455", "xtion", "azure-kinect", "l515")
LOWER, LATERAL, MORE_MS, OVERLAP, RESIDUAL = 0.25, 0.0005, 5.0, 0.93, 1.0
SENSES = {"fused": ("vision", "touch"), "vision": ("vision",)}


@dataclass(frozen=True)
class Pair:
    """One frame answered without colours and with: ADD-S and lateral errors (m), chi-square shares of the NEES,
    processor ms that the outline took more.
    """

    family: str
    sense: str
    level: float
    add_s: tuple[float, float]
    lateral: tuple[float, float]
    share: tuple[float, float]
    ms: float
    used: bool


def answers(frame: Frame, model: ObjectModel, use: Sequence[str], seed: int) -> tuple[Estimate, Estimate, float]:
    """The frame's answers without colours of the outline and with them; processor ms that these took more."""
    plain = EstimateSettings()
    without, colour = (replace(plain, contour=replace(plain.contour, used=used, own=used)) for used in (False, True))
    out, spent = [], []
    for one in (without, colour):
        begin = time.process_time()
        out.append(estimate(frame, model, use=use, seed=seed, settings=one))
        spent.append(time.process_time() - begin)
    return out[0], out[1], 1e3 * (spent[1] - spent[0])


def lateral(pose: Array, truth: Array, model: ObjectModel) -> float:
    """How far (m) the centroid at pose (4, 4) is from the truth's, across the camera's ray."""
    at, there = (poses.apply(one, model.centroid[None])[0] for one in (pose, truth))
    ray = there / max(float(np.linalg.norm(there)), 1e-9)
    off = at - there
    return float(np.linalg.norm(off - (off @ ray) * ray))


def pairs_of(family: Family, levels: Sequence[float], names: Sequence[str], trials: int, seed: int) -> Iterator[Pair]:
    """Every frame of the family with a true pose and a colour image, by each sense."""
    from scipy.stats import chi2

    for level in levels:
        for made in frames_of(family, level, trials, seed, tuple(names)):
            frame, judge = made.frame, judge_for(family, made)
            truth = frame.camera_from_object_truth
            if frame.rgb is None or truth is None:
                continue
            count = freedom(judge.model.symmetries)
            for sense, use in SENSES.items():
                if sense == "vision" and not len(frame.contacts):
                    continue  # the same as fused
                *both, ms = answers(frame, made.model, use, seed)
                errors = [judge.errors(one.pose, truth, one.covariance) for one in both]
                stage = next((one for one in both[1].trace if one.name == "outline"), None)
                yield Pair(
                    family.name,
                    sense,
                    level,
                    (errors[0].add_s, errors[1].add_s),
                    (lateral(both[0].pose, truth, judge.model), lateral(both[1].pose, truth, judge.model)),
                    (float(chi2.cdf(errors[0].nees, count)), float(chi2.cdf(errors[1].nees, count))),
                    ms,
                    bool(stage is not None and stage.rows),
                )


def run(settings: BenchSettings) -> Report:
    """A table of families, one of recorded frames."""
    trials = settings.count(1, 1)
    families = chosen(settings.family) if settings.family else tuple(FAMILIES[name] for name in USUAL)
    families = tuple(one for one in families if one.name != RECORDED)
    report = Report("colour", "With the colours of the outline and without", f"{trials} frames of each", settings.seed)
    cells = []
    for family in families:
        if not why_not(family):
            names = settings.some(objects_of(family, settings.objects), 2)
            levels = settings.some([level for level in family.levels if level <= MOST_HIDDEN], 1)
            cells += [(family, level, name) for level in levels for name in names]
    pairs: list[Pair] = []
    for family, level, name in settings.progress(cells, len(cells), "colour"):
        pairs += pairs_of(family, [level], [name], trials, settings.seed)
    table = _families(pairs, [one.name for one in families])
    report.tables.append(table)
    settings.show(table)
    report.claims += _claims(pairs)
    recorded, claims = _recorded(settings)
    report.claims += claims
    parted, told = parting.run(settings, families, trials, MOST_HIDDEN)
    report.claims += told
    printed, asked = prints.run(settings, trials)
    for one in (recorded, parted, printed):
        if one is not None:
            report.tables.append(one)
            settings.show(one)
    report.claims += asked
    return report


def _claims(pairs: Sequence[Pair]) -> list[Claim]:
    """What was asked of each family: a quarter less error on cameras imitated from their optics, none more elsewhere;
    half a millimetre across the ray where at most 30 % is hidden; milliseconds.
    """
    out = []
    for sense in SENSES:
        for name in dict.fromkeys(one.family for one in pairs):
            mine = [one for one in pairs if one.family == name and one.sense == sense]
            if not mine:
                continue
            before, after = (float(np.median([one.add_s[k] for one in mine])) for k in (0, 1))
            least = LOWER if FAMILIES[name].camera in OPTICAL else 0.0
            gain = 1.0 - after / max(before, 1e-9)
            out.append(Claim(f"{name}, {sense}: median ADD-S lower by", gain, least, True))
            shown = [one.lateral[1] for one in mine if not one.level > 0.3]
            if shown:
                what = f"{name}, {sense}: lateral mm to 30 % hidden"
                out.append(Claim(what, 1e3 * float(np.median(shown)), 1e3 * LATERAL, False))
    more = [one.ms for one in pairs if one.used]
    return [*out, Claim("processor ms more a frame", float(np.median(more)) if more else math.nan, MORE_MS, False, 1)]


def _families(pairs: Sequence[Pair], names: Sequence[str]) -> Table:
    columns = [Column("family"), Column("sense"), Column("frames", 0), Column("used"), Column("ADD-S mm without")]
    columns += [Column("ADD-S mm with"), Column("lateral mm without"), Column("lateral mm with")]
    columns += [Column("lateral mm to 30 % hidden"), Column(f"{REGION:.0%} without"), Column(f"{REGION:.0%} with")]
    columns += [Column("nearer with"), Column("ms", 1)]
    note = (
        f"Medians; hidden up to {MOST_HIDDEN:.0%}; a start 16 degrees and 33 mm off. {REGION:.0%}: share of truths that"
        " such regions hold. Used: frames whose outline had a say. Nearer with: of those, by ADD-S. ms: more of the"
        " processor's."
    )
    table = Table("By family", columns, note=note)
    for name in names:
        for sense in SENSES:
            mine = [one for one in pairs if one.family == name and one.sense == sense]
            if not mine:
                continue
            used = [one for one in mine if one.used]
            errors = [Quantile.of([one.add_s[k] for one in mine], 1e3) for k in (0, 1)]
            across = [1e3 * float(np.median([one.lateral[k] for one in mine])) for k in (0, 1)]
            shown = [one.lateral[1] for one in mine if not one.level > 0.3]
            held = [Rate.of([one.share[k] <= REGION for one in mine]) for k in (0, 1)]
            table.add(
                name,
                sense,
                len(mine),
                Rate.of([one.used for one in mine]),
                *errors,
                *across,
                1e3 * float(np.median(shown)) if shown else math.nan,
                *held,
                Rate.of([one.add_s[1] < one.add_s[0] for one in used]),
                float(np.median([one.ms for one in mine])),
            )
    return table


def _recorded(settings: BenchSettings) -> tuple[Table | None, list[Claim]]:
    """Recorded frames, their masks left out of what is asked and used to judge; None where there are none."""
    try:
        root = folder(settings.data)
    except InputError:
        return None, []
    columns = [Column("recording"), Column("overlap without", 3), Column("overlap with", 3)]
    columns += [Column("residual mm without"), Column("residual mm with"), Column("ADD-S mm without")]
    columns += [Column("ADD-S mm with"), Column("outline")]
    note = (
        f"No mask; a start {1e3 * START[1]:.0f} mm and {np.rad2deg(START[0]):.0f} degrees off. Overlap with the mask;"
        " residual: of the mask's pixels. ADD-S where the pose is known. Last row: medians."
    )
    table = Table("Recorded frames", columns, note=note)
    rows = []
    for one in captures(root, 1, 3 if settings.quick else None):
        if isinstance(one, str) or one.reference is None or one.frame.rgb is None:
            continue
        rng = np.random.default_rng(own_seed(settings.seed, one.name))
        start = poses.displaced(one.reference, *START, one.model.centroid, rng)
        *both, _ = answers(replace(one.frame, mask=None, prior=start), one.model, SENSES["fused"], settings.seed)
        found = [[measure(each.pose) for each in both] for measure in (one.overlap, one.residual)]
        errors = [math.nan if one.truth is None else one.judge.errors(each.pose, one.truth).add_s for each in both]
        row = [*found[0], *(1e3 * value for value in found[1]), *(1e3 * value for value in errors)]
        rows.append(row)
        table.add(one.name, *row, next((stage.why for stage in both[1].trace if stage.name == "outline"), ""))
    if not rows:
        return None, []
    middle = [float(np.median(values[np.isfinite(values)])) for values in np.array(rows).T if np.isfinite(values).any()]
    table.add("median", *middle, *[math.nan] * (6 - len(middle)), "")
    more = float(np.median([row[3] / max(row[2], 1e-9) for row in rows]))
    claims = [
        Claim("recorded frames: median overlap with the mask", middle[1], OVERLAP, True, 3),
        Claim("recorded frames: residual of depth over that without, median", more, RESIDUAL, False),
    ]
    return table, claims
