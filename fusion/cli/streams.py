"""Standard output and error of a command, whatever whoever started it has made of them."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from io import TextIOWrapper
from typing import Any, TextIO, cast

# Standard input, output and error.
STANDARD = (0, 1, 2)


class Patient:
    """A stream that goes on when its reader has enough: what is left to say is dropped, and the command's exit code
    is that of its result.
    """

    def __init__(self, stream: TextIO) -> None:
        """stream: where it goes as long as somebody reads."""
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        """Everything else is the stream's."""
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """As the stream's."""
        try:
            return self._stream.write(text)
        except BrokenPipeError:
            self._drop()
            return len(text)

    def flush(self) -> None:
        """As the stream's."""
        try:
            self._stream.flush()
        except BrokenPipeError:
            self._drop()

    def _drop(self) -> None:
        _drop(self._stream)


def _drop(stream: TextIO) -> None:
    """From now on into nothing, with what is still in its buffer."""
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, stream.fileno())
    os.close(nothing)


def drop_what_is_left() -> None:
    """Before a process ends: what standard output could not take, and was told of, is not tried again by Python, whose
    exit code it would be.
    """
    if sys.stdout is None:
        return
    try:
        sys.stdout.flush()
    except OSError:
        _drop(sys.stdout)


@contextmanager
def patient_streams() -> Iterator[None]:
    """Standard output and error that may be closed, be closed while it runs, or lack letters that are shown."""
    before = sys.stdout, sys.stderr
    if None in before:
        _occupy()
    strict = [stream for stream in before if getattr(stream, "errors", None) == "strict"]
    _answer(strict, "replace")
    sys.stdout, sys.stderr = (cast(TextIO, Patient(stream or _nothing())) for stream in before)
    try:
        yield
    finally:
        with suppress(OSError):  # a full disk was told of
            sys.stdout.flush()
            sys.stderr.flush()
        sys.stdout, sys.stderr = before
        _answer(strict, "strict")


def _answer(streams: Iterable[TextIO], errors: str) -> None:
    """What streams do with letters that their encoding has not, where that can be said: "replace" shows a question
    mark, "strict" ends the command.
    """
    for stream in streams:
        if isinstance(stream, TextIOWrapper):
            with suppress(OSError, ValueError):  # it is full, or closed: whoever writes next will hear
                stream.reconfigure(errors=errors)


def _nothing() -> TextIO:
    return open(os.devnull, "w", encoding="utf-8")


def _occupy() -> None:
    """Give the numbers of closed streams to nothing: the next file that is opened would get them, and with them
    whatever a library prints.
    """
    while (number := os.open(os.devnull, os.O_RDWR)) in STANDARD:  # the lowest one that is free
        continue
    os.close(number)
