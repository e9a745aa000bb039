"""The files an estimate leaves, out and in: poses.csv in BOP's format and result.json."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from fusion.advice.next_touch import NextTouch
from fusion.estimation.answer import ContactResidual, Estimate, Mode, Stage
from fusion.truth.errors import Errors, Judge, json_number
from scenes.errors import InputError
from scenes.files.formats.json_text import parsed
from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel
from scenes.recordings.bop import PoseRow, numbers, write_json, write_poses
from scenes.recordings.captures import Capture
from scenes.recordings.frames import Frame

Array = NDArray[np.float64]
Made = TypeVar("Made")

RESULT_VERSION = 1
VERDICTS = ("ok", "ambiguous", "lost")
# What sums of shares may be above 1 by rounding (no unit).
ROUNDING = 1e-6


def frame_errors(judge: Judge, frame: Frame, answer: Estimate) -> Errors | None:
    """Errors of the answer, None without ground truth."""
    truth = frame.camera_from_object_truth
    return None if truth is None else judge.errors(answer.pose, truth, answer.covariance)


def result_json(
    capture: str,
    model: ObjectModel,
    answers: Sequence[Estimate],
    errors: Sequence[Errors | None],
    touches: Sequence[Sequence[NextTouch]],
) -> dict[str, Any]:
    """The content of result.json; each frame with its own errors, and their medians under "errors" (empty without).

    touches: where one more contact would tell most, of each frame.
    """
    entries = []
    for answer, error, touched in zip(answers, errors, touches, strict=True):
        entry = answer.to_json()
        entry["next_touch"] = [touch.to_json() for touch in touched]
        if error is not None:
            entry["errors"] = error.to_json()
        entries.append(entry)
    known = [error.to_json() for error in errors if error is not None]
    overall: dict[str, Any] = {}
    if known:
        for name in known[0]:
            values = [value for entry in known if (value := entry[name]) is not None]
            overall[f"median_{name}"] = float(np.median(values)) if values else None
        overall["frames_with_truth"] = len(known)
        overall["success_add_s_below_5mm"] = float(np.mean([e.add_s < 0.005 for e in errors if e is not None]))
    return json_number(
        {"version": RESULT_VERSION, "capture": capture, "object": model.name, "frames": entries, "errors": overall}
    )


def write_results(out: Path, capture: Capture, answers: Sequence[Estimate], content: dict[str, Any]) -> None:
    """Write OUT/poses.csv and OUT/result.json; the folder is made when missing."""
    out.mkdir(parents=True, exist_ok=True)
    number, scene = capture.manifest.object_id, capture.manifest.notes.get("scene_id", 0)
    scene = scene if isinstance(scene, int) else 0
    write_poses(
        out / "poses.csv",
        [PoseRow(scene, a.frame, number, score_of(a), a.pose, a.time_ms / 1e3) for a in answers],
    )
    write_json(out / "result.json", content)


def score_of(answer: Estimate) -> float:
    """What poses.csv says an answer is worth, 0 to 1: the weight of its first mode; 0 where the object is lost."""
    return answer.modes[0].weight if answer.modes and answer.verdict != "lost" else 0.0


def find_result(path: str | Path) -> Path | None:
    """The result.json that a path means: the file, or the one in a folder of results; None when it is neither."""
    path = Path(path)
    if path.is_dir() and not (path / "capture.json").is_file():
        path = path / "result.json"
    return path if path.is_file() and path.suffix == ".json" else None


def read_result(path: str | Path) -> tuple[dict[str, Any], list[Estimate]]:
    """The content of a result.json and its answers; raises InputError for a file that is none.

    Modes of a file that does not say their covariances have that of the whole. Of a long track the frames are in a
    file beside it.
    """

    def whole(content: dict[str, Any], entries: Iterable[dict[str, Any]]) -> list[Estimate]:
        answers = [answer_of(entry) for entry in entries]
        _check_whole(content, answers)
        return answers

    return _read(path, whole)


def read_covariances(path: str | Path) -> dict[int, Array]:
    """The covariances (6, 6) of a result.json by frame, of frames that have one, whatever else it lacks; raises
    InputError for a file that is none.
    """

    def spreads(_: dict[str, Any], entries: Iterable[dict[str, Any]]) -> dict[int, Array]:
        told = [(entry["frame"], entry["covariance"]) for entry in entries]
        return {int(frame): _covariance(spread) for frame, spread in told if spread is not None}

    return {frame: spread for frame, spread in _read(path, spreads)[1].items() if np.isfinite(spread).all()}


def _read(
    path: str | Path, make: Callable[[dict[str, Any], Iterable[dict[str, Any]]], Made]
) -> tuple[dict[str, Any], Made]:
    """The content of a result.json, and what is made of it and of its frames' entries."""
    try:
        content = parsed(Path(path).read_text(encoding="utf-8-sig"))
        entries: Iterable[dict[str, Any]] = content["frames"]
        if content.get("frames_file"):
            with (Path(path).parent / content["frames_file"]).open(encoding="utf-8") as file:
                entries = [parsed(line) for line in file]
        made = make(content, entries)
    except OSError as error:
        raise InputError(f"{path}: expected a result.json, it cannot be opened: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: expected UTF-8 text, got other bytes") from error
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        why = f"found no {error}" if isinstance(error, KeyError) else str(error)
        raise InputError(f"{path}: expected a result.json as estimate writes it: {why}") from error
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return content, made


def capture_of(result: Path, content: dict[str, Any], given: Path | None = None) -> Path:
    """The capture that a result was made from: `given`, else where it was, else one of its name around the result.

    Raises InputError when there is none.
    """
    if given is not None:
        return given
    name = str(content.get("capture", ""))
    parents = [Path.cwd(), *list(result.resolve().parents)[:3]]
    around = [folder / part for folder in parents for part in (name, f"captures/{name}", "capture")]
    recorded = [Path(content["capture_path"])] if content.get("capture_path") else []
    for candidate in [*recorded, *around]:
        if (candidate / "capture.json").is_file():
            return candidate
    raise InputError(
        f"{result}: expected its capture {name!r} where it was made or beside it, found none: --capture DIR"
    )


def check_is_of(result: Path, content: dict[str, Any], answers: Sequence[Estimate], capture: Capture) -> None:
    """Raise InputError where the result is of another capture: it lacks a frame of the result, or has another name
    though the result's own is still where it was.
    """
    known = set(capture.frame_ids)
    lost = next((answer.frame for answer in answers if answer.frame not in known), None)
    if lost is not None:
        raise InputError(f"{capture.path}: expected the capture of {result}, got one without its frame {lost}")
    name, was = content.get("capture"), content.get("capture_path")
    own = Path(was) if isinstance(was, str) and (Path(was) / "capture.json").is_file() else None
    # one that has moved may have another name, too
    other = own is not None and own.resolve() != capture.path.resolve()
    if name is not None and name != capture.name and (other or not was):
        raise InputError(f"{capture.path}: expected {name}, the capture of {result}, got {capture.name}")


def _check_whole(content: dict[str, Any], answers: Sequence[Estimate]) -> None:
    """Raise InputError where a frame has two answers, or the capture's name or place is no text."""
    for name in ("capture", "capture_path"):
        if not isinstance(content.get(name), str | None):
            raise InputError(f"{name}: expected a text, got {content[name]!r:.60}")
    seen: set[int] = set()
    for answer in answers:
        if answer.frame in seen:
            raise InputError(f"frames: expected each frame once, got {answer.frame} twice")
        seen.add(answer.frame)


def answer_of(entry: dict[str, Any]) -> Estimate:
    """The answer that an entry of a result says; an InputError, KeyError or ValueError for one that says none."""
    pose = _pose(entry["camera_from_object"], "camera_from_object")
    frame, verdict = entry["frame"], entry["verdict"]
    if not isinstance(frame, int) or isinstance(frame, bool) or frame < 0:
        raise InputError(f"frame: expected a whole number from 0, got {frame!r:.60}")
    if verdict not in VERDICTS:
        raise InputError(f"frame {frame}: verdict: expected one of {', '.join(VERDICTS)}, got {verdict!r:.60}")
    held = entry.get("hand_from_object")
    spread = entry.get("covariance")
    covariance = np.full((6, 6), np.nan) if spread is None else _covariance(spread)
    contacts = tuple(
        ContactResidual(str(c["sensor"]), _number(c["residual_mm"]), _number(c["normal_deg"]), bool(c["outlier"]))
        for c in entry.get("contacts", [])
    )
    modes = tuple(
        Mode(
            _pose(m["pose"], "mode"),
            _share(m["weight"], "weight of a mode"),
            _number(m.get("cost")),
            covariance if m.get("covariance") is None else _covariance(m["covariance"]),
        )
        for m in entry.get("modes", [])
    )
    told = entry.get("confidence")
    confidence = float("nan") if told is None else _share(told, "confidence")
    return Estimate(
        frame=frame,
        pose=pose,
        covariance=covariance,
        modes=modes or (Mode(pose, 1.0, float("nan"), covariance),),  # a file that says none means its pose
        verdict=verdict,
        unobservable=tuple(map(str, entry.get("unobservable", []))),
        hand_from_object=None if held is None else _pose(held, "hand_from_object"),
        visible_fraction=_number(entry.get("visible_fraction")),
        trace=tuple(
            Stage(str(s["stage"]), bool(s["ran"]), str(s["why"]), float(s.get("ms", 0.0)), int(s["rows"]))
            for s in entry.get("trace", [])
        ),
        contacts=contacts,
        notes=tuple(map(str, entry.get("notes", []))),
        confidence=confidence,
        sure_within=1e-3 * _number(entry.get("sure_within_mm")),
        print_share=_number(entry.get("print_share")),
    )


def _pose(rows: Any, what: str) -> NDArray[np.float64]:
    return poses.check_pose(numbers(rows, 16, what).reshape(4, 4), what)


def _covariance(rows: Any) -> NDArray[np.float64]:
    array = np.array([[_number(x) for x in row] for row in rows], dtype=np.float64)
    if array.shape != (6, 6):
        raise InputError(f"covariance: expected 6x6 numbers, got {array.shape}")
    if (np.diag(array) < 0).any():
        raise InputError(f"covariance: expected variances from 0, got {np.diag(array).min():g}")
    return array


def _share(value: Any, what: str) -> float:
    share = float(value)
    if not 0.0 <= share <= 1.0 + ROUNDING:  # NaN is not between them either
        raise InputError(f"{what}: expected a number from 0 to 1, got {value!r:.60}")
    return share


def _number(value: Any) -> float:
    return float("nan") if value is None else float(value)
