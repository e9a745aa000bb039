"""From RGB-D to object pixels, free space and a coarse pose.

    from vision import look

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
    from scenes.recordings.beliefs import DepthModel
    from vision.look.hand.hand import HandView, view_hand
    from vision.look.look import look
    from vision.look.looked import Looked
    from vision.look.mask.mask import object_mask
    from vision.tracking.by_vision import track_by_vision
    from vision.visibility import Visibility

__all__ = [
    "DepthModel",
    "HandView",
    "Looked",
    "Visibility",
    "look",
    "object_mask",
    "track_by_vision",
    "view_hand",
]

check_packages()

# Silent unless who uses the package listens.
logging.getLogger(__name__).addHandler(logging.NullHandler())

_HOMES = {
    "DepthModel": "scenes.recordings.beliefs",
    "HandView": "vision.look.hand.hand",
    "Looked": "vision.look.looked",
    "Visibility": "vision.visibility",
    "object_mask": "vision.look.mask.mask",
    "look": "vision.look.look",
    "track_by_vision": "vision.tracking.by_vision",
    "view_hand": "vision.look.hand.hand",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'vision' has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module(_HOMES[name]), name)
