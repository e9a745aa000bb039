"""Say how well the hand holds the object: force closure, epsilon, volume, and where another finger would help."""

from __future__ import annotations

import argparse
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

from fusion.cli.compiling import announce_compiling
from fusion.cli.options import (
    add_object,
    add_prior,
    add_trust,
    names,
    non_negative,
    number,
    out_folder,
    positive,
    progress,
    say,
    show_table,
    warn_neglected,
    warn_of,
    whole,
    write_json,
)
from fusion.results.runs import estimates, load_object, prior_setter

if TYPE_CHECKING:
    from fusion.advice.grasp import GraspAnswer
    from fusion.estimation.answer import Estimate
    from scenes.geometry.objects import ObjectModel
    from scenes.recordings.captures import Capture
    from scenes.recordings.frames import Frame

SENSES = ("vision", "touch")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's own arguments."""
    add_trust(parser)
    parser.add_argument(
        "source",
        metavar="CAPTURE|RESULT",
        type=Path,
        help="a capture, estimated first, or a result.json (or its folder)",
    )
    parser.add_argument("--capture", metavar="DIR", type=Path, help="the capture of a result that has moved")
    add_object(parser, what="instead of the capture's object")
    parser.add_argument("--use", metavar="SENSES", type=names, default=SENSES, help="of the estimate")
    add_prior(parser)
    parser.add_argument("--friction", metavar="MU", type=non_negative, default=0.5, help="Coulomb's (default 0.5)")
    parser.add_argument(
        "--edges", metavar="N", type=positive, default=8, help="sides of a friction pyramid, 3 to 16 (default 8)"
    )
    parser.add_argument(
        "--soft-finger", metavar="MM", type=non_negative, default=0.0, help="radius of a soft contact (default 0: hard)"
    )
    parser.add_argument(
        "--norm", choices=("l1", "linf"), default="l1", help="limit the sum of the forces (l1) or each of them (linf)"
    )
    parser.add_argument(
        "--normals", choices=("sensed", "mesh"), default="sensed", help="whose normals (default sensed)"
    )
    parser.add_argument("--samples", metavar="N", type=whole, default=100, help="of the posterior (default 100)")
    parser.add_argument("--no-map", action="store_true", help="skip where another finger would help")
    parser.add_argument("--out", metavar="DIR", type=Path, help="where to write (default out/NAME of the capture)")
    parser.add_argument("--no-report", action="store_true", help="skip grasp.html")


def run(args: argparse.Namespace) -> int:
    """Exit code 1 when a frame's pose is lost, whose grasp cannot be told, or a frame was left out."""
    from fusion.advice.grasp import GraspAdviceSettings, assess
    from touch.grasp_quality import WrenchSettings

    wrenches = WrenchSettings(args.friction, args.edges, 1e-3 * args.soft_finger, args.norm)
    places = 0 if args.no_map else GraspAdviceSettings().places
    settings = GraspAdviceSettings(wrenches, args.normals, args.samples, places)
    left_out: dict[int, str] = {}
    capture, model, frames, answers = _answers(args, left_out)
    out = out_folder(args, capture.name)
    grasps = [
        assess(model, answer, frame, args.seed, settings)
        for frame, answer in progress(zip(frames, answers), len(frames), "grasping")
    ]
    asked = {"friction": args.friction, "edges": args.edges, "soft_finger_mm": args.soft_finger, "norm": args.norm}
    content = {
        "version": 1,
        "capture": capture.name,
        "object": model.name,
        "settings": {**asked, "normals": args.normals, "samples": args.samples, "seed": args.seed},
        "frames": [grasp.to_json() for grasp in grasps],
    }
    if left_out:
        content["left_out"] = [{"frame": number, "why": why} for number, why in left_out.items()]
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / "grasp.json", content)
    write_json(args.json, content)
    if not args.no_report:
        from fusion.results.report.page import write_report

        write_report(out / "grasp.html", capture.name, frames, model, answers, grasps=grasps)
    _show(grasps)
    say(f"wrote {out / 'grasp.json'}" + ("" if args.no_report else ", grasp.html"))
    return 1 if left_out or any(answer.verdict == "lost" for answer in answers) else 0


def _answers(
    args: argparse.Namespace, left_out: dict[int, str]
) -> tuple[Capture, ObjectModel, list[Frame], list[Estimate]]:
    """Capture, object, frames and their answers: read from a result, or estimated now. left_out: is told the frames
    that cannot be used, and why.
    """
    from fusion.results.files import capture_of, check_is_of, find_result, read_result
    from scenes.errors import InputError
    from scenes.recordings.captures import read_capture

    result = find_result(args.source)
    if result is None and args.capture is not None:
        raise InputError(f"--capture: expected a result, whose capture it is, got {args.source}")
    if result is not None:
        for option, given in (("--prior", args.prior is not None), ("--use", args.use != SENSES)):
            if given:
                raise InputError(f"{option}: expected a capture, which is estimated with it, got the result {result}")
        content, answers = read_result(result)
        unknown = next((one.frame for one in answers if not all(map(isfinite, one.covariance.ravel()))), None)
        if unknown is not None:
            raise InputError(f"{result}: expected covariances, found none of frame {unknown}")
        capture = read_capture(capture_of(result, content, args.capture), args.trust_paths)
        check_is_of(result, content, answers, capture)
        model = load_object(args.object, args.unit) if args.object else capture.model
        return capture, model, [capture.frame(answer.frame) for answer in answers], answers
    if not args.source.is_dir():
        raise InputError(f"{args.source}: expected a capture's folder, or a result.json or its folder, found neither")
    from fusion.estimation.asked import check_senses

    senses = tuple(sorted(check_senses(args.use), reverse=True))
    capture = read_capture(args.source, args.trust_paths)
    warn_neglected(capture)
    model = load_object(args.object, args.unit) if args.object else capture.model
    prepare = prior_setter(args.prior, args.seed)
    announce_compiling()
    shown = progress(capture.frame_ids, len(capture), "estimating")
    done = list(estimates(capture, shown, model, prepare, senses, args.seed, leave_out=left_out.__setitem__))
    warn_of(left_out)
    return capture, model, [frame for frame, _ in done], [answer for _, answer in done]


def _show(grasps: list[GraspAnswer]) -> None:
    heads = ("frame", "pose", "grasp", "contacts", "ε", "ε 5–95 %", "volume", "closed in")
    rows = [
        (
            str(g.frame),
            g.verdict,
            g.quality.verdict,
            str(len(g.points)) + (f" (+{len(g.left_out)} left out)" if g.left_out else ""),
            number(g.quality.epsilon, 3),
            f"{number(g.epsilon.low, 3)}–{number(g.epsilon.high, 3)}",
            f"{g.quality.volume:.3g}",
            f"{100 * g.closure_probability:.0f} %",
        )
        for g in grasps
    ]
    show_table(heads, rows)
    for g in grasps:
        if not g.quality.closure:
            say("; ".join((f"frame {g.frame}: {g.quality.why}", *g.notes)))
        for place in g.places:
            x, y, z = (1e3 * place.point).round()
            finger = "" if place.finger is None else f"; nearest is {place.finger}"
            gain = f"{place.told}, {place.information:.1f} nats about the pose"
            say(f"frame {g.frame}: a finger at ({x:.0f}, {y:.0f}, {z:.0f}) mm of the object: {gain}{finger}")
