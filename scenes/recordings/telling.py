"""How beliefs are told: as a table of capture.json or of TOML, one laid over the other; and written again.

A table is `{"camera": NAME, "depth": {…}, "calibration": {…}, "touch": {…}, "image": {…}, "mesh_sigma": …}`,
every part optional, the fields of `Beliefs` in metres, radians and pixels. `camera` is one of DEPTH_CAMERAS and stands
before what `depth` adds.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, fields, replace
from typing import Any

from scenes.errors import InputError, unknown
from scenes.files.merged import merged
from scenes.recordings.beliefs import Beliefs, DepthModel
from scenes.recordings.depth_cameras import DEPTH_CAMERAS

# One table with the words that begin messages about it: a file, a flag.
Told = tuple[str, Mapping[str, Any]]

# What a joint's error (rad) moves a fingertip by, metres per radian: three joints 0.12, 0.08 and 0.04 m away, as those
# of a person-sized finger are, add up to this as a root of squares.
JOINT_LEVER = 0.15


def believed(base: Beliefs | None, told: Iterable[Told]) -> Beliefs:
    """The beliefs after every table, the later over the earlier; base: what is believed before, default the library's.

    Raises InputError, beginning with the table's words, for what has no place in it or is no size.
    """
    out = base or Beliefs()
    for where, table in told:
        if not isinstance(table, Mapping):
            raise InputError(f"{where}: expected a table of beliefs, got {table!r}")
        rest = dict(table)
        if "camera" in rest:
            out = replace(out, depth=depth_camera(rest.pop("camera"), f"{where}: camera"))
        known = ["camera", *(field.name for field in fields(Beliefs))]
        for name in rest:
            if name not in known:
                raise unknown(where, name, known, "a belief of")
        out = merged(out, rest, where)
    return out


def depth_camera(name: Any, where: str = "camera") -> DepthModel:
    """The camera of that name. Raises InputError, listing the names, for another."""
    if not isinstance(name, str) or name not in DEPTH_CAMERAS:
        raise unknown(where, name, DEPTH_CAMERAS)
    return DEPTH_CAMERAS[name]


def of_joints(sigma: float) -> dict[str, Any]:
    """The table of beliefs that finger joints which are off by sigma (rad) each make."""
    return {"touch": {"fingertip_sigma": JOINT_LEVER * sigma}}


def beliefs_json(beliefs: Beliefs) -> dict[str, Any]:
    """As a table that `believed` reads back: the camera by its name where it is a known one, else by its numbers."""
    names = [name for name, model in DEPTH_CAMERAS.items() if model == beliefs.depth]
    rest = asdict(beliefs)
    depth = rest.pop("depth")
    return {"camera": names[0], **rest} if names else {"depth": depth, **rest}
