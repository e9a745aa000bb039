"""Look at a capture, and at a result of it, in a live 3-D view in the browser."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from fusion.cli.options import add_object, add_trust, positive, say, warn, write_json
from fusion.results.runs import load_object

if TYPE_CHECKING:
    from fusion.estimation.answer import Estimate


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's own arguments."""
    add_trust(parser)
    parser.add_argument("capture", metavar="CAPTURE", type=Path, help="folder of the capture")
    parser.add_argument("result", metavar="RESULT", type=Path, nargs="?", help="a result.json, or its folder")
    add_object(parser, what="instead of the capture's object")
    parser.add_argument("--port", metavar="N", type=positive, default=8080, help="default 8080, or the next free one")
    parser.add_argument("--no-browser", action="store_true", help="only say where the page is")


def run(args: argparse.Namespace) -> int:
    """Serve until interrupted, which is how a view ends: exit code 0."""
    import webbrowser

    from fusion.results.files import check_is_of, find_result, read_result
    from fusion.results.viewer import Viewer
    from scenes.errors import InputError
    from scenes.recordings.captures import read_capture

    if args.port > 65535:
        raise InputError(f"port: expected a number up to 65535, got {args.port}")
    capture = read_capture(args.capture, args.trust_paths)
    model = load_object(args.object, args.unit) if args.object else capture.model
    answers: list[Estimate] = []
    if args.result is not None:
        path = find_result(args.result)
        if path is None:
            raise InputError(f"{args.result}: expected a result.json or a folder with one, found none")
        content, answers = read_result(path)
        check_is_of(path, content, answers, capture)
    viewer = Viewer(
        capture, model, answers, args.port, lambda problem: warn(f"shown without what is broken: {problem}")
    )
    try:
        write_json(args.json, {"url": viewer.url, "frames": len(capture), "answers": len(answers)})
        say(f"{viewer.url} (Ctrl-C ends it)")
        if not args.no_browser:
            webbrowser.open(viewer.url)
        viewer.run()
    except KeyboardInterrupt:
        pass
    finally:
        viewer.stop()
    return 0
