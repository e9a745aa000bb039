"""What a capture holds under another name than is read: found when it is validated, for nothing else would tell.

Only what is written like something that is missing is named. Notes, logs and columns of one's own may lie about.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from scenes.files.formats.tables import CsvColumn
from scenes.files.problems import Problem

# Files and folders that are read where they are.
JSON_FILES = ("capture.json", "scene_camera.json", "rgb_camera.json", "scene_gt.json", "prior.json")
# Results may be written beside what they are of, and BOP scenes have a file that nobody here reads.
WRITTEN = ("poses.csv", "result.json", "result.jsonl", "report.html", "scene_gt_info.json")
# Folders of numbered files: how their names end, and how many numbers are in them.
NUMBERED = {"depth": (".png", 1), "rgb": (".png", 1), "clouds": (".ply", 1), "mask_visib": (".png", 2)}
FOLDERS = (*NUMBERED, "models", "tactile")
# Keys of capture.json and of its parts.
KEYS: dict[str, tuple[str, ...]] = {
    "": ("format", "version", "object", "hand", "world", "beliefs", "notes"),
    "object": ("id", "model", "unit", "name"),
    "hand": ("urdf", "sensors"),
}
# Of two names that are meant to be one so much (of 1) is the same: `n_x` and `nx`, `sigma_pt` and `sigma_point`.
ALIKE = 0.75


def strays(
    folder: Path, frame_ids: Sequence[int], content: Any, csv_files: Mapping[str, Sequence[CsvColumn]]
) -> Iterator[Problem]:
    """Files, columns and keys that nobody reads. content: of capture.json; csv_files: columns by name of the file."""
    yield from _names(folder, (*csv_files, *JSON_FILES), FOLDERS)
    for name, (ending, count) in NUMBERED.items():
        if (folder / name).is_dir():
            yield from _numbered(folder / name, ending, count, frozenset(frame_ids))
    for name, columns in csv_files.items():
        if (folder / name).is_file():
            yield from _columns(folder / name, columns)
    for part, known in KEYS.items():
        entries = content if not part else content.get(part) if isinstance(content, dict) else None
        if isinstance(entries, dict):
            for got, meant in _misspelt(entries, known):
                where = f"{part}: " if part else ""
                yield Problem(str(folder / "capture.json"), None, f"{where}expected {meant!r}, got {got!r}")


def _misspelt(names: Iterable[str], known: Iterable[str]) -> Iterator[tuple[str, str]]:
    """Names that are not known, and what is known, is not there and is written alike."""
    names, known = list(names), list(known)
    missing = {name.lower(): name for name in known if name not in names}
    for name in names:
        near = [] if name in known else get_close_matches(name.lower(), missing, n=1, cutoff=ALIKE)
        if near:
            yield name, missing[near[0]]


def _names(folder: Path, files: Sequence[str], folders: Sequence[str]) -> Iterator[Problem]:
    there = sorted(folder.iterdir())
    for kind, known in ((Path.is_file, files), (Path.is_dir, folders)):
        own = [path.name for path in there if kind(path) and path.name not in WRITTEN]
        for got, meant in _misspelt(own, known):
            yield Problem(str(folder / got), None, f"expected {meant}, got {got}: it is not read")


def _numbered(folder: Path, ending: str, count: int, frames: frozenset[int]) -> Iterator[Problem]:
    """Files whose names are not those of a frame's, and of masks those of no frame."""
    shape = re.compile("_".join([r"(\d{6,})"] * count) + re.escape(ending))
    example = "_".join(["000000"] * count) + ending
    for path in sorted(folder.iterdir()):
        found = shape.fullmatch(path.name)
        if found is None and path.suffix.lower() in (ending, ".jpg", ".jpeg", ".tif", ".tiff") and path.name[0] != ".":
            yield Problem(str(path), None, f"expected a name like {example}, got {path.name}: it is not read")
        elif found is not None and int(found[1]) not in frames:
            yield Problem(str(path), int(found[1]), "expected a frame of the capture, which has none of this number")


def spare_masks(folder: Path, rows: Mapping[int, int]) -> Iterator[Problem]:
    """Masks of a row that scene_gt.json has not, frame by frame; rows: how many it has of each frame of the capture."""
    for path in sorted((folder / "mask_visib").glob("*.png")):
        found = re.fullmatch(r"(\d{6,})_(\d{6,})", path.stem)
        count = None if found is None else rows.get(int(found[1]))
        if found is not None and count is not None and int(found[2]) >= max(count, 1):
            expected = f"expected a row of scene_gt.json, which has {count} of this frame"
            yield Problem(str(path), int(found[1]), f"{expected}, got row {int(found[2])}: it is not read")


def masks_of_none(folder: Path, frame_ids: Sequence[int]) -> Iterator[Problem]:
    """Masks of frames that the capture lacks, and files among them that are named otherwise."""
    if (folder / "mask_visib").is_dir():
        yield from _numbered(folder / "mask_visib", *NUMBERED["mask_visib"], frozenset(frame_ids))


def _columns(path: Path, columns: Sequence[CsvColumn]) -> Iterator[Problem]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            header = [name.strip() for name in next(csv.reader(file), [])]
    except (OSError, UnicodeDecodeError, csv.Error):
        return  # reading it tells
    for got, meant in _misspelt(header, [column.name for column in columns]):
        yield Problem(str(path), None, f"expected the column {meant}, got {got}: it is not read")
