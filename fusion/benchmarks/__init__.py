"""Benchmarks that a user can run: `palpate bench NAME`. Each module has `run(settings) -> Report`."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any

# Name on the command line -> module.
BENCHMARKS = {
    "real": "fusion.benchmarks.real.bench",
    "local": "fusion.benchmarks.contacts.local",
    "global": "fusion.benchmarks.contacts.global_search",
    "few": "fusion.benchmarks.contacts.few",
    "robustness": "fusion.benchmarks.contacts.robustness",
    "arrays": "fusion.benchmarks.arrays.bench",
    "gel": "fusion.benchmarks.gels.bench",
    "filters": "fusion.benchmarks.contacts.filters",
    "recognition": "fusion.benchmarks.contacts.recognition",
    "vision": "fusion.benchmarks.camera.vision",
    "search": "fusion.benchmarks.frames.search",
    "occlusion": "fusion.benchmarks.frames.occlusion",
    "calibration": "fusion.benchmarks.frames.calibration",
    "profile": "fusion.benchmarks.frames.profile",
    "skipping": "fusion.benchmarks.frames.skipping",
    "stability": "fusion.benchmarks.stability",
    "peers": "fusion.benchmarks.peers.bench",
    "scaling": "fusion.benchmarks.frames.scaling",
    "faults": "fusion.benchmarks.frames.faults",
    "scenes": "fusion.benchmarks.camera.scenes",
    "segmentation": "fusion.benchmarks.camera.segmentation",
    "colour": "fusion.benchmarks.camera.colour",
    "tracking": "fusion.benchmarks.tracking.bench",
    "failing": "fusion.benchmarks.tracking.failing",
    "memory": "fusion.benchmarks.tracking.memory",
}


def available() -> list[str]:
    """Names of the benchmarks that this installation has."""
    return [name for name, module in BENCHMARKS.items() if find_spec(module) is not None]


def load(name: str) -> Any:
    """The module of a benchmark; ImportError when it is not installed."""
    return import_module(BENCHMARKS[name])
