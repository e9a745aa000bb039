"""Run a benchmark, or all: tables on the terminal, and with --out DIR also JSON, text, Markdown and plots."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from fusion.cli.options import console, positive, progress, say, write_json

if TYPE_CHECKING:
    from fusion.benchmarks.printing.tables import BenchSettings


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's own arguments."""
    parser.add_argument(
        "name",
        metavar="NAME",
        help="the benchmark (peers: time against error of every method and peer), or all: resumed where DIR has some",
    )
    parser.add_argument("--trials", metavar="N", type=positive, help="trials of every cell (default: the benchmark's)")
    parser.add_argument(
        "--objects", metavar="A,B", type=names_list, help="objects (default: all of the benchmark or family)"
    )
    parser.add_argument(
        "--family",
        metavar="A,B",
        help="frames of these families, or all, tuning or report (docs/evaluation.md), where accuracy is measured:"
        " search, occlusion, calibration, vision, faults, tracking, failing, colour, peers, profile",
    )
    parser.add_argument(
        "--motions",
        metavar="A,B",
        type=names_list,
        help="motions of the sequences of `tracking` and `failing` (default: all; four)",
    )
    parser.add_argument(
        "--frames",
        metavar="N",
        type=positive,
        help="frames of each sequence of `tracking` (default: 45) and `failing` (24), or of `memory` (5000)",
    )
    parser.add_argument(
        "--methods",
        metavar="A,B",
        type=names_list,
        help="methods that follow the sequences of `tracking`, or that `occlusion` compares (default: all)",
    )
    parser.add_argument(
        "--data",
        metavar="DIR",
        type=Path,
        help="recorded captures for `real`, in DIR or its part real (default: PALPATE_DATA, ../shared/data); for `gel`"
        " recorded grasps alone, in DIR or its part digit",
    )
    parser.add_argument("--bop", metavar="DIR", type=Path, help="a BOP data set, split or scene for `real`")
    parser.add_argument(
        "--told",
        action="store_true",
        help="tell the estimator how large each family's errors are, as one who measured camera, robot and mesh would"
        " (calibration, vision)",
    )
    parser.add_argument(
        "--quick", action="store_true", help="less of everything, but all of it (all: five minutes on two cores)"
    )
    parser.add_argument(
        "--out",
        metavar="DIR",
        type=Path,
        help="also write NAME.json, NAME.txt, NAME.md and NAME.svg here, and keep captures (all: default out/bench)",
    )


def names_list(text: str) -> tuple[str, ...]:
    """Names between commas."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


def run(args: argparse.Namespace) -> int:
    """Exit code 0 also when a demand is missed: the report says so."""
    from dataclasses import replace

    from fusion import benchmarks
    from fusion.benchmarks.asked import check
    from fusion.benchmarks.printing.tables import BenchSettings, Table, show_report, show_table, write_report
    from scenes.errors import unknown

    names = benchmarks.available()
    if args.name != "all" and args.name not in names:
        raise unknown("bench", args.name, [*names, "all"])
    shown: list[Table] = []

    def show(table: Table) -> None:
        """A run that is stopped has shown what it had."""
        show_table(table, console())
        shown.append(table)

    settings = BenchSettings(args.trials, args.seed, args.quick, progress, args.objects, args.out, show, args.family)
    settings = replace(settings, motions=args.motions, frames=args.frames, methods=args.methods)
    settings = replace(settings, data=args.data, bop=args.bop, told=args.told)
    check(args.name, settings)  # before minutes of work
    if args.name == "all":
        return _run_all(args, names, settings)
    report = benchmarks.load(args.name).run(settings)
    show_report(report, console(), shown)
    if args.out is not None:
        for path in write_report(report, args.out):
            say(f"wrote {path}")
    write_json(args.json, report.to_json())
    return 0


def _run_all(args: argparse.Namespace, names: list[str], settings: BenchSettings) -> int:
    from dataclasses import replace

    from fusion.benchmarks.printing.run_all import Outcome, run_all, summary
    from fusion.benchmarks.printing.tables import show_table

    folder = args.out or Path("out") / "bench"

    def finished(one: Outcome) -> None:
        text = folder / f"{one.name}.txt"
        say(text.read_text(encoding="utf-8") if text.is_file() else f"{one.name}: {one.state} {one.why}")

    # each is printed whole when it is finished
    outcomes = run_all(names, replace(settings, show=lambda table: None), folder, finished)
    show_table(summary(outcomes), console())
    say(f"wrote {folder}")
    write_json(args.json, {"benchmarks": [one.report for one in outcomes]})
    return 0
