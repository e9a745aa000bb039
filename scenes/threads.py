"""How many threads compiled work may use: one setting for the whole package."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING

from scenes.errors import InputError

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

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
def _blas(loaded: tuple[str, ...]) -> ThreadpoolController:
    """What controls those of the modules `loaded`: a controller knows only the libraries that it found when made."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def one_blas_thread() -> AbstractContextManager[object]:
    """Keep linear algebra on the calling thread: on matrices of a hundred rows more threads cost more than they do.

    A BLAS that another thread has just worked for keeps that thread spinning for some 25 ms, which counts as the
    process's time: hold whatever is timed, and what goes before it, in one such block.
    """
    return _blas(tuple(name for name in BLAS_OF if name in sys.modules)).limit(limits=1, user_api="blas")


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
