"""What capture.json says of a capture, and the object model that it names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from scenes.errors import CaptureError, InputError
from scenes.files.problems import Problem, Report, refuse
from scenes.geometry.objects import METRES_PER_UNIT, ObjectModel
from scenes.recordings import bop
from scenes.recordings.beliefs import Beliefs
from scenes.recordings.telling import believed
from scenes.recordings.writing import FORMAT, VERSION, WORLDS

# models_info.json and the mesh may be rounded or sampled differently; more than this and a unit is wrong.
LARGEST_DIAMETER_RATIO = 1.5
# What recordings have that are not captures yet: BOP, YCBInEOAT, ROS 2, handover, plain images.
RECORDING_ENDINGS = (".bag", ".mcap", ".db3", ".ini", ".off")
RECORDINGS = ("scene_camera.json", "cam_K.txt", "metadata.yaml", "cloud.off", "depth", "rgb")


@dataclass(frozen=True)
class Manifest:
    """capture.json: object id, model file (inside the folder) and its unit, name; hand files or None; world; notes;
    what it says its sensors are worth, None where it says nothing.
    """

    object_id: int
    model: str
    unit: str
    name: str
    hand: tuple[str, str | None] | None
    world: str
    notes: dict[str, Any]
    beliefs: Beliefs | None = None


def read_model(folder: Path, manifest: Manifest) -> ObjectModel:
    """The capture's object, with the symmetries of models_info.json when there is one beside the mesh.

    Raises PalpateError for a missing or impossible mesh, or one whose size contradicts models_info.json.
    """
    path = folder / manifest.model
    if not path.is_file():
        raise CaptureError(f"{folder / 'capture.json'}: expected the object's mesh at {path}, found none")
    model = ObjectModel.load(path, unit=manifest.unit, name=manifest.name)
    info_path = path.parent / "models_info.json"
    if not info_path.is_file():
        return model
    content = bop.read_json(info_path, refuse)
    info = content.get(str(manifest.object_id)) if isinstance(content, dict) else None
    if not isinstance(info, dict):
        raise CaptureError(f"{info_path}: expected an entry for object {manifest.object_id}, found none")
    try:
        symmetries = bop.symmetries_entry(info)
        stated = float(bop.numbers(info.get("diameter", model.diameter / bop.MM), 1, "diameter")[0]) * bop.MM
    except InputError as error:
        raise CaptureError(f"{info_path}, object {manifest.object_id}: {error}") from error
    if stated <= 0 or max(stated / model.diameter, model.diameter / stated) > LARGEST_DIAMETER_RATIO:
        raise CaptureError(
            f"{path}: expected a diameter of {stated / bop.MM:.4g} mm as models_info.json says, got"
            f" {model.diameter / bop.MM:.4g} mm when its numbers are read as {manifest.unit}: is the unit right?"
        )
    return model.with_symmetries(symmetries)


def recording_hint(folder: Path) -> str:
    """What to say of a folder that is no capture but holds one, or looks like a recording of another format."""
    for depth in ("", "*/", "*/*/"):
        inside = next(iter(sorted(folder.glob(f"{depth}capture.json"))), None)
        if inside is not None:
            return f": a capture in it is {inside.parent}"
        found = next((path for name in RECORDINGS for path in sorted(folder.glob(depth + name))), None)
        if found is not None:
            return f": `palpate convert {found.parent} OUT` may make one of what looks like another format's recording"
    return ""


def read_manifest(folder: Path, report: Report) -> Manifest:
    """What capture.json says; raises CaptureError when there is none, reports each field that is not as it must be."""
    if not folder.is_dir():
        found = "a file" if folder.exists() else "nothing"
        hint = f": `palpate convert {folder} OUT` may make one of it" if folder.suffix in RECORDING_ENDINGS else ""
        raise CaptureError(f"{folder}: expected the folder of a capture, found {found}{hint}")
    path = folder / "capture.json"
    if not path.is_file():
        hint = recording_hint(folder)
        raise CaptureError(f"{folder}: expected a capture (a folder with capture.json), found no capture.json{hint}")
    content = bop.read_json(path, refuse)
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise CaptureError(f'{path}: expected "format": "{FORMAT}", got {str(content)[:60]}')
    if content.get("version") != VERSION or isinstance(content.get("version"), bool):
        raise CaptureError(f"{path}: expected version {VERSION}, got {content.get('version')!r}")

    def checked(good: bool, expected: str, got: Any) -> None:
        if not good:
            report(Problem(str(path), None, f"expected {expected}, got {got!r}"))

    target = content.get("object")
    target = target if isinstance(target, dict) else {}
    model, unit, number = target.get("model"), target.get("unit", "m"), target.get("id", 1)
    checked(isinstance(model, str), '"object" with "id", "model" and "unit"', content.get("object"))
    checked(isinstance(unit, str) and unit in METRES_PER_UNIT, f"a unit of {', '.join(METRES_PER_UNIT)}", unit)
    whole = isinstance(number, int) and not isinstance(number, bool)
    checked(whole, "a whole number as the object's id", number)
    name = target.get("name")
    checked(name is None or isinstance(name, str), "a text as the object's name", name)
    hand = content.get("hand")
    told = hand if isinstance(hand, dict) and isinstance(hand.get("urdf"), str) else None
    checked(hand is None or told is not None, "a hand with a urdf", hand)
    sensors = told.get("sensors") if told is not None else None
    checked(isinstance(sensors, str | None), "the path of a file as the hand's sensors", sensors)
    world = content.get("world", "camera")
    checked(world in WORLDS, f"a world of {' or '.join(WORLDS)}", world)
    files = (told["urdf"], sensors if isinstance(sensors, str) else None) if told is not None else None
    notes = content.get("notes")
    return Manifest(
        number if whole else 1,
        model if isinstance(model, str) else "",
        unit if isinstance(unit, str) and unit in METRES_PER_UNIT else "m",
        str(name or Path(str(model)).stem),
        files,
        world if world in WORLDS else "camera",
        notes if isinstance(notes, dict) else {},
        _beliefs(content, path, report),
    )


def frame_stamps(notes: Mapping[str, Any], frame_ids: Sequence[int]) -> dict[int, int] | None:
    """The notes' `stamps_ns`, the time (ns) of every frame by its number; None where there are none. Those of frames
    that were taken out of a recording are passed over.

    Raises InputError for those that are no whole numbers, leave out a frame, or run backwards.
    """
    noted = notes.get("stamps_ns")
    if noted is None:
        return None
    if not isinstance(noted, dict):
        raise InputError(f"stamps_ns: expected nanoseconds by frame number, got {str(noted)[:60]}")
    for number, stamp in noted.items():
        if not isinstance(stamp, int) or isinstance(stamp, bool):
            raise InputError(f"stamps_ns: expected whole nanoseconds, got {str(stamp)[:60]!r} of frame {number}")
    unstamped = [number for number in frame_ids if str(number) not in noted]
    if unstamped:
        expected = f"expected one of each of {len(frame_ids)} frames"
        raise InputError(f"stamps_ns: {expected}, got {len(noted)}, none of frame {unstamped[0]}")
    stamps = {number: int(noted[str(number)]) for number in frame_ids}
    for before, after in pairwise(frame_ids):
        if stamps[after] < stamps[before]:
            raise InputError(f"stamps_ns: expected times that run forwards, got frame {after} before frame {before}")
    return stamps


def _beliefs(content: dict[str, Any], path: Path, report: Report) -> Beliefs | None:
    if "beliefs" not in content:
        return None
    try:
        return believed(None, [("beliefs", content["beliefs"])])
    except InputError as error:
        report(Problem(str(path), None, str(error)))
        return None
