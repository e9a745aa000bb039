"""Files and folders that appear whole or not at all, and errors that name the file that was asked for.

A draft is a hidden sibling whose name tells which process of which machine makes it; what a killed process left behind
is cleared away when the same thing is next written.
"""

from __future__ import annotations

import os
import re
import shutil
import socket
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from scenes.errors import PalpateError

_LEFT = re.compile(r"\.(?P<kind>draft|old)-(?P<host>.*)-(?P<pid>\d+)-[^-]*$")
KEPT = "kept"


def replace_file(path: Path, content: bytes) -> None:
    """Write a file; a reader never meets half of it. Its folder is made. OSError names the file."""
    sweep(path)
    with named(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, draft = tempfile.mkstemp(dir=path.parent, prefix=_prefix(path, "draft"))
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(content)
            os.chmod(draft, 0o644)
            os.replace(draft, path)
        except BaseException:
            os.unlink(draft)
            raise


@contextmanager
def named(path: Path) -> Iterator[None]:
    """An OSError from inside is one of this file: a full disk does not say what it was asked to write."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error


@contextmanager
def draft_folder(out: Path) -> Iterator[Path]:
    """A new hidden folder beside `out` to write into, gone at the end unless `put` has moved it there.

    Drafts of dead processes are cleared away first. Errors about a file in the draft name its place in `out`.
    """
    sweep(out)
    with named(out):
        out.parent.mkdir(parents=True, exist_ok=True)
        draft = Path(tempfile.mkdtemp(prefix=_prefix(out, "draft"), dir=out.parent))
    try:
        draft.chmod(0o755)
        yield draft
    except PalpateError as error:
        if str(draft) not in str(error):
            raise
        raise type(error)(str(error).replace(str(draft), str(out))) from error
    except OSError as error:
        wrong = Path(str(error.filename)) if error.filename is not None else draft
        place = out / wrong.relative_to(draft) if wrong.is_relative_to(draft) else wrong
        raise OSError(error.errno, error.strerror or str(error), str(place)) from error
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def put(draft: Path, out: Path) -> None:
    """Rename the draft to `out`, in the place of what is there: absent between two renames, never half written."""
    old = None
    if out.exists():
        old = Path(tempfile.mkdtemp(prefix=_prefix(out, "old"), dir=out.parent))
        out.rename(old / KEPT)
    draft.rename(out)
    if old is not None:
        shutil.rmtree(old, ignore_errors=True)


def sweep(out: Path) -> None:
    """Clear away what killed processes left beside `out`; what one had moved aside comes back when `out` is gone."""
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
