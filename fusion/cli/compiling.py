"""What a machine's first run waits for: numba compiles the kernels, and standard error says how far it is."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TextIO

from fusion.cli.options import is_quiet

# Said before and by `palpate doctor`. `estimate` and `demo` compile for some 100 s of processor time, on one core.
TAKES = "one to two minutes"
# Kernels that an estimate by all senses compiles, those that others call not counted: 54. For a person to see an end.
USUAL = 55
# Between two lines (s) where one cannot stand in the place of the other: in a pipe, above a progress bar.
SAID_EVERY = 10.0


def announce_compiling() -> None:
    """On a machine's first run, say what the next minutes are spent on, and how far it is as long as it lasts (standard
    error, so results stay clean).
    """
    if is_quiet() or kernels_compiled()[0]:
        return
    from numba.core import event

    sys.stderr.write(f"compiling the kernels, once on this machine: {TAKES}\n")
    sys.stderr.flush()
    progress = Progress()
    event.register("numba:compile", _listening(progress))


def kernels_compiled() -> tuple[bool, Path]:
    """Whether an earlier run compiled the kernels, and the folder where they are kept."""
    from scenes.evidence.solver_kernels import align_poses

    # numba keeps an index beside the module, or in the user's cache folder when it may not write there
    folder = Path(align_poses._cache.cache_path)  # type: ignore[attr-defined]
    return any(folder.glob("solver_kernels.align_poses-*.nbi")), folder


class Progress:
    """Counts kernels as they are compiled, one within another as one. On a terminal one line that is taken away again;
    elsewhere a line now and then, which a progress bar can stand below.
    """

    def __init__(self, stream: TextIO | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        """stream: standard error as it is when something is said."""
        self._stream, self._clock = stream, clock
        self._begun = self._said_at = clock()
        self._within = self.count = 0

    def begin(self, name: str) -> None:
        """A kernel of that name, with its module, is compiled now."""
        self._within += 1
        if self._within > 1:
            return
        self.count += 1
        now = self._clock()
        stream = self._stream or sys.stderr
        how_far = f"{self.count} of about {USUAL}" if self.count <= USUAL else f"{self.count}"
        said = f"compiling kernel {how_far}, {now - self._begun:.0f} s so far: {name}"
        if _in_place(stream):
            stream.write(f"\r\x1b[K{said[:79]}")
        elif now - self._said_at >= SAID_EVERY:
            stream.write(f"{said}\n")
            self._said_at = now
        stream.flush()

    def end(self) -> None:
        """The kernel begun last is compiled."""
        self._within -= 1
        stream = self._stream or sys.stderr
        if not self._within and _in_place(stream):
            stream.write("\r\x1b[K")
            stream.flush()


def _in_place(stream: Any) -> bool:
    """Whether a line can be written over: on a terminal of which no progress bar has taken hold (rich's says so)."""
    return bool(stream.isatty()) and not hasattr(stream, "rich_proxied_file")


def _listening(progress: Progress) -> Any:
    """A listener to numba's compiler that tells `progress`."""
    from numba.core import event

    class Listener(event.Listener):
        def on_start(self, event: Any) -> None:
            function = event.data["dispatcher"].py_func
            progress.begin(f"{function.__module__}.{function.__name__}")

        def on_end(self, event: Any) -> None:
            progress.end()

    return Listener()
