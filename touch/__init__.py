"""From touch to contact evidence, and every estimator that works on touch alone.

    from touch import Contacts, localize

Names are loaded when they are first used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from scenes.recordings.frames import Contacts
    from touch.answers import Localization
    from touch.localization import localize
    from touch.recognition import Identification, identify

__all__ = ["Contacts", "Identification", "Localization", "identify", "localize"]

_HOMES = {
    "Contacts": "scenes.recordings.frames",
    "Identification": "touch.recognition",
    "Localization": "touch.answers",
    "identify": "touch.recognition",
    "localize": "touch.localization",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'touch' has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module(_HOMES[name]), name)
