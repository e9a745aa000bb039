"""The one place that imports Open3D: it preloads the libusb its wheel needs and names what else is missing."""

from __future__ import annotations

import ctypes
import importlib
import os
import sys
from functools import cache, partial
from types import ModuleType
from typing import Any

from scenes._interrupts import interrupts_later
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
        with interrupts_later():
            return importlib.import_module("open3d")
    except (OSError, ImportError) as error:
        raise SystemLibraryError(_missing_library_message(error)) from error
    finally:
        if stand_in:
            sys.modules.pop(PLOTLY, None)


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
