"""What is wrong with a file, and the two ways to take it: refuse at the first problem, or collect them all.

Readers of captures call `report(Problem(...))` and go on with what is left. Reading a capture passes `refuse`, which
raises; validating one passes the `append` of a list: both judge by the same code.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import NoReturn

from scenes.errors import CaptureError

# What readers that check little raise on files that are none, and what is made of their arrays.
UNREADABLE = (
    ArithmeticError,
    AssertionError,
    AttributeError,
    EOFError,
    LookupError,
    MemoryError,
    NameError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
    struct.error,
    zlib.error,
)


@dataclass(frozen=True)
class Problem:
    """file: path as the user gave it; frame: number, None when it is not one frame's problem; message: one line."""

    file: str
    frame: int | None
    message: str

    def __str__(self) -> str:
        where = self.file if self.frame is None else f"{self.file}, frame {self.frame}"
        message = " ".join(self.message.split())
        return message if self.frame is None and message.startswith(self.file) else f"{where}: {message}"


Report = Callable[[Problem], None]


def refuse(problem: Problem) -> NoReturn:
    """Raise the problem as a CaptureError."""
    raise CaptureError(str(problem))
