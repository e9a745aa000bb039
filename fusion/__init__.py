"""One answer from both senses, and everything a user runs.

    from fusion import estimate, track

Names are loaded when they are first used, so that `palpate --help` does not wait for compilers and ray casters.
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
    from fusion.estimation.answer import Estimate
    from fusion.estimation.estimate import estimate
    from fusion.estimation.posterior.samples import sample_poses
    from fusion.estimation.settings import EstimateSettings
    from fusion.settings import Settings
    from fusion.tracking.answer import TrackedEstimate, TrackSettings
    from fusion.tracking.rehearsal import rehearse
    from fusion.tracking.tracker import Tracker, track

__all__ = [
    "Estimate",
    "EstimateSettings",
    "Settings",
    "TrackSettings",
    "TrackedEstimate",
    "Tracker",
    "estimate",
    "rehearse",
    "sample_poses",
    "track",
]

check_packages()

# Silent unless who uses the package listens.
logging.getLogger(__name__).addHandler(logging.NullHandler())

_HOMES = {
    "Estimate": "fusion.estimation.answer",
    "EstimateSettings": "fusion.estimation.settings",
    "Settings": "fusion.settings",
    "TrackSettings": "fusion.tracking.answer",
    "TrackedEstimate": "fusion.tracking.answer",
    "Tracker": "fusion.tracking.tracker",
    "estimate": "fusion.estimation.estimate",
    "rehearse": "fusion.tracking.rehearsal",
    "sample_poses": "fusion.estimation.posterior.samples",
    "track": "fusion.tracking.tracker",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'fusion' has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module(_HOMES[name]), name)
