"""Many captures: each estimated by a worker process, its results whole or not there: a stopped run goes on.

Written against concurrent.futures.Executor: a pool of processes here, or a dask cluster's executor. Light at import:
the workers set their threads before anything compiled is loaded.
"""

from __future__ import annotations

import hashlib
import json
import os
import signal
import sys
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from scenes.errors import InputError, PalpateError
from scenes.files.whole import draft_folder, put, replace_file

if TYPE_CHECKING:
    from fusion.estimation.settings import EstimateSettings
    from scenes.recordings.telling import Told

# A capture whose worker dies is tried so often.
TRIES = 2
MARKER = "batch.json"
# What else a result has, and what one with a report has, too.
RESULT, REPORT = ("poses.csv", "result.json"), "report.html"
THUMBNAIL = "thumbnail.jpg"
# Status of a frame that no estimate should be made of.
LEFT_OUT = "left out"
# What one thread a worker means, for everything that brings its own.
THREADS = ("PALPATE_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")

Row = dict[str, Any]

# Of a row, in the order of the tables.
COLUMNS = (
    "capture",
    "frame",
    "object",
    "status",
    "verdict",
    "confidence",
    "add_s_mm",
    "rotation_deg",
    "translation_mm",
    "visible_fraction",
    "contacts",
    "modes",
    "time_ms",
    "error",
)


@dataclass(frozen=True)
class Job:
    """One capture: path; name, its path below the batch's folder; out, the folder of its results; and what estimate is
    told. Plain values, to be sent to another process.
    """

    path: str
    name: str
    out: str
    use: tuple[str, ...] = ("vision", "touch")
    prior: str | None = None
    object: str | None = None
    unit: str = "m"
    report: bool = True
    seed: int = 0
    trust_paths: bool = False
    settings: EstimateSettings | None = None
    told: tuple[Told, ...] = ()

    @property
    def fingerprint(self) -> str:
        """Of everything that changes the results; the same for the same question."""
        asked = {key: value for key, value in asdict(self).items() if key not in ("path", "name", "out", "trust_paths")}
        asked["told"] = [table for _, table in self.told]  # not the names of the files that said so
        asked = {key: value for key, value in asked.items() if key not in ("settings", "told") or value}
        asked["read"] = self._read()
        return hashlib.sha256(json.dumps(asked, sort_keys=True).encode()).hexdigest()[:16]

    def _read(self) -> list[tuple[str, int, int]]:
        """Name, size (bytes) and time of change (ns) of all files that it reads: a capture that is another one by now,
        and a mesh or a start that was written anew, ask another question.
        """
        capture, out = os.path.realpath(self.path), os.path.realpath(self.out)
        found = [Path(said) for said in (self.object, self.prior) if said is not None and Path(said).is_file()]
        for place, folders, files in os.walk(capture):
            # results that lie in a capture are not read
            folders[:] = [name for name in folders if os.path.join(place, name) != out and not name.startswith(".")]
            found += [Path(place) / name for name in files]
        read = []
        for path in sorted(found):
            with suppress(OSError):  # gone by now: the estimate says so
                said = path.stat()
                read.append((os.path.relpath(path, capture), said.st_size, said.st_mtime_ns))
        return read


@dataclass(frozen=True)
class Outcome:
    """What became of a job: rows, one a frame, or one that says what went wrong; status "done", "kept" (from an earlier
    run) or "error". Of its rows those of frames that could not be used have the status "left out".
    """

    job: Job
    status: str
    rows: list[Row]

    @property
    def answers(self) -> list[Row]:
        """The rows that have an answer."""
        return [row for row in self.rows if row["status"] == "done"]

    @property
    def left_out(self) -> list[Row]:
        """The rows of frames that could not be used."""
        return [row for row in self.rows if row["status"] == LEFT_OUT]


def find_captures(folder: Path) -> list[Path]:
    """The captures below a folder, sorted, links followed, each place once; a capture's own folders and hidden ones are
    not looked into.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: expected a folder of captures, found {'a file' if folder.exists() else 'nothing'}")
    found = []
    been: set[str] = set()
    for place, folders, files in os.walk(folder, followlinks=True):
        real = os.path.realpath(place)
        if real in been:  # links may lead in circles
            folders.clear()
            continue
        been.add(real)
        if "capture.json" in files:
            found.append(Path(place))
            folders.clear()
        folders[:] = sorted(name for name in folders if not name.startswith("."))
    if not found:
        from scenes.recordings.manifest import recording_hint

        hint = recording_hint(folder)
        raise InputError(f"{folder}: expected captures (folders with capture.json) in it, found none{hint}")
    return sorted(found)


def finished(job: Job) -> list[Row] | None:
    """The rows of a capture that was done before by the same question, None when it was not."""
    try:
        content = json.loads((Path(job.out) / MARKER).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    if not isinstance(content, dict) or content.get("fingerprint") != job.fingerprint:
        return None
    rows, wanted = content.get("rows"), (*RESULT, REPORT) if job.report else RESULT
    whole = isinstance(rows, list) and all(isinstance(row, dict) for row in rows)
    return rows if whole and all((Path(job.out) / name).is_file() for name in wanted) else None


def run_capture(job: Job) -> list[Row]:
    """Estimate every frame of a capture and write its results: a folder that appears whole. In a worker process."""
    one_thread()
    from fusion.advice.next_touch import next_touches
    from fusion.results.files import frame_errors, result_json, write_results
    from fusion.results.runs import estimates, frame_setter, load_object
    from fusion.truth.errors import Judge, json_number
    from scenes.recordings.captures import read_capture

    capture = read_capture(job.path, job.trust_paths)
    model = load_object(job.object, job.unit) if job.object else capture.model
    prepare, judge = frame_setter(job.prior, job.seed, job.told), Judge.of(model)
    frames, answers, errors = [], [], []
    left_out: dict[int, str] = {}
    asked = capture, capture.frame_ids, model, prepare, job.use, job.seed
    for frame, answer in estimates(*asked, settings=job.settings, leave_out=left_out.__setitem__):
        frames.append(frame)
        answers.append(answer)
        errors.append(frame_errors(judge, frame, answer))
    out = Path(job.out)
    with draft_folder(out) as draft:
        touches = [next_touches(model, answer, frame) for frame, answer in zip(frames, answers)]
        content = result_json(capture.name, model, answers, errors, touches)
        content["capture_path"] = str(capture.path.resolve())
        if left_out:
            content["left_out"] = [{"frame": number, "why": why} for number, why in left_out.items()]
        write_results(draft, capture, answers, content)
        if job.report:
            from fusion.results.report.page import write_report
            from fusion.results.report.stills import write_thumbnail

            write_thumbnail(draft / THUMBNAIL, frames, model, answers)
            page = draft / REPORT
            write_report(page, capture.name, frames, model, answers, None, content["errors"], touches=touches)
        told = [_row(job, model.name, answer, error) for answer, error in zip(answers, errors)]
        told += [left_out_row(job, number, why) for number, why in left_out.items()]
        rows = json_number(sorted(told, key=lambda row: row["frame"]))
        marker = {"fingerprint": job.fingerprint, "rows": rows}
        replace_file(draft / MARKER, (json.dumps(marker, indent=1, allow_nan=False) + "\n").encode())
        _replace(draft, out)
    return list(rows)


def _replace(draft: Path, out: Path) -> None:
    """Put the draft in the place of an older result, if there is one; refuse a folder that is no result of a batch."""
    if out.exists() and any(out.iterdir()) and not (out / MARKER).is_file():
        raise InputError(f"{out}: expected a new folder, or older results of a batch: it holds other files")
    put(draft, out)


def _row(job: Job, name: str, answer: Any, error: Any) -> Row:
    told = {} if error is None else error.to_json()
    row: Row = dict.fromkeys(COLUMNS)
    row |= {"capture": job.name, "frame": answer.frame, "object": name, "status": "done", "verdict": answer.verdict}
    row |= {key: told.get(key) for key in ("add_s_mm", "rotation_deg", "translation_mm")}
    row |= {"confidence": answer.confidence, "visible_fraction": answer.visible_fraction, "time_ms": answer.time_ms}
    return row | {"contacts": len(answer.contacts), "modes": len(answer.modes)}


def error_row(job: Job, message: str) -> Row:
    """The row of a capture that gave no result."""
    return dict.fromkeys(COLUMNS) | {"capture": job.name, "status": "error", "error": " ".join(message.split())}


def left_out_row(job: Job, number: int, why: str) -> Row:
    """The row of a frame that could not be used."""
    return error_row(job, why) | {"frame": number, "status": LEFT_OUT}


# ---- workers


def one_thread() -> None:
    """One thread for everything this process computes with: there are as many processes as cores."""
    for name in THREADS:
        os.environ.setdefault(name, "1")


def start_worker() -> None:
    """In a new worker: one thread, Ctrl-C left to the parent, and no life after the parent's."""
    for name in THREADS:
        os.environ[name] = "1"
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform == "linux":
        import ctypes

        # PR_SET_PDEATHSIG: a parent that is killed outright cannot tell its workers
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(1, signal.SIGTERM)


@contextmanager
def interrupt_held() -> Iterator[None]:
    """Ctrl-C waits until the end. A worker that starts meanwhile inherits that and never hears it: what it imports
    before `start_worker` would end in a traceback of its own.
    """
    held = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, held)


class Backend(Protocol):
    """Where the work is done. workers: jobs that are handed out at a time."""

    workers: int

    def start(self) -> Executor:
        """A fresh executor."""
        ...

    def stop(self, executor: Executor) -> None:
        """End its work now, whatever is running."""
        ...


class Processes:
    """Worker processes on this machine, started afresh: no threads or locks of the parent in them."""

    def __init__(self, workers: int) -> None:
        """How many."""
        self.workers = workers

    def start(self) -> Executor:
        """A fresh pool."""
        from concurrent.futures import ProcessPoolExecutor
        from multiprocessing import get_context

        return ProcessPoolExecutor(self.workers, mp_context=get_context("spawn"), initializer=start_worker)

    def stop(self, executor: Executor) -> None:
        """End the pool's processes now; none is left behind."""
        import multiprocessing

        executor.shutdown(wait=False, cancel_futures=True)
        children = multiprocessing.active_children()
        for child in children:
            child.terminate()
        for child in children:
            child.join(5.0)
            if child.is_alive():
                child.kill()


class Cluster:
    """A running dask cluster, which tries a job elsewhere when its worker dies. Its workers see the same files."""

    def __init__(self, address: str, patience: float = 10.0) -> None:
        """Connect within `patience` seconds; raises InputError without the package or without a scheduler there."""
        try:
            from distributed import Client
        except ImportError as error:
            message = "a scheduler needs dask.distributed, which is not installed: pip install 'palpate[cluster]'"
            raise InputError(message) from error
        try:
            self._client = Client(address, timeout=patience, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise InputError(f"scheduler: expected one at {address}, none answers: {error}") from error
        self.workers = 2 * max(1, sum(self._client.ncores().values()))

    def start(self) -> Executor:
        """The cluster's executor."""
        executor: Executor = self._client.get_executor(pure=False, retries=TRIES - 1)
        return executor

    def stop(self, executor: Executor) -> None:
        """Take back what waits; the cluster itself goes on."""
        executor.shutdown(wait=False)

    def close(self) -> None:
        """Leave the cluster."""
        self._client.close()


def run_jobs(
    jobs: Sequence[Job],
    backend: Backend,
    work: Callable[[Job], list[Row]] = run_capture,
) -> Iterator[Outcome]:
    """Outcomes as they come. What a job raises is its own row; a worker that dies takes nothing else with it.

    No more jobs are handed out than there are workers, so that a broken pool tells whom to suspect; suspects are tried
    alone, and one whose worker dies `TRIES` times is a row.
    """
    waiting, suspects = deque(jobs), deque[Job]()
    deaths: dict[str, int] = {}
    executor: Executor | None = None
    running: dict[Future[list[Row]], Job] = {}
    try:
        while waiting or suspects or running:
            alone = bool(suspects) and not running
            queue = suspects if alone else (deque() if suspects else waiting)
            executor = executor or backend.start()
            broken = False
            while queue and len(running) < (1 if alone else backend.workers):
                job = queue.popleft()
                try:
                    with interrupt_held():
                        running[executor.submit(work, job)] = job
                except BrokenExecutor:
                    queue.appendleft(job)  # it never began
                    broken = True
                    break
            ended = wait(running, return_when=FIRST_COMPLETED).done if running else set()
            # whoever ended well before the pool broke has an answer; the others are asked again
            for future in ended:
                job = running.pop(future)
                error = future.exception()
                if isinstance(error, BrokenExecutor):
                    broken = True
                    deaths[job.name] = deaths.get(job.name, 0) + 1
                    # beside others it may have been another's fault: only deaths alone are counted to the end
                    if alone and deaths[job.name] >= TRIES:
                        yield Outcome(job, "error", [error_row(job, "the worker process died, twice")])
                    else:
                        suspects.append(job)
                elif error is not None:
                    yield Outcome(job, "error", [error_row(job, _words(error))])
                else:
                    yield Outcome(job, "done", future.result())
            if broken and not running:
                backend.stop(executor)
                executor = None
    except BaseException:
        if executor is not None:
            backend.stop(executor)
            executor = None
        raise
    finally:
        if executor is not None:
            executor.shutdown()


def _words(error: BaseException) -> str:
    return str(error) if isinstance(error, PalpateError) else f"{type(error).__name__}: {error}"
