"""Grasps of several DIGITs: images, the untouched background, the sensors' poses and one contact point each.

The layout of multi-tactile-6d-estimation (Caddeo et al., ICRA 2023): a folder a grasp with `Image_heatmap_K.png`,
`poses_sensors.txt` (a line a sensor, `x y z axis_x axis_y axis_z angle`, world from sensor, metres and radians) and
`sensors.off` (a contact point a sensor, world); `background.png` and `model.obj` there or in a folder above.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenes.errors import CaptureError, InputError
from scenes.files.formats import images
from scenes.files.formats.off import read_off
from scenes.formats.conversion import Converted, located
from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel
from scenes.recordings import bop
from scenes.recordings.captures import write_capture
from scenes.recordings.frames import Contacts, Frame, GelImage
from scenes.robot.digit import HOUSING, digit_gel, model_from_sensor
from scenes.robot.gels import Gel
from scenes.robot.hands import Hand
from scenes.robot.sensors import Sensor
from scenes.robot.urdf import Joint, Robot, Shape

Array = NDArray[np.float64]

POSES, IMAGE, CONTACTS = "poses_sensors.txt", "Image_heatmap_{}.png", "sensors.off"
BACKGROUND, MODELS = "background.png", ("model.obj", "model.ply", "model.off", "model.stl")
# The background and the object may be this many folders up: one serves all grasps.
LEVELS_UP = 3
# An axis off unit length by more than this is no rounding error.
LENGTH_TOLERANCE = 1e-3


def is_grasp(folder: str | Path) -> bool:
    """True for a folder with sensors' poses and a first image."""
    return (Path(folder) / POSES).is_file() and (Path(folder) / IMAGE.format(0)).is_file()


def grasps_in(folder: Path) -> list[Path]:
    """The folder itself, or the grasps in it, at most two levels down."""
    if is_grasp(folder):
        return [folder]
    return sorted(path.parent for path in (*folder.glob(f"*/{POSES}"), *folder.glob(f"*/*/{POSES}")))


def convert(folder: Path, out: Path, model: ObjectModel | None = None) -> Converted:
    """Write one grasp as a capture of one frame (world: robot base; the hand: the sensors where they were).

    Raises PalpateError, one line, for what is missing, malformed or of another size.
    """
    background_file = _above(folder, (BACKGROUND,), "the untouched skin's image")
    background = located(background_file, images.read_rgb)
    if model is None:
        model = ObjectModel.load(
            _above(folder, MODELS, "the object (or --object MESH)"), name=folder.resolve().parent.name
        )
    world_from_model = _poses(folder / POSES)
    gel = digit_gel((background.shape[1], background.shape[0]), background)
    shown: dict[str, GelImage] = {}
    for number in range(len(world_from_model)):
        path = folder / IMAGE.format(number)
        if not path.is_file():
            raise CaptureError(f"{path}: expected an image for each of {len(world_from_model)} poses, found none")
        image = located(path, images.read_rgb)
        if image.shape != background.shape:
            want, got = (f"{shape[1]}x{shape[0]}" for shape in (background.shape, image.shape))
            raise CaptureError(f"{path}: expected an image of {want} pixels as {background_file}, got {got}")
        shown[f"digit{number}"] = image
    hand = _hand(world_from_model, gel)
    contacts = Contacts(np.zeros((0, 3)))
    if (folder / CONTACTS).is_file():
        points = read_off(folder / CONTACTS).points
        if len(points) != len(world_from_model):
            raise CaptureError(f"{folder / CONTACTS}: expected {len(world_from_model)} points, got {len(points)}")
        contacts = Contacts(points, sensors=list(shown))
    frame = Frame(0, str(folder), hand=hand, joints={}, world_from_hand=np.eye(4), contacts=contacts, gels=shown)
    notes = {"source": "digit-grasps", "folder": folder.name}
    return Converted((write_capture(out, [frame], model, hand, world="robot base", notes=notes),), 1)


def _above(folder: Path, names: tuple[str, ...], what: str) -> Path:
    for place in [folder, *folder.resolve().parents][: LEVELS_UP + 1]:
        for name in names:
            if (place / name).is_file():
                return place / name
    raise CaptureError(f"{folder}: expected {what} in {' or '.join(names)}, there or above, found none")


def _poses(path: Path) -> list[Array]:
    """world_from_model (4, 4) of every line."""
    try:
        lines = [line for line in path.read_text(encoding="utf-8-sig").splitlines() if line.strip()]
    except (OSError, UnicodeDecodeError) as error:
        raise CaptureError(f"{path}: expected a text file of poses, it cannot be read") from error
    out = []
    for number, line in enumerate(lines, 1):
        where = f"{path}, line {number}"
        try:
            x, y, z, *axis, angle = bop.numbers(line.replace(",", " ").split(), 7, where)
        except InputError as error:
            raise CaptureError(str(error)) from error
        length = float(np.linalg.norm(axis))
        if abs(length - 1.0) > LENGTH_TOLERANCE:
            raise CaptureError(f"{where}: expected an axis of length 1, got {length:.4g}")
        out.append(poses.make_pose(poses.exp_rotation(np.array(axis) / length * angle), (x, y, z)))
    if not out:
        raise CaptureError(f"{path}: expected a pose of every sensor, got none")
    return out


def _hand(world_from_model: list[Array], gel: Gel) -> Hand:
    """The sensors where they were: no joints that move."""
    links: dict[str, tuple[Shape, ...]] = {"base": ()}
    joints, sensors = [], {}
    for number, pose in enumerate(world_from_model):
        name = f"digit{number}"
        links[name] = (_housing(),)
        joints.append(Joint(f"{name}_mount", "fixed", "base", name, pose, np.array([1.0, 0.0, 0.0])))
        sensors[name] = Sensor(name, name, "gel", model_from_sensor(), gel=gel)
    return Hand(Robot("digits", "base", links, tuple(joints)), sensors)


def _housing() -> Shape:
    import trimesh

    low, high = np.array(HOUSING).T
    box = trimesh.creation.box(high - low)
    vertices = np.asarray(box.vertices, dtype=np.float64) + 0.5 * (low + high)
    centre = poses.make_pose(None, 0.5 * (low + high))
    return Shape("box", tuple(float(x) for x in high - low), centre, vertices, np.asarray(box.faces, dtype=np.int64))
