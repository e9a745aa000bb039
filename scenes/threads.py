"""How many threads compiled work may use: one setting for the whole package."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING

from scenes.errors import InputError

if TYPE_CHECKING:
    from threadpoolctl import LibController

VARIABLE = "PALPATE_THREADS"


def thread_count() -> int:
    """Threads allowed to this process: PALPATE_THREADS when set, else the cores that it may run on.

    Raises InputError when the variable is not a whole number above 0.
    """
    text = os.environ.get(VARIABLE, "").strip()
    if not text:
        if hasattr(os, "sched_getaffinity"):  # Linux: respects cgroup and taskset limits that cpu_count ignores
            return max(1, len(os.sched_getaffinity(0)))
        return os.cpu_count() or 1
    if not text.isdecimal() or int(text) < 1:
        raise InputError(f"{VARIABLE}: expected a whole number above 0, got {text!r}")
    return int(text)


# Modules that bring a BLAS of their own, some of them only when they are used.
BLAS_OF = ("numpy", "scipy.linalg", "cv2")


@cache
def _blas(loaded: tuple[str, ...]) -> list[LibController]:
    """What controls those of the modules `loaded`: a controller knows only the libraries that it found when made."""
    from threadpoolctl import ThreadpoolController

    return [library for library in ThreadpoolController().lib_controllers if library.user_api == "blas"]


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Keep linear algebra on the calling thread: on matrices of a hundred rows more threads cost more than they do.

    A BLAS that another thread has just worked for keeps that thread spinning for some 25 ms, which counts as the
    process's time: hold whatever is timed, and what goes before it, in one such block. The limit is the process's:
    where several threads hold one, the last to leave lifts it.
    """
    _limit.enter()
    try:
        yield
    finally:
        _limit.leave()


class _Limit:
    """How many hold a BLAS to one thread, and what undoes it."""

    def __init__(self) -> None:
        self._lock, self._holding = threading.Lock(), 0
        # libraries that had more threads, and how many
        self._before: list[tuple[LibController, int]] = []

    def enter(self) -> None:
        with self._lock:
            if not self._holding:
                # a context of threadpoolctl's own asks each library for its version, too: a hundredth of a frame's time
                libraries = _blas(tuple(name for name in BLAS_OF if name in sys.modules))
                known = [(library, library.get_num_threads()) for library in libraries]
                self._before = [(library, count) for library, count in known if count is not None and count != 1]
                for library, _ in self._before:
                    _set_threads(library, 1)
            self._holding += 1

    def leave(self) -> None:
        with self._lock:
            self._holding -= 1
            if not self._holding:
                for library, count in self._before:
                    _set_threads(library, count)


def _set_threads(library: LibController, count: int) -> None:
    """Set how many threads a library has, whichever thread asks: of those that set the process's OpenBLAS, a newer
    threadpoolctl listens to the first, and silently to no other while that lives.
    """
    anyone = getattr(library, "clear_controlling_thread", lambda force: None)
    anyone(force=True)
    library.set_num_threads(count)
    anyone(force=True)  # nor does this one keep others from it


_limit = _Limit()


@cache
def _pool(workers: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(workers, thread_name_prefix="palpate")


def run_chunks(work: Callable[[slice], None], count: int, smallest: int = 1) -> None:
    """Call work(slice) over 0..count-1, on several threads when each gets at least `smallest` items.

    For compiled kernels that release the interpreter lock and write to disjoint parts of their outputs. Twice as many
    chunks as threads evens out poses that take longer; the result does not depend on how the work was cut.
    """
    # most calls are too small for a second thread: then nobody asks how many there are
    parts = max(1, count // max(1, smallest))
    threads = 1 if parts == 1 else min(thread_count(), parts)
    if threads <= 1:
        if count:
            work(slice(0, count))
        return
    edges = [count * i // (2 * threads) for i in range(2 * threads + 1)]
    for future in [_pool(threads).submit(work, slice(a, b)) for a, b in pairwise(edges) if b > a]:
        future.result()
