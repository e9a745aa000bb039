"""The one place that imports Open3D: it preloads the libusb its wheel needs and names what else is missing."""

from __future__ import annotations

import ctypes
import importlib
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache, partial
from types import FrameType, ModuleType
from typing import Any

from scenes.errors import SystemLibraryError


@cache
def open3d() -> ModuleType:
    """The open3d module, ready to use.

    Its wheel links libusb-1.0, which a bare machine lacks; the libusb-package wheel carries it, and once loaded
    globally the linker is content. Raises SystemLibraryError, naming the Debian package, for anything else.
    """
    import libusb_package

    path = libusb_package.get_library_path()
    if path is not None:
        ctypes.CDLL(os.fspath(path), mode=ctypes.RTLD_GLOBAL)
    # in a notebook it would start a server of its own and say so; nothing here draws with it
    os.environ.setdefault("OPEN3D_DISABLE_WEB_VISUALIZER", "true")
    stand_in = PLOTLY not in sys.modules and "open3d" not in sys.modules
    if stand_in:
        sys.modules[PLOTLY] = _drawing_later()
    try:
        with _interrupts_later():
            return importlib.import_module("open3d")
    except (OSError, ImportError) as error:
        raise SystemLibraryError(_missing_library_message(error)) from error
    finally:
        if stand_in:
            sys.modules.pop(PLOTLY, None)


@contextmanager
def _interrupts_later() -> Iterator[None]:
    """Ctrl-C waits for the half second: in the middle it would be an error of Open3D's, and what is half loaded spoils
    the exit code of the process.
    """
    if threading.current_thread() is not threading.main_thread():  # no other hears of signals
        yield
        return
    heard: list[tuple[int, FrameType | None]] = []
    before = signal.signal(signal.SIGINT, lambda *what: heard.append(what))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        if heard and callable(before):
            before(*heard[0])


# Open3D loads a web server, half a second, for three functions that draw in a browser.
PLOTLY = "open3d.visualization.draw_plotly"
DRAWING = ("get_plotly_fig", "draw_plotly", "draw_plotly_server")


def _drawing_later() -> ModuleType:
    """A module in that one's place, whose functions load it when they are called."""
    module = ModuleType(PLOTLY)
    for name in DRAWING:
        setattr(module, name, partial(_draw, name))
    return module


def _draw(name: str, *args: Any, **kwargs: Any) -> Any:
    return getattr(importlib.import_module(PLOTLY), name)(*args, **kwargs)


PACKAGES = {
    "libGL.so.1": "libgl1",
    "libEGL.so.1": "libegl1",
    "libX11.so.6": "libx11-6",
    "libgomp.so.1": "libgomp1",
    "libudev.so.1": "libudev1",
    "libidn2.so.0": "libidn2-0",
    "libstdc++.so.6": "libstdc++6",
}


def _missing_library_message(error: Exception) -> str:
    text = str(error)
    for library, package in PACKAGES.items():
        if library in text:
            return f"Open3D needs {library}, which this machine lacks: install the system package {package}"
    return f"Open3D could not be loaded: {text}"
