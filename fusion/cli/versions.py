"""Versions of palpate and of what it stands on, as installed."""

from __future__ import annotations

import platform
import re
import sys
from importlib import metadata

# Of a source tree that is not installed; the same as in pyproject.toml.
NEEDED = (
    "numpy",
    "scipy",
    "numba",
    "trimesh",
    "open3d-cpu",
    "libusb-package",
    "opencv-contrib-python-headless",
    "rich",
    "jsonschema",
    "threadpoolctl",
    "shtab",
)
# Extras and the package that each adds.
OPTIONAL = {"viewer": "viser", "cluster": "distributed", "ros": "rosbags", "peers": "small_gicp"}


def dependencies() -> tuple[str, ...]:
    """Names of what palpate needs on this machine, without the extras."""
    try:
        required = metadata.requires("palpate") or []
    except metadata.PackageNotFoundError:
        return NEEDED
    found = []
    for line in required:
        requirement, _, condition = line.partition(";")
        name = re.match(r"[\w.-]+", requirement)
        if name is not None and "extra ==" not in condition and _is_for_here(name[0]):
            found.append(name[0])
    return tuple(found)


def _is_for_here(name: str) -> bool:
    """Whether a requirement with a condition is for this machine: Open3D has two wheels, new Pythons read TOML."""
    if name.startswith("open3d"):
        here = platform.system() == "Linux" and platform.machine() == "x86_64"
        return name == ("open3d-cpu" if here else "open3d")
    return name != "tomli" or sys.version_info < (3, 11)


def version_of(name: str) -> str | None:
    """The installed version, None when there is none."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def lines() -> list[str]:
    """Palpate's own version, then Python's and the dependencies', one a line."""
    own = version_of("palpate") or "0 (not installed)"
    needed = [f"  {name} {version_of(name) or 'not installed'}" for name in dependencies()]
    return [
        f"palpate {own}",
        f"  python {platform.python_version()} ({platform.system()} {platform.machine()})",
        *needed,
    ]
