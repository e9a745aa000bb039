"""Recorded contact sets for the benchmarks: real and simulated iCub contacts (tacman-fp7/tactile-localization, 2016).

Read from the folder named by PALPATE_DATA, else from ../shared/data beside the project; never part of it.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from scenes.errors import InputError
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts

ROOT = Path(__file__).resolve().parents[3]


@dataclass(frozen=True)
class ContactSet:
    """name; mesh file; window m of T2 tables 4.3 and 4.5; real: measured by a robot; what the authors' C++ reached for
    MUPF and Scaling Series: index (mm) and seconds on one thread (NaN when not measured).
    """

    name: str
    mesh: str
    window: int
    real: bool
    mupf: tuple[float, float]
    scaling: tuple[float, float]


NAN = float("nan")
SETS = (
    ContactSet("Box15_sim", "box", 9, False, (2.44, 0.83), (2.41, 1.74)),
    ContactSet("Tetra9_sim", "tetrahedron", 4, False, (2.58, 0.55), (NAN, NAN)),
    ContactSet("Tetra30_sim", "tetrahedron", 12, False, (1.02, 1.20), (3.23, 0.02)),
    ContactSet("Cleaner_sim", "cleaner", 36, False, (2.65, 5.02), (67.6, 0.73)),
    ContactSet("Robot_sim", "robot", 24, False, (4.70, 3.48), (9.19, 0.26)),
    ContactSet("Lego_exp", "legoBox", 55, True, (11.62, 3.20), (9.97, 1.86)),
    ContactSet("Cylinder_exp", "cylinder", 18, True, (7.05, 2.08), (17.5, 0.99)),
)


def folder() -> Path:
    """Where the contact sets are. Raises InputError when they are not."""
    root = Path(os.environ.get("PALPATE_DATA") or ROOT.parent / "shared" / "data")
    path = root / "icub-contacts"
    if not path.is_dir():
        raise InputError(f"bench: expected contact sets at {path}, found no folder (set PALPATE_DATA to its parent)")
    return path


def read_points(path: Path) -> Contacts:
    """Contacts of a point list (OFF)."""
    from scenes.files.formats.off import read_off

    return Contacts(read_off(path).points)


def read_set(one: ContactSet) -> tuple[ObjectModel, Contacts]:
    """Model with its lattice built, and contacts."""
    model = ObjectModel.load(folder() / "models" / f"{one.mesh}.off")
    model.field, model.surface  # noqa: B018  (not part of any time)
    return model, read_points(folder() / "contacts" / f"{one.name}.off")


def recognition_models() -> list[ObjectModel]:
    """The nine tools, lattices built."""
    models = [ObjectModel.load(path) for path in sorted((folder() / "recognition-models").glob("*.off"))]
    for model in models:
        model.field, model.surface  # noqa: B018  (not part of any time)
    return models


def recognition_sets() -> dict[str, Contacts]:
    """Contacts by file name; the name tells the tool."""
    return {path.stem: read_points(path) for path in sorted((folder() / "recognition-contacts").glob("*.off"))}
