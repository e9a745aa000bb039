"""Lists of points and meshes as files that become one another: .off, .ply, and contacts as .csv, in their own unit."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from fusion.cli.options import check_target

if TYPE_CHECKING:
    from scenes.files.formats.off import OffData
    from scenes.formats.conversion import Converted, Dropped

ENDINGS = (".off", ".ply", ".csv")


def convert_list(source: Path, out: Path, frame: int | None = None) -> Converted:
    """Write the list as the ending of `out` says; what that has no place for is dropped and counted. Contacts of a .csv
    stay in a .csv as they are, of any number of frames; frame: which of them, default the only one, or all.

    Raises PalpateError for other endings, broken files, and a .csv of several frames that becomes a list of points.
    """
    from scenes.errors import InputError
    from scenes.files.formats.off import write_off
    from scenes.files.formats.ply import ply_content
    from scenes.files.whole import replace_file
    from scenes.formats.conversion import Converted, Dropped

    kinds = (source.suffix.lower(), out.suffix.lower())
    if kinds[0] not in ENDINGS or kinds[1] not in ENDINGS:
        raise InputError(f"convert: expected files ending in {', '.join(ENDINGS)}, got {source.name} to {out.name}")
    if frame is not None and kinds[0] != ".csv":
        raise InputError(f"--frame: expected contacts as .csv, which have frames, got {source}")
    check_target(out)
    dropped = Dropped()
    if kinds == (".csv", ".csv"):
        _write_rows(source, out, frame)
        return Converted((out,))
    data = _read(source, frame, dropped)
    if kinds[1] == ".off":
        write_off(out, data.points, data.faces, data.colours, data.normals)
    elif kinds[1] == ".ply":
        dropped.add("normals", "a list of points as PLY has none", 0 if data.normals is None else len(data.normals))
        replace_file(out, ply_content(out, data.points, data.faces if len(data.faces) else None, data.colours))
    else:
        dropped.add("faces", "contacts have none", len(data.faces))
        dropped.add("colours", "contacts have none", 0 if data.colours is None else len(data.colours))
        _write_contacts(out, data)
    return Converted((out,), dropped=dropped)


def _read(source: Path, frame: int | None, dropped: Dropped) -> OffData:
    from scenes.files.formats.off import OffData, read_off
    from scenes.files.formats.ply import read_cloud
    from scenes.files.formats.tables import NO_FACES

    if source.suffix.lower() == ".off":
        return read_off(source)
    if source.suffix.lower() == ".csv":
        return _read_contacts(source, frame, dropped)
    points, colours = read_cloud(source)
    faces = _faces(source)
    return OffData(points, NO_FACES if faces is None else faces, colours)


def _read_contacts(source: Path, frame: int | None, dropped: Dropped) -> OffData:
    """Points of contacts, with their normals where all have one; what else is said of them is counted as dropped."""
    import numpy as np

    from fusion.cli.commands.answers.localize import read_contacts
    from scenes.files.formats import tables
    from scenes.files.formats.off import OffData
    from scenes.files.problems import refuse

    felt = read_contacts(source, frame)
    rows = tables.read_table(source, tables.LOOSE_CONTACTS, refuse)
    rows = rows if frame is None else rows.of_frame(frame)
    known = int(felt.has_normal.sum())
    if known < len(felt):
        dropped.add("normals", f"{len(felt) - known} of {len(felt)} contacts have none, and points all or none", known)
    for what, names in (("sigmas", ("sigma_point", "sigma_normal")), ("forces", ("fx", "fy", "fz"))):
        said = np.isfinite(rows.stack(*names)).any(axis=1)
        dropped.add(what, "lists of points have no place for them", int(said.sum()))
    dropped.add("names of sensors", "lists of points have no place for them", sum(map(bool, rows.texts["sensor"])))
    return OffData(felt.points, tables.NO_FACES, None, felt.normals if known == len(felt) else None)


def _write_rows(source: Path, out: Path, frame: int | None) -> None:
    """Contacts to contacts: every row with all that is said of it, or every one of that frame."""
    import numpy as np

    from scenes.errors import CaptureError, InputError
    from scenes.files.formats import tables
    from scenes.files.problems import refuse
    from scenes.recordings.captures import contacts_of

    rows = tables.read_table(source, tables.LOOSE_CONTACTS, refuse)
    if not len(rows):
        raise CaptureError(f"{source}: expected contacts, got none")
    if frame is not None:
        rows = rows.of_frame(frame)
        if not len(rows):
            raise InputError(f"{source}: expected a frame that has contacts, got {frame}")
    try:
        contacts_of(rows)
    except InputError as error:
        raise CaptureError(f"{source}: {error}") from error
    names = [name or f"contact{i}" for i, name in enumerate(rows.texts["sensor"])]
    numbers = np.stack([rows.numbers[column.name] for column in tables.CONTACTS[2:]], axis=1).tolist()
    told = zip(rows.frames().tolist(), names, numbers, strict=True)
    tables.write_table(out, tables.CONTACTS, ([frame, name, *values] for frame, name, values in told))


def _write_contacts(out: Path, data: OffData) -> None:
    from scenes.files.formats import tables

    unknown = float("nan")
    normals = [[unknown] * 3] * len(data.points) if data.normals is None else data.normals.tolist()
    rows = enumerate(zip(data.points.tolist(), normals, strict=True))
    tables.write_table(out, tables.CONTACTS, ([0, f"contact{i}", *p, *n, *[unknown] * 5] for i, (p, n) in rows))


def _faces(path: Path) -> Any:
    from scenes.files.formats.meshes import loaded

    return getattr(loaded(path), "faces", None)
