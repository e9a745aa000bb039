"""Options that are given and would do nothing: refused, for who gives one believes that it does something.

Light at import: what is heavy is imported by the function that needs it.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from scenes.errors import InputError

# Options of names and places, of which nothing is none: an empty variable of a shell is a mistake.
NAMED = ("--object", "--out", "--json", "--output", "-o", "--plot", "--write", "--config", "--result", "--prior")


def check_given(words: Sequence[str], args: argparse.Namespace) -> None:
    """Raise InputError for an option of `NAMED` with an empty value, and for a --unit that no mesh file has."""
    for option, value in zip(words, [*words[1:], None]):
        said, equals, rest = option.partition("=")
        if said in NAMED and (rest == "" if equals else value == ""):
            raise InputError(f"{said}: expected a name or a path, got nothing ('')")
    if getattr(args, "unit", "m") == "m" or not hasattr(args, "object"):
        return
    if args.object is None:
        raise InputError(f"--unit: expected --object MESH beside it, whose unit it is, got {args.unit} alone")
    if not Path(args.object).exists():
        from scenes.synthesis import library

        if args.object in (*library.names(), *library.tool_names(), *library.held_out_names()):
            raise InputError(
                f"--unit: expected a mesh file as --object, got {args.object}, which is generated in metres"
            )
