"""Print a shell's completion script: commands, options, choices and files, as the parser has them."""

from __future__ import annotations

import argparse

from fusion.cli.options import say, write_json

SHELLS = ("bash", "zsh", "fish", "tcsh", "powershell")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's own arguments."""
    parser.add_argument("shell", choices=SHELLS, help="source what this prints, see docs/commands.md")


def run(args: argparse.Namespace) -> int:
    """Write the script to standard output."""
    write_json(args.json, {"shell": args.shell, "commands": sorted(commands(args.parser))})
    say(script(args.parser, args.shell).rstrip("\n"))
    return 0


def script(parser: argparse.ArgumentParser, shell: str) -> str:
    """The script; a value without choices is completed as a file."""
    import shtab

    for command in (parser, *commands(parser).values()):
        for action in command._actions:
            if action.nargs != 0 and not action.choices:
                action.complete = shtab.FILE  # type: ignore[attr-defined]  # what shtab looks for
    return str(shtab.complete(parser, shell))


def commands(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """The commands' parsers by name."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            return dict(action.choices)
    return {}
