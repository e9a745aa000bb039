"""The errors a user can meet: each says what was expected, what came, and where."""

from __future__ import annotations

from collections.abc import Iterable


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


def was_interrupted(error: BaseException) -> bool:
    """Whether Ctrl-C is behind an error: what is compiled makes another of it when it comes while it is loaded."""
    at: BaseException | None = error
    while at is not None:
        if isinstance(at, KeyboardInterrupt):
            return True
        at = at.__cause__ or at.__context__
    return False


def check_above(settings: object, names: Iterable[str], least: float = 0.0) -> None:
    """Raise InputError naming the first of these settings that is not above `least`, or no finite number."""
    for name in names:
        value = getattr(settings, name)
        if not least < value < float("inf"):
            raise InputError(f"{name}: expected a finite number above {least:g}, got {value:g}")


def unknown(what: str, got: object, choices: Iterable[str], expected: str = "one of") -> InputError:
    """The error for a name that is none of the choices: lists them, and says which is written alike."""
    from difflib import get_close_matches

    names = list(choices)
    by_lower = {name.lower(): name for name in names}
    near = get_close_matches(str(got).lower(), by_lower, n=1)
    hint = f": did you mean {by_lower[near[0]]}?" if near else ""
    return InputError(f"{what}: expected {expected} {', '.join(names)}, got {got!r}{hint}")
