"""Which tool was touched: recorded and simulated contacts, every candidate, and verdicts where nobody could tell."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.contacts.sets import recognition_models, recognition_sets
from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Rate, Report, Spread, Table
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts
from scenes.synthesis import library
from touch.recognition import Identification, identify

Array = NDArray[np.float64]

CONTACTS = 100
NOISES = (0.0, 0.002, 0.005)
FEW = (1, 2, 3, 5, 10, 20)
OUTLIERS = (0.0, 0.1, 0.2, 0.3, 0.5)
# Contacts, their noise (m) and the share of false ones of a tool that is left out of the candidates, and is not.
STRANGERS = ((100, 0.0, 0.0), (100, 0.002, 0.0), (100, 0.001, 0.2), (40, 0.0, 0.0), (40, 0.001, 0.0), (20, 0.001, 0.0))
# False contacts lie this far off the surface, metres: another part of the hand touched something else.
OUTLIER_SPREAD = 0.03


@dataclass(frozen=True)
class _Trial:
    truth: str
    found: Identification

    @property
    def right(self) -> bool:
        return self.found.best == self.truth

    @property
    def confident_error(self) -> bool:
        return self.found.verdict == "ok" and not self.right


def run(settings: BenchSettings) -> Report:
    """Recorded sets, simulated sets by noise, false contacts, and the hopeless cases."""
    models = recognition_models()
    count = settings.count(5, 1)
    report = Report("recognition", "Recognition by touch", f"{count} per model and cell", settings.seed)
    identify(models[:2], _touched(models[0], 20, 0.0, np.random.default_rng(0)))  # compiled before anything is timed
    recorded, wrong_recorded, seconds = _recorded(models, settings)
    report.tables.append(recorded)
    noisy = _cells(
        models, settings, "noise", count, [(f"{1e3 * n:.0f} mm", CONTACTS, n, 0.0) for n in settings.some(NOISES, 2)]
    )
    false = _cells(
        models,
        settings,
        "false contacts",
        count,
        [(f"{100 * o:.0f} %", CONTACTS, 0.001, o) for o in settings.some(OUTLIERS, 2)],
    )
    few = _cells(
        models, settings, "contacts", count, [(str(n), n, 0.001, 0.0) for n in FEW[-2 if settings.quick else 0 :]]
    )
    titles = (
        f"{CONTACTS} contacts, by noise",
        f"{CONTACTS} contacts of 1 mm, by the share of false ones",
        "contacts of 1 mm, by how many",
    )
    for title, table in zip(titles, (noisy, false, few)):
        report.tables.append(_table(title, table))
    hopeless, wrong_hopeless = _hopeless(models, settings)
    report.tables.append(hopeless)
    strangers, both_errors = _strangers(models, settings, max(1, count // 2))
    report.tables.append(strangers)
    trials = [t for cells in (noisy, false, few) for cell in cells.values() for t in cell]
    clean = noisy[f"{1e3 * NOISES[0]:.0f} mm"]
    errors = sum(t.confident_error for t in trials) + wrong_recorded + wrong_hopeless
    times = [t.found.time_s for t in clean]
    report.claims += [
        Claim("clean contacts named right, share", float(np.mean([t.right for t in clean])), 1.0, True),
        Claim("confident errors", float(errors), 0, False, 0),
        *both_errors,
        Claim(f"{len(models)} candidates, {CONTACTS} contacts, s", float(np.mean(times)), 0.5, False, 3),
        Claim("recorded sets, slowest, s", max(seconds), 0.5, False, 3),
    ]
    return report


def _touched(model: ObjectModel, count: int, noise: float, rng: np.random.Generator, outliers: float = 0.0) -> Contacts:
    """Scattered contacts of the model at a random pose, some of them false."""
    points, normals = model.sample_surface(count, seed=int(rng.integers(2**31)))
    points = points + noise * rng.normal(size=points.shape)
    false = rng.random(count) < outliers
    points = points + np.where(false[:, None], OUTLIER_SPREAD * np.abs(rng.normal(size=(count, 1))) * normals, 0.0)
    pose = se3.make_pose(se3.random_rotations(1, rng)[0], 0.3 * rng.normal(size=3))
    return Contacts(se3.apply(pose, points))


def _recorded(models: list[ObjectModel], settings: BenchSettings) -> tuple[Table, int, list[float]]:
    table = Table(
        "Recorded sets",
        [
            Column("set"),
            Column("contacts"),
            Column("best"),
            Column("verdict"),
            Column("index mm", 3),
            Column("next"),
            Column("its index mm", 3),
            Column("likelihood", 4),
            Column("s", 3),
        ],
        note="hook2 was measured on pipeHook2; the simulated sets carry the tool's name. T2: 6/6 simulated, 4/6 real",
    )
    wrong, seconds = 0, []
    for name, contacts in recognition_sets().items():
        found = identify(models, contacts, settings.seed)
        first, second = found.candidates[:2]
        truth = "pipeHook2" if name == "hook2" else name.rpartition("_")[2]
        wrong += found.verdict == "ok" and found.best != truth
        seconds.append(found.time_s)
        table.add(
            name,
            len(contacts),
            found.best,
            found.verdict,
            1e3 * first.index,
            second.name,
            1e3 * second.index,
            first.likelihood,
            found.time_s,
        )
    return table, wrong, seconds


def _cells(
    models: list[ObjectModel],
    settings: BenchSettings,
    what: str,
    count: int,
    cells: list[tuple[str, int, float, float]],
) -> dict[str, list[_Trial]]:
    def each() -> Iterator[tuple[str, int, float, float, int, int]]:
        for label, contacts, noise, outliers in cells:
            for k in range(0, len(models), 3 if settings.quick else 1):
                for trial in range(count):
                    yield label, contacts, noise, outliers, k, trial

    out: dict[str, list[_Trial]] = {label: [] for label, *_ in cells}
    total = len(cells) * len(range(0, len(models), 3 if settings.quick else 1)) * count
    for label, contacts, noise, outliers, k, trial in settings.progress(each(), total, what):
        rng = np.random.default_rng([settings.seed, contacts, int(1e4 * noise), int(100 * outliers), k, trial])
        felt = _touched(models[k], contacts, noise, rng, outliers)
        out[label].append(_Trial(models[k].name, identify(models, felt, settings.seed + trial)))
    return out


def _table(title: str, cells: dict[str, list[_Trial]]) -> Table:
    table = Table(
        title,
        [
            Column("cell"),
            Column("named right"),
            Column("said ok"),
            Column("ok and right"),
            Column("confident errors"),
            Column("ms", 0),
        ],
        note="contacts scattered over every tool at random poses; ok and right: of those said ok",
    )
    for label, trials in cells.items():
        sure = [t for t in trials if t.found.verdict == "ok"]
        table.add(
            label,
            Rate.of([t.right for t in trials]),
            Rate.of([t.found.verdict == "ok" for t in trials]),
            Rate.of([t.right for t in sure]),
            sum(t.confident_error for t in trials),
            Spread.of([t.found.time_s for t in trials], 1e3),
        )
    return table


def _strangers(models: list[ObjectModel], settings: BenchSettings, trials: int) -> tuple[Table, list[Claim]]:
    """Contacts of each tool, once while it is not among the candidates but its relatives are, so that the answer is
    "none of these", and once while it is.
    """
    columns = [Column("contacts"), Column("noise mm", 0), Column("false %", 0), Column("trials", 0)]
    columns += [Column("left out: named for sure"), Column("none of these")]
    columns += [Column("there: said ok"), Column("wrongly"), Column("none of these")]
    table = Table(
        "The tool is left out of the candidates, and is not",
        columns,
        note="The same contacts both times. named for sure: a relative, wrongly; none of these: told with more than"
        " half of the likelihood.",
    )
    cells = settings.some(STRANGERS, 1)
    which = range(0, len(models), 3 if settings.quick else 1)
    asked = [(cell, k, trial) for cell in cells for k in which for trial in range(trials)]
    found: dict[tuple[int, float, float], list[tuple[Identification, _Trial]]] = {cell: [] for cell in cells}
    for cell, k, trial in settings.progress(asked, len(asked), "left out"):
        count, noise, false = cell
        rng = np.random.default_rng([settings.seed, count, int(1e4 * noise), int(100 * false), k, trial, 1])
        felt = _touched(models[k], count, noise, rng, false)
        without = identify([model for model in models if model is not models[k]], felt, settings.seed + trial)
        found[cell].append((without, _Trial(models[k].name, identify(models, felt, settings.seed + trial))))
    for cell in cells:
        table.add(str(cell[0]), 1e3 * cell[1], 100 * cell[2], *_both_errors(found[cell]))
    together = _both_errors([pair for cell in cells for pair in found[cell]])
    table.add("all", None, None, *together)
    _, sure, _, named, *_ = together
    return table, [
        Claim("a relative named for sure, its tool not among the candidates, share", sure.share, 0.03, False, 3),
        Claim("the same contacts, the tool among the candidates: ok, share", named.share, 0.75, True),
    ]


def _both_errors(pairs: list[tuple[Identification, _Trial]]) -> tuple[int, Rate, Rate, Rate, Rate, Rate]:
    """Trials; a tool left out: named for sure, none of these; and there: ok, wrongly, none of these."""
    without, there = [pair[0] for pair in pairs], [pair[1] for pair in pairs]
    return (
        len(pairs),
        Rate.of([one.verdict == "ok" for one in without]),
        Rate.of([one.none > 0.5 for one in without]),
        Rate.of([one.found.verdict == "ok" for one in there]),
        Rate.of([one.confident_error for one in there]),
        Rate.of([one.found.none > 0.5 for one in there]),
    )


def _hopeless(models: list[ObjectModel], settings: BenchSettings) -> tuple[Table, int]:
    """Contacts that fit several objects, or none: verdicts that must not be sure of the wrong one."""
    rng = np.random.default_rng(settings.seed)
    shapes = [library.make("sphere"), library.make("cylinder"), library.make("box")]
    plane = np.column_stack([rng.uniform(-0.02, 0.02, size=(30, 2)), np.zeros(30)])
    hook = models[3]
    once = hook.sample_surface(1, seed=1)[0]
    contradictory = np.concatenate([hook.sample_surface(20, seed=2)[0], models[0].sample_surface(20, seed=3)[0]])
    cases: list[tuple[str, list[ObjectModel], Array, str]] = [
        ("30 contacts on one plane", [*shapes, *models[:2]], plane, ""),
        ("one contact felt 30 times", models, np.repeat(once, 30, axis=0), ""),
        ("half from one tool, half from another", models, contradictory, ""),
        ("noise in a ball of 30 cm", models, 0.15 * rng.normal(size=(60, 3)), ""),
        ("30 contacts on a sphere", shapes, shapes[0].sample_surface(30, seed=4)[0], "sphere"),
        ("30 contacts on a cylinder", shapes, shapes[1].sample_surface(30, seed=5)[0], "cylinder"),
    ]
    table = Table(
        "Cases at the edge",
        [
            Column("case"),
            Column("best"),
            Column("verdict"),
            Column("index mm", 3),
            Column("likelihood", 3),
            Column("right"),
        ],
        note="right: the shape that was touched, or not sure where several shapes (or none) would do",
    )
    wrong = 0
    for label, candidates, points, truth in cases:
        found = identify(candidates, Contacts(points), settings.seed)
        right = found.best == truth if truth else found.verdict != "ok"
        wrong += not right and found.verdict == "ok"
        first = found.candidates[0]
        table.add(label, found.best, found.verdict, 1e3 * first.index, first.likelihood, right)
    return table, wrong
