"""What every conversion shares: counts of what was left out, a folder that appears whole, errors with their file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from scenes.errors import CaptureError, PalpateError
from scenes.files.whole import draft_folder, followed
from scenes.recordings.frames import Frame
from scenes.words import counted

Array = NDArray[np.float64]
T = TypeVar("T")

# Contacts that fingers may have felt: recorded sets have 3 to 75, clouds from a thousand points on.
MOST_CONTACTS = 300
# A camera whose distortion coefficients are all below this draws straight lines straight.
LARGEST_DISTORTION = 1e-9
# Periods (an hour of 30 Hz) that numbers leave out at most: a longer gap is a clock that was set.
LONGEST_GAP = 100_000


class Dropped:
    """How many of what were left out, and why; in the order in which they were first met."""

    def __init__(self) -> None:
        self._counts: Counter[tuple[str, str]] = Counter()

    def add(self, what: str, why: str, count: int = 1) -> None:
        """Count `count` more of `what` (a topic, "image") left out because of `why`; nothing for a count of 0."""
        if count:
            self._counts[what, why] += count

    def count(self, what: str | None = None) -> int:
        """How many were left out, of everything or of `what`."""
        return sum(n for (name, _), n in self._counts.items() if what in (None, name))

    def merge(self, other: Dropped) -> None:
        """Count all of another's too."""
        self._counts.update(other._counts)

    def to_json(self) -> list[dict[str, Any]]:
        """One entry a pair of what and why."""
        return [{"what": what, "why": why, "count": n} for (what, why), n in self._counts.items()]

    def lines(self) -> list[str]:
        """The same as sentences."""
        return [f"dropped {n} of {what}: {why}" for (what, why), n in self._counts.items()]


@dataclass(frozen=True)
class Converted:
    """What a conversion wrote: files or folders, the number of frames, what was left out, and things worth knowing."""

    written: tuple[Path, ...]
    frames: int = 0
    dropped: Dropped = field(default_factory=Dropped)
    remarks: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """For `--json`."""
        return {
            "written": [str(path) for path in self.written],
            "frames": self.frames,
            "dropped": self.dropped.to_json(),
            "remarks": list(self.remarks),
        }


def many_contacts(where: str, count: int, hint: str = "") -> tuple[str, ...]:
    """A warning where more contacts were read than fingers feel; none for a number that may be."""
    if count <= MOST_CONTACTS:
        return ()
    return (f"warning: {where}: all {count} points become contacts, more than fingers feel: is it a cloud?{hint}",)


def period_of(stamps: Sequence[int]) -> int:
    """The time from one image to the next as most of them have it, in the unit of the sorted stamps; 0 of a single one.

    A middle one of the differences, not a mean of two: a gap among few images is no period.
    """
    steps = sorted(after - before for before, after in pairwise(stamps) if after > before)
    return steps[(len(steps) - 1) // 2] if steps else 0


def numbers_in_time(stamps: Sequence[int], period: int) -> list[int]:
    """Frame numbers from 0, as many apart as there are periods between the sorted stamps, at least one: a tracker takes
    numbers for time, and a gap for so many frames that it has missed.
    """
    numbers = [0] if stamps else []
    for before, after in pairwise(stamps):
        step = (2 * (after - before) + period) // (2 * period) if period else 1
        numbers.append(numbers[-1] + min(max(step, 1), LONGEST_GAP))
    return numbers


def gaps_of(numbers: Sequence[int], period_ns: int) -> tuple[str, ...]:
    """A remark on the numbers that no frame has; none where all are there."""
    missing = [after - before - 1 for before, after in pairwise(numbers) if after - before > 1]
    if not missing:
        return ()
    period = f"{period_ns / 1e6:.4g} ms"
    return (f"{counted(len(missing), 'gap')} in time: frame numbers leave out {sum(missing)} periods of {period}",)


def at_least_one(frames: Iterable[Frame], source: Path, dropped: Dropped) -> Iterator[Frame]:
    """The frames; raises CaptureError with what was dropped when there were none."""
    empty = True
    for frame in frames:
        empty = False
        yield frame
    if empty:
        reasons = "; ".join(dropped.lines()) or "it holds none"
        raise CaptureError(f"{source}: expected at least one frame, got none: {reasons}")


def check_undistorted(where: str, coefficients: Array, cure: str) -> None:
    """Raise CaptureError for a lens whose distortion `coefficients` (k,) are not all zero; `cure` says what to do."""
    largest = float(np.abs(coefficients).max(initial=0.0))
    if not largest <= LARGEST_DISTORTION:  # NaN, too
        raise CaptureError(f"{where}: expected images without distortion, got coefficients up to {largest:.3g}: {cure}")


def located(path: Path, read: Callable[[Path], T]) -> T:
    """read(path), with the file's name before whatever it complains of."""
    try:
        return read(path)
    except PalpateError as error:
        message = str(error)
        raise CaptureError(message if message.startswith(str(path)) else f"{path}: {message}") from error


@contextmanager
def new_folder(out: Path) -> Iterator[Path]:
    """A folder to write into that becomes `out` when all goes well; raises CaptureError when `out` holds files."""
    if out.is_file() or (out.is_dir() and any(out.iterdir())):
        found = "a file" if out.is_file() else "other files in it"
        raise CaptureError(f"{out}: expected a new or empty folder to write to, found {found}")
    with draft_folder(out) as partial:
        yield partial
        target = followed(out)
        if target.is_dir():
            target.rmdir()
        partial.rename(target)
