"""Contacts that lie, and contacts that cannot tell: what the default finds, and whether it says so."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.contacts import trials as scene
from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Rate, Report, Table
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts
from scenes.synthesis import library

Array = NDArray[np.float64]

OBJECTS = ("bust", "drill")
# Share of false contacts for which a success is demanded.
TOLD = 0.3
SHARES = (0.0, 0.1, 0.2, 0.3, 0.5)
# Contacts of a trial with false ones among them, and how far off those are (m).
CONTACTS, ASTRAY = 20, (0.01, 0.05)
USUAL = "0.9 mm, 5°"


def run(settings: BenchSettings) -> Report:
    """Two tables and their demands."""
    count = settings.count(100, 4)
    report = Report(
        "robustness", "Contacts that lie, and contacts that cannot tell", f"{count} trials a cell", settings.seed
    )
    table = Table(
        f"False contacts among {CONTACTS}, {USUAL}",
        [Column("object"), Column("false"), Column("success"), Column("said ok"), Column("sure, wrong")],
        note=f"False: {1e3 * ASTRAY[0]:.0f} to {1e3 * ASTRAY[1]:.0f} mm off, with random normals, and said to be"
        " as good as the others.",
    )
    sure_and_wrong = []
    told = []
    for name in settings.some(OBJECTS, 1):
        model = library.make(name)
        for share in settings.progress(SHARES, len(SHARES), f"{name}, false contacts"):
            right, sure = _spoiled(model, share, count, settings.seed)
            sure_and_wrong.append(float((sure & ~right).mean()))
            if share == TOLD:
                told.append(float(right.mean()))
            table.add(name, f"{share:.0%}", Rate.of(right), Rate.of(sure), Rate.of(sure & ~right))
    report.tables.append(table)
    settings.show(table)
    cases = Table(
        "Contacts that cannot tell, or can",
        [Column("case"), Column("said ok"), Column("expected"), Column("right")],
        note="Right: said ambiguous or lost where the pose cannot be known, ok where it can (but for a symmetry)."
        " Found: < 1 cm, < 15°.",
    )
    shares = []
    few = settings.count(20, 2)
    for case, expected, trials in _cases(few, settings.seed):
        said = np.array([verdict == "ok" for verdict, _ in trials])
        found = np.array([close for _, close in trials])
        right = {"ok": said, "not ok": ~said, "ok only if found": ~said | found}[expected]
        shares.append(float(right.mean()))
        cases.add(case, Rate.of(said), expected, Rate.of(right))
    report.tables.append(cases)
    settings.show(cases)
    report.claims += [
        Claim(f"{TOLD:.0%} false contacts: success, least of the objects", min(told), 0.9, True),
        Claim("false contacts: sure and wrong, largest share of a cell", max(sure_and_wrong), 0.05, False),
        Claim("cases at the edge: right verdicts, share", float(np.mean(shares)), 0.95, True),
    ]
    return report


def _spoiled(model: ObjectModel, share: float, count: int, seed: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Of each trial: whether the pose was found, and whether the verdict was ok."""
    from touch.localization import localize

    right, sure = [], []
    for i, trial in enumerate(scene.trials(model, CONTACTS, scene.NOISES[USUAL], count, seed)):
        rng = np.random.default_rng([seed, 77, i])
        points, normals = trial.contacts.points.copy(), trial.contacts.normals.copy()
        false = rng.choice(CONTACTS, round(CONTACTS * share), replace=False)
        points[false] += _directions(len(false), rng) * rng.uniform(*ASTRAY, (len(false), 1))
        normals[false] = _directions(len(false), rng)
        contacts = Contacts(points, normals, trial.contacts.sigma_point, trial.contacts.sigma_normal)
        answer = localize(model, contacts, i)
        right.append(scene.is_close(scene.errors(model, answer.pose, trial.truth)))
        sure.append(answer.verdict == "ok")
    return np.array(right), np.array(sure)


def _cases(count: int, seed: int) -> list[tuple[str, str, list[tuple[str, bool]]]]:
    """Name, expected verdict, and of `count` trials of every case the verdict and whether the pose was found."""
    from touch.localization import localize

    def verdicts(model: ObjectModel, contacts_of) -> list[tuple[str, bool]]:  # type: ignore[no-untyped-def]
        answers = [localize(model, contacts_of(np.random.default_rng([seed, i])), i) for i in range(count)]
        return [(a.verdict, scene.is_close(scene.errors(model, a.pose, np.eye(4)))) for a in answers]

    def felt(points: Array, normals: Array, rng: np.random.Generator) -> Contacts:
        noise = scene.NOISES[USUAL]
        points = points + noise.point * rng.normal(size=points.shape)
        turned = normals + noise.normal * rng.normal(size=normals.shape)
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
        return Contacts(points, turned, noise.point, noise.normal)

    def scattered(model: ObjectModel, n: int):  # type: ignore[no-untyped-def]
        return lambda rng: felt(*model.sample_surface(n, seed=int(rng.integers(2**31))), rng)

    drill, box, ball, tube = (library.make(name) for name in ("drill", "box", "sphere", "cylinder"))

    def coplanar(rng: np.random.Generator) -> Contacts:
        points, normals = box.sample_surface(2000, seed=int(rng.integers(2**31)))
        side = normals @ normals[0] > 0.999
        return felt(points[side][:12], normals[side][:12], rng)

    def repeated(rng: np.random.Generator) -> Contacts:
        point, normal = drill.sample_surface(1, seed=int(rng.integers(2**31)))
        return felt(np.repeat(point, 12, axis=0), np.repeat(normal, 12, axis=0), rng)

    def contradictory(n: int, away: float):  # type: ignore[no-untyped-def]
        def of(rng: np.random.Generator) -> Contacts:
            """Half from where the object is, half from `away` (m)."""
            both = felt(*drill.sample_surface(n, seed=int(rng.integers(2**31))), rng)
            both.points[n // 2 :] += away * _directions(1, rng)
            return both

        return of

    return [
        ("one contact on a drill", "not ok", verdicts(drill, scattered(drill, 1))),
        ("two contacts on a drill", "not ok", verdicts(drill, scattered(drill, 2))),
        ("three contacts on a drill", "ok only if found", verdicts(drill, scattered(drill, 3))),
        ("twelve contacts on one side of a box", "not ok", verdicts(box, coplanar)),
        ("one place of a drill twelve times", "not ok", verdicts(drill, repeated)),
        ("half of twelve contacts 4 cm away", "ok only if found", verdicts(drill, contradictory(12, 0.04))),
        ("half of forty contacts 2 cm away", "ok only if found", verdicts(drill, contradictory(40, 0.02))),
        ("twelve contacts on a drill", "ok", verdicts(drill, scattered(drill, 12))),
        ("twelve contacts on a sphere", "ok", verdicts(ball, scattered(ball, 12))),
        ("twenty contacts on a cylinder", "ok", verdicts(tube, scattered(tube, 20))),
    ]


def _directions(count: int, rng: np.random.Generator) -> Array:
    drawn = rng.normal(size=(count, 3))
    return np.asarray(drawn / np.maximum(np.linalg.norm(drawn, axis=1, keepdims=True), 1e-12), dtype=np.float64)
