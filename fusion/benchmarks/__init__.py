"""Benchmarks that a user can run: `palpate bench NAME`. Each module has `run(settings) -> Report`."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any

# Name on the command line -> module.
BENCHMARKS = {
    "local": "fusion.benchmarks.local",
    "global": "fusion.benchmarks.global_search",
    "robustness": "fusion.benchmarks.contact_robustness",
    "arrays": "fusion.benchmarks.arrays",
    "filters": "fusion.benchmarks.filters",
    "recognition": "fusion.benchmarks.recognition",
    "vision": "fusion.benchmarks.vision",
    "occlusion": "fusion.benchmarks.occlusion",
    "calibration": "fusion.benchmarks.calibration",
    "skipping": "fusion.benchmarks.skipping",
    "stability": "fusion.benchmarks.stability",
    "peers": "fusion.benchmarks.peers",
    "scaling": "fusion.benchmarks.scaling",
    "faults": "fusion.benchmarks.faults",
    "scenes": "fusion.benchmarks.scenes",
    "segmentation": "fusion.benchmarks.segmentation",
    "tracking": "fusion.benchmarks.tracking",
}


def available() -> list[str]:
    """Names of the benchmarks that this installation has."""
    return [name for name, module in BENCHMARKS.items() if find_spec(module) is not None]


def load(name: str) -> Any:
    """The module of a benchmark; ImportError when it is not installed."""
    return import_module(BENCHMARKS[name])
