"""The parser of `palpate`: every command with its options."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Sequence
from types import ModuleType
from typing import Any, NoReturn

from fusion.cli.commands.answers import batch, estimate, grasp, identify, localize, track
from fusion.cli.commands.data import convert, model, synth, validate, view
from fusion.cli.commands.install import completion, demo, doctor
from fusion.cli.commands.measures import bench, calibrate_gel, compare, evaluate, fit_confidence
from fusion.cli.options import add_common
from scenes.errors import InputError, unknown

COMMANDS = (
    *(demo, synth, validate, estimate, track, compare, evaluate, localize, identify),
    *(grasp, model, batch, view, convert, calibrate_gel, bench, fit_confidence, completion, doctor),
)


class Parser(argparse.ArgumentParser):
    """argparse that raises instead of printing its usage: a mistake costs one line. What begins with a minus and a
    digit is a value, which its option judges, and no option.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        """As argparse's."""
        super().__init__(*args, **kwargs)
        self._negative_number_matcher = re.compile(r"-\.?\d")

    def print_help(self, file: Any = None) -> None:
        """As argparse's, but that of a full disk is told."""
        (file or sys.stdout).write(self.format_help())

    def error(self, message: str) -> NoReturn:
        """Raise InputError with the command's name and the complaint."""
        wrong = re.fullmatch(r"argument ([^:]+): invalid choice: '(.*?)' \(choose from (.*)\)", message)
        if wrong is not None:
            raise unknown(wrong[1].lower(), wrong[2], re.findall(r"[\w-]+", wrong[3]))
        raise InputError(f"{message} (see {self.prog} --help)")


class _Version(argparse.Action):
    """--version: looked up only when asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from fusion.cli.versions import lines

        sys.stdout.write("\n".join(lines()) + "\n")
        parser.exit()


def _name(module: ModuleType) -> str:
    return module.__name__.rpartition(".")[2].replace("_", "-")


def build_parser(argv: Sequence[str] | None = None) -> argparse.ArgumentParser:
    """The parser of all commands, or one to read argv with: other commands have no arguments then, which saves time."""
    said = next((word for word in argv or () if not word.startswith("-")), None)
    known = [_name(module) for module in COMMANDS if module is not completion]  # whose script needs all
    parser = Parser(
        prog="palpate",
        description="Where is the object in the hand? 6-DOF pose from a half-blind RGB-D camera and touch.",
        epilog="Exit codes: 0 done, 1 the answer is lost or invalid, 2 bad use or input. PALPATE_THREADS sets threads.",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="versions of palpate and of what it stands on")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for module in COMMANDS:
        name = _name(module)
        # `python -OO` drops docstrings
        summary = (module.__doc__ or name).strip().splitlines()[0]
        command = commands.add_parser(name, help=summary, description=summary)
        if said == name or said not in known:
            module.add_arguments(command)
            add_common(command)
        command.set_defaults(run=module.run, parser=parser)
    return parser
