"""`palpate`: the one place where errors become a line on stderr and an exit code.

Exit codes: 0 done; 1 the answer is lost or the capture invalid; 2 bad use or bad input; 130 interrupted. Light at
import: the commands are loaded where Ctrl-C is already a line.
"""

from __future__ import annotations

import atexit
import gc
import sys
from collections.abc import Sequence

from fusion.cli.streams import drop_what_is_left, patient_streams
from scenes._interrupts import whole_imports
from scenes.errors import PalpateError, was_interrupted

BAD_INPUT = 2
INTERRUPTED = 130

# New objects between two searches for unreachable circles: loading the libraries makes a million that all stay, and
# Python's 700 would look through them a thousand times. Objects, not bytes; by judgement.
COLLECT_EVERY = 50_000


def start() -> int:
    """`main` of a process of its own."""
    gc.set_threshold(COLLECT_EVERY)
    atexit.register(gc.freeze)  # what is left at the end goes with the process: a fifth of a second saved
    code = main()
    drop_what_is_left()
    return code


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command line; returns the exit code. No traceback for anything a user can cause."""
    with patient_streams(), whole_imports():
        return _run(argv)


def _run(argv: Sequence[str] | None) -> int:
    try:
        from fusion.cli.given import check_given
        from fusion.cli.options import check_target, set_volume
        from fusion.cli.parser import build_parser
        from fusion.cli.targets import check_targets

        given = sys.argv[1:] if argv is None else argv
        try:
            args = build_parser(given).parse_args(given)
        finally:  # --help and --version end here, and are told of a full disk as well
            sys.stdout.flush()
        set_volume(args.verbose, args.quiet)
        check_given(given, args)
        check_targets(args)
        check_target(args.json)
        code = int(args.run(args))
        sys.stdout.flush()
        return code
    except PalpateError as error:
        return _complain(str(error))
    except UnicodeDecodeError as error:
        return _complain(f"expected UTF-8 text, got other bytes: {error.reason}")
    except OSError as error:
        where = f"{error.filename}: " if error.filename is not None else ""
        return _complain(f"{where}{error.strerror or error}")
    except KeyboardInterrupt:
        return _interrupted()
    except Exception as error:
        if was_interrupted(error):
            return _interrupted()
        raise


def _interrupted() -> int:
    sys.stderr.write("palpate: interrupted\n")
    return INTERRUPTED


def _complain(message: str) -> int:
    sys.stderr.write(f"palpate: {' '.join(message.split())}\n")
    return BAD_INPUT


if __name__ == "__main__":
    sys.exit(start())
