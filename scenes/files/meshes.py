"""The one place where trimesh reads a file: whatever its readers trip over is one line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

# Endings of which one archive or compressed file is told by both.
_DOUBLE = (".gz", ".bz2")


def loaded(path: Path, force: str | None = None) -> Any:
    """What trimesh makes of a file; force: "mesh" for one mesh of all its parts.

    Raises ValueError, one line without the path: its readers, and the packages that read single formats for it, each
    have errors of their own.
    """
    import trimesh

    try:
        return trimesh.load(path, force=force, process=False)
    except Exception as error:  # a dozen readers check little and share no error
        said = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(f"a {_ending(path)} that cannot be read: {said}") from error


def _ending(path: Path) -> str:
    endings = [suffix.lower() for suffix in path.suffixes]
    if len(endings) > 1 and endings[-1] in _DOUBLE:
        return "".join(endings[-2:])
    return endings[-1] if endings else "file without an ending"
