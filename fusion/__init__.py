"""One answer from both senses, and everything a user runs.

    from fusion import estimate

Names are loaded when they are first used, so that `palpate --help` does not wait for compilers and ray casters.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fusion.answer import Estimate
    from fusion.estimation import estimate
    from fusion.stages import EstimateSettings

__all__ = ["Estimate", "EstimateSettings", "estimate"]

_HOMES = {"Estimate": "fusion.answer", "EstimateSettings": "fusion.stages", "estimate": "fusion.estimation"}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'fusion' has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module(_HOMES[name]), name)
