"""Estimate many captures, by several processes or a cluster; a run that was stopped goes on where it ended."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fusion.cli.compiling import announce_compiling
from fusion.cli.config import add_config, estimate_settings, told
from fusion.cli.options import (
    add_object,
    add_prior,
    add_sure,
    add_trust,
    names,
    number,
    out_folder,
    percent,
    positive,
    progress,
    say,
    show_table,
    with_sure,
    write_json,
)
from fusion.cli.telling import add_beliefs
from scenes.words import counted

if TYPE_CHECKING:
    from fusion.results.batch import Job, Outcome


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's own arguments."""
    add_trust(parser)
    parser.add_argument("folder", metavar="DIR", type=Path, help="folder with captures in it, however deep")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--workers", metavar="N", type=positive, help="processes (default: the cores that may be used)")
    where.add_argument("--scheduler", metavar="ADDRESS", help="of a dask cluster, like tcp://host:8786")
    add_object(parser, what="instead of the captures' objects")
    parser.add_argument(
        "--use", metavar="SENSES", type=names, default=("vision", "touch"), help="vision,touch (default)"
    )
    add_prior(parser)
    add_sure(parser)
    add_beliefs(parser)
    add_config(parser)
    parser.add_argument("--out", metavar="DIR", type=Path, help="where to write (default out/NAME of the folder)")
    parser.add_argument("--no-report", action="store_true", help="skip the captures' report.html")
    parser.add_argument("--again", action="store_true", help="also what an earlier run did")


def run(args: argparse.Namespace) -> int:
    """Exit code 1 when a capture failed, a frame could not be used, or one is lost."""
    from fusion.estimation.asked import check_senses
    from fusion.estimation.settings import usual_settings
    from fusion.results.batch import Job, Outcome, find_captures, finished
    from fusion.results.batch_files import write_all
    from fusion.results.runs import frame_setter
    from fusion.results.summary import summary_of
    from scenes.files.whole import sweep

    use = tuple(sorted(check_senses(args.use), reverse=True))
    believed = tuple(told(args))
    frame_setter(args.prior, args.seed, believed)  # a mistake in it is one line now, not one a capture
    paths = find_captures(args.folder)
    out = out_folder(args, args.folder.resolve().name)
    asked: dict[str, Any] = {
        "use": use,
        "prior": args.prior,
        "object": args.object,
        "unit": args.unit,
        "report": not args.no_report,
    }
    asked |= {"trust_paths": args.trust_paths, "told": believed}
    settings = with_sure(estimate_settings(args.config), args)
    if settings != usual_settings():  # what is usual is what rows of a run without any say
        asked["settings"] = settings
    jobs = []
    for path in paths:
        name = path.relative_to(args.folder).as_posix()
        name = args.folder.resolve().name if name == "." else name
        jobs.append(Job(str(path.resolve()), name, str((out / name).resolve()), seed=args.seed, **asked))
    found: dict[str, Outcome] = {}
    for job in jobs:
        sweep(Path(job.out))  # what an earlier run was killed over
        rows = None if args.again else finished(job)
        if rows is not None:
            found[job.name] = Outcome(job, "kept", rows)
    rest = [job for job in jobs if job.name not in found]
    announce_compiling()
    out.mkdir(parents=True, exist_ok=True)
    for outcome in progress(_outcomes(args, rest), len(rest), "estimating"):
        found[outcome.job.name] = outcome
    outcomes = [found[job.name] for job in jobs]
    summary = summary_of(outcomes)
    written = write_all(out, out.resolve().name, outcomes)
    write_json(args.json, {"summary": summary, "rows": [row for outcome in outcomes for row in outcome.rows]})
    _show(outcomes, summary)
    say(f"wrote {', '.join(str(path) for path in written)}")
    return 1 if summary["failed"] or summary["left_out"] or summary["verdicts"]["lost"] else 0


def _outcomes(args: argparse.Namespace, jobs: list[Job]) -> Iterator[Outcome]:
    from fusion.results.batch import Cluster, Processes, run_jobs
    from scenes.threads import thread_count

    if not jobs:
        return
    if args.scheduler is None:
        yield from run_jobs(jobs, Processes(min(args.workers or thread_count(), len(jobs))))
        return
    cluster = Cluster(args.scheduler)
    try:
        yield from run_jobs(jobs, cluster)
    finally:
        cluster.close()


def _show(outcomes: list[Outcome], summary: dict[str, Any]) -> None:
    from fusion.results.summary import median

    heads = ("capture", "frames", "ok", "ambiguous", "lost", "sure", "ADD-S mm", "rot °", "time ms")
    rows = []
    for outcome in outcomes:
        if outcome.status == "error":
            continue
        done = outcome.answers
        counts = [str(sum(row["verdict"] == word for row in done)) for word in ("ok", "ambiguous", "lost")]
        names_of = ("confidence", "add_s_mm", "rotation_deg", "time_ms")
        middle = [median([row[name] for row in done]) for name in names_of]
        measured = [percent(middle[0]), number(middle[1]), number(middle[2]), number(middle[3], 0)]
        rows.append((outcome.job.name, str(len(done)), *counts, *measured))
    if rows:
        show_table(heads, rows)
    for outcome in outcomes:
        if outcome.status == "error":
            say(f"{outcome.job.name}: failed: {outcome.rows[0]['error']}")
        elif outcome.left_out:
            first, more = outcome.left_out[0], len(outcome.left_out) - 1
            also = f", and {counted(more, 'more frame')}" if more else ""
            say(f"{outcome.job.name}: left out: {first['error']}{also}")
    kept = f", {summary['kept']} of them from an earlier run" if summary["kept"] else ""
    failed = f", {summary['failed']} failed" if summary["failed"] else ""
    missing = f", {summary['left_out']} left out" if summary["left_out"] else ""
    say(f"{counted(summary['captures'], 'capture')}{kept}{failed}; {counted(summary['frames'], 'frame')}{missing}")
