"""What a benchmark's numbers depend on: the command, the code, the machine and the versions of packages."""

from __future__ import annotations

import hashlib
import os
import platform
import sys
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

PACKAGES = (
    *("palpate", "numpy", "scipy", "numba", "open3d", "open3d-cpu", "trimesh", "opencv-contrib-python-headless"),
    *("small_gicp", "chsel", "torch"),
)


def command_line() -> str:
    """The command as it was typed, its path left out."""
    return " ".join(["palpate", *sys.argv[1:]])


@cache
def source_version() -> str:
    """Version of the package and a digest of its code: numbers of other code are not taken for those of this one."""
    root = Path(__file__).resolve().parents[3]
    digest = hashlib.sha256()
    for room in ("scenes", "vision", "touch", "fusion"):
        for path in sorted((root / room).rglob("*.py")):
            digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    try:
        version = metadata.version("palpate")
    except metadata.PackageNotFoundError:
        version = "0"
    return f"{version}+{digest.hexdigest()[:12]}"


def machine() -> dict[str, Any]:
    """Processor, cores allowed, memory, Python and the versions of what the numbers depend on."""
    from scenes.threads import thread_count

    installed = {(d.metadata["Name"] or "").lower(): d.version for d in metadata.distributions()}
    versions = {name: installed[name] for name in PACKAGES if name in installed}
    return {
        "processor": _processor(),
        "threads": thread_count(),
        "memory_gb": _memory(),
        "system": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        "versions": versions,
    }


def machine_line() -> str:
    """The same in one line."""
    facts = machine()
    versions = ", ".join(f"{name} {version}" for name, version in facts["versions"].items())
    memory = "" if facts["memory_gb"] is None else f", {facts['memory_gb']:.0f} GB"
    return f"{facts['processor']}, {facts['threads']} threads{memory}; Python {facts['python']}, {versions}"


def _processor() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        for line in cpuinfo.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _memory() -> float | None:
    if "SC_PHYS_PAGES" not in getattr(os, "sysconf_names", {}):
        return None
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 1e9
