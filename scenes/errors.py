"""The errors a user can meet: each says what was expected, what came, and where."""

from __future__ import annotations


class PalpateError(Exception):
    """Root of every error raised on purpose; the command line turns it into one line and exit code 2."""


class MeshError(PalpateError):
    """A mesh that cannot serve as an object: empty, open beyond repair, or of impossible size."""


class CaptureError(PalpateError):
    """A capture (or one of its files) that is missing, malformed or contradicts itself."""


class InputError(PalpateError):
    """An argument outside what a function or command accepts."""


class SystemLibraryError(PalpateError):
    """A shared library that a dependency needs is not installed on this machine."""
