"""Contact sets as the tacman repositories keep them: an `.ini` that names a mesh and measurements, both `.off`, metres.

Vezzani, Pattacini, Battistelli, Chisci, Natale, Memory Unscented Particle Filter for 6-DOF tactile localization, IEEE
TRO 2017. Lines are `key value` as YARP's ResourceFinder reads them. `measurementsFile` holds contacts, or a cloud where
`fingersFile` holds the contacts; `modelFile` the mesh, or `modelFile0`, `modelFile1`, … the candidates.
"""

from __future__ import annotations

import re
from pathlib import Path

from scenes.errors import CaptureError, InputError
from scenes.files.formats.off import read_off
from scenes.formats.conversion import Converted, Dropped, many_contacts
from scenes.geometry.objects import ObjectModel
from scenes.recordings.captures import write_capture
from scenes.recordings.frames import Contacts, Frame

# The files are named as seen from the folder where the programs ran: so many folders up they are looked for.
LEVELS_UP = 3


def read_ini(path: Path) -> dict[str, str]:
    """The keys and values of the file, sections and comments left out; raises CaptureError when it is not text."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise CaptureError(f"{path}: expected a text file of keys and values, it cannot be read") from error
    lines = (re.split(r"#|//", line, maxsplit=1)[0].strip() for line in text.splitlines())
    pairs = (line.split(None, 1) for line in lines if line and not line.startswith("["))
    return {pair[0]: pair[1].strip() if len(pair) > 1 else "" for pair in pairs}


def is_set(path: str | Path) -> bool:
    """True for an .ini file that names measurements."""
    path = Path(path)
    return path.suffix.lower() == ".ini" and path.is_file() and "measurementsFile" in read_ini(path)


def convert(path: Path, out: Path, model: ObjectModel | None = None, object_id: int | None = None) -> Converted:
    """Write the set as a capture of one frame (world: robot base); measurements beyond numMeas are dropped and counted.

    model: instead of the file's; object_id: which of several modelFileN. Raises PalpateError for files that are missing
    or broken and for several models without a choice.
    """
    settings = read_ini(path)
    if "measurementsFile" not in settings:
        raise CaptureError(f"{path}: expected measurementsFile, got {', '.join(list(settings)[:6]) or 'nothing'}")
    model = model or _model(path, settings, object_id)
    measured = read_off(_find(path, settings["measurementsFile"]))
    cloud = colours = None
    if "fingersFile" in settings:
        cloud, colours = measured.points, measured.colours
        measured = read_off(_find(path, settings["fingersFile"]))
    dropped = Dropped()
    felt = Contacts(measured.points, measured.normals)
    if cloud is None and settings.get("numMeas", "").isdecimal():
        most = int(settings["numMeas"])
        dropped.add("contacts", f"beyond numMeas {most}", max(0, len(felt) - most))
        felt = felt.take(range(min(most, len(felt))))
    remarks = _doubts(path, settings, len(felt))
    frame = Frame(index=0, where=str(path), cloud=cloud, cloud_colours=colours, contacts=felt)
    notes = {"source": "tacman", "settings": settings}
    return Converted((write_capture(out, [frame], model, world="robot base", notes=notes),), 1, dropped, remarks)


def _doubts(path: Path, settings: dict[str, str], felt: int) -> tuple[str, ...]:
    """Sentences for contacts that look like the points of a cloud: the same file twice, or too many for fingers."""
    named, measured = settings.get("fingersFile"), settings["measurementsFile"]
    if named is None:
        hint = "; a cloud needs a fingersFile beside it that names the contacts"
        return many_contacts(f"{path}: {measured}", felt, hint)
    if _find(path, named).resolve() == _find(path, measured).resolve():
        return (
            f"warning: {path}: fingersFile and measurementsFile are both {named}: its points are cloud and contacts",
        )
    return many_contacts(f"{path}: {named}", felt)


def convert_contacts(contacts: Contacts, out: Path, model: ObjectModel, where: str) -> Converted:
    """A list of contacts as a capture of one frame (world: robot base)."""
    frame = Frame(index=0, where=where, contacts=contacts)
    written = write_capture(out, [frame], model, world="robot base", notes={"source": "contacts"})
    return Converted((written,), 1, remarks=many_contacts(where, len(contacts)))


def _model(path: Path, settings: dict[str, str], object_id: int | None) -> ObjectModel:
    named = {key: value for key, value in settings.items() if re.fullmatch(r"modelFile\d*", key)}
    if object_id is not None:
        named = {key: value for key, value in named.items() if key == f"modelFile{object_id}"}
    if len(named) != 1:
        got = ", ".join(named) or "none"
        raise InputError(f"{path}: expected one modelFile, got {got}: choose with --object-id, or say --object MESH")
    return ObjectModel.load(_find(path, next(iter(named.values()))))


def _find(path: Path, name: str) -> Path:
    """The file that the .ini names, seen from its folder or, without leading `..`, from one of those above it."""
    beside = path.parent / name
    if beside.is_file():
        return beside
    inside = Path(*[part for part in Path(name).parts if part != ".."])
    for folder in [path.resolve().parent, *path.resolve().parents][: LEVELS_UP + 1]:
        if (folder / inside).is_file():
            return folder / inside
    raise CaptureError(f"{path}: expected the file {name} that it names, found none")
