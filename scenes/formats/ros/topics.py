"""The topic map: a JSON file that says what the topics of a ROS bag are to a capture.

Paths are relative to the map's folder. Every key is checked, so that a slip of the pen is an error and not a silence.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.errors import CaptureError, InputError
from scenes.files.problems import refuse
from scenes.geometry import poses
from scenes.geometry.objects import METRES_PER_UNIT
from scenes.recordings import bop
from scenes.recordings.beliefs import Beliefs
from scenes.recordings.telling import believed

Array = NDArray[np.float64]

FORMAT = "palpate-topics"
VERSION = 1
# Half the time between two images at 25 a second: a message farther away belongs to another image.
DEFAULT_TOLERANCE_S = 0.02

# What a topic can be, and what its entry may say beside its role (marked ! when it must).
ROLES: dict[str, tuple[str, ...]] = {
    "depth": ("depth_scale",),
    "camera_info": ("rectified",),
    "rgb": ("registered",),
    "mask": ("registered",),
    "joints": ("names",),
    "wrench": ("sensor!",),
    "tactile": ("sensor!", "field!", "scale"),
    "contacts": (
        "points!",
        "normals",
        "forces",
        "sensor",
        "sensor_field",
        "frame",
        "frame_field",
        "flip_normals",
        "zero_unknown",
        "sigma_point",
        "sigma_normal",
    ),
    "marker": ("index", "field"),
    "tf": (),
    "tf_static": ("optional",),
}
SINGLE = ("depth", "camera_info", "rgb", "mask", "marker")
REQUIRABLE = ("rgb", "mask", "joints", "wrench", "tactile", "contacts", "hand", "object", "prior")
FRAMES = ("camera", "world", "hand", "object", "prior")
KEYS = (
    "format",
    "version",
    "tolerance_s",
    "object",
    "hand",
    "world",
    "frames",
    "required",
    "topics",
    "definitions",
    "intrinsics",
    "static_frames",
    "marker",
    "beliefs",
)


@dataclass(frozen=True)
class Topic:
    """One topic: its name in the bag, its role and what else the map says of it."""

    name: str
    role: str
    options: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class TopicMap:
    """A topic map as read.

    tolerance_s: how far a message may be from the depth image it goes with; mesh (file, unit, name) and hand (URDF,
    sensors or None), None when the map names none; world: "camera" or "robot base"; frames: TF frames by what they are
    to the capture; required: roles without which a frame is dropped; definitions: message definitions by type;
    intrinsics (fx, fy, cx, cy; pixels) where no topic has them; static_frames: (parent, child, parent_from_child) that
    no topic has; marker: camera_from_tracker and marker_from_object (4, 4) around the poses of a marker's topic;
    beliefs: what the sensors are worth.
    """

    path: Path
    topics: tuple[Topic, ...]
    tolerance_s: float = DEFAULT_TOLERANCE_S
    mesh: tuple[Path, str, str] | None = None
    hand: tuple[Path, Path | None] | None = None
    world: str = "camera"
    frames: dict[str, str] = field(default_factory=dict)
    required: tuple[str, ...] = ()
    definitions: dict[str, str] = field(default_factory=dict)
    intrinsics: tuple[float, float, float, float] | None = None
    static_frames: tuple[tuple[str, str, Array], ...] = ()
    marker: tuple[Array, Array] | None = None
    beliefs: Beliefs | None = None

    def of_role(self, role: str) -> list[Topic]:
        """The topics of a role, in the map's order."""
        return [topic for topic in self.topics if topic.role == role]


def read_map(path: Path) -> TopicMap:
    """Read a topic map; raises CaptureError with the key for anything that is not as the schema has it."""
    return parse_map(bop.read_json(path, refuse), path)


def parse_map(content: Any, path: Path) -> TopicMap:
    """A topic map from its JSON content; path: where it came from. Raises as `read_map`."""

    def demand(good: bool, expected: str, got: Any) -> None:
        if not good:
            raise CaptureError(f"{path}: expected {expected}, got {str(got)[:80]}")

    demand(isinstance(content, dict), "an object", type(content).__name__)
    demand(content.get("format") == FORMAT, f'"format": "{FORMAT}"', content.get("format"))
    demand(content.get("version") == VERSION, f'"version": {VERSION}', content.get("version"))
    unknown = [key for key in content if key not in KEYS]
    demand(not unknown, f"the keys {', '.join(KEYS)}", ", ".join(unknown))
    tolerance = content.get("tolerance_s", DEFAULT_TOLERANCE_S)
    good = isinstance(tolerance, int | float) and math.isfinite(tolerance) and tolerance >= 0
    demand(good, "tolerance_s of 0 or more seconds", tolerance)
    topics = content.get("topics")
    demand(isinstance(topics, dict) and bool(topics), '"topics": {"/topic": {"role": …}, …}', topics)
    read = tuple(_topic(name, entry, demand) for name, entry in topics.items())
    for role in SINGLE:
        names = [topic.name for topic in read if topic.role == role]
        least = 1 if role == "depth" or (role == "camera_info" and "intrinsics" not in content) else 0
        demand(least <= len(names) <= 1, f"one topic with the role {role}", ", ".join(names) or "none")
    frames = content.get("frames", {})
    good = isinstance(frames, dict) and all(key in FRAMES and isinstance(name, str) for key, name in frames.items())
    demand(good, f"frames with names for some of {', '.join(FRAMES)}", frames)
    world = content.get("world", "camera")
    demand(world in ("camera", "robot base"), 'a world of "camera" or "robot base"', world)
    demand(world == "camera" or "world" in frames, 'frames.world, the TF frame of the world "robot base"', frames)
    required = content.get("required", [])
    good = isinstance(required, list) and all(role in REQUIRABLE for role in required)
    demand(good, f"required to list some of {', '.join(REQUIRABLE)}", required)
    hand = _hand(path, content.get("hand"), demand)
    demand(hand is None or "hand" in frames, "frames.hand, the TF frame of the hand's root link", frames)
    needs_hand = [topic.name for topic in read if topic.role == "wrench"]
    demand(hand is not None or not needs_hand, f"a hand with sensors for {', '.join(needs_hand)}", "none")
    return TopicMap(
        path,
        read,
        float(tolerance),
        _mesh(path, content.get("object"), demand),
        hand,
        world,
        {key: name.lstrip("/") for key, name in frames.items()},
        tuple(required),
        _definitions(path, content.get("definitions", {}), demand),
        _intrinsics(content.get("intrinsics"), demand),
        _static_frames(content.get("static_frames", []), demand),
        _marker(content.get("marker"), any(topic.role == "marker" for topic in read), demand),
        _beliefs(path, content),
    )


Demand = Callable[[bool, str, Any], None]


def _topic(name: str, entry: Any, demand: Demand) -> Topic:
    role = entry.get("role") if isinstance(entry, dict) else None
    demand(isinstance(role, str) and role in ROLES, f"{name}: a role of {', '.join(ROLES)}", role)
    options = {key: value for key, value in entry.items() if key != "role"}
    known = [key.rstrip("!") for key in ROLES[str(role)]]
    for key, value in options.items():
        demand(key in known, f"{name}: keys for the role {role} of {', '.join(known) or 'none'}", key)
        if key in ("rectified", "registered", "flip_normals", "zero_unknown", "optional"):
            demand(isinstance(value, bool), f"{name}: {key} true or false", value)
        elif key in ("depth_scale", "scale", "sigma_point", "sigma_normal"):
            good = isinstance(value, int | float) and math.isfinite(value) and value > 0
            demand(good, f"{name}: {key} above 0", value)
        elif key == "index":
            demand(isinstance(value, int) and value >= 0, f"{name}: index of 0 or more", value)
        elif key == "names":
            good = isinstance(value, dict) and all(isinstance(text, str) for text in value.values())
            demand(good, f"{name}: names as an object of texts", value)
        else:
            demand(isinstance(value, str) and bool(value), f"{name}: {key} as a text", value)
    missing = [key.rstrip("!") for key in ROLES[str(role)] if key.endswith("!") and key.rstrip("!") not in options]
    demand(not missing, f"{name}: {', '.join(missing)} for the role {role}", "none")
    return Topic(name, str(role), options)


def _beliefs(path: Path, content: dict[str, Any]) -> Beliefs | None:
    if "beliefs" not in content:
        return None
    try:
        return believed(None, [("beliefs", content["beliefs"])])
    except InputError as error:
        raise CaptureError(f"{path}: {error}") from error


def _intrinsics(entry: Any, demand: Demand) -> tuple[float, float, float, float] | None:
    if entry is None:
        return None
    keys = ("fx", "fy", "cx", "cy")
    good = isinstance(entry, dict) and set(entry) == set(keys)
    good = good and all(isinstance(x, int | float) and math.isfinite(x) for x in entry.values())
    demand(good and min(entry["fx"], entry["fy"]) > 0, "intrinsics with fx, fy above 0, cx, cy in pixels", entry)
    fx, fy, cx, cy = (float(entry[key]) for key in keys)
    return fx, fy, cx, cy


def pose_of(entry: Any, what: str, demand: Demand) -> Array:
    """(4, 4) from position [x, y, z] (m) and orientation [x, y, z, w]."""
    good = isinstance(entry, dict) and {"position", "orientation"} <= set(entry)
    values = [*entry["position"], *entry["orientation"]] if good else []
    good = len(values) == 7 and all(isinstance(x, int | float) and math.isfinite(x) for x in values)
    demand(good, f"{what} with position [x, y, z] and orientation [x, y, z, w]", entry)
    x, y, z, qx, qy, qz, qw = (float(value) for value in values)
    length = math.sqrt(qx * qx + qy * qy + qz * qz + qw * qw)
    demand(abs(length - 1.0) < 1e-2, f"{what} with a unit quaternion", f"length {length:.4g}")
    return poses.make_pose(poses.from_quaternion(np.array([qw, qx, qy, qz]) / length), (x, y, z))


def _static_frames(entry: Any, demand: Demand) -> tuple[tuple[str, str, Array], ...]:
    good = isinstance(entry, list) and all(
        isinstance(row, dict) and isinstance(row.get("parent"), str) and isinstance(row.get("child"), str)
        for row in entry
    )
    demand(good, "static_frames with parent, child, position and orientation", entry)
    return tuple(
        (row["parent"].lstrip("/"), row["child"].lstrip("/"), pose_of(row, "a static frame", demand)) for row in entry
    )


def _marker(entry: Any, wanted: bool, demand: Demand) -> tuple[Array, Array] | None:
    demand((entry is not None) == wanted, "marker beside a topic with the role marker, and neither without", entry)
    if entry is None:
        return None
    keys = ("camera_from_tracker", "marker_from_object")
    demand(isinstance(entry, dict) and set(entry) == set(keys), f"marker with {', '.join(keys)}", entry)
    return pose_of(entry[keys[0]], keys[0], demand), pose_of(entry[keys[1]], keys[1], demand)


def _mesh(path: Path, entry: Any, demand: Demand) -> tuple[Path, str, str] | None:
    if entry is None:
        return None
    good = isinstance(entry, dict) and isinstance(entry.get("model"), str) and set(entry) <= {"model", "unit", "name"}
    demand(good, '"object" with model, and unit and name if need be', entry)
    unit = entry.get("unit", "m")
    demand(isinstance(unit, str) and unit in METRES_PER_UNIT, f"a unit of {', '.join(METRES_PER_UNIT)}", unit)
    file = path.parent / entry["model"]
    return file, unit, str(entry.get("name") or file.stem)


def _hand(path: Path, entry: Any, demand: Demand) -> tuple[Path, Path | None] | None:
    if entry is None:
        return None
    good = isinstance(entry, dict) and isinstance(entry.get("urdf"), str) and set(entry) <= {"urdf", "sensors"}
    demand(good, '"hand" with urdf, and sensors if need be', entry)
    sensors = entry.get("sensors")
    demand(sensors is None or isinstance(sensors, str), "the hand's sensors as a file name", sensors)
    files = path.parent / entry["urdf"], None if sensors is None else path.parent / sensors
    for file in files:
        demand(file is None or file.is_file(), f"the hand's file {file}", "none there")
    return files


def _definitions(path: Path, entry: Any, demand: Demand) -> dict[str, str]:
    """Message definitions by type (`pkg/msg/Name`): the text, or the name of a .msg file."""
    good = isinstance(entry, dict) and all(isinstance(text, str) for text in entry.values())
    demand(good, "definitions as an object of texts or .msg files by type", entry)
    found = {}
    for name, text in entry.items():
        demand(name.count("/") == 2 and "/msg/" in name, "message types like my_msgs/msg/Tactile", name)
        if text.endswith(".msg") and "\n" not in text:
            file = path.parent / text
            demand(file.is_file(), f"the definition of {name} in {file}", "no file there")
            text = file.read_text(encoding="utf-8")
        found[name] = text
    return found
