"""A whole track in numbers, from the files it has left: read line by line, one row of numbers a frame is kept."""

from __future__ import annotations

import json
from array import array
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion.results.files import RESULT_VERSION
from fusion.results.report.words import worst_sigmas
from fusion.results.track.files import FRAMES, POSES, TIMES, lines
from fusion.truth.errors import json_number
from scenes.files.whole import replace_file
from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel

Array = NDArray[np.float64]

# A result.json of at most so many frames has them all, as that of an estimate has; a longer track's are in result.jsonl
# only: a reader of JSON holds some 30 KB of memory a frame.
MOST_IN_RESULT = 1000
# Spans of frames (slips, losses, left out) that are listed; all are counted.
MOST_SPANS = 200
PERCENTILES = (50, 90, 99)
ERRORS = ("add_mm", "add_s_mm", "rotation_deg", "translation_mm", "nees")
SUCCESS_MM = 5.0


@dataclass(frozen=True)
class Columns:
    """One row a frame that has an answer, in the order of the track, unless said otherwise.

    frame; verdict and how, words; slip, moved; statistic of slip; position (n, 3) m of the object's centroid, camera
    frame; turn (n, 3) rad from the first frame's orientation; held (n, 6) the same two in the hand (turn, position),
    NaN without; sigma (n, 2) worst directions, rad and m; confidence; missing: names of the stages that had nothing to
    work on, comma-separated; errors by name (n,), NaN without truth; step and latency (n,) ms, NaN where not measured;
    skipped: (frame, cause, why) of every frame without an answer.
    """

    frame: NDArray[np.int64]
    verdict: list[str]
    how: list[str]
    slip: NDArray[np.bool_]
    moved: NDArray[np.bool_]
    statistic: Array
    position: Array
    turn: Array
    held: Array
    sigma: Array
    confidence: Array
    missing: list[str]
    errors: dict[str, Array]
    step: Array
    latency: Array
    skipped: list[tuple[int, str, str]]

    def __len__(self) -> int:
        return len(self.frame)


def read_columns(out: Path, model: ObjectModel) -> Columns:
    """The columns of the track in that folder. Raises InputError for files that are none of a track."""
    numbers = array("d")  # of an hour 20 MB, where lists would be 110
    verdict: list[str] = []
    how: list[str] = []
    missing: list[str] = []
    first: list[Array | None] = [None, None]
    words: dict[str, str] = {}  # a handful of words, not one a frame
    for entry in lines(out / FRAMES):
        said = entry["tracking"]
        pose, held = _matrix(entry["camera_from_object"]), _matrix(entry["hand_from_object"])
        placed = [_placed(model, part, first, i) for i, part in enumerate((pose, held))]
        sigma = worst_sigmas(_array(entry["covariance"], (6, 6)))
        errors = entry.get("errors") or {}
        said_of: tuple[float, ...] = (
            entry["frame"],
            said["slip"],
            said["moved_in_hand"],
            _number(said["slip_statistic"]),
        )
        said_of += (*placed[0], *placed[1], *sigma, _number(entry.get("confidence")))
        numbers.extend((*said_of, *(_number(errors.get(name)) for name in ERRORS)))
        gone = ",".join(stage["stage"] for stage in entry["trace"] if not stage["ran"])
        for kept, word in ((verdict, entry["verdict"]), (how, said["how"]), (missing, gone)):
            kept.append(words.setdefault(word, word))
    table = np.frombuffer(numbers, dtype=np.float64).reshape(-1, 19 + len(ERRORS))
    step, latency = np.full((2, len(table)), np.nan)
    skipped = []
    row = 0
    for entry in lines(out / TIMES):  # the same frames in the same order, and those left out
        if "skipped" in entry:
            skipped.append((int(entry["frame"]), str(entry["skipped"]), str(entry["why"])))
        elif row < len(table):
            step[row], latency[row] = _number(entry.get("step_ms")), _number(entry.get("latency_ms"))
            row += 1
    return Columns(
        frame=table[:, 0].astype(np.int64),
        verdict=verdict,
        how=how,
        slip=table[:, 1] > 0,
        moved=table[:, 2] > 0,
        statistic=table[:, 3],
        turn=table[:, 4:7],
        position=table[:, 7:10],
        held=table[:, 10:16],
        sigma=table[:, 16:18],
        confidence=table[:, 18],
        missing=missing,
        errors={name: table[:, 19 + i] for i, name in enumerate(ERRORS)},
        step=step,
        latency=latency,
        skipped=skipped,
    )


def summary(columns: Columns, recorded: int, hertz: float | None, complete: bool) -> dict[str, Any]:
    """What result.json says of the track as a whole. recorded: frames of the recording."""
    causes = Counter(cause for _, cause, _ in columns.skipped)
    lost = [verdict == "lost" for verdict in columns.verdict]
    return {
        "complete": complete,
        "frames_recorded": recorded,
        "frames_answered": len(columns),
        "frames_skipped": {cause: causes[cause] for cause in ("behind", "unreadable")},
        "how": dict(Counter(columns.how)),
        "verdicts": dict(Counter(columns.verdict)),
        "slips": _spans(columns.frame, columns.slip),
        "losses": _spans(columns.frame, lost),
        "hertz": hertz,
        "step_ms": percentiles(columns.step),
        "latency_ms": percentiles(columns.latency),
        "files": {"poses": POSES, "frames": FRAMES, "times": TIMES},
    }


def percentiles(values: Array) -> dict[str, float | None]:
    """p50, p90, p99 and the largest of those that are known; None for none."""
    known = values[np.isfinite(values)]
    named = {f"p{p}": float(np.percentile(known, p)) if len(known) else None for p in PERCENTILES}
    return named | {"max": float(known.max()) if len(known) else None}


def spans(flags: Sequence[bool] | NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and last row of every run of true ones."""
    padded = np.concatenate([[False], np.asarray(flags, dtype=bool), [False]])
    edges = np.flatnonzero(padded[1:] != padded[:-1])
    return [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2])]


def _spans(frames: NDArray[np.int64], flags: Sequence[bool] | NDArray[np.bool_]) -> dict[str, Any]:
    found = spans(flags)
    return {"count": len(found), "spans": [[int(frames[a]), int(frames[b])] for a, b in found[:MOST_SPANS]]}


def overall_errors(columns: Columns) -> dict[str, Any]:
    """The "errors" of result.json: medians over the frames whose truth is known; empty without any."""
    known = columns.errors["add_s_mm"][np.isfinite(columns.errors["add_s_mm"])]
    if not len(known):
        return {}
    out: dict[str, Any] = {}
    for name, values in columns.errors.items():
        finite = values[np.isfinite(values)]
        out[f"median_{name}"] = float(np.median(finite)) if len(finite) else None
    return out | {"frames_with_truth": len(known), "success_add_s_below_5mm": float(np.mean(known < SUCCESS_MM))}


def timed_entries(out: Path) -> Iterator[dict[str, Any]]:
    """The frames' entries as result.json has them: those of result.jsonl with the times that were measured."""
    times = (entry for entry in lines(out / TIMES) if "skipped" not in entry)
    for entry, timed in zip(lines(out / FRAMES), times):
        entry["time_ms"] = float(sum(timed["stages_ms"]))
        for stage, ms in zip(entry["trace"], timed["stages_ms"]):
            stage["ms"] = ms
        yield entry


def write_result(
    path: Path, out: Path, head: dict[str, Any], columns: Columns, last: dict[str, Any], next_touch: list[Any]
) -> None:
    """Write a result.json: head, errors and the track's summary `last`, and the frames (of a long track, where they
    are). next_touch: of the last frame, where the object is now.
    """
    content = {"version": RESULT_VERSION, **head, "errors": overall_errors(columns), "track": last, "frames": []}
    if len(columns) > MOST_IN_RESULT:
        own = path.parent.resolve() == out.resolve()
        content["frames_file"] = FRAMES if own else str((out / FRAMES).resolve())
    else:
        content["frames"] = list(timed_entries(out))
        if content["frames"]:
            content["frames"][-1]["next_touch"] = next_touch
    replace_file(path, (json.dumps(json_number(content), indent=1, allow_nan=False) + "\n").encode())


def _placed(model: ObjectModel, pose: Array | None, first: list[Array | None], which: int) -> list[float]:
    """Turn (rad) from the first such pose and the centroid's place (m); NaN without a pose."""
    if pose is None or not np.isfinite(pose).all():
        return [float("nan")] * 6
    start = first[which]
    if start is None:
        start = first[which] = pose
    turn = poses.log_rotation(pose[:3, :3] @ start[:3, :3].T)
    return [*map(float, turn), *map(float, poses.apply(pose, model.centroid[None])[0])]


def _matrix(rows: Any) -> Array | None:
    return None if rows is None else _array(rows, (4, 4))


def _array(rows: Any, shape: tuple[int, int]) -> Array:
    found = np.array([[_number(x) for x in row] for row in rows or []], dtype=np.float64)
    return found if found.shape == shape else np.full(shape, np.nan)


def _number(value: Any) -> float:
    return float("nan") if value is None else float(value)
