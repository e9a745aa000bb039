"""Touch sensors of a hand: where each sits, what it measures, and the layout file `sensors.json` in and out."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.cache import Arrays, are_triangles, remembered_of_file
from scenes.errors import InputError, unknown
from scenes.files.formats.json_text import parsed
from scenes.files.formats.meshes import loaded
from scenes.files.formats.ply import write_ply
from scenes.files.inside import stays_inside
from scenes.files.problems import UNREADABLE
from scenes.geometry import poses
from scenes.robot.gels import Gel, read_gel, write_gel

Array = NDArray[np.float64]

# Raised whenever reading a surface's hull changes, so that old cache entries are not read.
HULL_VERSION = 1

KINDS = ("wrench", "array", "point", "gel")
# What each surface must say, metres; a mesh's file is named relative to sensors.json, and its convex hull counts.
SURFACES = {"sphere": ("radius",), "ellipsoid": ("radii",), "cylinder": ("radius", "length"), "mesh": ("file",)}
# What the file may say of a sensor.
KEYS = ("link", "kind", "link_from_sensor", "surface", "taxels", "soft_layer", "gel")
# A sensor sits on its link, however long that is (m); a number of millimetres is beyond.
FARTHEST_SENSOR = 1.0
# A taxel's distance (m) from its sensor's origin along each axis: no link of a hand is as large.
FARTHEST_TAXEL = 0.5
# Directions are unit vectors to so many parts (no unit); what rounding has left is scaled to one, what is shorter than
# the least points nowhere.
UNIT_TOLERANCE = 1e-9
LEAST_NORMAL = 1e-6
# What a soft layer may say, from and to: stiffness (N/m), thickness (m: no fingertip's rubber is a hand's breadth),
# modulus and pressures (Pa), Poisson's ratio and the blur's share of the thickness (no unit). Beyond the lower ends
# divisions overflow; 1e12 is more than steel and all forces of a hand.
SOFT_LAYER = {
    "stiffness": (1e-6, 1e12),
    "thickness": (1e-6, 0.1),
    "modulus": (1e-6, 1e12),
    "poisson": (-0.999, 0.4999),
    "spread": (0.0, 1e3),
    "saturation": (1e-6, 1e12),
    "threshold": (0.0, 1e12),
}


@dataclass(frozen=True)
class Sensor:
    """One touch sensor, fixed to a link.

    kind: "wrench" (force and torque), "array" (pressures of taxels), "point" (contact points as such) or "gel" (images
    of a soft skin from behind).
    link_from_sensor (4, 4). surface: {"sphere": {"radius": r}}, {"ellipsoid": {"radii": [a, b, c]}},
    {"cylinder": {"radius": r, "length": l}} (along z) or {"mesh": {"file": path}}, in the sensor frame, metres; None
    when unknown. A mesh may hold "vertices" and "faces" instead of a file. taxels (k, 6): position and outward normal
    in the sensor frame, or None. soft_layer: its material as the file gives it, or None. gel: what a gel sensor is
    made of, None for every other.
    """

    name: str
    link: str
    kind: str
    link_from_sensor: Array
    surface: dict[str, dict[str, Any]] | None = None
    taxels: Array | None = None
    soft_layer: dict[str, Any] | None = None
    gel: Gel | None = None

    def __post_init__(self) -> None:
        """Bring the normals of taxels to unit length; InputError for those that point nowhere."""
        if self.taxels is not None:
            object.__setattr__(self, "taxels", unit_taxels(self.taxels, f"sensor {self.name!r}: taxels"))

    @property
    def radius(self) -> float | None:
        """Radius of a spherical surface, metres; None for every other sensor."""
        return float(self.surface["sphere"]["radius"]) if self.surface and "sphere" in self.surface else None

    def to_json(self) -> dict[str, Any]:
        """Its entry of sensors.json."""
        entry: dict[str, Any] = {"link": self.link, "kind": self.kind}
        entry["link_from_sensor"] = [float(x) for x in self.link_from_sensor.ravel()]
        if self.surface is not None:
            entry["surface"] = self.surface
        if self.taxels is not None:
            entry["taxels"] = self.taxels.tolist()
        if self.soft_layer is not None:
            entry["soft_layer"] = self.soft_layer
        return entry


def read_sensors(path: str | Path, within: Path | None = None) -> dict[str, Sensor]:
    """All sensors of a sensors.json by name, in the file's order; InputError names file and sensor.

    within: a folder out of which the meshes of surfaces may not lie (CaptureError); by default anywhere.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: expected a sensors file, found none")
    try:
        data = parsed(path.read_text(encoding="utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: expected JSON, got malformed text: {error}") from error
    if not isinstance(data, dict):
        raise InputError(f"{path}: expected an object of sensors by name, got {type(data).__name__}")
    return {name: _parse(name, entry, f"{path}: sensor {name!r}", path.parent, within) for name, entry in data.items()}


def write_sensors(path: str | Path, sensors: dict[str, Sensor]) -> None:
    """Write sensors.json, and beside it the convex hulls of fingertip meshes ("tips") and gels' images ("gels")."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    entries = {name: sensor.to_json() for name, sensor in sensors.items()}
    for number, (name, sensor) in enumerate(sensors.items()):
        if sensor.surface is not None and "mesh" in sensor.surface:
            vertices, faces = surface_hull(sensor.surface, f"sensor {name!r}")
            file = f"tips/{number:02d}.ply"
            (path.parent / "tips").mkdir(exist_ok=True)
            write_ply(path.parent / file, vertices, faces)
            entries[name]["surface"] = {"mesh": {"file": file}}
        if sensor.gel is not None:
            entries[name]["gel"] = write_gel(sensor.gel, path.parent, f"{number:02d}")
    path.write_text(json.dumps(entries, indent=1) + "\n", encoding="utf-8")


def surface_hull(surface: dict[str, dict[str, Any]], where: str) -> tuple[Array, NDArray[np.int64]]:
    """Vertices (n, 3) m and faces (m, 3), wound outwards, of the convex hull of a mesh as a fingertip, sensor frame.

    Raises InputError, beginning with `where`, for a file that is missing or holds no solid.
    """
    values = surface["mesh"]
    if "vertices" in values:
        return np.asarray(values["vertices"], dtype=np.float64), np.asarray(values["faces"], dtype=np.int64)
    path = Path(values["file"])
    if not path.is_file():
        raise InputError(f"{where}: expected the mesh of its surface, found no file {path}")
    return _hull_of(path, path.stat().st_mtime_ns, where)


@lru_cache(maxsize=32)
def _hull_of(path: Path, changed: int, where: str) -> tuple[Array, NDArray[np.int64]]:
    """Read once for every state of the file."""

    def make() -> Arrays:
        from scipy.spatial import QhullError

        try:
            mesh: Any = loaded(path, force="mesh")
            hull = mesh.convex_hull
        except QhullError as error:
            raise ValueError(str(error)) from error
        return {
            "vertices": np.array(hull.vertices, dtype=np.float64),
            "faces": np.array(hull.faces, dtype=np.int64),
        }

    try:
        hull = remembered_of_file("hull", HULL_VERSION, path, make, are_triangles)
    except UNREADABLE as error:
        said = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"{where}: expected a solid mesh in {path}, got {said}") from error
    return hull["vertices"], hull["faces"]


def _parse(name: str, entry: Any, where: str, folder: Path, within: Path | None) -> Sensor:
    if not isinstance(entry, dict):
        raise InputError(f"{where}: expected an object with link, kind and link_from_sensor, got {entry!r}")
    _check_keys(entry, KEYS, where)
    link, kind = entry.get("link"), entry.get("kind")
    if not isinstance(link, str) or not link:
        raise InputError(f"{where}: expected the name of its link, got {link!r}")
    if kind not in KINDS:
        raise InputError(f"{where}: expected kind {', '.join(KINDS)}, got {kind!r}")
    pose = _floats(entry.get("link_from_sensor", np.eye(4).ravel().tolist()), f"{where}: link_from_sensor")
    if pose.size != 16:
        raise InputError(f"{where}: link_from_sensor: expected 16 numbers, row by row, got {pose.size}")
    taxels = None
    if entry.get("taxels") is not None:
        taxels = unit_taxels(entry["taxels"], f"{where}: taxels")
    if kind == "array" and taxels is None:
        raise InputError(f"{where}: expected taxels for an array, got none")
    soft_layer = entry.get("soft_layer")
    if soft_layer is not None:
        check_soft_layer(soft_layer, f"{where}: soft_layer")
    link_from_sensor = poses.check_pose(pose.reshape(4, 4), f"{where}: link_from_sensor")
    away = float(np.linalg.norm(link_from_sensor[:3, 3]))
    if away > FARTHEST_SENSOR:
        expected = f"expected a sensor within {FARTHEST_SENSOR:g} m of its link"
        raise InputError(f"{where}: link_from_sensor: {expected}, got one {away:.4g} m off: mm read as m?")
    surface = _surface(entry.get("surface"), where, folder, within)
    if kind == "gel" and entry.get("gel") is None:
        raise InputError(f"{where}: expected the entry gel for a gel, got none")
    gel = read_gel(entry["gel"], where, folder, within) if entry.get("gel") is not None else None
    return Sensor(name, link, kind, link_from_sensor, surface, taxels, soft_layer, gel)


def unit_taxels(values: Any, where: str) -> Array:
    """(k, 6) positions and unit normals. Raises InputError for other shapes, numbers that are not finite, normals that
    point nowhere and positions that are on no link.
    """
    taxels = _floats(values, where)
    if taxels.ndim != 2 or taxels.shape[1] != 6:
        raise InputError(f"{where}: expected rows of x, y, z, nx, ny, nz, got shape {taxels.shape}")
    far = np.abs(taxels[:, :3]).max(axis=1, initial=0.0) > FARTHEST_TAXEL
    if far.any():
        row = int(np.argmax(far))
        got = f"row {row} = {taxels[row, :3].tolist()}"
        raise InputError(f"{where}: expected positions within {FARTHEST_TAXEL:g} m, got {got}: mm read as m?")
    length = np.linalg.norm(taxels[:, 3:], axis=1)
    if not (length > LEAST_NORMAL).all():
        row = int(np.argmin(length))
        raise InputError(f"{where}: expected outward normals, got row {row} = {taxels[row, 3:].tolist()}")
    rough = np.abs(length - 1.0) > UNIT_TOLERANCE
    taxels[rough, 3:] /= length[rough, None]
    return taxels


def check_soft_layer(entry: Any, where: str) -> None:
    """Raise InputError for a soft layer that says what has no place, or a number that no material has."""
    if not isinstance(entry, dict):
        raise InputError(f"{where}: expected an object, got {entry!r}")
    _check_keys(entry, SOFT_LAYER, where)
    for key, value in entry.items():
        low, high = SOFT_LAYER[key]
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not (number and low <= value <= high):
            hint = ": mm read as m?" if key == "thickness" and number and value > high else ""
            raise InputError(f"{where}: {key}: expected a number from {low:g} to {high:g}, got {value!r}{hint}")


def _check_keys(entry: dict[str, Any], known: Iterable[str], where: str) -> None:
    for key in entry:
        if key not in known:
            raise unknown(where, key, known, "keys of")


def _surface(surface: Any, where: str, folder: Path, within: Path | None) -> dict[str, dict[str, Any]] | None:
    if surface is None:
        return None
    where = f"{where}: surface"
    if not isinstance(surface, dict) or len(surface) != 1:
        raise InputError(f"{where}: expected one of {', '.join(SURFACES)}, got {surface!r}")
    kind, values = next(iter(surface.items()))
    if kind not in SURFACES:
        raise InputError(f"{where}: expected one of {', '.join(SURFACES)}, got {kind!r}")
    for key in SURFACES[kind]:
        value = values.get(key) if isinstance(values, dict) else None
        if value is None:
            raise InputError(f"{where}: {kind}: expected a value {key!r}, got {values!r}")
        if kind == "mesh":
            if not isinstance(value, str):
                raise InputError(f"{where}: mesh: expected a file name, got {value!r}")
            return {kind: {"file": str(stays_inside(folder / value, within, where).resolve())}}
        numbers = _floats(value, f"{where}: {kind} {key}").ravel()
        if len(numbers) != (3 if key == "radii" else 1) or (numbers <= 0).any():
            raise InputError(f"{where}: {kind} {key}: expected lengths above 0 in metres, got {value!r}")
    return {kind: dict(values)}


def _floats(values: Any, where: str) -> Array:
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{where}: expected numbers, got {values!r}") from error
    if not np.isfinite(array).all():
        raise InputError(f"{where}: expected finite numbers, got {values!r}")
    return array
