"""One answer from both senses, and everything a user runs.

    from fusion import estimate, track

Names are loaded when they are first used, so that `palpate --help` does not wait for compilers and ray casters.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fusion.answer import Estimate
    from fusion.estimation import estimate
    from fusion.stages import EstimateSettings
    from fusion.tracking import Tracker, track
    from fusion.tracking_answer import TrackedEstimate, TrackSettings

__all__ = ["Estimate", "EstimateSettings", "TrackSettings", "TrackedEstimate", "Tracker", "estimate", "track"]

_HOMES = {
    "Estimate": "fusion.answer",
    "EstimateSettings": "fusion.stages",
    "TrackSettings": "fusion.tracking_answer",
    "TrackedEstimate": "fusion.tracking_answer",
    "Tracker": "fusion.tracking",
    "estimate": "fusion.estimation",
    "track": "fusion.tracking",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'fusion' has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module(_HOMES[name]), name)
