"""Check a capture: every problem, each with file and frame; or one JSON file by its schema."""

from __future__ import annotations

import argparse
from pathlib import Path

from fusion.cli.options import add_trust, say, write_json
from scenes.words import counted


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's own arguments."""
    add_trust(parser)
    parser.add_argument(
        "capture",
        metavar="CAPTURE",
        type=Path,
        help="folder of the capture, or a capture.json, sensors.json, topics.json or result.json",
    )


def run(args: argparse.Namespace) -> int:
    """Exit code 1 when there is a problem; what may be right is a warning."""
    from scenes.errors import CaptureError
    from scenes.files.problems import Problem
    from scenes.recordings.captures import Capture
    from scenes.recordings.checking.validation import validate

    if args.capture.is_file() and args.capture.suffix.lower() == ".json":
        return _one_file(args)
    if not args.capture.is_dir():
        found = "a file" if args.capture.exists() else "nothing"
        raise CaptureError(f"{args.capture}: expected the folder of a capture, found {found}")
    doubts: list[Problem] = []
    problems = validate(args.capture, args.trust_paths, doubts.append)
    frames = 0 if problems else len(Capture(args.capture, trust_paths=args.trust_paths))
    told = [[{"file": p.file, "frame": p.frame, "message": p.message} for p in some] for some in (problems, doubts)]
    write_json(args.json, {"valid": not problems, "frames": frames, "problems": told[0], "warnings": told[1]})
    for problem in problems:
        say(str(problem))
    for doubt in doubts:
        say(f"warning: {doubt}")
    if problems:
        say(counted(len(problems), "problem"))
        return 1
    say(
        f"{args.capture}: {counted(frames, 'frame')}, no problem"
        + (f", {counted(len(doubts), 'warning')}" if doubts else "")
    )
    return 0


def _one_file(args: argparse.Namespace) -> int:
    """A single file against the schema of its kind."""
    from scenes.errors import CaptureError
    from scenes.files.problems import refuse
    from scenes.files.schema import NAMES, complaints, kind_of
    from scenes.recordings.bop import read_json

    content = read_json(args.capture, refuse)
    kind = kind_of(content)
    if kind is None:
        kinds = ", ".join(f"{name}.json" for name in NAMES)
        raise CaptureError(f"{args.capture}: expected the content of one of {kinds}, got another file's")
    found = complaints(content, kind)
    entries = [{"file": str(args.capture), "frame": None, "message": line} for line in found]
    write_json(args.json, {"valid": not found, "schema": kind, "problems": entries})
    for line in found:
        say(f"{args.capture}: {line}")
    say(f"{args.capture}: {counted(len(found), 'problem') if found else 'no problem'}, as a {kind}.json")
    return 1 if found else 0
