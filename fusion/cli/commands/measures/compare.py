"""Compare methods on the same frames: errors, times, verdicts, as a table and a plot."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from fusion.cli.compiling import announce_compiling
from fusion.cli.config import add_config, estimate_settings, told
from fusion.cli.options import (
    add_object,
    add_prior,
    add_trust,
    check_target,
    names,
    number,
    progress,
    say,
    show_table,
    warn_neglected,
    warn_of,
    write_json,
)
from fusion.cli.telling import add_beliefs
from fusion.results.runs import frame_setter, load_object

if TYPE_CHECKING:
    from fusion.truth.compare import Summary

HEADS = (
    "method",
    "frames",
    "ADD-S mm",
    "< 5 mm",
    "rot °",
    "trans mm",
    "cloud mm",
    "reported contacts mm",  # as the robot reports them, uncorrected: the same places for every method
    "time ms",
    "verdicts",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's own arguments."""
    add_trust(parser)
    parser.add_argument("captures", metavar="CAPTURE", type=Path, nargs="+", help="folders of captures")
    parser.add_argument(
        "--methods",
        metavar="NAMES",
        type=names,
        help="icp, icp_segmented, icp_touch, vision, touch, fused (default all)",
    )
    add_object(parser, what="instead of the captures' object")
    add_prior(parser)
    add_beliefs(parser)
    add_config(parser)
    parser.add_argument("--plot", metavar="FILE", type=Path, help="also draw the errors: .html or .svg")


def run(args: argparse.Namespace) -> int:
    """Exit code 0, for a method that is lost is what a comparison is for; 1 when a frame could not be used."""
    from fusion.results.plots import check_suffix, write_plot
    from fusion.truth.best import find_best, sentences
    from fusion.truth.compare import METHODS, check_methods, compare, summarise
    from scenes.recordings.captures import read_capture

    methods = check_methods(args.methods if args.methods is not None else METHODS)
    if args.plot is not None:
        check_suffix(args.plot)
        check_target(args.plot)
    settings = estimate_settings(args.config)
    prepare = frame_setter(args.prior, args.seed, told(args))
    captures = [read_capture(path, args.trust_paths) for path in args.captures]
    for capture in captures:
        warn_neglected(capture)
    model = load_object(args.object, args.unit) if args.object else None
    total = len(methods) * sum(map(len, captures))
    announce_compiling()
    left_out: list[str] = []
    found_rows = compare(captures, methods, args.seed, model, prepare, settings, leave_out=left_out.append)
    rows = list(progress(found_rows, total, "comparing"))
    summaries = summarise(rows)
    groups = list(dict.fromkeys(row.group for row in rows))
    found = {group: find_best([row for row in rows if row.group == group], args.seed) for group in groups}
    for group, best in found.items():
        for line in sentences(best) if best is not None else ():
            say(f"{group}: {line}" if len(groups) > 1 and not line.startswith(" ") else line)
    show(summaries)
    warn_of(dict(enumerate(left_out)))
    if args.plot is not None:
        write_plot(args.plot, rows)
        say(f"wrote {args.plot}")
    write_json(
        args.json,
        {
            "best": {group: best.to_json() for group, best in found.items() if best is not None},
            "summary": [s.to_json() for s in summaries],
            "rows": [row.to_json() for row in rows],
            "left_out": left_out,
        },
    )
    return 1 if left_out else 0


def show(summaries: list[Summary]) -> None:
    """One table a group; the group's name above it when there are several."""
    groups = list(dict.fromkeys(s.group for s in summaries))
    for group in groups:
        rows = [_cells(s) for s in summaries if s.group == group]
        show_table(HEADS, rows, title=group if len(groups) > 1 else None)


def _cells(s: Summary) -> list[str]:
    success = "–" if s.success != s.success else f"{100 * s.success:.0f} %"
    numbers = (s.rotation_deg, s.translation_mm, s.cloud_mm, s.contacts_mm)
    verdicts = ", ".join(f"{count} {word}" for word, count in s.verdicts.items())
    return [
        s.method,
        str(s.frames),
        number(s.add_s_mm),
        success,
        *map(number, numbers),
        number(s.time_ms, 1 if s.time_ms < 10 else 0),
        verdicts,
    ]
