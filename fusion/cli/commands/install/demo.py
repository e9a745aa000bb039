"""Make a grasp that hides most of an object, and watch touch repair what the camera cannot see."""

from __future__ import annotations

import argparse
from pathlib import Path

from fusion.cli.compiling import announce_compiling
from fusion.cli.options import check_folder, say, write_json

OBJECT = "drill"
OCCLUSION = 0.8
NOISE = "lab"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's own arguments."""
    parser.add_argument("--out", metavar="DIR", type=Path, default=Path("out/demo"), help="default out/demo")


def run(args: argparse.Namespace) -> int:
    """Exit code 1 when the fused answer is lost."""
    from fusion.cli.commands.measures.compare import show
    from fusion.results.report.page import write_report
    from fusion.truth.compare import METHODS, compare, summarise
    from scenes.synthesis import library
    from scenes.synthesis.hands import five_finger_hand
    from scenes.synthesis.recording import synthesize

    check_folder(args.out)
    model = library.make(OBJECT)
    announce_compiling()
    say(f"a {OBJECT} in a hand that hides {100 * OCCLUSION:.0f} % of it, noise like a {NOISE}'s")
    capture = synthesize(
        args.out / "capture", model, five_finger_hand(), 1, OCCLUSION, ("point",), NOISE, seed=args.seed
    )
    rows = list(compare([capture], METHODS, args.seed))
    summaries = summarise(rows)
    show(summaries)
    fused = [row.estimate for row in rows if row.method == "fused" and row.estimate is not None]
    comparison = {"rows": [row.to_json() for row in rows]}
    write_report(args.out / "report.html", capture.name, list(capture), capture.model, fused, comparison)
    write_json(args.json, {"summary": [s.to_json() for s in summaries], **comparison})
    say(f"the picture: {args.out / 'report.html'}")
    return 1 if any(answer.verdict == "lost" for answer in fused) else 0
