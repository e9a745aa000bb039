"""Contact filters on recorded contacts: MUPF, UPF, Scaling Series, ICP and the default, beside what was published."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.contacts.sets import SETS, ContactSet, read_set
from fusion.benchmarks.printing.one_thread import one_thread
from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Rate, Report, Spread, Table
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts
from touch.answers import Localization
from touch.localization import localize
from touch.published.particles import memory_unscented_particle_filter as unscented
from touch.published.particles.recursion import StoppingRule, localize_online

Array = NDArray[np.float64]

# A trial succeeds when its index is this near the floor (m): half of what the filters believe of a contact.
SUCCESS = 0.005
# The same pose as one of the best fits' (T1: 15 degrees, 1 cm).
SAME_ANGLE, SAME_DISTANCE = math.radians(15.0), 0.01

METHODS = ("mupf", "mupf, as published", "upf", "scaling-series", "annealed-particle-filter", "icp", "multistart")
# T2 tables 4.2 and 4.5 (index mm, seconds, successes of 50): what is closest to the sets that are public.
PUBLISHED = {
    "Box15_sim": "2.5, 1.61 s, 50",
    "Tetra30_sim": "2.1, 3.63 s, 50",
    "Cleaner_sim": "2.5, 7.32 s, 50",
    "Robot_sim": "2.1, 3.95 s, 50",
    "Lego_exp": "9.0, 12.8 s, 46",
    "Cylinder_exp": "6.3, 6.71 s, 50",
}


@dataclass(frozen=True)
class _Trials:
    index: Array
    seconds: Array
    poses: Array


def run(settings: BenchSettings) -> Report:
    """Every set through every method; then how the index falls contact by contact."""
    count = settings.count(50, 2)
    report = Report("filters", "Contact filters on recorded contact sets", f"{count} per cell", settings.seed)
    sets = settings.some(SETS, 2)
    cells = [(one, method) for one in sets for method in METHODS]
    results: dict[tuple[str, str], _Trials] = {}
    scenes: dict[str, tuple[ObjectModel, Contacts]] = {}
    for one, method in settings.progress(cells, len(cells), "filters"):
        if one.name not in scenes:
            scenes[one.name] = read_set(one)
        model, contacts = scenes[one.name]
        search = _search(one, method, len(contacts))
        search(model, contacts, settings.seed)  # what is compiled at the first call is not timed
        timed = [_timed(search, model, contacts, settings.seed + trial) for trial in range(count)]
        found, seconds = [f for f, _ in timed], np.array([s for _, s in timed])
        results[one.name, method] = _Trials(
            np.array([f.index for f in found]), seconds, np.array([f.pose for f in found])
        )
    for one in sets:
        report.tables.append(_table(one, *scenes[one.name], results))
    report.tables.append(_recursion(scenes, settings))
    report.claims.extend(_claims(sets, results))
    return report


def _search(one: ContactSet, method: str, count: int) -> Callable[[ObjectModel, Contacts, int], Localization]:
    if method != "mupf, as published":
        return lambda model, contacts, seed: localize(model, contacts, seed, method)
    # T2 tables 4.1 and 4.3, contacts in their recorded order, once each
    as_published = unscented.UnscentedSettings(
        particles=1200 if one.real else 700,
        sigma=0.02 if one.real else 0.01,
        window=min(one.window, count),
        scattered=False,
        fewest_updates=0,
    )
    return lambda model, contacts, seed: unscented.localize(model, contacts, seed, settings=as_published)


def _timed(
    search: Callable[[ObjectModel, Contacts, int], Localization], model: ObjectModel, contacts: Contacts, seed: int
) -> tuple[Localization, float]:
    """An answer and the processor's seconds of its search, without what makes modes and a verdict of its end."""
    with one_thread():
        begin, used = time.perf_counter(), time.process_time()
        found = search(model, contacts, seed)
        used, taken = time.process_time() - used, time.perf_counter() - begin
    return found, used * found.time_s / taken


def _floor(one: ContactSet, results: dict[tuple[str, str], _Trials]) -> float:
    return min(float(results[one.name, method].index.min()) for method in METHODS)


def _table(one: ContactSet, model: ObjectModel, contacts: Contacts, results: dict[tuple[str, str], _Trials]) -> Table:
    table = Table(
        f"{one.name}: {len(contacts)} contacts{', real' if one.real else ''}",
        [
            Column("method"),
            Column("index mm", 2),
            Column("largest", 2),
            Column("successes"),
            Column("best pose"),
            Column("ms", 1),
            Column("C++ index mm", 2),
            Column("C++ / ours", 0),
        ],
    )
    floor = _floor(one, results)
    fits = [mode.pose for mode in localize(model, contacts, 0).modes]
    for method in METHODS:
        trials = results[one.name, method]
        theirs = one.mupf if method.startswith("mupf") else one.scaling if method == "scaling-series" else None
        table.add(
            method,
            Spread.of(trials.index, 1e3),
            1e3 * float(trials.index.max()),
            Rate.of(trials.index <= floor + SUCCESS),
            Rate.of([_same(model, pose, fits) for pose in trials.poses]),
            Spread.of(trials.seconds, 1e3),
            theirs[0] if theirs else None,
            theirs[1] / float(trials.seconds.mean()) if theirs else None,
        )
    published = f"; T2: MUPF {PUBLISHED[one.name]}/50" if one.name in PUBLISHED else ""
    table.note = (
        f"floor {1e3 * floor:.3f} mm (the lowest index of any trial); success: within {1e3 * SUCCESS:.0f} mm of it;"
        f" best pose: within 15 deg and 10 mm of a mode of the default's answer{published};"
        " C++: the authors' program of 2016, -O3, one thread"
    )
    return table


def _same(model: ObjectModel, pose: Array, fits: list[Array]) -> bool:
    for fit in fits:
        delta = se3.difference(model.symmetries.nearest(pose, fit), fit, model.centroid)
        if np.linalg.norm(delta[:3]) < SAME_ANGLE and np.linalg.norm(delta[3:]) < SAME_DISTANCE:
            return True
    return False


def _recursion(scenes: dict[str, tuple[ObjectModel, Contacts]], settings: BenchSettings) -> Table:
    """After how many contacts the index's trend says stop, and what stopping there costs."""
    table = Table(
        "An estimate after every contact (T2 figure 4.14)",
        [
            Column("set"),
            Column("contacts"),
            Column("stopped after", 1),
            Column("index there mm", 2),
            Column("index at the end mm", 2),
            Column("ms per contact", 1),
        ],
        note="index: all contacts of the set, at the estimate; stop: the trend of the index over the contacts so far",
    )
    count = settings.count(5, 1)
    for name, (model, contacts) in scenes.items():
        stops, there, last, pace = [], [], [], []
        for trial in range(count):
            rule, stopped = StoppingRule(), None
            for step in localize_online(model, contacts, settings.seed + trial):
                if rule.observe(step.index) and stopped is None:
                    stopped = step
                pace.append(step.time_s)
                final = step
            stopped = stopped or final
            stops.append(stopped.contacts)
            there.append(_index(model, contacts, stopped.pose))
            last.append(_index(model, contacts, final.pose))
        table.add(
            name, len(contacts), Spread.of(stops), Spread.of(there, 1e3), Spread.of(last, 1e3), Spread.of(pace, 1e3)
        )
    return table


def _index(model: ObjectModel, contacts: Contacts, pose: Array) -> float:
    return float(np.abs(model.surface.closest(se3.apply(se3.inverse(pose), contacts.points))[0]).mean())


def _claims(sets: Sequence[ContactSet], results: dict[tuple[str, str], _Trials]) -> list[Claim]:
    claims = []
    for one in sets:
        floor = _floor(one, results)
        mupf, series, default = (results[one.name, m] for m in ("mupf", "scaling-series", "multistart"))
        claims += [
            Claim(f"{one.name}: MUPF mean index, mm", 1e3 * float(mupf.index.mean()), one.mupf[0], False),
            Claim(f"{one.name}: MUPF successes, share", float((mupf.index <= floor + SUCCESS).mean()), 0.98, True),
            Claim(f"{one.name}: MUPF times faster than C++", one.mupf[1] / float(mupf.seconds.mean()), 20, True, 0),
            Claim(f"{one.name}: Scaling Series successes", float((series.index <= floor + SUCCESS).mean()), 0.98, True),
            Claim(
                f"{one.name}: default's mean index above the floor, mm",
                1e3 * (float(default.index.mean()) - floor),
                # 5 %, or the precision of the ray caster where the floor is zero
                max(0.05 * 1e3 * floor, 0.005),
                False,
                3,
            ),
            Claim(f"{one.name}: default, s", float(default.seconds.mean()), 0.1, False, 3),
        ]
    return claims
