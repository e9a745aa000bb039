"""Where a track goes on after a stop: the tracker's state, how far it is, and how long its files were by then.

One file, written anew every few seconds and whole at every instant. What stands in the other files beyond what it says
was written after it, and is cut off and made again, bit by bit the same.
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from scenes.errors import InputError
from scenes.files.whole import replace_file

CHECKPOINT = "track.checkpoint"
FORMAT = "palpate-track"
VERSION = 2


@dataclass(frozen=True)
class Checkpoint:
    """asked: what the track was asked for, in words that must be the same again; done: frames dealt with, last: the
    number of the last of them (-1 for none); answered: how many of them have an answer; sizes: bytes of the growing
    files; seen: digests of what the first and the last answered frame show, by number; state: of the tracker.
    """

    asked: dict[str, str]
    done: int
    last: int
    answered: int
    sizes: dict[str, int]
    seen: dict[int, str]
    state: bytes

    def write(self, out: Path) -> None:
        """Into the folder of the track's files."""
        run = {"format": FORMAT, "version": VERSION, "asked": self.asked, "done": self.done, "last": self.last}
        run |= {"answered": self.answered, "sizes": self.sizes, "seen": self.seen}
        arrays = {"run": json.dumps(run).encode(), "state": self.state}
        content = io.BytesIO()
        np.savez(content, allow_pickle=False, **{k: np.frombuffer(v, dtype=np.uint8) for k, v in arrays.items()})
        replace_file(out / CHECKPOINT, content.getvalue())

    @staticmethod
    def read(out: Path) -> Checkpoint | None:
        """Of that folder; None when it has none. Raises InputError for a file that is none."""
        path = out / CHECKPOINT
        if not path.is_file():
            return None
        try:
            with np.load(path, allow_pickle=False) as file:
                run: dict[str, Any] = json.loads(file["run"].tobytes())
                if (run["format"], run["version"]) != (FORMAT, VERSION):
                    raise InputError(
                        f"{path}: expected {FORMAT} version {VERSION}, got {run['format']} {run['version']}"
                    )
                sizes = {str(name): int(size) for name, size in run["sizes"].items()}
                asked = {str(name): str(word) for name, word in run["asked"].items()}
                seen = {int(number): str(sight) for number, sight in run["seen"].items()}
                counts = int(run["done"]), int(run["last"]), int(run["answered"])
                return Checkpoint(asked, *counts, sizes, seen, file["state"].tobytes())
        except (ValueError, KeyError, TypeError, AttributeError, EOFError, OSError, zipfile.BadZipFile) as error:
            raise InputError(f"{path}: expected a track's checkpoint: {error}") from error

    def check(self, out: Path, asked: dict[str, str], frame_ids: tuple[int, ...], sight: Callable[[int], str]) -> None:
        """Raise InputError, naming it, when something else is asked for than the track began with, or of a recording
        that is another one, whatever its folder's name is. sight: the digest of what its frame of that number shows.
        """
        path = out / CHECKPOINT
        for name in sorted(set(asked) | set(self.asked)):
            then, now = self.asked.get(name, "nothing"), asked.get(name, "nothing")
            if then != now:
                raise InputError(f"{path}: expected {name} {then}, as the track began, got {now}")
        if self.done and (len(frame_ids) < self.done or frame_ids[self.done - 1] != self.last):
            expected = f"frame {self.last} as number {self.done} of the capture"
            raise InputError(f"{path}: expected {expected}, as the track had it: it is another recording")
        for number, then in self.seen.items():
            if number not in frame_ids or sight(number) != then:
                expected = f"frame {number} to show what it showed to the track"
                raise InputError(f"{path}: expected {expected}, got other readings: it is another recording")
