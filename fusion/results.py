"""The files an estimate leaves: poses.csv in BOP's format and result.json."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fusion.answer import Estimate
from fusion.judging import Errors, Judge, json_number
from fusion.next_touch import next_touches
from scenes.captures import Capture
from scenes.formats.bop import PoseRow, write_json, write_poses
from scenes.frames import Frame
from scenes.objects import ObjectModel

RESULT_VERSION = 1


def frame_errors(judge: Judge, frame: Frame, answer: Estimate) -> Errors | None:
    """Errors of the answer, None without ground truth."""
    truth = frame.camera_from_object_truth
    return None if truth is None else judge.errors(answer.pose, truth, answer.covariance)


def result_json(
    capture: str,
    model: ObjectModel,
    frames: Sequence[Frame],
    answers: Sequence[Estimate],
    errors: Sequence[Errors | None],
) -> dict[str, Any]:
    """The content of result.json; each frame with its own errors, and their medians under "errors" (empty without)."""
    entries = []
    for frame, answer, error in zip(frames, answers, errors, strict=True):
        entry = answer.to_json()
        entry["next_touch"] = [touch.to_json() for touch in next_touches(model, answer, frame)]
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
    number = capture.settings.object_id
    write_poses(
        out / "poses.csv",
        [PoseRow(0, a.frame, number, a.modes[0].weight if a.modes else 0.0, a.pose, a.time_ms / 1e3) for a in answers],
    )
    write_json(out / "result.json", content)
