"""Which frame comes next: one after the other, or the newest that a camera would have delivered by now. Seconds."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from scenes.errors import InputError

# A replay (s) of which no end is to be seen: no system sleeps for thousands of years.
LONGEST = 365 * 86400.0


@dataclass(frozen=True)
class Next:
    """position of the frame to work on; behind: positions passed over because newer ones had come; due: the instant
    (s, of the replay's clock) at which a camera delivers it, None when frames wait for the tracker.
    """

    position: int
    behind: range
    due: float | None = None


class InTurn:
    """Every frame, as fast as it goes."""

    hertz: float | None = None

    def __init__(self, numbers: Sequence[int], first: int = 0) -> None:
        """numbers: of the recording's frames; first: position to begin at."""
        self._count, self._first = len(numbers), first

    def __iter__(self) -> Iterator[Next]:
        return (Next(position, range(0)) for position in range(self._first, self._count))

    def latency(self, due: float | None) -> float | None:
        """Nothing is late here."""
        return None

    @contextmanager
    def stopped(self) -> Iterator[None]:
        """As in a replay."""
        yield


class RealTime(InTurn):
    """A recording as a camera of `hertz` delivers it, whoever is ready or not: a buffer of one frame, the newest.

    Frames count by their numbers, so a gap in the recording is a gap in time. What no live camera costs (reading files,
    the report's pictures) is done while the clock stands still.
    """

    def __init__(
        self,
        numbers: Sequence[int],
        hertz: float,
        first: int = 0,
        clock: Callable[[], float] = time.perf_counter,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """The clock starts when the first frame is asked for. Raises InputError for a rate at which it takes years."""
        super().__init__(numbers, first)
        frames = numbers[-1] - numbers[first] if first < len(numbers) else 0
        if frames / hertz > LONGEST:
            said = f"so many frames a second that {frames} take less than a year, got {hertz:g}"
            raise InputError(f"realtime: expected {said}")
        self.hertz = hertz
        self._numbers = numbers
        self._clock, self._sleep = clock, sleep
        self._start = self._held = 0.0

    def __iter__(self) -> Iterator[Next]:
        self._start, self._held = self._clock(), 0.0
        position = self._first
        while position < self._count:
            wait = self._due(position) - self._now()
            if wait > 0:
                self._sleep(wait)
            newest = position
            while newest + 1 < self._count and self._due(newest + 1) <= self._now():
                newest += 1
            yield Next(newest, range(position, newest), self._due(newest))
            position = newest + 1

    def latency(self, due: float | None) -> float | None:
        """Seconds since the camera delivered the frame."""
        return None if due is None else self._now() - due

    @contextmanager
    def stopped(self) -> Iterator[None]:
        """The clock stands still meanwhile."""
        begin = self._clock()
        try:
            yield
        finally:
            self._held += self._clock() - begin

    def _now(self) -> float:
        return self._clock() - self._start - self._held

    def _due(self, position: int) -> float:
        assert self.hertz is not None
        return (self._numbers[position] - self._numbers[self._first]) / self.hertz
