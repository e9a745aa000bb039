"""The world: things with geometry, and recordings of them.

    from scenes import ObjectModel, read_capture

Names are loaded when they are first used.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any

from scenes.own import check_packages

if TYPE_CHECKING:
    from scenes.errors import PalpateError
    from scenes.geometry.cameras import Camera
    from scenes.geometry.objects import ObjectModel
    from scenes.recordings.captures import read_capture, write_capture
    from scenes.recordings.frames import Contacts, Frame
    from scenes.robot.hands import Hand

__all__ = ["Camera", "Contacts", "Frame", "Hand", "ObjectModel", "PalpateError", "read_capture", "write_capture"]

check_packages()

# Silent unless who uses the package listens.
logging.getLogger(__name__).addHandler(logging.NullHandler())

_HOMES = {
    "Camera": "scenes.geometry.cameras",
    "Contacts": "scenes.recordings.frames",
    "Frame": "scenes.recordings.frames",
    "Hand": "scenes.robot.hands",
    "ObjectModel": "scenes.geometry.objects",
    "PalpateError": "scenes.errors",
    "read_capture": "scenes.recordings.captures",
    "write_capture": "scenes.recordings.captures",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'scenes' has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module(_HOMES[name]), name)
