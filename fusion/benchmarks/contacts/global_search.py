"""No prior at all: where is the object, from three to five contacts (T1 section 4.3.1.2), every global method a row."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fusion.benchmarks.contacts import trials as scene
from fusion.benchmarks.contacts.local import bound_ratios
from fusion.benchmarks.printing.charts import Chart
from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Quantile, Rate, Report, Spread, Table
from scenes.geometry.objects import ObjectModel
from scenes.synthesis import library
from scenes.synthesis.noise.presets import TouchNoise

# T1's object, a complex one, a tool.
OBJECTS = ("wine_glass", "bust", "drill")
# Methods beside the default, and the most trials of a cell that their seconds allow, in full and quick.
SLOW = {"monte-carlo": (50, 2), "direct": (50, 2), "annealing": (50, 2)}
# T1's count of contacts: there the slow methods are compared.
PUBLISHED_CONTACTS = 5
NAMES = {"multistart": "default", "monte-carlo": "Monte-Carlo (T1)", "direct": "DIRECT", "annealing": "annealing"}
USUAL = "0.9 mm, 5°"


@dataclass(frozen=True)
class Cell:
    """What one method did in one cell; times in ms."""

    success: Rate
    oracle: Rate
    exact: Rate | None
    listed: Rate
    rotation: Spread
    position: Spread
    ratio_rotation: float
    ratio_position: float
    optimal: Rate
    sure_and_wrong: Rate
    time: Quantile


def run(settings: BenchSettings) -> Report:
    """All tables of this file."""
    usual = settings.count(200, 10)
    report = Report(
        "global",
        "pose from contacts alone, no prior",
        f"{usual} trials a cell for the default, {settings.count(50, 2)} for slow methods, 60 at most for grasps",
        settings.seed,
    )
    columns = [Column("object"), Column("contacts"), Column("from"), Column("noise"), Column("method")]
    columns += [Column("success"), Column("from the truth"), Column("exact"), Column("listed"), Column("rotation °", 2)]
    columns += [Column("position mm", 2), Column("÷ bound rot"), Column("÷ bound pos"), Column("optimal")]
    columns += [Column("sure, wrong"), Column("median ms", 1)]
    note = (
        "T1 (wine glass, five contacts, 0.9 mm and 5°): 7.1 mm, 3.72°, 63 s; > 75 % with four or more. "
        "Success: < 1 cm, < 15°, modulo symmetry. From the truth: the success of an oracle that starts its "
        "refinement there. Exact: of an oracle that chooses among the listed modes and the truth's by the exact "
        "likelihood of the contacts: what they allow. Listed: some listed mode is a success. ÷ bound: RMS error"
        " in the right mode over the Cramér-Rao bound. Optimal: cost at most the truth's. Sure, wrong: "
        "verdict ok without success."
    )
    table = Table("Global search", columns, note=note)
    chart: dict[str, list[tuple[float, float]]] = {}
    for name in settings.some(OBJECTS, 1):
        model = library.make(name)
        model.field  # noqa: B018  (built before anything is timed)
        for source, grasps in (("scattered", 0), ("grasps", 1 if settings.quick else 12)):
            for contacts in (3, 4, 5):
                for label, noise in scene.NOISES.items():
                    if settings.quick and label != USUAL:
                        continue
                    for method in NAMES:
                        slow = method != "multistart"
                        if slow and (grasps or label != USUAL or contacts != PUBLISHED_CONTACTS):
                            continue
                        n = settings.count(*SLOW[method]) if slow else min(usual, 60 if grasps else usual)
                        cell = _cell(model, contacts, noise, method, n, settings, grasps)
                        if cell is None:
                            continue
                        table.add(name, contacts, source, label, NAMES[method], *vars(cell).values())
                        if label == USUAL and not grasps:
                            chart.setdefault(f"{NAMES[method]}, {name}", []).append(
                                (contacts, 100 * cell.success.share)
                            )
                            if method == "multistart":
                                _claim(report, name, contacts, cell)
    report.tables.append(table)
    settings.show(table)
    report.charts.append(Chart("Global search, scattered, 0.9 mm and 5°", "contacts", "success, %", chart))
    return report


def _claim(report: Report, name: str, contacts: int, cell: Cell) -> None:
    if contacts == 3:
        return
    what = f"{name}, {contacts} scattered contacts"
    report.claims += [
        Claim(f"{what}: success", cell.success.share, 0.95 if contacts == 5 else 0.90, True),
        Claim(f"{what}: optimal", cell.optimal.share, 0.95, True),
        Claim(f"{what}: RMS rotation ÷ bound", cell.ratio_rotation, 1.2, False),
        Claim(f"{what}: RMS position ÷ bound", cell.ratio_position, 1.2, False),
        Claim(f"{what}: median ms", cell.time.value, 50.0, False, 1),
    ]


def _cell(
    model: ObjectModel,
    contacts: int,
    noise: TouchNoise,
    method: str,
    count: int,
    settings: BenchSettings,
    grasps: int,
) -> Cell | None:
    from touch.localization import localize

    cases = list(scene.trials(model, contacts, noise, count, settings.seed, grasps))
    if not cases:
        return None
    localize(model, cases[0].contacts, 0, method)  # compiled and tabled before anything is timed
    found, limits, oracle, exact, listed, optimal, wrong, times = [], [], [], [], [], [], [], []
    # the exact likelihood is that of scattered contacts, and as slow as the search: where the demands are
    weighable = not grasps and method == "multistart" and noise == scene.NOISES[USUAL]
    for i, trial in enumerate(settings.progress(cases, len(cases), f"{model.name} {contacts} {method}")):
        answer = localize(model, trial.contacts, i, method)
        times.append(answer.time_s)
        found.append(scene.errors(model, answer.pose, trial.truth))
        limits.append(scene.bound(model, trial.contacts, trial.truth))
        near = scene.from_truth(model, trial.contacts, trial.truth)
        oracle.append(scene.is_close(scene.errors(model, near, trial.truth)))
        if weighable:
            choice = scene.likeliest(model, trial.contacts, answer.modes, trial.truth)
            exact.append(scene.is_close(scene.errors(model, choice, trial.truth)))
        listed.append(any(scene.is_close(scene.errors(model, m.pose, trial.truth)) for m in answer.modes))
        optimal.append(scene.is_optimal(model, trial.contacts, answer.pose, trial.truth))
        wrong.append(answer.verdict == "ok" and not scene.is_close(found[-1]))
    errors = np.array(found)
    return Cell(
        Rate.of([scene.is_close(e) for e in found]),
        Rate.of(oracle),
        Rate.of(exact) if exact else None,
        Rate.of(listed),
        Spread.of(errors[:, 0], 180 / np.pi),
        Spread.of(errors[:, 1], 1e3),
        *bound_ratios(errors, np.array(limits)),
        Rate.of(optimal),
        Rate.of(wrong),
        Quantile.of(times, 1e3),
    )
