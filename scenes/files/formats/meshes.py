"""The one place where trimesh reads a file: what its readers trip over is one line, what they grumble about ours."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from scenes.words import counted

_log = logging.getLogger(__name__)

# Bytes of a binary STL: a header, how many triangles follow, and each of them.
_STL_HEADER, _STL_COUNT, _STL_TRIANGLE = 80, 4, 50

# Endings of which one archive or compressed file is told by both.
_DOUBLE = (".gz", ".bz2")


def loaded(path: Path, force: str | None = None) -> Any:
    """What trimesh makes of a file; force: "mesh" for one mesh of all its parts. What its readers warn of and go on
    without (a picture that is not there) is logged as information.

    Raises ValueError, one line without the path: its readers, and the packages that read single formats for it, each
    have errors of their own.
    """
    import trimesh

    try:
        with _heard() as said_of_it:
            found = trimesh.load(path, force=force, process=False)
        for words in dict.fromkeys(said_of_it):
            _log.info("%s: %s", path, words)
        return found
    except Exception as error:  # a dozen readers check little and share no error
        said = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(f"a {_ending(path)} that cannot be read: {said}") from error


def without_triangles(path: Path) -> str:
    """What is in a file of which `loaded` made no mesh of triangles, in words: points, a part of a mesh, or nothing."""
    if path.suffix.lower() == ".stl":
        return _cut_stl(path) or "no triangle"
    try:
        points = getattr(loaded(path), "vertices", ())
    except ValueError:
        points = ()
    return f"{counted(len(points), 'point')} and no triangle" if len(points) else "no triangle"


def _cut_stl(path: Path) -> str | None:
    """Of a binary STL that ends before its triangles do, how much of it there is; None of any other file."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(_STL_HEADER + _STL_COUNT)
    if head.lstrip().startswith(b"solid"):  # text, whose end is a word
        return None
    told = int.from_bytes(head[_STL_HEADER:], "little") if len(head) == _STL_HEADER + _STL_COUNT else None
    if told is None:
        return f"a file of {size} bytes, which is less than the head of an STL"
    there = max(size - len(head), 0) // _STL_TRIANGLE
    return f"{there} of the {told} triangles its head tells of: the file is cut off" if there < told else None


@contextmanager
def _heard() -> Iterator[list[str]]:
    """What trimesh and the packages below it warn of meanwhile, which is nothing to put on a user's standard error."""
    said: list[str] = []

    class Ear(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            said.append(" ".join(record.getMessage().split()))

    logger, ear = logging.getLogger("trimesh"), Ear(logging.WARNING)
    before = logger.propagate
    logger.propagate = False
    logger.addHandler(ear)
    try:
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            yield said
        said += [" ".join(str(one.message).split()) for one in warned]
    finally:
        logger.removeHandler(ear)
        logger.propagate = before


def _ending(path: Path) -> str:
    endings = [suffix.lower() for suffix in path.suffixes]
    if len(endings) > 1 and endings[-1] in _DOUBLE:
        return "".join(endings[-2:])
    return endings[-1] if endings else "file without an ending"
