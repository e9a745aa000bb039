"""Fit the confidence: frames of tuning families answered, both regressions fitted, families left out in turn."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fusion.cli.options import check_target, console, names, positive, progress, say, share, write_json

if TYPE_CHECKING:
    from fusion.benchmarks.confidence.answers import Told
    from fusion.benchmarks.confidence.fit import Fitted

METHODS = ("fused", "few", "vision", "touch")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's own arguments."""
    parser.add_argument(
        "--family",
        metavar="A,B",
        type=names,
        help="tuning families (default: all of them; report families are refused)",
    )
    parser.add_argument("--objects", metavar="A,B", type=names, help="only these objects")
    parser.add_argument("--levels", metavar="F,F", type=_shares, help="only these hidden shares of the families' own")
    parser.add_argument("--trials", metavar="N", type=positive, default=1, help="frames of each object and level")
    parser.add_argument("--methods", metavar="A,B", type=_methods, default=METHODS, help=f"of {', '.join(METHODS)}")
    parser.add_argument(
        "--answers",
        metavar="FILE",
        type=Path,
        default=Path("confidence.jsonl"),
        help="answers as JSON lines, as they come; those it has are not made again (default confidence.jsonl)",
    )
    parser.add_argument(
        "--from",
        metavar="FILE",
        dest="given",
        type=Path,
        action="append",
        help="answer nothing: fit this file; again for more files",
    )
    parser.add_argument(
        "--only", metavar="A,B", type=_factor_names, help="fit these factors; the others stay as they stand"
    )
    parser.add_argument("--captures", metavar="DIR", type=Path, help="keep the frames here, and read those that are")
    parser.add_argument("--jobs", metavar="N", type=positive, help="processes (default: the threads that are allowed)")
    parser.add_argument(
        "--write", metavar="FILE", type=Path, help="the factors, for --config of other commands (.toml) or as .json"
    )


def run(args: argparse.Namespace) -> int:
    """Print the tables and the factors; exit code 0 also when the calibration is not what is demanded."""
    from fusion.benchmarks.confidence.answers import read_answers, tuned_on
    from fusion.benchmarks.confidence.fit import fit_model
    from fusion.benchmarks.confidence.report import literals, report_of
    from fusion.benchmarks.families.table import FAMILIES, TUNING, chosen
    from fusion.benchmarks.printing.tables import show_report

    check_target(args.write)
    asked = [FAMILIES[name] for name in FAMILIES if FAMILIES[name].role == TUNING]
    if args.family is not None:
        asked = [one for name in args.family for one in chosen(name)]
    families = tuned_on(asked)
    if args.given is None:
        _answer(args, families)
    wanted = {family.name for family in families}
    told = [one for path in args.given or [args.answers] for one in read_answers(path) if one.family in wanted]
    told = [one for one in told if _is_asked(one, args)]
    tuned_on(FAMILIES[one.family] for one in told)
    kinds = [seen for seen in (True, False) if any(one.seen == seen and one.sense != "none" for one in told)]
    # nothing at all is refused by the fit, in its words
    fits = [fit_model(told, seen, *_held(args.only, seen)) for seen in kinds or [True]]
    report = report_of(fits, args.seed)
    _mixed(told)
    show_report(report, console())
    for line in literals(fits):
        say(line)
    if args.write is not None:
        _write(args.write, fits)
        say(f"wrote {args.write}")
    write_json(args.json, {**report.to_json(), "factors": {one.name: _factors(one) for one in fits}})
    return 0


def _answer(args: argparse.Namespace, families: Iterable[Any]) -> None:
    from fusion.benchmarks.confidence.answers import answered, mend, read_answers, works_of, write_line
    from fusion.benchmarks.strata import parallel

    check_target(args.answers)
    if args.answers.is_file():
        mend(args.answers)
    known = read_answers(args.answers) if args.answers.is_file() else []
    methods = [(sense, start) for start in (True, False) for sense in args.methods]
    asked = args.levels, args.objects, args.trials, args.seed, methods, args.captures
    works = works_of(list(families), *asked, known)
    with args.answers.open("a", encoding="utf-8") as file:
        for found in progress(parallel(answered, works, args.jobs), len(works), "frames"):
            file.write("".join(write_line(one) for one in found))
            file.flush()
    say(f"{len(works)} frames answered, {len({one.place for one in known})} known; {args.answers}")


def _held(only: tuple[str, ...] | None, seen: bool) -> tuple[Any, tuple[str, ...]]:
    """The regression whose other factors stay, and those that do not; None to fit them all."""
    from fusion.estimation.posterior.confidence import ConfidenceSettings

    if only is None:
        return None, ()
    settings = ConfidenceSettings()
    return (settings.seen if seen else settings.felt), only


def _is_asked(told: Told, args: argparse.Namespace) -> bool:
    levels, objects = args.levels, args.objects
    here = levels is None or any(abs(told.level - level) < 1e-6 for level in levels)
    return here and (objects is None or told.object in objects) and told.sense in (*args.methods, "none")


def _mixed(told: list[Told]) -> None:
    from fusion.benchmarks.printing.provenance import source_version
    from fusion.cli.options import warn

    others = sum(one.version != source_version() for one in told)
    if others:
        warn(f"{others} of {len(told)} answers are of another version of the code")


def _factors(one: Fitted) -> dict[str, float]:
    from dataclasses import asdict

    return {name: float(f"{value:.4g}") for name, value in asdict(one.factors).items()}


def _write(path: Path, fits: list[Fitted]) -> None:
    from scenes.files.whole import replace_file

    found = {one.name: _factors(one) for one in fits}
    if path.suffix == ".json":
        text = json.dumps({"estimate": {"confidence": found}}, indent=1) + "\n"
    else:
        lines = [
            [f"[estimate.confidence.{name}]", *(f"{k} = {v!r}" for k, v in of.items())] for name, of in found.items()
        ]
        text = "\n\n".join("\n".join(part) for part in lines) + "\n"
    replace_file(path, text.encode())


def _shares(text: str) -> tuple[float, ...]:
    return tuple(share(part) for part in names(text))


def _factor_names(text: str) -> tuple[str, ...]:
    from fusion.estimation.posterior.confidence import FEATURES

    found, known = names(text), [*(feature.name for feature in FEATURES), "nearest"]
    if not found or not set(found) <= set(known):
        raise argparse.ArgumentTypeError(f"expected some of {', '.join(known)}, got {text!r}")
    return found


def _methods(text: str) -> tuple[str, ...]:
    found = names(text)
    if not found or not set(found) <= set(METHODS):
        raise argparse.ArgumentTypeError(f"expected some of {', '.join(METHODS)}, got {text!r}")
    return found
