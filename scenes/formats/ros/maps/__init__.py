"""Topic maps of public recordings, ready to use: `--topics NAME`; what a bag lacks is taken from beside it or named.

Object-in-Hand (PoseFusion, Tu et al., IROS 2023): `OBJECT/NAME.bag` with `OBJECT/config/`. The bag has no camera_info
(`--intrinsics`), and TF does not know the camera: `config/basefootprint_camera.yaml` of the recordings' tools does. The
object's truth is the tracked marker's: camera_from_tracker (`camera_transmitter.yaml`) times the marker's pose times
`sensor1_object_NAME.yaml`. Each contact has its own frame, a fingertip's; where no electrode tells its
place, the publisher leaves it at zero. One topic has the joints of the hand (24) and of the arm in turn. The 19
electrodes of each BioTac are impedances without a scale to pascal: left out.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from scenes.errors import CaptureError, InputError
from scenes.formats.ros.topics import TopicMap, parse_map

FOLDER = Path(__file__).resolve().parent
# TF frame from which the recordings' camera was calibrated.
BASE = "base_footprint"
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


def names() -> list[str]:
    """The ready maps."""
    return sorted(path.stem for path in FOLDER.glob("*.json"))


def ready_map(name: str, bag: Path, intrinsics: tuple[float, float, float, float] | None) -> TopicMap:
    """The map of that name for a bag. Raises InputError for what the bag lacks and nothing gives, CaptureError for a
    malformed file beside it.
    """
    path = FOLDER / f"{name}.json"
    content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    if intrinsics is None:
        raise InputError(
            f"{bag}: expected --intrinsics FX,FY,CX,CY (a RealSense has them on its label): no camera_info"
        )
    content["intrinsics"] = dict(zip(("fx", "fy", "cx", "cy"), intrinsics))
    config = bag.parent / "config"
    tracker = config / "camera_transmitter.yaml"
    markers = sorted(config.glob("sensor1_object_*.yaml"))
    if tracker.is_file() and markers:
        content["marker"] = {"camera_from_tracker": _pose(tracker), "marker_from_object": _pose(markers[0])}
    else:
        del content["topics"]["/pose_array"]  # no truth without them; nothing else needs it
    camera = config / "basefootprint_camera.yaml"
    if not camera.is_file():
        raise InputError(f"{bag}: expected {camera} (x, y, z, qx, qy, qz, qw): TF does not know where the camera is")
    child = content["frames"]["camera"]
    content["static_frames"] = [{"parent": BASE, "child": child, **_pose(camera)}]
    return parse_map(content, path)


def _pose(path: Path) -> dict[str, list[float]]:
    """Position and orientation of a YAML pose: x, y, z then x, y, z, w under two keys, or x … qw on one level."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise CaptureError(f"{path}: expected a text file with a pose, it cannot be read") from error
    found = re.findall(rf"^\s*(q?[xyzw])\s*:\s*({NUMBER})\s*$", text, flags=re.MULTILINE)
    values = [float(value) for _, value in found]
    keys = "".join(key[-1] for key, _ in found)
    if keys != "xyzxyzw":
        raise CaptureError(f"{path}: expected x, y, z and a quaternion x, y, z, w as numbers, got {keys or 'none'}")
    return {"position": values[:3], "orientation": values[3:]}
