"""Check a capture: every problem, each with file and frame."""

from __future__ import annotations

import argparse
from pathlib import Path

from fusion.cli.options import add_trust, say, write_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's own arguments."""
    add_trust(parser)
    parser.add_argument("capture", metavar="CAPTURE", type=Path, help="folder of the capture")


def run(args: argparse.Namespace) -> int:
    """Exit code 1 when there is a problem."""
    from scenes.errors import CaptureError
    from scenes.recordings.captures import Capture
    from scenes.recordings.validation import validate

    if not args.capture.is_dir():
        found = "a file" if args.capture.exists() else "nothing"
        raise CaptureError(f"{args.capture}: expected the folder of a capture, found {found}")
    problems = validate(args.capture, args.trust_paths)
    frames = 0 if problems else len(Capture(args.capture, trust_paths=args.trust_paths))
    entries = [{"file": p.file, "frame": p.frame, "message": p.message} for p in problems]
    write_json(args.json, {"valid": not problems, "frames": frames, "problems": entries})
    for problem in problems:
        say(str(problem))
    if problems:
        say(f"{len(problems)} problem{'s'[: len(problems) > 1]}")
        return 1
    say(f"{args.capture}: {frames} frame{'s'[: frames > 1]}, no problem")
    return 0
