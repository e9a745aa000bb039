"""Tell by touch alone which of several known objects it is."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from fusion.cli.commands.answers.localize import read_contacts
from fusion.cli.options import length_unit, number, progress, say, show_table, write_json

if TYPE_CHECKING:
    from scenes.geometry.objects import ObjectModel

MESHES = (".ply", ".obj", ".stl", ".off", ".glb")
HEADS = ("object", "index mm", "likelihood", "1/G share", "")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's own arguments."""
    parser.add_argument("contacts", metavar="CONTACTS", type=Path, help="contacts.csv, or a point list as .off or .ply")
    parser.add_argument(
        "--objects", metavar="DIR", type=Path, required=True, help=f"folder of candidate meshes ({' '.join(MESHES)})"
    )
    parser.add_argument("--unit", type=length_unit, default="m", help="of the mesh files: m (default), cm, mm, inch")
    parser.add_argument("--frame", metavar="N", type=int, help="of a contacts.csv with several frames, this one")


def run(args: argparse.Namespace) -> int:
    """Exit code 1 when no candidate fits at all."""
    from scenes.recordings.checking.validation import check_scale
    from scenes.recordings.frames import Frame
    from touch.recognition import identify

    contacts = read_contacts(args.contacts, args.frame)
    models = load_candidates(args.objects, args.unit)
    largest = max(models, key=lambda model: model.diameter)
    check_scale(Frame(0, where=str(args.contacts), contacts=contacts), largest)
    found = identify(models, contacts, args.seed)
    cells = [
        [
            one.name,
            number(1e3 * one.index, 3),
            number(one.likelihood, 3),
            number(one.inverse_cost, 3),
            "given up early" if one.given_up else "",
        ]
        for one in found.candidates
    ]
    cells.append(["none of these", "", number(found.none, 3), "", ""])
    show_table(HEADS, cells)
    named = found.best if found.none < 0.5 else f"none of these (nearest: {found.best})"
    say(
        f"{named}: {found.verdict}, noise of a contact {1e3 * found.sigma:.1f} mm,"
        f" {found.independent:.0f} of {len(contacts)} contacts independent; {found.time_s:.3f} s"
    )
    for note in found.notes:
        say(f"why not ok: {note}")
    content = {
        "best": found.best,
        "verdict": found.verdict,
        "notes": list(found.notes),
        "candidates": [
            {
                "object": one.name,
                "index_mm": 1e3 * one.index,
                "likelihood": one.likelihood,
                "inverse_cost": one.inverse_cost,
                "pose": one.pose.tolist(),
                "given_up": one.given_up,
            }
            for one in found.candidates
        ],
        "none": found.none,
        "margin": found.margin,
        "sigma_mm": 1e3 * found.sigma,
        "independent_contacts": found.independent,
        "time_s": found.time_s,
    }
    write_json(args.json, content)
    return 1 if found.verdict == "lost" else 0


def load_candidates(folder: Path, unit: str = "m") -> list[ObjectModel]:
    """Every mesh of the folder, by name. Raises InputError for no folder, no mesh, or two meshes of one name."""
    from scenes.errors import InputError
    from scenes.geometry.objects import ObjectModel

    if not folder.is_dir():
        raise InputError(f"objects: expected a folder of meshes, found none at {folder}")
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in MESHES and path.is_file())
    if not paths:
        raise InputError(f"objects: expected meshes ({', '.join(MESHES)}) in {folder}, found none")
    names = [path.stem for path in paths]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"objects: expected one mesh of a name in {folder}, found two of {twice[0]}")
    models = []
    for path in progress(paths, len(paths), "meshes"):
        model = ObjectModel.load(path, unit=unit)
        model.field  # noqa: B018  (built or read from the cache before anything is timed)
        models.append(model)
    return models
