"""The world: things with geometry, and recordings of them.

    from scenes import ObjectModel, read_capture

Names are loaded when they are first used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from scenes.captures import read_capture, write_capture
    from scenes.errors import PalpateError
    from scenes.frames import Contacts, Frame
    from scenes.objects import ObjectModel

__all__ = ["Contacts", "Frame", "ObjectModel", "PalpateError", "read_capture", "write_capture"]

_HOMES = {
    "Contacts": "scenes.frames",
    "Frame": "scenes.frames",
    "ObjectModel": "scenes.objects",
    "PalpateError": "scenes.errors",
    "read_capture": "scenes.captures",
    "write_capture": "scenes.captures",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'scenes' has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module(_HOMES[name]), name)
