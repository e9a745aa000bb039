"""One answer from both senses, and everything a user runs.

    from fusion import estimate, track

Names are loaded when they are first used, so that `palpate --help` does not wait for compilers and ray casters.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fusion.estimation.answer import Estimate
    from fusion.estimation.estimate import estimate
    from fusion.estimation.settings import EstimateSettings
    from fusion.settings import Settings
    from fusion.tracking.answer import TrackedEstimate, TrackSettings
    from fusion.tracking.tracker import Tracker, track

__all__ = [
    "Estimate",
    "EstimateSettings",
    "Settings",
    "TrackSettings",
    "TrackedEstimate",
    "Tracker",
    "estimate",
    "track",
]

_HOMES = {
    "Estimate": "fusion.estimation.answer",
    "EstimateSettings": "fusion.estimation.settings",
    "Settings": "fusion.settings",
    "TrackSettings": "fusion.tracking.answer",
    "TrackedEstimate": "fusion.tracking.answer",
    "Tracker": "fusion.tracking.tracker",
    "estimate": "fusion.estimation.estimate",
    "track": "fusion.tracking.tracker",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'fusion' has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module(_HOMES[name]), name)
