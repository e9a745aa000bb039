"""How many threads compiled work may use: one setting for the whole package."""

from __future__ import annotations

import os

from scenes.errors import InputError

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
