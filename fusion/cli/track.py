"""Follow the object through the frames of a capture, finding it again when lost; writes what estimate writes."""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import TYPE_CHECKING

from fusion.cli.config import add_config, read_config, told
from fusion.cli.options import (
    add_beliefs,
    add_run,
    add_sure,
    announce_compiling,
    number,
    out_folder,
    percent,
    progress,
    say,
    show_table,
    with_sure,
    write_run,
)
from fusion.results.runs import load_object, prior_setter

if TYPE_CHECKING:
    from fusion.tracking.answer import TrackedEstimate
    from fusion.truth.errors import Errors
    from scenes.recordings.frames import Frame

# A table of more frames than this shows only those in which something happened.
LONG = 40


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's own arguments."""
    add_run(parser)
    add_sure(parser)
    add_beliefs(parser)
    add_config(parser)


def run(args: argparse.Namespace) -> int:
    """Exit code 1 when the object is lost in the last frame."""
    from fusion.estimation.asked import check_senses
    from fusion.results.files import frame_errors
    from fusion.tracking.tracker import Tracker
    from fusion.truth.errors import Judge
    from scenes.recordings.captures import read_capture
    from scenes.recordings.telling import believed
    from scenes.recordings.validation import check_scale

    senses = tuple(sorted(check_senses(args.use), reverse=True))
    config, said = read_config(args.config), told(args)
    capture = read_capture(args.capture, args.trust_paths)
    beliefs = believed(capture.beliefs, said)
    settings = replace(config.track, first=with_sure(config.track.first, args))
    out_folder(args, capture.name)  # before the work, not after it
    model = load_object(args.object, args.unit) if args.object else capture.model
    prepare = prior_setter(args.prior, args.seed)

    def new_tracker() -> Tracker:
        return Tracker(model, use=senses, seed=args.seed, settings=settings, beliefs=beliefs)

    judge, tracker = Judge.of(model), new_tracker()
    announce_compiling()
    frames: list[Frame] = []
    answers: list[TrackedEstimate] = []
    errors: list[Errors | None] = []
    for recorded in progress(capture, len(capture), "tracking"):
        # the coarse start is for the beginning; a track goes on by itself
        frame = recorded if answers and args.prior is not None else prepare(recorded, model)
        if not answers:
            # compiles, loads the kernels and the lattice: a frame's time should tell of the frame
            check_scale(frame, model)
            new_tracker().step(frame)
        frames.append(frame)
        answers.append(tracker.step(frame))
        errors.append(frame_errors(judge, frame, answers[-1]))
    written = write_run(args, capture, model, frames, answers, errors)
    _show(answers, errors)
    say(written)
    return 1 if answers[-1].verdict == "lost" else 0


def _show(answers: list[TrackedEstimate], errors: list[Errors | None]) -> None:
    """The table of frames, and the track in two lines."""
    import numpy as np

    heads = ("frame", "how", "verdict", "sure", "in the hand", "ADD-S mm", "rot °", "trans mm", "time ms", "not known")
    rows = []
    for answer, error in zip(answers, errors):
        told = answer.moved_in_hand or answer.how != "tracked" or answer.verdict != "ok"
        if len(answers) > LONG and not told:
            continue
        values = (
            (None,) * 3 if error is None else (1e3 * error.add_s, np.rad2deg(error.rotation), 1e3 * error.translation)
        )
        measured = [number(value) for value in values]
        slip = "slips" if answer.slip else "moves" if answer.moved_in_hand else "–"
        unknown = ", ".join(answer.unobservable) or "–"
        said = str(answer.frame), answer.how, answer.verdict, percent(answer.confidence), slip
        rows.append((*said, *measured, number(answer.time_ms, 0), unknown))
    title = None if len(answers) <= LONG else f"{len(rows)} of {len(answers)} frames in which something happened"
    show_table(heads, rows, title)
    known = [error for error in errors if error is not None]
    if known:
        median, worst = (1e3 * float(f([e.add_s for e in known])) for f in (np.median, np.max))
        say(f"ADD-S: median {median:.2f} mm, largest {worst:.2f} mm")
    count = {how: sum(a.how == how for a in answers) for how in ("tracked", "carried", "re-initialised", "lost")}
    times = [a.time_ms for a in answers if a.how == "tracked"]
    went = ", ".join(f"{n} {how}" for how, n in count.items() if n) or "started"
    say(f"{len(answers)} frames: {went}" + (f"; median {np.median(times):.0f} ms a tracked frame" if times else ""))
