"""From touch to contact evidence, and every estimator that works on touch alone.

    from touch import Contacts, localize

Names are loaded when they are first used.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any

try:
    from scenes.own import check_packages
except ImportError as error:  # another's "scenes" came first, and refuses in words of its own
    if getattr(error, "name", None) not in ("scenes", "scenes.own"):
        raise
    raise ImportError(
        f"palpate: expected its package 'scenes' beside {__file__}, but Python finds another one or none:"
        " uninstall or rename that, or install palpate into an environment of its own"
    ) from error

if TYPE_CHECKING:
    from scenes.recordings.frames import Contacts
    from touch.answers import Localization
    from touch.localization import localize
    from touch.recognition import Identification, identify

__all__ = ["Contacts", "Identification", "Localization", "identify", "localize"]

check_packages()

# Silent unless who uses the package listens.
logging.getLogger(__name__).addHandler(logging.NullHandler())

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
