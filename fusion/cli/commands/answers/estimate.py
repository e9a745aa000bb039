"""Estimate the object's pose in every frame of a capture; writes poses.csv, result.json and report.html."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from fusion.cli.compiling import announce_compiling
from fusion.cli.config import add_config, estimate_settings, told
from fusion.cli.options import (
    add_run,
    add_sure,
    non_negative,
    number,
    out_folder,
    percent,
    pose_lines,
    progress,
    say,
    show_table,
    tolerance,
    warn_neglected,
    warn_of,
    with_sure,
    write_run,
)
from fusion.cli.telling import add_beliefs
from fusion.results.runs import estimates, frame_setter, load_object

HEADS = (
    *("frame", "verdict", "sure", "ADD-S mm", "rot °", "trans mm", "cloud mm", "contacts mm", "time ms"),
    "not known",
)
# Frames whose reasons are printed; result.json has all of them.
MOST_REMARKS = 5
# Frames whose pose is printed; poses.csv and result.json have all of them.
MOST_POSES = 10


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's own arguments."""
    add_run(parser)
    add_sure(parser)
    add_beliefs(parser)
    add_config(parser)
    parser.add_argument(
        "--tolerance", metavar="MM,DEG", type=tolerance, help="good enough, like 1,2: work beyond is skipped"
    )
    parser.add_argument(
        "--frames", metavar="N,A-B", type=frame_numbers, help="these frames only, like 0,10-20 (default all)"
    )
    parser.add_argument("--budget-ms", metavar="N", type=non_negative, help="milliseconds a frame may take")


def run(args: argparse.Namespace) -> int:
    """Exit code 1 when a frame's answer is lost, or a frame could not be used."""
    from fusion.estimation.asked import check_senses
    from fusion.results.files import frame_errors
    from fusion.truth.errors import Judge
    from scenes.recordings.captures import read_capture

    senses = tuple(sorted(check_senses(args.use), reverse=True))
    settings = with_sure(estimate_settings(args.config), args)
    prepare = frame_setter(args.prior, args.seed, told(args))
    capture = read_capture(args.capture, args.trust_paths)
    out_folder(args, capture.name)  # before the work, not after it
    warn_neglected(capture)
    model = load_object(args.object, args.unit) if args.object else capture.model
    judge = Judge.of(model)
    frames, answers, errors, rows = [], [], [], []
    announce_compiling()
    numbers = chosen(capture.frame_ids, args.frames)
    shown = progress(numbers, len(numbers), "estimating")
    limits = args.tolerance, args.budget_ms
    left_out: dict[int, str] = {}
    told_of = left_out.__setitem__
    for frame, answer in estimates(capture, shown, model, prepare, senses, args.seed, *limits, settings, told_of):
        frames.append(frame)
        answers.append(answer)
        errors.append(frame_errors(judge, frame, answer))
        rows.append(_row(answer, errors[-1], judge.agreement(frame, answer.pose)))
    written = write_run(args, capture, model, frames, answers, errors, left_out)
    show_table(HEADS, rows)
    for line in (*_poses(answers), *_remarks(answers)):
        say(line)
    say(written)
    warn_of(left_out)
    return 1 if left_out or any(answer.verdict == "lost" for answer in answers) else 0


def frame_numbers(text: str) -> tuple[range, ...]:
    """A value of --frames: numbers and spans that hold both their ends. Raises InputError."""
    from scenes.errors import InputError

    spans = []
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        if not (first.isdecimal() and (last.isdecimal() if dash else not last)):
            raise InputError(f"frames: expected numbers and spans like 0,10-20, got {text!r}")
        spans.append(range(int(first), int(last or first) + 1))
    return tuple(spans)


def chosen(known: Sequence[int], spans: tuple[range, ...] | None) -> list[int]:
    """The frames that --frames asks for, in their order. Raises InputError for a part that has none of them."""
    from scenes.errors import InputError

    for span in spans or ():
        if not any(number in span for number in known):
            asked = str(span.start) if len(span) == 1 else f"{span.start}-{span.stop - 1}"
            raise InputError(
                f"frames: expected some of the capture's {len(known)} ({known[0]} to {known[-1]}), got {asked}"
            )
    return [number for number in known if spans is None or any(number in span for span in spans)]


def _poses(answers) -> list[str]:  # type: ignore[no-untyped-def]  # naming the type would import it
    """Where the object is, for a person: camera_from_object of the first frames; poses.csv has all of them."""
    lines = []
    for answer in answers[:MOST_POSES]:
        said, matrix = pose_lines(answer.pose)
        lines.append(f"frame {answer.frame}: object in the camera frame: {said}")
        if len(answers) == 1:
            lines.append(f"camera_from_object (m): {matrix}")
    return [*lines, f"and {len(answers) - MOST_POSES} more poses"] if len(answers) > MOST_POSES else lines


def _remarks(answers) -> list[str]:  # type: ignore[no-untyped-def]  # naming the type would import it
    """Why frames are not ok and what is doubtful about them: the table has no room for it."""
    told = [a for a in answers if a.verdict != "ok" or len(a.notes) > 1]  # the first note is the verdict's reason
    lines = [f"frame {a.frame}: {a.verdict}: {'; '.join(a.notes)}" for a in told[:MOST_REMARKS]]
    return [*lines, f"and {len(told) - MOST_REMARKS} more frames"] if len(told) > MOST_REMARKS else lines


def _contacts_mm(answer, agreement) -> float:  # type: ignore[no-untyped-def]  # naming the types would import them
    """Mean |distance| of the contacts that result.json lists: where the answer's correction of the calibration has
    them. Where touch was not used, of those recorded, as the robot reports them.
    """
    if answer.contacts:
        return sum(abs(one.residual_mm) for one in answer.contacts) / len(answer.contacts)
    return 1e3 * float(agreement.contacts)


def _row(answer, errors, agreement) -> list[str]:  # type: ignore[no-untyped-def]  # naming the types would import them
    against = (None, None, None) if errors is None else (errors.add_s, errors.rotation, errors.translation)
    factors = (1e3, 57.29577951308232, 1e3)
    return [
        str(answer.frame),
        answer.verdict,
        percent(answer.confidence),
        *(number(None if value is None else value * factor) for value, factor in zip(against, factors)),
        number(1e3 * agreement.cloud),
        number(_contacts_mm(answer, agreement)),
        number(answer.time_ms, 0),
        ", ".join(answer.unobservable) or "–",
    ]
