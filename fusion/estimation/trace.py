"""The trace of an estimate: each stage, run or skipped, why, how long, on how many rows."""

from __future__ import annotations

import logging
import time
from dataclasses import replace

from fusion.estimation.answer import Estimate, Stage

_log = logging.getLogger(__name__)


class _Running:
    """The stage under way: `note` says what it worked on. Of a trace's list `stages`, those that are added before it
    ends are within it.
    """

    __slots__ = ("_before", "_begin", "_name", "_run", "_stages", "_why_not", "rows", "why")

    def __init__(self, stages: list[Stage], name: str, run: bool, why_not: str) -> None:
        self._stages, self._name, self._run, self._why_not = stages, name, run, why_not
        self._before, self._begin = len(stages), time.perf_counter()
        self.rows, self.why = 0, ""

    def note(self, rows: int, why: str) -> None:
        """Rows of evidence used, and a few words on the outcome."""
        self.rows, self.why = rows, why

    def __enter__(self) -> _Running:
        """As it is."""
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """List it, unless it failed."""
        if kind is not None:
            return
        spent = 1e3 * (time.perf_counter() - self._begin) - sum(inner.ms for inner in self._stages[self._before :])
        why, rows = (self.why, self.rows) if self._run else (self._why_not, 0)
        if _log.isEnabledFor(logging.DEBUG):
            _log.debug("%s: %s", self._name, f"{spent:.1f} ms, {rows} rows, {why}" if self._run else why)
        self._stages.append(Stage(self._name, self._run, why, max(spent, 0.0), rows))


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

    def noting_budget(self, answer: Estimate) -> Estimate:
        """The answer with a note when it took longer than the budget: what cannot be skipped takes its time."""
        if not self.over_budget:
            return answer
        note = f"the time budget of {self._budget:g} ms was exceeded: {self.spent_ms:.0f} ms"
        return replace(answer, notes=(*answer.notes, note))

    def skipping(self, answer: Estimate, name: str, why: str) -> Estimate:
        """The answer with a line of its trace rewritten: stage `name` was skipped, for this reason."""
        stages = tuple(Stage(name, False, why) if s.name == name and not s.ran else s for s in answer.trace)
        return replace(answer, trace=stages)

    def stage(self, name: str, run: bool, why_not: str) -> _Running:
        """Time a stage. A stage that is not run still passes through (on nothing) and is listed as skipped.

        Stages within it are listed before it, and their time is theirs.
        """
        return _Running(self._stages, name, run, why_not)
