"""What every conversion shares: counts of what was left out, a folder that appears whole, errors with their file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from scenes.errors import CaptureError, PalpateError
from scenes.files.whole import draft_folder
from scenes.recordings.frames import Frame

Array = NDArray[np.float64]
T = TypeVar("T")

# Contacts that fingers may have felt: recorded sets have 3 to 75, clouds from a thousand points on.
MOST_CONTACTS = 300
# A camera whose distortion coefficients are all below this draws straight lines straight.
LARGEST_DISTORTION = 1e-9


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
        if out.is_dir():
            out.rmdir()
        partial.rename(out)
