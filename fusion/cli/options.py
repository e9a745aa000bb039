"""What several commands share: options, the text of `--prior` and `--tolerance`, objects by name, output.

Light at import: argparse only. Everything heavy is imported by the function that needs it.
"""

from __future__ import annotations

import argparse
import errno
import json
import logging
import math
import os
import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from fusion.results import runs
from scenes.errors import InputError, unknown

if TYPE_CHECKING:
    from rich.console import Console

    from fusion.estimation.settings import EstimateSettings
    from scenes.recordings.captures import Capture


T = TypeVar("T")

# Output that is not a terminal has no width; tables must not be cut there, however long what is not known is (columns).
PIPE_WIDTH = 4000

# Frames left out that are named, each with the reason.
MOST_LEFT_OUT = 5

# Each has a logger of its name.
PACKAGES = ("scenes", "vision", "touch", "fusion")


def add_common(parser: argparse.ArgumentParser) -> None:
    """The options that every command has."""
    parser.add_argument("--json", metavar="FILE", type=Path, help="write the result as JSON")
    parser.add_argument("--seed", metavar="S", type=whole, default=0, help="seed of everything random (default 0)")
    volume = parser.add_mutually_exclusive_group()
    volume.add_argument("-v", "--verbose", action="count", default=0, help="say what is done on stderr; -vv: and how")
    volume.add_argument("-q", "--quiet", action="store_true", help="print nothing but errors")


def add_object(parser: argparse.ArgumentParser, required: bool = False, what: str = "the object") -> None:
    """--object and --unit."""
    parser.add_argument(
        "--object", metavar="NAME|MESH", required=required, help=f"{what}: a mesh file, or the name of a generated one"
    )
    parser.add_argument("--unit", type=length_unit, default="m", help="of the mesh file: m (default), cm, mm, inch")


def add_trust(parser: argparse.ArgumentParser) -> None:
    """--trust-paths, of every command that reads captures."""
    parser.add_argument(
        "--trust-paths", action="store_true", help="also read files outside the capture's folder that it names"
    )


def add_prior(parser: argparse.ArgumentParser) -> None:
    """--prior."""
    parser.add_argument(
        "--prior",
        metavar="none|gt+NOISE|FILE",
        help="coarse start: none, ground truth plus noise like gt+33mm,16deg, or a prior.json;"
        " default: the capture's own",
    )


def add_sure(parser: argparse.ArgumentParser) -> None:
    """--sure-within, --outline and --print."""
    parser.add_argument(
        "--sure-within",
        metavar="MM",
        type=positive_number,
        help="`sure` is the probability that ADD-S is below this (default 5)",
    )
    parser.add_argument(
        "--outline",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="whether the object's outline in the image (colour, grey, infra-red) may move the answer, and the image's"
        " colours tell apart what touches",
    )
    parser.add_argument(
        "--print",
        dest="printed",
        action="store_true",
        help="the way round counts that what is printed on the mesh tells: without knowing it no answer is ok",
    )


def with_sure(settings: EstimateSettings, args: argparse.Namespace) -> EstimateSettings:
    """The settings with what --sure-within, --outline and --print say."""
    from dataclasses import replace

    from fusion.estimation.asked import sure_to_be_within

    if not args.outline:
        look = replace(settings.look, colour=replace(settings.look.colour, used=False))
        settings = replace(settings, contour=replace(settings.contour, used=False, own=False), look=look)
    if args.printed:
        settings = replace(settings, texture=replace(settings.texture, counts=True))
    return sure_to_be_within(settings, None if args.sure_within is None else 1e-3 * args.sure_within)


def length_unit(text: str) -> str:
    """A unit of lengths that meshes may have, for argparse."""
    if text != "m":
        from scenes.geometry.objects import METRES_PER_UNIT

        if text not in METRES_PER_UNIT:
            raise unknown("unit", text, METRES_PER_UNIT)
    return text


def whole(text: str) -> int:
    """A whole number from 0, for argparse."""
    if not text.strip().isdecimal():
        raise argparse.ArgumentTypeError(f"expected a whole number from 0, got {text!r}")
    return int(text)


def positive(text: str) -> int:
    """A whole number above 0, for argparse."""
    if not text.strip().isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number above 0, got {text!r}")
    return int(text)


def positive_number(text: str) -> float:
    """A finite number above 0, for argparse."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        raise argparse.ArgumentTypeError(f"expected a number above 0, got {text!r}")
    return value


def non_negative(text: str) -> float:
    """A finite number from 0, for argparse."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value >= 0):
        raise argparse.ArgumentTypeError(f"expected a number from 0, got {text!r}")
    return value


def share(text: str) -> float:
    """A number from 0 to 1, or per cent, for argparse."""
    try:
        value = float(text.removesuffix("%")) / (100.0 if text.endswith("%") else 1.0)
    except ValueError:
        value = math.nan
    if not 0.0 <= value < 1.0:
        raise argparse.ArgumentTypeError(f"expected a share from 0 to below 1, got {text!r}")
    return value


def names(text: str) -> tuple[str, ...]:
    """Comma-separated names, for argparse."""
    return tuple(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))


def length_and_angle(text: str) -> tuple[float, float]:
    """`33mm,16deg` or `33,16` (mm and degrees are understood) as metres and radians, for argparse."""
    try:
        return runs.length_and_angle(text)
    except InputError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def tolerance(text: str) -> tuple[float, float]:
    """As `length_and_angle`, both above 0, for argparse."""
    found = length_and_angle(text)
    if min(found) <= 0:
        raise argparse.ArgumentTypeError(f"expected a length and an angle above 0 like 1mm,2deg, got {text!r}")
    return found


def console() -> Console:
    """Where tables go: as wide as the terminal, uncut and uncoloured in a pipe."""
    from rich.console import Console

    interactive = sys.stdout.isatty()
    return Console(width=None if interactive else PIPE_WIDTH, highlight=False, soft_wrap=not interactive)


def show_table(columns: Iterable[str], rows: Iterable[Iterable[str]], title: str | None = None) -> None:
    """Print a table; the first column is text, the others are numbers and stand right."""
    if _QUIET:
        return
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    table = Table(title=title, box=box.SIMPLE_HEAD, title_justify="left", pad_edge=False)
    for index, name in enumerate(columns):
        table.add_column(name, justify="left" if index == 0 else "right", no_wrap=True)
    for row in rows:
        table.add_row(*(escape(cell) for cell in row))
    console().print(table)


def say(text: str) -> None:
    """One line on standard output."""
    if not _QUIET:
        sys.stdout.write(f"{text}\n")


def warn(text: str) -> None:
    """One line on standard error that is no error, of this program."""
    if not _QUIET:
        sys.stderr.write(f"palpate: {text}\n")
        sys.stderr.flush()


def warn_of(left_out: Mapping[int, str]) -> None:
    """Say which frames could not be used, and why; of many the first few."""
    for why in list(left_out.values())[:MOST_LEFT_OUT]:
        warn(f"left out: {why}")
    if len(left_out) > MOST_LEFT_OUT:
        warn(f"left out: {len(left_out) - MOST_LEFT_OUT} more frames")


def warn_neglected(capture: Capture) -> None:
    """Say what in a capture is passed over though something is wrong with it; of much the first few."""
    from scenes.recordings.checking.validation import neglected

    found = neglected(capture)
    for problem in found[:MOST_LEFT_OUT]:
        warn(f"passed over: {problem}")
    if len(found) > MOST_LEFT_OUT:
        warn(f"passed over: {len(found) - MOST_LEFT_OUT} more, which `palpate validate` names")


def is_quiet() -> bool:
    """Whether -q was given."""
    return _QUIET


def pose_lines(pose: Any) -> list[str]:
    """A pose (4, 4) for a person: position (mm), rotation vector (degrees), and the matrix to copy."""
    import numpy as np

    from scenes.geometry.poses import log_rotation

    matrix = np.asarray(pose, dtype=np.float64)
    place = " ".join(f"{1e3 * x:.2f}" for x in matrix[:3, 3])
    turn = " ".join(f"{x:.2f}" for x in np.rad2deg(log_rotation(matrix[:3, :3])))
    rows = "], [".join(", ".join(f"{x:.6f}" for x in row) for row in matrix)
    return [f"position {place} mm, rotation vector {turn} °", f"[[{rows}]]"]


# Whether -q was given: files and exit codes only.
_QUIET = False


def set_volume(verbose: int, quiet: bool) -> None:
    """What -v and -q ask for: -v says on standard error what is done, -vv how; -q says nothing but errors."""
    global _QUIET
    _QUIET = quiet
    handler: logging.Handler = logging.StreamHandler(sys.stderr) if verbose else logging.NullHandler()
    handler.setFormatter(logging.Formatter("%(name)s: %(message)s"))
    for package in PACKAGES:
        logger = logging.getLogger(package)
        logger.handlers = [handler]  # a second command of the same process says nothing twice, and is as loud as asked
        logger.setLevel({0: logging.NOTSET, 1: logging.INFO}.get(verbose, logging.DEBUG))


def percent(value: float | None) -> str:
    """A share for a table, in per cent; a dash for what is not known. What is not quite all is not rounded to all."""
    if value is None or math.isnan(value):
        return "–"
    return ">99 %" if 0.995 <= value < 1 else f"{100 * value:.0f} %"


def number(value: float | None, digits: int = 2) -> str:
    """A number for a table; a dash for what is not known."""
    if value is None or math.isnan(value):
        return "–"
    return f"{value:.{digits}f}" if math.isfinite(value) else "∞"


def check_target(path: Path | None) -> None:
    """Make the folder of a file to write, or raise OSError: before the work, not after it."""
    from scenes.files.whole import followed, is_stream, loops

    if path is None:
        return
    if is_stream(path):  # opening a pipe would wait for its reader, and closing it would end what that reads
        if not os.access(path, os.W_OK):
            raise PermissionError(errno.EACCES, "cannot be written", str(path))
        return
    if loops(path):
        raise OSError(errno.ELOOP, "expected a file to write, found a link that leads back to itself", str(path))
    folder = followed(path).parent
    check_folder(folder)
    folder.mkdir(parents=True, exist_ok=True)
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, "expected a file to write, found a folder", str(path))
    try:
        if path.exists():
            path.open("ab").close()
        else:
            _try_writing(folder)
    except OSError as error:
        raise PermissionError(errno.EACCES, "cannot be written", str(path)) from error


def check_folder(path: Path) -> Path:
    """The folder, which may be new, when it can be written to; raises OSError: before the work, not after it."""
    from scenes.files.whole import loops

    if loops(path):
        raise OSError(errno.ELOOP, "expected a folder to write to, found a link that leads back to itself", str(path))
    there = next(part for part in (path, *path.absolute().parents) if part.exists())
    if not there.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, "expected a folder to write to, found a file", str(there))
    try:
        _try_writing(there)
    except OSError as error:
        raise PermissionError(errno.EACCES, "cannot be written to", str(path)) from error
    return path


def _try_writing(folder: Path) -> None:
    """Raise OSError where no file can be made; permissions alone do not tell (of /proc, of read-only mounts)."""
    from tempfile import TemporaryFile

    with TemporaryFile(dir=folder):
        pass


def write_json(path: Path | None, content: Any) -> None:
    """Write --json's file when one was asked for; NaN becomes null."""
    if path is None:
        return
    from fusion.truth.errors import json_number
    from scenes.files.whole import replace_file

    replace_file(path, (json.dumps(json_number(content), indent=1, allow_nan=False) + "\n").encode())


def progress(items: Iterable[T], total: int, what: str) -> Iterator[T]:
    """The items, with a bar on a terminal and silence in a pipe."""
    if _QUIET or not sys.stderr.isatty() or total < 2:
        yield from items
        return
    from rich.console import Console
    from rich.progress import track

    yield from track(items, description=what, total=total, console=Console(stderr=True), transient=True)


def add_run(parser: argparse.ArgumentParser) -> None:
    """What every command has that answers frame by frame: capture, object, senses, start, and where to write."""
    parser.add_argument("capture", metavar="CAPTURE", type=Path, help="folder of the capture")
    add_trust(parser)
    add_object(parser, what="instead of the capture's object")
    parser.add_argument(
        "--use", metavar="SENSES", type=names, default=("vision", "touch"), help="vision,touch (default)"
    )
    add_prior(parser)
    parser.add_argument("--out", metavar="DIR", type=Path, help="where to write (default out/NAME of the capture)")
    parser.add_argument("--no-report", action="store_true", help="skip report.html")


def out_folder(args: argparse.Namespace, name: str) -> Path:
    """Where a command writes: --out, else out/NAME; raises OSError where it cannot be, and InputError where --json is
    one of the files there.
    """
    from fusion.cli.targets import check_apart
    from scenes.files.whole import loops

    out = args.out or Path("out") / name
    lost = next((part for part in (out, *out.absolute().parents) if part.is_symlink() and not part.exists()), None)
    if lost is not None and not loops(lost):
        raise FileNotFoundError(errno.ENOENT, "expected a folder to write to, found a link to nothing", str(lost))
    check_folder(out)
    check_apart("--json", args.json, out)
    return out


def write_run(args, capture, model, frames, answers, errors, left_out) -> str:  # type: ignore[no-untyped-def]  # heavy imports
    """Write poses.csv, result.json, report.html and --json of a run with the arguments of `add_run`; says what.

    left_out: why, of each frame that could not be used, by its number.
    """
    from fusion.advice.next_touch import next_touches
    from fusion.results.files import result_json, write_results

    out = out_folder(args, capture.name)
    touches = [next_touches(model, answer, frame) for frame, answer in zip(frames, answers)]
    content = result_json(capture.name, model, answers, errors, touches)
    content["capture_path"] = str(capture.path.resolve())  # grasp and view read the recording again
    if left_out:
        content["left_out"] = [{"frame": number, "why": why} for number, why in left_out.items()]
    write_results(out, capture, answers, content)
    if not args.no_report:
        from fusion.results.report.page import write_report

        page = out / "report.html"
        write_report(page, capture.name, frames, model, answers, None, content["errors"], touches=touches)
    write_json(args.json, content)
    return f"wrote {out / 'poses.csv'}, result.json" + ("" if args.no_report else ", report.html")
