"""Ctrl-C waits until what is being loaded is loaded: libraries take it for an error of their own.

Trimesh takes whatever ends an import of its for a library that is not there and goes on without; what is compiled
(numba, NumPy, Open3D) makes another error of it, and what is half loaded spoils the exit code of the process.
"""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

from scenes.own import PACKAGES


@contextmanager
def interrupts_later() -> Iterator[None]:
    """Ctrl-C is heard at the end, by whoever listens then; in the main thread only, no other hears of it."""
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or before is None or before is _hear:
        yield
        return
    _heard.clear()
    signal.signal(signal.SIGINT, _hear)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        if _heard:
            signal.raise_signal(signal.SIGINT)


_heard: list[int] = []


def _hear(number: int, frame: object) -> None:
    _heard.append(number)


@contextmanager
def whole_imports() -> Iterator[None]:
    """Modules of others are loaded whole, or not at all, while this lasts; our own may be interrupted at any time."""
    finder = _Whole()
    sys.meta_path.insert(0, finder)
    try:
        yield
    finally:
        sys.meta_path.remove(finder)


class _Whole(MetaPathFinder):
    """Finds what the other finders find, and has it loaded with Ctrl-C put off."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """As the first of the others; None for palpate's own modules, and for what nobody finds."""
        if fullname.partition(".")[0] in PACKAGES:
            return None
        for finder in list(sys.meta_path):
            find = None if isinstance(finder, _Whole) else getattr(finder, "find_spec", None)
            spec = None if find is None else find(fullname, path, target)
            if spec is not None:
                _put_off(spec)
                return spec
        return None


def _put_off(spec: ModuleSpec) -> None:
    """Have the spec's loader run its module once with Ctrl-C put off; loaders that are classes (of what is built in)
    stay as they are.
    """
    loader: Any = spec.loader
    waits = "exec_module" in getattr(loader, "__dict__", {})
    if waits or isinstance(loader, type) or not hasattr(loader, "exec_module"):
        return

    def run(module: ModuleType) -> None:
        vars(loader).pop("exec_module", None)
        with interrupts_later():
            loader.exec_module(module)

    with suppress(AttributeError):  # a loader that nothing can be put onto
        loader.exec_module = run
