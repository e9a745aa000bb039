"""A file that one process at a time writes to; the operating system lets go of it when that process ends, however."""

from __future__ import annotations

import errno
import os
import sys
from pathlib import Path

from scenes.files.whole import named

# What another one's hold looks like; any other error comes of a file system that cannot hold files.
HELD = (errno.EWOULDBLOCK, errno.EAGAIN, errno.EACCES, errno.EDEADLK)
# Windows keeps others from reading the bytes that are held: one far behind the end (bytes) of any file here.
FAR_BEHIND = 1 << 40


def claimed(path: Path) -> int | None:
    """A handle that holds the file, made if need be, until it is closed; None when another process has it.

    Where the system or its file system knows no holding, nobody is kept out. Raises OSError for a file that cannot be
    written.
    """
    with named(path):
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        _hold(handle)
    except OSError as error:
        if error.errno in HELD:
            os.close(handle)
            return None
    return handle


def _hold(handle: int) -> None:
    if sys.platform == "win32":
        import msvcrt

        os.lseek(handle, FAR_BEHIND, os.SEEK_SET)
        msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        return
    import fcntl

    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
