"""The files that grow while a track runs: poses.csv, result.jsonl, times.jsonl and the list of the report's pictures.

Every frame is one whole line of each, handed to the system at once: whoever reads along, or looks after a crash, finds
whole lines. poses.csv and result.jsonl hold what follows from the recording and the seed alone, so the same track has
the same bytes, however often it was stopped; what was measured by a clock is in times.jsonl.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fusion.results.files import score_of
from fusion.tracking.answer import TrackedEstimate
from fusion.truth.errors import Errors, json_number
from scenes.errors import InputError
from scenes.files.whole import named
from scenes.recordings.bop import POSES_HEADER, PoseRow, pose_lines

POSES, FRAMES, TIMES = "poses.csv", "result.jsonl", "times.jsonl"
# The report's pictures are beside the page, with a line each of what they show.
REPORT_FOLDER = "report"
PICTURES = f"{REPORT_FOLDER}/pictures.jsonl"
# BOP: the time of an image is not known. It is in times.jsonl.
UNTIMED = -1.0


class GrowingFiles:
    """The files of one track, open for appending."""

    def __init__(self, out: Path, sizes: dict[str, int] | None = None, pictures: bool = False) -> None:
        """New and empty ones, or with `sizes` (bytes by name) those that are there, cut back to these; pictures:
        whether there will be any.

        Raises OSError where they cannot be written, InputError when one is shorter than it was.
        """
        self.out = out
        (out / REPORT_FOLDER if pictures else out).mkdir(parents=True, exist_ok=True)
        self._files: dict[str, int] = {}
        for name in (POSES, FRAMES, TIMES, *((PICTURES,) if pictures else ())):
            path = out / name
            with named(path):
                there = path.stat().st_size if path.exists() else 0
                if sizes is not None and there < sizes.get(name, 0):
                    self.close()
                    raise InputError(
                        f"{path}: expected the {sizes[name]} bytes that the track had written, got {there}"
                    )
                self._files[name] = os.open(path, os.O_WRONLY | os.O_CREAT, 0o644)
                os.ftruncate(self._files[name], 0 if sizes is None else sizes.get(name, 0))
                os.lseek(self._files[name], 0, os.SEEK_END)
        if sizes is None:
            self._append(POSES, f"{','.join(POSES_HEADER)}\n")

    def answered(
        self, answer: TrackedEstimate, errors: Errors | None, times: dict[str, float], scene: int, object_id: int
    ) -> None:
        """A frame's answer; times: milliseconds by name. scene, object_id: BOP's numbers."""
        row = PoseRow(scene, answer.frame, object_id, score_of(answer), answer.pose, UNTIMED)
        self._append(POSES, pose_lines([row]))
        entry = answer.to_json() | ({} if errors is None else {"errors": errors.to_json()})
        entry.pop("time_ms")
        stages = [stage.pop("ms") for stage in entry["trace"]]
        self._line(FRAMES, entry)
        rounded = {name: round(value, 4) for name, value in times.items()}
        self._line(TIMES, {"frame": answer.frame, **rounded, "stages_ms": [round(ms, 4) for ms in stages]})

    def skipped(self, frame: int, cause: str, why: str) -> None:
        """A frame without an answer. cause: "behind" or "unreadable"."""
        self._line(TIMES, {"frame": frame, "skipped": cause, "why": why})

    def pictured(self, entry: dict[str, Any]) -> None:
        """What the picture of a frame shows."""
        self._line(PICTURES, entry)

    def sizes(self) -> dict[str, int]:
        """Bytes of each file, safe from a power cut when this returns."""
        for handle in self._files.values():
            os.fsync(handle)
        return {name: os.fstat(handle).st_size for name, handle in self._files.items()}

    def close(self) -> None:
        """Close what is open."""
        while self._files:
            os.close(self._files.popitem()[1])

    def _line(self, name: str, entry: dict[str, Any]) -> None:
        self._append(name, json.dumps(json_number(entry), allow_nan=False, separators=(",", ":")) + "\n")

    def _append(self, name: str, text: str) -> None:
        content = text.encode()
        with named(self.out / name):
            while content:  # a full disk takes a part and refuses the rest
                content = content[os.write(self._files[name], content) :]


def lines(path: Path) -> Iterator[dict[str, Any]]:
    """The entries of a .jsonl, one by one; raises InputError with the line of what is none. Nothing without a file."""
    if not path.is_file():
        return
    with path.open("rb") as file:
        for number, line in enumerate(file, 1):
            try:
                entry = json.loads(line)
            except ValueError as error:
                raise InputError(f"{path}, line {number}: expected JSON: {error}") from error
            if not isinstance(entry, dict) or "frame" not in entry:
                raise InputError(f"{path}, line {number}: expected an entry with its frame")
            yield entry
