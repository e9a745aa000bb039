"""The trace of an estimate: each stage, run or skipped, why, how long, on how many rows."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

from fusion.estimation.answer import Estimate, Stage

_log = logging.getLogger(__name__)


class _Running:
    """The stage under way: `note` says what it worked on."""

    def __init__(self) -> None:
        self.rows = 0
        self.why = ""

    def note(self, rows: int, why: str) -> None:
        """Rows of evidence used, and a few words on the outcome."""
        self.rows, self.why = rows, why


class Trace:
    """Collects stages; knows what is left of a time budget (ms, None = no limit)."""

    def __init__(self, budget_ms: float | None = None) -> None:
        self._begin = time.perf_counter()
        self._budget = budget_ms
        self._stages: list[Stage] = []

    @property
    def stages(self) -> tuple[Stage, ...]:
        """All stages so far."""
        return tuple(self._stages)

    @property
    def spent_ms(self) -> float:
        """Milliseconds since the trace began."""
        return 1e3 * (time.perf_counter() - self._begin)

    @property
    def over_budget(self) -> bool:
        """Whether optional work should be skipped."""
        return self._budget is not None and self.spent_ms > self._budget

    def skipping(self, answer: Estimate, name: str, why: str) -> Estimate:
        """The answer with a line of its trace rewritten: stage `name` was skipped, for this reason."""
        stages = tuple(Stage(name, False, why) if s.name == name and not s.ran else s for s in answer.trace)
        return replace(answer, trace=stages)

    @contextmanager
    def stage(self, name: str, run: bool, why_not: str) -> Iterator[_Running]:
        """Time a stage. A stage that is not run still passes through (on nothing) and is listed as skipped.

        Stages within it are listed before it, and their time is theirs.
        """
        running = _Running()
        begin, before = time.perf_counter(), len(self._stages)
        yield running
        spent = 1e3 * (time.perf_counter() - begin) - sum(inner.ms for inner in self._stages[before:])
        if _log.isEnabledFor(logging.DEBUG):
            _log.debug("%s: %s", name, f"{spent:.1f} ms, {running.rows} rows, {running.why}" if run else why_not)
        self._stages.append(
            Stage(name, run, running.why if run else why_not, max(spent, 0.0), running.rows if run else 0)
        )
