"""Files and folders that appear whole or not at all, and errors that name the file that was asked for.

A draft is a hidden sibling whose name tells which process of which machine makes it; what a killed process left behind
is cleared away when the same thing is next written.
"""

from __future__ import annotations

import errno
import os
import re
import shutil
import socket
import stat
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from scenes.errors import PalpateError

_LEFT = re.compile(r"\.(?P<kind>draft|old)-(?P<host>.*)-(?P<pid>\d+)-[^-]*$")
KEPT = "kept"


def replace_file(path: Path, content: bytes) -> None:
    """Write a file; a reader never meets half of it. Its folder is made. A link stays, and what it leads to is written;
    into what is no file of its own (a device, a pipe, standard output) it goes as it comes. OSError names the file.
    """
    with named(path):
        stream = _stream(path)
        if stream is not None:
            _pour(stream, path, content)
            return
        target = followed(path)
        sweep(target)
        target.parent.mkdir(parents=True, exist_ok=True)
        handle, draft = tempfile.mkstemp(dir=target.parent, prefix=_prefix(target, "draft"))
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(content)
            os.chmod(draft, 0o644)
            os.replace(draft, target)
        except BaseException:
            os.unlink(draft)
            raise


def is_stream(path: Path) -> bool:
    """Whether what is written to the path goes as it comes: there is no file of its own to be replaced."""
    return _stream(path) is not None


def _stream(path: Path) -> int | None:
    """The handle of standard output or error where the path is one of them, -1 for another device or pipe, None for a
    file, a folder, and what is not there.
    """
    try:
        there = path.stat()
    except OSError:
        return None
    if stat.S_ISDIR(there.st_mode):
        return None
    for handle in (1, 2):
        with suppress(OSError):
            # a file that a shell has opened for it, too: its reader holds on to it, whatever has its name
            if os.path.samestat(there, os.fstat(handle)):
                return handle
    return None if stat.S_ISREG(there.st_mode) else -1


def _pour(stream: int, path: Path, content: bytes) -> None:
    if stream < 0:
        with path.open("wb") as file:
            file.write(content)
        return
    for told in (sys.stdout, sys.stderr):  # what was said before comes before
        told.flush()
    with os.fdopen(os.dup(stream), "wb") as file:
        file.write(content)


def followed(path: Path) -> Path:
    """Where links of that name lead to, whether anything is there or not."""
    return Path(os.path.realpath(path)) if path.is_symlink() else path


def loops(path: Path) -> bool:
    """Whether a link on the way there leads back to itself; `Path.resolve` makes different things of that."""
    try:
        os.stat(path)
    except OSError as error:
        return error.errno == errno.ELOOP
    except ValueError:  # no name of a file
        pass
    return False


@contextmanager
def named(path: Path) -> Iterator[None]:
    """An OSError from inside is one of this file: a full disk does not say what it was asked to write."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error


@contextmanager
def draft_folder(out: Path) -> Iterator[Path]:
    """A new hidden folder beside `out` (or what it leads to) to write into, gone at the end unless `put` has moved it.

    Drafts of dead processes are cleared away first. Errors about a file in the draft name its place in `out`.
    """
    target = followed(out)
    sweep(target)
    with named(out):
        target.parent.mkdir(parents=True, exist_ok=True)
        draft = Path(tempfile.mkdtemp(prefix=_prefix(target, "draft"), dir=target.parent))
    try:
        draft.chmod(0o755)
        yield draft
    except PalpateError as error:
        if str(draft) not in str(error):
            raise
        raise type(error)(str(error).replace(str(draft), str(out))) from error
    except OSError as error:
        # of a copy that finds no room it names what was copied first
        named_by = [Path(str(name)) for name in (error.filename, error.filename2) if name is not None] or [draft]
        wrong = next((path for path in named_by if path.is_relative_to(draft)), named_by[0])
        place = out / wrong.relative_to(draft) if wrong.is_relative_to(draft) else wrong
        raise OSError(error.errno, error.strerror or str(error), str(place)) from error
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def put(draft: Path, out: Path) -> None:
    """Rename the draft to `out`, in the place of what is there: absent between two renames, never half written. A link
    stays, and the folder it leads to is replaced.
    """
    out, old = followed(out), None
    if out.exists():
        old = Path(tempfile.mkdtemp(prefix=_prefix(out, "old"), dir=out.parent))
        out.rename(old / KEPT)
    draft.rename(out)
    if old is not None:
        shutil.rmtree(old, ignore_errors=True)


def sweep(out: Path) -> None:
    """Clear away what killed processes left beside `out`; what one had moved aside comes back when `out` is gone."""
    out = followed(out)
    if not out.parent.is_dir():
        return
    start = f".{out.name}."
    for left in sorted(path for path in out.parent.iterdir() if path.name.startswith(start)):
        found = _LEFT.fullmatch(left.name[len(start) - 1 :])
        if found is None or found["host"] != _host() or _lives(int(found["pid"])):
            continue
        if found["kind"] == "old" and (left / KEPT).exists() and not out.exists():
            (left / KEPT).rename(out)
        if left.is_dir():
            shutil.rmtree(left, ignore_errors=True)
        else:
            left.unlink(missing_ok=True)


def _prefix(path: Path, kind: str) -> str:
    return f".{path.name}.{kind}-{_host()}-{os.getpid()}-"


def _host() -> str:
    return re.sub(r"[^\w.]", "_", socket.gethostname()) or "localhost"


def _lives(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        return True
    return True
