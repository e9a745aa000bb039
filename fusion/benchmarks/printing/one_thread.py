"""One thread for everybody, so that methods are compared at the same work: ours, Open3D's, OpenCV's, PyTorch's."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from scenes.threads import VARIABLE


@contextmanager
def one_thread() -> Iterator[None]:
    """Inside the block compiled work has one thread: by every library's own setting, and where the system has
    affinities by one core, which also binds pools that no setting reaches.
    """
    import cv2
    from threadpoolctl import threadpool_limits

    before, threads = os.environ.get(VARIABLE), cv2.getNumThreads()
    cores = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
    os.environ[VARIABLE] = "1"
    cv2.setNumThreads(1)
    _bind(set(sorted(cores)[-1:]))
    try:
        with threadpool_limits(limits=1):
            yield
    finally:
        _bind(cores)
        cv2.setNumThreads(threads)
        if before is None:
            del os.environ[VARIABLE]
        else:
            os.environ[VARIABLE] = before


def _bind(cores: set[int]) -> None:
    """Every thread of this process to these cores; nothing without any."""
    if not cores:
        return
    os.sched_setaffinity(0, cores)
    tasks = Path("/proc/self/task")
    for task in tasks.iterdir() if tasks.is_dir() else ():
        with suppress(OSError):  # a thread that has ended
            os.sched_setaffinity(int(task.name), cores)
