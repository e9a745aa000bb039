"""Every benchmark in one run that may be stopped and gone on with: what was done with the same settings is not redone.

The folder gets each benchmark's own files, and `all.json` with what ran, how, on what machine and code, for how long. A
quick run has a time for everything together; a benchmark that uses up its part of it is stopped between two cells, and
what it had shown is kept.
"""

from __future__ import annotations

import hashlib
import json
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from importlib import metadata
from pathlib import Path
from typing import Any, TypeVar

from fusion.benchmarks import load
from fusion.benchmarks.tables import BenchSettings, Column, Report, Table, machine, write_report
from scenes.errors import PalpateError

T = TypeVar("T")

INDEX = "all.json"
# Seconds of a quick run, all together; the last cell may run over.
QUICK_SECONDS = 270.0
# Parts of that time, 1 where nothing is said: those that have more to do even when in a hurry.
PARTS = {"stability": 3.0, "vision": 2.0, "occlusion": 2.0, "peers": 2.0}
# States of a benchmark in the index.
DONE, STOPPED, FAILED = "done", "stopped", "could not run"


class OutOfTime(Exception):
    """A benchmark's part of the time is used up."""


@dataclass
class Outcome:
    """One benchmark of the run. state: see above; why: of one that was stopped or could not run; again: it was taken
    from an earlier run.
    """

    name: str
    state: str
    seconds: float
    why: str = ""
    again: bool = False
    report: dict[str, Any] = field(default_factory=dict)

    @property
    def demands(self) -> str:
        """How many of its demands were met."""
        claims = self.report.get("claims", [])
        return f"{sum(bool(c['met']) for c in claims)} of {len(claims)}" if claims else ""


def source_version() -> str:
    """Version of the package and a digest of its code: numbers of other code are not taken for those of this one."""
    root = Path(__file__).resolve().parents[2]
    digest = hashlib.sha256()
    for room in ("scenes", "vision", "touch", "fusion"):
        for path in sorted((root / room).rglob("*.py")):
            digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    try:
        version = metadata.version("palpate")
    except metadata.PackageNotFoundError:
        version = "0"
    return f"{version}+{digest.hexdigest()[:12]}"


def settings_key(settings: BenchSettings) -> dict[str, Any]:
    """What of the settings decides the numbers."""
    return {
        "trials": settings.trials,
        "seed": settings.seed,
        "quick": settings.quick,
        "objects": None if settings.objects is None else list(settings.objects),
    }


def run_all(
    names: Sequence[str],
    settings: BenchSettings,
    folder: Path,
    finished: Callable[[Outcome], None] = lambda outcome: None,
    clock: Callable[[], float] = time.monotonic,
    seconds: float | None = None,
) -> list[Outcome]:
    """Run the named benchmarks one after the other into the folder; finished(outcome) is told of each.

    seconds: for all of them together (default: QUICK_SECONDS of a quick run, else no limit); each benchmark gets its
    part of what is left. Those whose entry in the folder's index has the same settings and code are read back.
    """
    folder.mkdir(parents=True, exist_ok=True)
    limit = seconds if seconds is not None else QUICK_SECONDS if settings.quick else None
    version, begin = source_version(), clock()
    outcomes: list[Outcome] = []
    kept = {name: found for name in names if (found := _earlier(folder, name, settings, version)) is not None}
    left = [name for name in names if name not in kept]
    for name in names:
        if name in kept:
            outcome = kept[name]
        else:
            part = None
            if limit is not None:
                share = PARTS.get(name, 1.0) / sum(PARTS.get(other, 1.0) for other in left)
                part = share * max(0.0, limit - (clock() - begin))
            left.remove(name)
            outcome = _run_one(name, settings, folder, part, clock)
        outcomes.append(outcome)
        _write_index(folder, outcomes, settings, version)
        finished(outcome)
    return outcomes


def _run_one(
    name: str, settings: BenchSettings, folder: Path, seconds: float | None, clock: Callable[[], float]
) -> Outcome:
    shown: list[Table] = []
    begin = clock()

    def show(table: Table) -> None:
        shown.append(table)
        settings.show(table)

    limited = replace(
        settings,
        folder=folder,
        show=show,
        progress=settings.progress if seconds is None else _until(begin + seconds, settings.progress, clock),
    )
    state, why = DONE, ""
    try:
        report = load(name).run(limited)
    except OutOfTime:
        state, why = STOPPED, f"its {seconds:.0f} s were used up"
        report = Report(name, f"stopped: {why}", "unfinished", settings.seed, list(shown))
    except (PalpateError, OSError) as error:
        state, why = FAILED, " ".join(str(error).split())
        report = Report(name, f"could not run: {why}", "none", settings.seed, list(shown))
    write_report(report, folder)
    return Outcome(name, state, clock() - begin, why, report=report.to_json())


def _until(deadline: float, progress: Callable[..., Iterator[Any]], clock: Callable[[], float]) -> Callable[..., Any]:
    """The progress, but that it raises OutOfTime instead of handing out a cell after the deadline."""

    def limited(items: Iterable[T], total: int, what: str) -> Iterator[T]:
        for item in progress(items, total, what):
            if clock() > deadline:
                raise OutOfTime
            yield item

    return limited


def _earlier(folder: Path, name: str, settings: BenchSettings, version: str) -> Outcome | None:
    """The finished outcome of an earlier run with the same settings and code; None without one."""
    try:
        entry = json.loads((folder / INDEX).read_text(encoding="utf-8"))["benchmarks"][name]
        report = json.loads((folder / entry["file"]).read_text(encoding="utf-8"))
        same = entry["state"] == DONE and entry["settings"] == settings_key(settings) and entry["version"] == version
        return Outcome(name, DONE, float(entry["seconds"]), again=True, report=report) if same else None
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
            "settings": settings_key(settings),
            "version": version,
            "file": f"{outcome.name}.json",
            "demands_met": outcome.demands,
        }
    command = " ".join(["palpate", *sys.argv[1:]])
    content = {"command": command, "machine": machine(), "version": version, "benchmarks": benchmarks}
    partial = path.with_suffix(".tmp")
    partial.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    partial.replace(path)


def summary(outcomes: Sequence[Outcome]) -> Table:
    """One row a benchmark: what became of it, its time, its demands."""
    table = Table(
        "All benchmarks", [Column("benchmark"), Column("state"), Column("s", 1), Column("demands met"), Column("note")]
    )
    for one in outcomes:
        state = f"{one.state} before" if one.again else one.state
        table.add(one.name, state, one.seconds, one.demands or None, one.why)
    total = sum(one.seconds for one in outcomes if not one.again)
    table.note = f"{total:.0f} s; a benchmark that is done with the same settings and code is not run again."
    return table
