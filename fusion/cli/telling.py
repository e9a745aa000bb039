"""--camera, --calibration, --joints, --mesh, --image: what is believed of a recording, in mm, degrees and pixels."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from fusion.cli.options import length_and_angle, positive_number
from scenes.errors import unknown

if TYPE_CHECKING:
    from scenes.recordings.telling import Told


def add_beliefs(parser: argparse.ArgumentParser) -> None:
    """--camera, --calibration, --joints, --mesh, --image: over --config, and that over what a capture says."""
    group = parser.add_argument_group("what is believed of the recording", "instead of what its capture.json says")
    group.add_argument(
        "--camera",
        metavar="NAME|FILE",
        help="the depth camera: kinect-v1, xtion, d435, d455, azure-kinect, l515, clean (simulated), or a TOML file"
        " with fields of [beliefs.depth], `like` one of these",
    )
    group.add_argument(
        "--calibration",
        metavar="MM,DEG",
        type=_calibration,
        help="sigma per axis of where the camera has the robot",
    )
    group.add_argument("--joints", metavar="DEG", type=_joints, help="sigma of a finger's joint")
    group.add_argument("--mesh", metavar="MM", type=_mesh, help="sigma of what the mesh leaves out")
    group.add_argument(
        "--image",
        metavar="PX",
        type=_image,
        help="sigma of how far the colour or grey image lies beside depth (default 1.5, 0.25 of a grey one)",
    )


def beliefs_told(args: argparse.Namespace) -> list[Told]:
    """The tables of beliefs that the flags of `add_beliefs` make; none for a command without them."""
    from scenes.recordings.telling import of_joints

    found: list[Told] = []
    if getattr(args, "camera", None) is not None:
        found.append(_camera_told(args.camera))
    if getattr(args, "calibration", None) is not None:
        sizes = dict(zip(("translation_sigma", "rotation_sigma"), args.calibration))
        found.append(("--calibration", {"calibration": sizes}))
    if getattr(args, "joints", None) is not None:
        found.append(("--joints", of_joints(math.radians(args.joints))))
    if getattr(args, "mesh", None) is not None:
        found.append(("--mesh", {"mesh_sigma": 1e-3 * args.mesh}))
    if getattr(args, "image", None) is not None:
        found.append(("--image", {"image": {"grey_sigma": args.image, "colour_sigma": args.image}}))
    return found


def _camera_told(text: str) -> Told:
    """--camera's name, or the fields of its file: whatever the file leaves out is as of the camera it is `like`."""
    from scenes.files.merged import read_toml
    from scenes.recordings.depth_cameras import DEPTH_CAMERAS

    path = Path(text)
    if text in DEPTH_CAMERAS:
        return "--camera", {"camera": text}
    if not path.is_file():
        raise unknown("--camera", text, DEPTH_CAMERAS, "a TOML file or one of")
    content = read_toml(path)
    return f"--camera {path}", {"camera": content.pop("like", "kinect-v1"), "depth": content}


def _mesh(text: str) -> float:
    """Millimetres, for argparse."""
    from scenes.recordings.beliefs import LARGEST

    return _up_to(positive_number(text), 1e3 * LARGEST["mesh_sigma"], "mm", text)


def _image(text: str) -> float:
    """Pixels, for argparse."""
    from scenes.recordings.beliefs import LARGEST

    return _up_to(positive_number(text), LARGEST["colour_sigma"], "px", text)


def _joints(text: str) -> float:
    """Degrees, for argparse."""
    from scenes.recordings.beliefs import LARGEST
    from scenes.recordings.telling import JOINT_LEVER

    return _up_to(positive_number(text), math.degrees(LARGEST["fingertip_sigma"] / JOINT_LEVER), "degrees", text)


def _calibration(text: str) -> tuple[float, float]:
    """Metres and radians, for argparse."""
    from scenes.recordings.beliefs import LARGEST

    length, angle = length_and_angle(text)
    most = LARGEST["translation_sigma"], LARGEST["rotation_sigma"]
    if not (0 < length <= most[0] and 0 < angle <= most[1]):
        expected = f"above 0 and up to {1e3 * most[0]:g} mm and {math.degrees(most[1]):.3g} degrees"
        raise argparse.ArgumentTypeError(f"expected a length and an angle {expected}, got {text!r}")
    return length, angle


def _up_to(value: float, most: float, unit: str, text: str) -> float:
    if value > most:
        raise argparse.ArgumentTypeError(f"expected a number above 0 and up to {most:.3g} {unit}, got {text!r}")
    return value
