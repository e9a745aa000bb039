"""Follow the object through the frames of a capture, finding it again when lost; answers are written as they come."""

from __future__ import annotations

import argparse
import shlex
import signal
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from fusion.cli.compiling import announce_compiling
from fusion.cli.config import add_config, read_config, told
from fusion.cli.options import (
    add_run,
    add_sure,
    is_quiet,
    non_negative,
    number,
    out_folder,
    percent,
    positive_number,
    say,
    show_table,
    warn,
    warn_neglected,
    with_sure,
)
from fusion.cli.telling import add_beliefs
from fusion.results.runs import load_object, prior_setter
from scenes.words import counted

if TYPE_CHECKING:
    from fusion.results.track.running import Step, TrackRun
    from fusion.results.track.summary import Columns

# A table of more frames than this shows only those in which something happened, and no more of these.
LONG = 40
# Seconds between the lines that a pipe is told.
SAID_EVERY = 10.0
INTERRUPTED = 130


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's own arguments."""
    add_run(parser)
    add_sure(parser)
    add_beliefs(parser)
    add_config(parser)
    parser.add_argument("--resume", action="store_true", help="go on where an interrupted track into --out has ended")
    parser.add_argument(
        "--realtime", metavar="HZ", type=positive_number, help="replay as a camera of so many frames a second delivers"
    )
    parser.add_argument(
        "--checkpoint", metavar="S", type=non_negative, default=5.0, help="seconds between checkpoints (default 5)"
    )


def run(args: argparse.Namespace) -> int:
    """Exit code 1 when the object is lost in the last frame, 130 when interrupted."""
    from fusion.estimation.asked import check_senses
    from fusion.results.track.running import RunOptions, TrackRun, asked_for
    from fusion.tracking.tracker import Tracker
    from scenes.recordings.captures import read_capture
    from scenes.recordings.telling import believed

    senses = tuple(sorted(check_senses(args.use), reverse=True))
    config, said = read_config(args.config), told(args)
    capture = read_capture(args.capture, args.trust_paths)
    beliefs = believed(capture.beliefs, said)
    settings = replace(config.track, first=with_sure(config.track.first, args))
    out = out_folder(args, capture.name)  # before the work, not after it
    warn_neglected(capture)
    model = load_object(args.object, args.unit) if args.object else capture.model
    prepare = prior_setter(args.prior, args.seed)
    asked = asked_for(model, senses, args.prior, args.seed, settings, beliefs)

    def new_tracker() -> Tracker:
        return Tracker(model, use=senses, seed=args.seed, settings=settings, beliefs=beliefs)

    announce_compiling()
    options = RunOptions(args.checkpoint, args.realtime, not args.no_report)
    with TrackRun(capture, model, out, new_tracker, prepare, asked, options, args.resume) as track:
        if args.resume:
            say(
                f"resumed after {track.done} of {len(capture)} frames"
                if track.done
                else "no checkpoint: from the start"
            )
        with _Stop() as stop, _Ticker(len(capture), args.realtime) as ticker:
            for step in track.steps():
                ticker.tell(step)
                if stop.asked:
                    break
        track.save()
        columns = _finish(args, track)
    if stop.asked and track.done < len(capture):
        again = shlex.join(["palpate", *_same_again(sys.argv[1:])])
        warn(f"interrupted after {track.done} of {len(capture)} frames, which are in {out}; go on with: {again}")
        return INTERRUPTED
    return 1 if len(columns) and columns.verdict[-1] == "lost" else 0


def _finish(args: argparse.Namespace, track: TrackRun) -> Columns:
    """The files of the whole, and what is printed of it."""
    from fusion.results.track.summary import MOST_IN_RESULT, read_columns, summary, write_result

    capture, out = track.capture, track.out
    complete = track.done == len(capture)
    columns = read_columns(out, track.model)
    last = summary(columns, len(capture), args.realtime, complete)
    head = {"capture": capture.name, "capture_path": str(capture.path.resolve()), "object": track.model.name}
    touch = track.next_touch() if complete and len(columns) <= MOST_IN_RESULT else []
    for path in (out / "result.json", *([args.json] if args.json is not None else ())):
        write_result(path, out, head, columns, last, touch)
    wrote = "poses.csv, result.jsonl, times.jsonl, result.json"
    if not args.no_report and complete:
        from fusion.results.track.report import write_track_report

        write_track_report(out, capture.name, track.model, columns, last, capture.frame_ids)
        wrote += ", report.html"
    _show(columns, last)
    say(f"wrote {out / wrote}")
    return columns


def _same_again(words: list[str]) -> list[str]:
    return words if "--resume" in words else [*words, "--resume"]


class _Stop:
    """Ctrl-C (or a service's SIGTERM) asks to end after this frame; the second one ends at once."""

    def __init__(self) -> None:
        self.asked = False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> _Stop:
        if threading.current_thread() is threading.main_thread():  # in another, whoever called hears it
            self._before = {kind: signal.signal(kind, self._heard) for kind in (signal.SIGINT, signal.SIGTERM)}
        return self

    def __exit__(self, *_: object) -> None:
        for kind, handler in self._before.items():
            signal.signal(kind, handler)

    def _heard(self, kind: int, _: object) -> None:
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True
        warn("stopping after this frame; once more stops at once")


class _Ticker:
    """How far it is: a bar on a terminal; in a pipe a plain line now and then. Both on standard error."""

    def __init__(
        self, total: int, hertz: float | None, clock: Callable[[], float] = time.monotonic, every: float = SAID_EVERY
    ) -> None:
        self._total, self._hertz, self._clock, self._every = total, hertz, clock, every
        self._bar: Any = None
        self._said_at = clock()
        self._times: list[float] = []
        self._counts = {"slips": 0, "lost": 0, "left out": 0}
        self._slipping = False

    def __enter__(self) -> _Ticker:
        if sys.stderr.isatty() and not is_quiet() and self._total > 1:
            from rich.console import Console
            from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

            columns = (TextColumn("tracking"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
            self._bar = Progress(
                *columns, TextColumn("{task.description}"), console=Console(stderr=True), transient=True
            )
            self._bar.start()
            self._bar.add_task("", total=self._total)
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def tell(self, step: Step) -> None:
        """One more frame."""
        answer = step.answer
        slips = answer is not None and answer.slip
        self._counts["slips"] += slips and not self._slipping
        self._slipping = slips
        self._counts["lost"] += answer is not None and answer.verdict == "lost"
        self._counts["left out"] += step.behind + (answer is None)
        self._times.append(step.ms)
        if answer is None:
            warn(f"frame {step.number} is left out: {step.why}")
        elif step.problems:
            warn(f"frame {step.number} is tracked without what is broken: {'; '.join(step.problems)}")
        if self._bar is not None:
            self._bar.update(0, completed=step.done, description=self._words())
            self._times = self._times[-30:]
        elif self._clock() - self._said_at >= self._every:
            warn(f"{step.done} of {self._total} frames, {self._words()}")
            self._said_at, self._times = self._clock(), []

    def _words(self) -> str:
        told = ", ".join(f"{count} {what}" for what, count in self._counts.items() if count)
        return f"{sum(self._times) / len(self._times):.0f} ms a frame" + (f", {told}" if told else "")


def _show(columns: Columns, last: dict[str, Any]) -> None:
    """The table of frames, and the track in a few lines."""
    import numpy as np

    heads = ("frame", "how", "verdict", "sure", "in the hand", "ADD-S mm", "rot °", "trans mm", "time ms", "σ mm")
    told = [
        i
        for i in range(len(columns))
        if len(columns) <= LONG
        or columns.moved[i]
        or columns.slip[i]
        or columns.how[i] != "tracked"
        or columns.verdict[i] != "ok"
    ]
    rows = []
    for i in told[:LONG]:
        measured = [number(float(columns.errors[name][i])) for name in ("add_s_mm", "rotation_deg", "translation_mm")]
        slip = "slips" if columns.slip[i] else "moves" if columns.moved[i] else "–"
        times = number(float(columns.step[i]), 0), number(1e3 * float(columns.sigma[i, 1]))
        said = str(columns.frame[i]), columns.how[i], columns.verdict[i], percent(float(columns.confidence[i]))
        rows.append((*said, slip, *measured, *times))
    title = None
    if len(columns) > LONG:
        title = f"{len(told)} of {len(columns)} frames in which something happened"
        title += f": the first {LONG}, the others are in result.jsonl" if len(told) > LONG else ""
    show_table(heads, rows, title)
    known = columns.errors["add_s_mm"][np.isfinite(columns.errors["add_s_mm"])]
    if len(known):
        say(f"ADD-S: median {np.median(known):.2f} mm, largest {known.max():.2f} mm")
    count = ", ".join(f"{n} {how}" for how, n in last["how"].items())
    left_out = last["frames_skipped"]
    skipped = "".join(f", {n} left out ({cause})" for cause, n in left_out.items() if n)
    slips = counted(last["slips"]["count"], "slip")
    say(f"{counted(last['frames_answered'], 'frame')}: {count or 'none'}{skipped}; {slips}")
    say(_times("a frame", last["step_ms"]))
    if last["hertz"] is not None:
        say(_times(f"from a frame's arrival at {last['hertz']:g} Hz to its answer", last["latency_ms"]))


def _times(what: str, found: dict[str, float | None]) -> str:
    said = ", ".join(f"{name} {number(value, 1)}" for name, value in found.items())
    return f"ms {what}: {said}"
