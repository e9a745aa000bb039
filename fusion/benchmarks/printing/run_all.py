"""Every benchmark in one run that may be stopped and gone on with: what was done with the same settings is not redone.

The folder gets each benchmark's own files, and `all.json` with what ran, how, on what machine and code, for how long.
A quick run does less of everything (fewer trials, objects, budgets), and all of that: about five minutes on two cores.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from fusion.benchmarks import load
from fusion.benchmarks.printing.provenance import command_line, machine, source_version
from fusion.benchmarks.printing.tables import BenchSettings, Column, Report, Table, write_report
from scenes.errors import PalpateError

INDEX = "all.json"
# States of a benchmark in the index.
DONE, FAILED = "done", "could not run"


@dataclass
class Outcome:
    """One benchmark of the run. state: see above; seconds by the clock and of processors; why: of one that could not
    run; again: it was taken from an earlier run.
    """

    name: str
    state: str
    seconds: float
    processor: float = 0.0
    why: str = ""
    again: bool = False
    report: dict[str, Any] = field(default_factory=dict)

    @property
    def demands(self) -> str:
        """How many of its demands were met."""
        claims = self.report.get("claims", [])
        return f"{sum(bool(c['met']) for c in claims)} of {len(claims)}" if claims else ""


def settings_key(settings: BenchSettings) -> dict[str, Any]:
    """What of the settings decides the numbers."""
    return {
        "trials": settings.trials,
        "seed": settings.seed,
        "quick": settings.quick,
        "objects": None if settings.objects is None else list(settings.objects),
        "family": settings.family,
        "data": None if settings.data is None else str(settings.data),
        "bop": None if settings.bop is None else str(settings.bop),
    }


def run_all(
    names: Sequence[str],
    settings: BenchSettings,
    folder: Path,
    finished: Callable[[Outcome], None] = lambda outcome: None,
    clock: Callable[[], float] = time.monotonic,
) -> list[Outcome]:
    """Run the named benchmarks one after the other into the folder; finished(outcome) is told of each.

    Those whose entry in the folder's index has the same settings and code are read back.
    """
    folder.mkdir(parents=True, exist_ok=True)
    version = source_version()
    outcomes: list[Outcome] = []
    for name in names:
        outcome = _earlier(folder, name, settings, version) or _run_one(name, settings, folder, clock)
        outcomes.append(outcome)
        _write_index(folder, outcomes, settings, version)
        finished(outcome)
    return outcomes


def _run_one(name: str, settings: BenchSettings, folder: Path, clock: Callable[[], float]) -> Outcome:
    shown: list[Table] = []
    begin, used = clock(), sum(os.times()[:4])

    def show(table: Table) -> None:
        shown.append(table)
        settings.show(table)

    state, why = DONE, ""
    try:
        report = load(name).run(replace(settings, folder=folder, show=show))
    except (PalpateError, OSError) as error:
        state, why = FAILED, " ".join(str(error).split())
        report = Report(name, f"could not run: {why}", "none", settings.seed, list(shown))
    write_report(report, folder)
    processor = sum(os.times()[:4]) - used
    return Outcome(name, state, clock() - begin, processor, why, report=report.to_json())


def _earlier(folder: Path, name: str, settings: BenchSettings, version: str) -> Outcome | None:
    """The finished outcome of an earlier run with the same settings and code; None without one."""
    try:
        entry = json.loads((folder / INDEX).read_text(encoding="utf-8"))["benchmarks"][name]
        report = json.loads((folder / entry["file"]).read_text(encoding="utf-8"))
        same = entry["state"] == DONE and entry["settings"] == settings_key(settings) and entry["version"] == version
        times = float(entry["seconds"]), float(entry["processor_seconds"])
        return Outcome(name, DONE, *times, again=True, report=report) if same else None
    except (OSError, ValueError, KeyError, TypeError):
        return None  # none, or a damaged one: run it


def _write_index(folder: Path, outcomes: list[Outcome], settings: BenchSettings, version: str) -> None:
    """Whole after every benchmark; entries of benchmarks that this run has not come to are kept."""
    path = folder / INDEX
    try:
        benchmarks = dict(json.loads(path.read_text(encoding="utf-8"))["benchmarks"])
    except (OSError, ValueError, KeyError, TypeError):
        benchmarks = {}
    for outcome in outcomes:
        benchmarks[outcome.name] = {
            "state": outcome.state,
            "why": outcome.why,
            "seconds": round(outcome.seconds, 3),
            "processor_seconds": round(outcome.processor, 3),
            "trials": outcome.report.get("trials", ""),
            "settings": settings_key(settings),
            "version": version,
            "file": f"{outcome.name}.json",
            "demands_met": outcome.demands,
        }
    content = {"command": command_line(), "machine": machine(), "version": version, "benchmarks": benchmarks}
    partial = path.with_suffix(".tmp")
    partial.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    partial.replace(path)


def summary(outcomes: Sequence[Outcome]) -> Table:
    """One row a benchmark: what became of it, of how many trials, its time, its demands."""
    columns = [Column("benchmark"), Column("state"), Column("trials"), Column("s", 1), Column("processor s", 1)]
    table = Table("All benchmarks", [*columns, Column("demands met")])
    for one in outcomes:
        state = f"{one.state} before" if one.again else one.state
        table.add(
            one.name, state, one.why or one.report.get("trials", ""), one.seconds, one.processor, one.demands or None
        )
    total, used = (sum(getattr(one, n) for one in outcomes if not one.again) for n in ("seconds", "processor"))
    table.note = f"{total:.0f} s, of processors {used:.0f} s; done with the same settings and code is not run again."
    return table
