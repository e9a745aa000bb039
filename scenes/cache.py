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

# Mesh files whose bytes tell the whole geometry.
WHOLE_IN_ONE_FILE = (".ply", ".stl", ".off", ".obj", ".glb")

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


def remembered_of_file(
    kind: str, settings: object, path: Path, make: Callable[[], Arrays], is_sound: Callable[[Arrays], bool]
) -> Arrays:
    """As `remembered`, of what `make` reads from a file: known again by the file's bytes, wherever it lies.

    A format whose geometry lies in further files beside it (glTF) is read anew each time. Raises OSError for a file
    that cannot be read.
    """
    if path.suffix.lower() not in WHOLE_IN_ONE_FILE:
        return make()
    content = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    return remembered(kind, (settings, path.suffix.lower()), [content], make, is_sound)


def are_triangles(arrays: Arrays) -> bool:
    """Whether "vertices" (n, 3) and "faces" (m, 3) are a mesh: finite, of corners that exist."""
    vertices, faces = arrays["vertices"], arrays["faces"]
    if not (vertices.ndim == faces.ndim == 2 and vertices.shape[1] == faces.shape[1] == 3 and len(faces)):
        return False
    if not (vertices.dtype == np.float64 and faces.dtype == np.int64 and np.isfinite(vertices).all()):
        return False
    return bool(faces.min() >= 0 and faces.max() < len(vertices))


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
