"""Arrays that take seconds to make, kept on disk by the content they were made from.

Nothing depends on it: a folder that cannot be written, or a file that is damaged, costs the time of making them again.
"""

from __future__ import annotations

import hashlib
import logging
import os
import tempfile
import zipfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Arrays = dict[str, NDArray[Any]]

_log = logging.getLogger(__name__)


def cache_folder() -> Path:
    """Where arrays are kept: $PALPATE_CACHE, else the user's cache folder."""
    root = os.environ.get("PALPATE_CACHE")
    if root:
        return Path(root)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()) / "palpate"


def remembered(
    kind: str,
    settings: object,
    content: Iterable[NDArray[Any]],
    make: Callable[[], Arrays],
    is_sound: Callable[[Arrays], bool],
) -> Arrays:
    """The arrays that `make` returns, or those of an earlier call with the same settings and content.

    kind names the files; settings: whatever has a repr that tells it all, a version of the maker among it. is_sound:
    whether arrays read from a file, by name, may be used (KeyError for an absent one is understood). Two processes that
    make the same arrays at once each write a private file and rename it, so a reader never sees half of one.
    """
    digest = hashlib.sha256(repr(settings).encode())
    for array in content:
        digest.update(repr((array.shape, array.dtype.str)).encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    path = cache_folder() / f"{kind}-{digest.hexdigest()[:32]}.npz"
    stored = _read(path)
    if stored is not None and _sound(stored, is_sound):
        _log.debug("read %s", path)
        return stored
    _log.info("building the %s of an object, once: kept in %s", kind, path)
    made = make()
    _write(path, made)
    return made


def _sound(arrays: Arrays, is_sound: Callable[[Arrays], bool]) -> bool:
    try:
        return is_sound(arrays)
    except (KeyError, ValueError, TypeError):
        return False


def _read(path: Path) -> Arrays | None:
    try:
        with np.load(path) as data:
            return {name: np.asarray(data[name], order="C") for name in data.files}
    except (OSError, ValueError, TypeError, KeyError, EOFError, zipfile.BadZipFile):
        return None  # absent or damaged


def _write(path: Path, arrays: Arrays) -> None:
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".tmp", delete=False) as file:
            temporary = Path(file.name)
            np.savez(file, **arrays)  # type: ignore[arg-type]  # its stub takes the names for allow_pickle
        os.replace(temporary, path)
    except OSError:
        # a read-only or full cache folder costs time, never the answer
        if temporary is not None:
            temporary.unlink(missing_ok=True)
