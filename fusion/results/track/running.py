"""A track over a recording of any length: one frame in memory, every answer on disk before the next frame is read."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any

from fusion.advice.next_touch import next_touches
from fusion.results.files import answer_of, frame_errors
from fusion.results.runs import reporting
from fusion.results.track.checkpoints import CHECKPOINT, Checkpoint
from fusion.results.track.files import FRAMES, REPORT_FOLDER, TIMES, GrowingFiles, lines
from fusion.results.track.pictures import Photographer
from fusion.results.track.replay import InTurn, Next, RealTime
from fusion.tracking.answer import TrackedEstimate, TrackSettings
from fusion.tracking.checkpoint import digest, restore_tracker, save_tracker
from fusion.tracking.rehearsal import rehearse
from fusion.tracking.tracker import Tracker
from fusion.truth.errors import Judge
from scenes.errors import InputError, PalpateError
from scenes.files.claimed import claimed
from scenes.files.problems import Problem, refuse
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import Beliefs
from scenes.recordings.captures import Capture
from scenes.recordings.checking.validation import check_scale
from scenes.recordings.frames import Frame

_log = logging.getLogger(__name__)

# Files of an earlier track in the same folder that would contradict a new one until it is done.
OLD = ("result.json", "report.html", CHECKPOINT)
OLD_PICTURES = ("*.jpg", "part_*.js")


@dataclass(frozen=True)
class RunOptions:
    """How a track is run, beside what it is asked for."""

    # Between two checkpoints (s): what a power cut costs. One takes some 10 ms, mostly of waiting for the disk.
    checkpoint_every: float = 5.0
    # Of a replay in real time (frames/s); None takes every frame in its turn.
    hertz: float | None = None
    # Whether pictures for the report are written.
    pictures: bool = True


@dataclass(frozen=True)
class Step:
    """A frame done: its number; answer, None for one without (why says why); errors of the recording's files that the
    answer had to do without; behind: frames passed over before it; ms: wall time of the tracker; done: frames so far.
    """

    number: int
    answer: TrackedEstimate | None
    why: str
    problems: tuple[str, ...]
    behind: int
    ms: float
    done: int


class TrackRun:
    """One run of the tracker over a capture, into a folder. Use as a context manager."""

    def __init__(
        self,
        capture: Capture,
        model: ObjectModel,
        out: Path,
        new_tracker: Callable[[], Tracker],
        prepare: Callable[[Frame, ObjectModel], Frame],
        asked: dict[str, str],
        options: RunOptions | None = None,
        resume: bool = False,
    ) -> None:
        """prepare: what is done to frames until one shows the object (their coarse start); asked: as for a Checkpoint.

        resume: go on where the folder's checkpoint is; without one, begin. Raises InputError when it is of a track
        that was asked something else, and for a folder that another track is being written to.
        """
        self.capture, self.model, self.out = capture, model, out
        self.options = options or RunOptions()
        self._new_tracker, self._prepare, self._asked = new_tracker, prepare, asked
        self._tracker = new_tracker()
        self._judge = Judge(model)
        self.done = self.answered = 0
        self._last = -1
        self._seen: dict[int, str] = {}
        self._answered_frame: Frame | None = None
        self._claim = _claim(out)
        try:
            self._begin(resume)
        except BaseException:
            os.close(self._claim)
            raise

    def _begin(self, resume: bool) -> None:
        """From the folder's checkpoint, or from the start in a folder without an earlier track's files."""
        capture, model, out, asked = self.capture, self.model, self.out, self._asked
        found = Checkpoint.read(out) if resume else None
        if found is not None:
            found.check(out, asked, capture.frame_ids, self._sight)
            self._seen = dict(found.seen)
            restore_tracker(self._tracker, found.state, capture.hand)
            self.done, self.answered, self._last = found.done, found.answered, found.last
        else:
            _clear(out)
        self._tracker.live = self.options.hertz is not None
        self._files = GrowingFiles(out, None if found is None else found.sizes, self.options.pictures)
        total = len(capture)
        self._photographer = Photographer(out / REPORT_FOLDER, model, total) if self.options.pictures else None
        self._saved_at = time.monotonic()
        notes = capture.manifest.notes.get("scene_id", 0)
        self._scene = notes if isinstance(notes, int) else 0

    def __enter__(self) -> TrackRun:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._files.close()
        os.close(self._claim)

    def steps(self) -> Iterator[Step]:
        """Track what is left of the recording; each step is on disk when it is yielded."""
        how, numbers = self.options, self.capture.frame_ids
        if self.done >= len(numbers):
            return
        pace = InTurn(numbers, self.done) if how.hertz is None else RealTime(numbers, how.hertz, self.done)
        self._look_before(how.hertz is not None)
        for one in pace:
            yield self._step(one, pace)
            if time.monotonic() - self._saved_at >= how.checkpoint_every:
                self.save()

    def next_touch(self) -> list[dict[str, Any]]:
        """Where one more contact would tell most about the object of the last answer, as result.json says it."""
        last = None
        for last in lines(self.out / FRAMES):  # noqa: B007  # only the last is wanted
            pass
        if last is None:
            return []
        frame, answer = self._read(int(last["frame"]))[0], answer_of(last)
        return [] if frame is None else [touch.to_json() for touch in next_touches(self.model, answer, frame)]

    def save(self) -> None:
        """Write the checkpoint."""
        state = save_tracker(self._tracker, self.capture.hand)
        sizes = self._files.sizes()
        if self._answered_frame is not None:
            first = dict(list(self._seen.items())[:1])
            self._seen = first | {self._answered_frame.index: _what_it_shows(self._answered_frame)}
            self._answered_frame = None
        Checkpoint(self._asked, self.done, self._last, self.answered, sizes, self._seen, state).write(self.out)
        self._saved_at = time.monotonic()

    def _sight(self, number: int) -> str:
        """What the recording's frame of that number shows, without what is broken of it."""
        with reporting(self.capture, lambda problem: None):
            return _what_it_shows(self.capture.frame(number))

    def _look_before(self, in_real_time: bool) -> None:
        """Whether the first frame can be what it says. Where a clock will run it is rehearsed, too: times should tell
        of frames. Otherwise no frame is searched twice.
        """
        with reporting(self.capture, refuse):
            first = self._prepare(self.capture[0], self.model)
        check_scale(first, self.model)
        if in_real_time:
            rehearse(self._new_tracker, first)

    def _step(self, one: Next, pace: InTurn) -> Step:
        numbers = self.capture.frame_ids
        for position in one.behind:
            self._files.skipped(numbers[position], "behind", "a newer frame had come")
        number = numbers[one.position]
        begin = time.perf_counter()
        with pace.stopped():
            frame, problems = self._read(number)
        read = time.perf_counter()
        answer, why, ms = None, "; ".join(problems), 0.0
        if frame is not None:
            try:
                answer = self._tracker.step(frame)
            except PalpateError as error:
                if not self.answered:  # a track does not begin with what cannot be used
                    raise
                why = str(error)
            ms = 1e3 * (time.perf_counter() - read)
        if answer is not None:
            if problems:
                answer = replace(answer, notes=(*answer.notes, *problems))
            self._write(one, pace, answer, frame, {"read_ms": 1e3 * (read - begin), "step_ms": ms})
        else:
            self._files.skipped(number, "unreadable", why)
        self._last, self.done = number, one.position + 1
        if answer is not None:
            self.answered, self._answered_frame = self.answered + 1, frame
            if self.answered == 1:  # the first is found by a search: it is not to be made again
                self.save()
        return Step(number, answer, why, problems, len(one.behind), ms, self.done)

    def _write(
        self, one: Next, pace: InTurn, answer: TrackedEstimate, frame: Frame | None, times: dict[str, float]
    ) -> None:
        assert frame is not None
        late = pace.latency(one.due)
        with pace.stopped():
            errors = frame_errors(self._judge, frame, answer)
            if self._photographer is not None:
                shown = self._photographer.take(frame, answer, one.position)
                if shown is not None:
                    self._files.pictured(shown)
        measured = times if late is None else times | {"latency_ms": 1e3 * late}
        self._files.answered(answer, errors, measured, self._scene, self.capture.manifest.object_id)
        _log.info("frame %d: %s, %s in %.0f ms", answer.frame, answer.how, answer.verdict, times["step_ms"])

    def _read(self, number: int) -> tuple[Frame | None, tuple[str, ...]]:
        """The frame, and what is wrong with its files: a later frame is tracked without what is broken.

        A coarse start that was asked for is for the beginning, however many frames it takes; a track goes on by itself.
        """
        if not self.done:
            with reporting(self.capture, refuse):
                return self._prepare(self.capture.frame(number), self.model), ()
        found: list[Problem] = []
        try:
            with reporting(self.capture, found.append):
                frame = self.capture.frame(number)
        except PalpateError as error:
            return None, (str(error),)
        if not self._tracker.begun:
            try:
                frame = self._prepare(frame, self.model)
            except InputError:  # a start for the first frame only: the recording's own is still not what was asked for
                frame = replace(frame, prior=None)
        return frame, tuple(dict.fromkeys(map(str, found)))


def _what_it_shows(frame: Frame) -> str:
    """A digest of what was sensed, wherever the recording lies; start, truth and beliefs may be told anew."""
    bare = replace(frame, where="", hand=None, beliefs=None, prior=None, camera_from_object_truth=None)
    return digest(bare)


def asked_for(
    model: ObjectModel,
    senses: tuple[str, ...],
    prior: str | None,
    seed: int,
    settings: TrackSettings | None,
    beliefs: Beliefs | None,
) -> dict[str, str]:
    """What decides every answer, as words that a checkpoint holds and compares."""
    return {
        "object": f"{model.name} ({digest((model.vertices, model.faces))})",
        "senses": ",".join(senses),
        "prior": "the capture's" if prior is None else prior,
        "seed": str(seed),
        "settings": digest(settings or TrackSettings()),
        "beliefs": digest(beliefs),
    }


def _claim(out: Path) -> int:
    """The handle that keeps other tracks out of the folder as long as it is open."""
    out.mkdir(parents=True, exist_ok=True)
    handle = claimed(out / TIMES)
    if handle is None:
        raise InputError(f"{out}: expected a folder for one track, found one at work: wait for it, or name another")
    return handle


def _clear(out: Path) -> None:
    """Take away what an earlier track has left in the folder."""
    for name in OLD:
        (out / name).unlink(missing_ok=True)
    for pattern in OLD_PICTURES:
        for path in (out / REPORT_FOLDER).glob(pattern):
            path.unlink()
