"""Where a capture's files may be: in its own folder, so that one from a stranger reads nothing else of this machine."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from scenes.errors import CaptureError
from scenes.files.whole import loops

HINT = "trust its paths (--trust-paths) if you know where it comes from"


def stays_inside(path: Path, folder: Path | None, where: str) -> Path:
    """The path, when it and what it links to lie in `folder` (None: anywhere).

    Raises CaptureError, beginning with `where`, for absolute paths, `..` and links that lead out of it or
    back to themselves.
    """
    if folder is not None:
        if loops(path):
            raise CaptureError(f"{where}: expected a file or folder, got {path.name}, a link that leads back to itself")
        root = folder.resolve()
        try:
            target = path.resolve()
        except ValueError as error:  # a zero byte, half of a surrogate pair
            raise CaptureError(f"{where}: expected the name of a file, got {str(path)[-60:]!a}") from error
        if not target.is_relative_to(root):
            raise CaptureError(f"{where}: expected files inside {folder}, got {path}, which is {target}: {HINT}")
    return path


def refuse_links_outside(folder: Path) -> None:
    """Raise CaptureError for the first link below the folder that leads out of it."""
    for link in _links(folder):
        stays_inside(link, folder, str(link))


def _links(folder: Path) -> Iterator[Path]:
    with os.scandir(folder) as entries:
        for entry in sorted(entries, key=lambda entry: entry.name):
            if entry.is_symlink():
                yield Path(entry.path)
            elif entry.is_dir():
                yield from _links(Path(entry.path))
