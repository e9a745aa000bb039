"""What parting the image by its colours is worth: frames of families whose hand nobody has a model of, without a mask,
answered with the image's colours telling apart what touches and without.

The outline has its say in both.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fusion.benchmarks.families.making import frames_of, judge_for, objects_of, why_not
from fusion.benchmarks.families.table import RECORDED, Family
from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Quantile, Rate, Table
from fusion.estimation.estimate import estimate
from fusion.estimation.settings import EstimateSettings
from vision.contour.lines import is_grey

SENSES = {"fused": ("vision", "touch"), "vision": ("vision",)}
# An answer is right within this ADD-S (m).
RIGHT = 0.005


@dataclass(frozen=True)
class Parted:
    """One frame answered without colours parting it and with: ADD-S (m), whether it was ok, processor seconds. start:
    whether it had one; used: whether colours parted it.
    """

    family: str
    sense: str
    start: bool
    add_s: tuple[float, float]
    ok: tuple[bool, bool]
    seconds: tuple[float, float]
    used: bool


def parts(family: Family) -> str:
    """Why a family's frames have nothing that colours could tell apart; "" when they have."""
    if family.name == RECORDED or family.mask or family.hand_known:
        return "a mask or a hand's model tells things apart"
    return why_not(family)


def answered(family: Family, level: float, name: str, trials: int, seed: int) -> Iterator[Parted]:
    """Every frame of the family with a true pose and a colour image, by each sense, with its start and without."""
    plain = EstimateSettings()
    without = replace(plain, look=replace(plain.look, colour=replace(plain.look.colour, used=False)))
    for made in frames_of(family, level, trials, seed, (name,)):
        frame, judge, truth = made.frame, judge_for(family, made), made.frame.camera_from_object_truth
        if frame.rgb is None or truth is None or is_grey(frame.rgb):
            continue
        for sense, use in SENSES.items():
            if sense == "fused" and not len(frame.contacts):
                continue  # the same as vision
            for start in (False, True):
                asked = frame if start else replace(frame, prior=None)
                both, spent = [], []
                for settings in (without, plain):
                    begin = time.process_time()
                    both.append(estimate(asked, made.model, use=use, seed=seed, settings=settings))
                    spent.append(time.process_time() - begin)
                errors = [judge.errors(one.pose, truth).add_s for one in both]
                stage = next(one for one in both[1].trace if one.name == "colours")
                ok = [one.verdict == "ok" for one in both]
                yield Parted(
                    family.name,
                    sense,
                    start,
                    (errors[0], errors[1]),
                    (ok[0], ok[1]),
                    (spent[0], spent[1]),
                    bool(stage.rows),
                )


def run(
    settings: BenchSettings, families: Sequence[Family], trials: int, most: float
) -> tuple[Table | None, list[Claim]]:
    """The table of the families that have something to tell apart, hidden up to the share `most`; None without one."""
    told: list[Parted] = []
    cells = [
        (family, level, name)
        for family in families
        if not parts(family)
        for level in settings.some([level for level in family.levels if level <= most], 1)
        for name in settings.some(objects_of(family, settings.objects), 2)
    ]
    for family, level, name in settings.progress(cells, len(cells), "parted by colour"):
        told += answered(family, level, name, trials, settings.seed)
    if not told:
        return None, []
    columns = [Column("family"), Column("sense"), Column("start"), Column("frames", 0), Column("parted")]
    columns += [Column("right without"), Column("right with"), Column("of right ADD-S mm without")]
    columns += [Column("of right ADD-S mm with"), Column("wrong but ok without", 0), Column("wrong but ok with", 0)]
    columns += [Column("ms without", 0), Column("ms with", 0)]
    note = f"Hidden up to {most:.0%}; neither mask nor hand model. Right: ADD-S up to 5 mm. ms: of the processor's."
    table = Table("Parted by colour", columns, note=note)
    keys = dict.fromkeys((one.family, one.sense, one.start) for one in told)
    for family, sense, start in keys:
        mine = [one for one in told if (one.family, one.sense, one.start) == (family, sense, start)]
        table.add(family, sense, "33 mm, 16°" if start else "none", len(mine), *_row(mine))
    claims = []
    for start, word in ((False, "without a start"), (True, "with a start")):
        mine = [one for one in told if one.start == start]
        if mine:
            shares = [float(np.mean([one.add_s[k] < RIGHT for one in mine])) for k in (0, 1)]
            claims.append(Claim(f"parted by colour, {word}: share right, more", shares[1] - shares[0], 0.0, True))
    return table, claims


def _row(mine: Sequence[Parted]) -> list[object]:
    right = [[one.add_s[k] < RIGHT for one in mine] for k in (0, 1)]
    near = [Quantile.of([one.add_s[k] for one in mine if one.add_s[k] < RIGHT], 1e3) for k in (0, 1)]
    wrong = [sum(one.ok[k] and not one.add_s[k] < RIGHT for one in mine) for k in (0, 1)]
    spent = [1e3 * float(np.median([one.seconds[k] for one in mine])) for k in (0, 1)]
    return [Rate.of([one.used for one in mine]), *(Rate.of(one) for one in right), *near, *wrong, *spent]
