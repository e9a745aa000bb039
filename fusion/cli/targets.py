"""No command writes over what it reads, nor one of its files over another: found before the work, for all commands.

Light at import: what is heavy is not needed.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from scenes.errors import InputError

# Options that name one file to write, in every command that has them.
FILES = ("json", "output", "plot", "write")
# Arguments that are paths or may be: texts, too, for whoever has a file of that name means it.
TEXTS = ("object", "prior", "camera", "poses")
# Commands whose OUT is a file, or may be one, and those whose OUT has captures or results at any depth.
OUT_IS_FILE = "calibrate-gel"
OUT_IS_EITHER = "convert"
DEEP = ("batch", "convert", "demo", "synth")
# What a folder of results has, and what a folder of a capture has.
RESULTS = ("poses.csv", "result.json", "result.jsonl", "report.html", "grasp.json", "grasp.html")
SUMMARIES = ("results.csv", "results.parquet", "index.html")
CAPTURES = ("capture.json", "scene_camera.json", "rgb_camera.json", "scene_gt.json", "prior.json", "models_info.json")
TABLES = ("joints.csv", "hand_poses.csv", "contacts.csv", "no_contact.csv", "wrenches.csv", "sensors.json")
# Kinds of files that hold what was recorded or modelled, and those of them that an option writes.
DATA = (
    *(".ply", ".obj", ".stl", ".off", ".glb", ".gltf", ".dae", ".urdf", ".xml"),
    *(".png", ".jpg", ".jpeg", ".npy", ".npz", ".csv", ".pcd", ".bag", ".mcap", ".db3"),
)
WRITTEN = {"--output": (".ply",)}
# What a recording that is converted to glb or tum becomes: a file, whatever its name.
FILE_FORMATS = ("glb", "tum")


def check_targets(args: argparse.Namespace) -> None:
    """Raise InputError where a file to write is one that the command reads, lies in a capture that it reads, or is
    another one that it writes. A folder of results may lie in a capture, and files in that folder.
    """
    files = list(_files(args))
    for option, target in files:
        converted = option == "OUT" and args.command == OUT_IS_EITHER  # whose kind it is
        if not converted and _is_data(option, target):
            raise InputError(f"{option}: expected a new file, or an older one of its kind, got {target}, which is data")
    out = None if _is_file(args) else getattr(args, "out", None)
    if not files and args.command != OUT_IS_EITHER:
        return
    inputs = list(_inputs(args))
    if args.command == OUT_IS_EITHER and out is not None and any(_same(out, source) for source in inputs):
        raise InputError(f"OUT: expected another folder than what is read, got {out}")
    for number, (option, target) in enumerate(files):
        for other, earlier in files[:number]:
            if _same(target, earlier):
                raise InputError(f"{option}: expected another file than {other} has, got {target}")
        for source in inputs:
            if _same(target, source):
                raise InputError(f"{option}: expected a file that is not read, got {target}, which the command reads")
        captures = (_capture_of(target, source) for source in inputs if source.is_dir())
        folder = next((found for found in captures if found is not None), None)
        if folder is not None and not _apart(target, out, folder):
            raise InputError(f"{option}: expected a file outside the capture that is read, {folder}, got {target}")
        if out is not None:
            check_apart(option, target, out, args.command in DEEP)


def check_apart(option: str, target: Path | None, out: Path, deep: bool = False) -> None:
    """Raise InputError where the file is one of those that are written into `out`; deep: or into a folder in it."""
    if target is None or target.name not in (*RESULTS, *SUMMARIES, *CAPTURES, *TABLES):
        return
    place, folder = _real(target).parent, _real(out)
    if place == folder or (deep and place.is_relative_to(folder)):
        raise InputError(f"{option}: expected another file than those of results or captures in {out}, got {target}")


def _files(args: argparse.Namespace) -> Iterator[tuple[str, Path]]:
    """The options that name a file to write, and the file; not pipes and devices, which nothing is lost in."""
    for name in FILES:
        path = getattr(args, name, None)
        if isinstance(path, Path) and _ordinary(path):
            yield f"--{name}", path
    if _is_file(args) and _ordinary(args.out):
        yield "OUT", args.out


def _is_data(option: str, target: Path) -> bool:
    """Whether a file to write is there and holds what was recorded or modelled, as its name tells: of a data set, more
    is read than the arguments name.
    """
    data = target.name in (*CAPTURES, *TABLES) or target.suffix.lower() in DATA
    return data and target.suffix.lower() not in WRITTEN.get(option, ()) and target.is_file()


def _is_file(args: argparse.Namespace) -> bool:
    """Whether the command's OUT is a file."""
    out = getattr(args, "out", None)
    if args.command == OUT_IS_FILE or not isinstance(out, Path) or args.command != OUT_IS_EITHER:
        return args.command == OUT_IS_FILE
    return args.to in FILE_FORMATS or (args.to is None and out.suffix != "" and not out.is_dir())


def _ordinary(path: Path) -> bool:
    return path.is_file() or not path.exists()


def _inputs(args: argparse.Namespace) -> Iterator[Path]:
    """Files and folders that are there and the arguments name, with a result's own files and its capture."""
    for name, value in vars(args).items():
        if name in FILES or name == "out":
            continue
        for each in value if isinstance(value, list | tuple) else (value,):
            if isinstance(each, Path) or (name in TEXTS and isinstance(each, str) and each):
                path = Path(each)
                if _is_there(path):
                    yield path
                    yield from _of_result(path)


def _of_result(path: Path) -> Iterator[Path]:
    """What goes with a result that is read: its files, and the capture that it says it is of."""
    folder = path if path.is_dir() else path.parent
    if path.is_dir() and (path / "capture.json").is_file():
        return
    if not path.is_dir() and path.name not in RESULTS:
        return
    yield from (folder / name for name in ("result.json", "result.jsonl", "poses.csv") if (folder / name).is_file())
    result = path if path.suffix == ".json" else folder / "result.json"
    content = None
    with suppress(OSError, ValueError, RecursionError):  # what is wrong with it is told when it is read
        content = json.loads(result.read_text(encoding="utf-8-sig"))
    capture = content.get("capture_path") if isinstance(content, dict) else None
    if isinstance(capture, str) and Path(capture).is_dir():
        yield Path(capture)


def _is_there(path: Path) -> bool:
    try:
        return path.exists()
    except (OSError, ValueError):  # a text that is no path
        return False


def _same(one: Path, other: Path) -> bool:
    if _real(one) == _real(other):
        return True
    try:
        return os.path.samefile(one, other)
    except OSError:
        return False


def _capture_of(target: Path, source: Path) -> Path | None:
    """The capture's folder that has the target: the folder that is read, or one in it; None for neither."""
    place, root = _real(target), _real(source)
    if not place.is_relative_to(root):
        return None
    within = (folder for folder in place.parents if folder.is_relative_to(root))
    return next((folder for folder in within if (folder / "capture.json").is_file()), None)


def _apart(target: Path, out: Path | None, capture: Path) -> bool:
    """Whether the target lies in a folder of results inside the capture."""
    if out is None:
        return False
    folder = _real(out)
    return folder != capture and folder.is_relative_to(capture) and _real(target).is_relative_to(folder)


def _real(path: Path) -> Path:
    return Path(os.path.realpath(path))
