"""Recordings made, with their truth known.

    from scenes.synthesis import synthesize

Names are loaded when they are first used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from scenes.synthesis.recording import synthesize, synthesize_frames
    from scenes.synthesis.settings import SynthesisSettings

__all__ = ["SynthesisSettings", "synthesize", "synthesize_frames"]

_HOMES = {
    "SynthesisSettings": "scenes.synthesis.settings",
    "synthesize": "scenes.synthesis.recording",
    "synthesize_frames": "scenes.synthesis.recording",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'scenes.synthesis' has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module(_HOMES[name]), name)
