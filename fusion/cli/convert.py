"""Turn foreign recordings into captures and back: icub-handover folders, contact lists, meshes."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from fusion.cli.options import say, write_json

HELP = "a handover folder or a folder of them, a capture, contacts (.off, .csv), or a mesh or cloud"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's own arguments."""
    parser.add_argument("source", metavar="IN", type=Path, help=HELP)
    parser.add_argument("out", metavar="OUT", type=Path, help="folder or file to write; its ending says the format")


def run(args: argparse.Namespace) -> int:
    """Exit code 0; what was written is listed."""
    written = convert(args.source, args.out)
    write_json(args.json, {"written": [str(path) for path in written]})
    for path in written:
        say(f"wrote {path}")
    return 0


def convert(source: Path, out: Path) -> list[Path]:
    """Convert by what `source` is and what `out` is called; raises InputError when no way is known."""
    from scenes.captures import read_capture
    from scenes.errors import InputError
    from scenes.formats import handover

    if not source.exists():
        raise InputError(f"{source}: expected {HELP}, found nothing")
    if source.is_file():
        return [_convert_file(source, out)]
    if (source / "capture.json").is_file():
        return handover.export(read_capture(source), out)
    if handover.is_grasp(source):
        return [handover.convert(source, out)]
    grasps = sorted(folder for folder in source.iterdir() if folder.is_dir() and handover.is_grasp(folder))
    if grasps:
        return [handover.convert(folder, out / folder.name) for folder in grasps]
    files = ", ".join(handover.FILES)
    raise InputError(f"{source}: expected a capture (capture.json) or a handover recording ({files}), found neither")


def _convert_file(source: Path, out: Path) -> Path:
    """Between point lists and meshes as .off and .ply, and contacts as .csv."""
    from scenes.errors import InputError
    from scenes.formats import tables
    from scenes.formats.off import OffData, read_off, write_off
    from scenes.formats.ply import read_cloud, write_ply

    kinds = (source.suffix.lower(), out.suffix.lower())
    known = (".off", ".ply", ".csv")
    if kinds[0] not in known or kinds[1] not in known:
        raise InputError(f"convert: expected files ending in {', '.join(known)}, got {source.name} to {out.name}")
    data: Any
    if kinds[0] == ".off":
        data = read_off(source)
    elif kinds[0] == ".csv":
        from fusion.cli.localize import read_contacts

        felt = read_contacts(source)
        data = OffData(felt.points, tables.NO_FACES, None, felt.normals if felt.has_normal.all() else None)
    else:
        points, colours = read_cloud(source)
        data = OffData(points, tables.NO_FACES, colours)
        faces = _faces(source)
        if faces is not None:
            data = OffData(points, faces, colours)
    out.parent.mkdir(parents=True, exist_ok=True)
    if kinds[1] == ".off":
        write_off(out, data.points, data.faces, data.colours, data.normals)
    elif kinds[1] == ".ply":
        write_ply(out, data.points, data.faces if len(data.faces) else None, data.colours)
    else:
        rows = zip(
            data.points.tolist(), [[float("nan")] * 3] * len(data.points) if data.normals is None else data.normals
        )
        blank = [float("nan")] * 5
        tables.write_table(out, tables.CONTACTS, ([0, f"contact{i}", *p, *n, *blank] for i, (p, n) in enumerate(rows)))
    return out


def _faces(path: Path) -> Any:
    import trimesh

    mesh = trimesh.load(path, process=False)
    return getattr(mesh, "faces", None)
