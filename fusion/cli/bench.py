"""Run a benchmark: tables on the terminal, and with --out DIR also JSON, text and plots."""

from __future__ import annotations

import argparse
from pathlib import Path

from fusion.cli.options import console, positive, progress, say, write_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's own arguments."""
    parser.add_argument("name", metavar="NAME", help="the benchmark, or all")
    parser.add_argument("--trials", metavar="N", type=positive, help="trials of every cell (default: the benchmark's)")
    parser.add_argument(
        "--objects", metavar="A,B", type=names_list, help="objects of `vision` (default: all there are)"
    )
    parser.add_argument("--quick", action="store_true", help="a tenth of the work, to see that it runs")
    parser.add_argument(
        "--out", metavar="DIR", type=Path, help="also write NAME.json, NAME.txt and NAME.svg here, and keep captures"
    )


def names_list(text: str) -> tuple[str, ...]:
    """Names between commas."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


def run(args: argparse.Namespace) -> int:
    """Exit code 0 also when a demand is missed: the report says so."""
    from fusion import benchmarks
    from fusion.benchmarks.tables import BenchSettings, Table, show_report, show_table, write_report
    from scenes.errors import InputError

    names = benchmarks.available()
    if args.name != "all" and args.name not in names:
        raise InputError(f"bench: expected one of {', '.join([*names, 'all'])}, got {args.name!r}")
    shown: list[Table] = []

    def show(table: Table) -> None:
        """A run that is stopped has shown what it had."""
        show_table(table, console())
        shown.append(table)

    settings = BenchSettings(args.trials, args.seed, args.quick, progress, args.objects, args.out, show)
    reports = []
    for name in names if args.name == "all" else [args.name]:
        report = benchmarks.load(name).run(settings)
        show_report(report, console(), shown)
        if args.out is not None:
            for path in write_report(report, args.out):
                say(f"wrote {path}")
        reports.append(report.to_json())
    if args.json is not None:
        write_json(args.json, reports[0] if args.name != "all" else {"benchmarks": reports})
    return 0
