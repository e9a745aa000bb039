"""`palpate`: the parser, and the one place where errors become a line on stderr and an exit code.

Exit codes: 0 done; 1 the answer is lost or the capture invalid; 2 bad use or bad input; 130 interrupted.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from importlib import metadata
from typing import NoReturn

from fusion.cli import (
    batch,
    bench,
    compare,
    completion,
    convert,
    demo,
    estimate,
    evaluate,
    grasp,
    identify,
    localize,
    model,
    synth,
    track,
    validate,
    view,
)
from fusion.cli.options import add_common, check_target
from scenes.errors import InputError, PalpateError

COMMANDS = (
    *(demo, synth, validate, estimate, track, compare, evaluate, localize, identify),
    *(grasp, model, batch, view, convert, bench, completion),
)

BAD_INPUT = 2
INTERRUPTED = 130


class Parser(argparse.ArgumentParser):
    """argparse that raises instead of printing its usage: a mistake costs one line."""

    def error(self, message: str) -> NoReturn:
        """Raise InputError with the command's name and the complaint."""
        raise InputError(f"{message} (see {self.prog} --help)")


class _Version(argparse.Action):
    """--version: looked up only when asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        try:
            version = metadata.version("palpate")
        except metadata.PackageNotFoundError:
            version = "0 (not installed)"
        sys.stdout.write(f"palpate {version}\n")
        parser.exit()


def build_parser() -> argparse.ArgumentParser:
    """The parser of all commands."""
    parser = Parser(
        prog="palpate",
        description="Where is the object in the hand? 6-DOF pose from a half-blind RGB-D camera and touch.",
        epilog="Exit codes: 0 done, 1 the answer is lost or invalid, 2 bad use or input. PALPATE_THREADS sets threads.",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for module in COMMANDS:
        name = module.__name__.rpartition(".")[2]
        summary = (module.__doc__ or "").strip().splitlines()[0]
        command = commands.add_parser(name, help=summary, description=summary)
        module.add_arguments(command)
        add_common(command)
        command.set_defaults(run=module.run)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command line; returns the exit code. No traceback for anything a user can cause."""
    try:
        args = build_parser().parse_args(argv)
        check_target(args.json)
        code = int(args.run(args))
        sys.stdout.flush()
        return code
    except PalpateError as error:
        return _complain(str(error))
    except BrokenPipeError:
        # whoever reads our output has enough; keep the interpreter from complaining when it closes stdout
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except UnicodeDecodeError as error:
        return _complain(f"expected UTF-8 text, got other bytes: {error.reason}")
    except OSError as error:
        where = f"{error.filename}: " if error.filename is not None else ""
        return _complain(f"{where}{error.strerror or error}")
    except KeyboardInterrupt:
        sys.stderr.write("palpate: interrupted\n")
        return INTERRUPTED


def _complain(message: str) -> int:
    sys.stderr.write(f"palpate: {' '.join(message.split())}\n")
    return BAD_INPUT


if __name__ == "__main__":
    sys.exit(main())
