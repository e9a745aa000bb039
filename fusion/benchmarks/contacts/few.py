"""Few contacts and no start: how often the default is right, how often it says so, and whether both are the same.

What is 95 % sure may be wrong in 1 of 20; what a search has not found no posterior knows of.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fusion.benchmarks.contacts import trials as scene
from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Rate, Report, Table
from fusion.benchmarks.strata import WRONG, freedom, gathered
from scenes.errors import unknown
from scenes.recordings.frames import Contacts
from scenes.synthesis import library
from scenes.synthesis.noise.presets import TouchNoise

CONTACTS = (3, 4, 5, 6, 8, 12)
# Noise of points (m) that a trial draws one of; of normals (rad).
POINTS, NORMALS = (0.5e-3, 1e-3, 3e-3), 0.12
# Shares of wrong answers that are called `ok`, of all, as asked of answers to frames by touch alone, and of those that
# are `ok`, which are 95 % sure; and how far the mean confidence may be from the share of right answers.
MOST_WRONG, MOST_OF_SURE, MOST_OFF = 0.03, 0.05, 0.05


@dataclass(frozen=True)
class FewCell:
    """Trials of an object with so many contacts."""

    name: str
    contacts: int
    trials: int
    seed: int


@dataclass(frozen=True)
class Tried:
    """One answer. normals, told: whether the contacts have normals and say their sigma; holds: whether its region of
    95 % holds the truth; ms: processor time.
    """

    name: str
    contacts: int
    normals: bool
    told: bool
    right: bool
    verdict: str
    confidence: float
    holds: bool
    ms: float

    @property
    def ok(self) -> bool:
        """Whether it is said to be so."""
        return self.verdict == "ok"


def try_cell(cell: FewCell) -> list[Tried]:
    """Every trial of a cell, with normals and without, told the sigmas and not."""
    from scipy.stats import chi2

    from fusion.truth.errors import Judge
    from touch.localization import localize

    model = library.make(cell.name)
    judge, region = Judge(model), float(chi2.ppf(0.95, freedom(model.symmetries)))
    out = []
    for size in range(len(POINTS)):
        noise = TouchNoise(point=POINTS[size], normal=NORMALS)
        count = len(range(size, cell.trials, len(POINTS)))
        for i, trial in enumerate(scene.trials(model, cell.contacts, noise, count, cell.seed + 1000 * size)):
            felt = trial.contacts
            for normals in (True, False):
                for told in (True, False):
                    contacts = Contacts(
                        felt.points,
                        felt.normals if normals else None,
                        felt.sigma_point if told else None,
                        felt.sigma_normal if told and normals else None,
                    )
                    begin = time.process_time()
                    answer = localize(model, contacts, seed=i)
                    ms = 1e3 * (time.process_time() - begin)
                    errors = judge.errors(answer.pose, trial.truth, answer.covariance)
                    right, holds = errors.add_s < WRONG, errors.nees <= region
                    case = cell.name, cell.contacts, normals, told
                    out.append(Tried(*case, right, answer.verdict, answer.confidence, holds, ms))
    return out


def run(settings: BenchSettings) -> Report:
    """Two tables and their demands."""
    trials = settings.count(12, 1)
    known = (*library.names(), *library.tool_names(), *library.held_out_names())
    for name in settings.objects or ():
        if name not in known:
            raise unknown("--objects", name, known, "some of")
    names = settings.some(settings.objects or (*library.names(), *library.held_out_names()), 2)
    counts = CONTACTS[::3] if settings.quick else CONTACTS
    cells = [FewCell(name, count, trials, settings.seed) for name in names for count in counts]
    report = Report(
        "few",
        "Few contacts and no start: is what is sure right?",
        f"{trials} trials of each object and number of contacts, {len(names)} objects",
        settings.seed,
    )
    # not in the order of who was done first: sums must come out the same
    found = sorted(gathered(try_cell, cells, settings), key=lambda t: (names.index(t.name), t.contacts))
    by_count = _table("By what is felt", ("normals", "sigma told", "contacts"))
    for normals in (True, False):
        for told in (True, False):
            for count in counts:
                case = [t for t in found if (t.normals, t.told, t.contacts) == (normals, told, count)]
                by_count.add(*("yes" if one else "no" for one in (normals, told)), str(count), *_cells(case))
    by_count.add("all", "all", "all", *_cells(found))
    by_object = _table("By object", ("object",))
    for name in names:
        by_object.add(name, *_cells([t for t in found if t.name == name]))
    for table in (by_count, by_object):
        report.tables.append(table)
        settings.show(table)
    wrong = _share(found, lambda t: t.ok and not t.right)
    off = abs(float(np.mean([t.confidence - t.right for t in found])))
    of_sure = _share([t for t in found if t.ok], lambda t: not t.right)
    report.claims += [
        Claim("wrong, but ok: share of all", wrong, MOST_WRONG, False, 3),
        Claim("wrong: share of those that are ok", of_sure, MOST_OF_SURE, False, 3),
        Claim("mean confidence less share of right answers", off, MOST_OFF, False, 3),
    ]
    return report


def _table(title: str, head: tuple[str, ...]) -> Table:
    columns = ("< 5 mm", "said ok", "wrong, but ok", "mean confidence", "95 % region holds")
    sizes = ", ".join(f"{1e3 * size:g}" for size in POINTS)
    note = (
        f"Contacts anywhere on the object, {sizes} mm and {np.rad2deg(NORMALS):.0f} degrees off, no start. Confidence:"
        " the probability of less than 5 mm that the answer states; ok: from 95 % on."
        " CPU ms: processor time of an answer, median."
    )
    return Table(title, [*(Column(name) for name in (*head, *columns)), Column("CPU ms", 0)], note=note)


def _cells(tried: Sequence[Tried]) -> tuple[Rate, Rate, Rate, float, Rate, float]:
    return (
        Rate.of([t.right for t in tried]),
        Rate.of([t.ok for t in tried]),
        Rate.of([t.ok and not t.right for t in tried]),
        float(np.mean([t.confidence for t in tried])),
        Rate.of([t.holds for t in tried]),
        float(np.median([t.ms for t in tried])),
    )


def _share(tried: Sequence[Tried], is_so: Callable[[Tried], bool]) -> float:
    return Rate.of([is_so(t) for t in tried]).share if tried else 0.0
