"""FeelSight logs (Suresh et al., NeuralFeels, Science Robotics 2024) as captures, one a camera.

`OBJECT/LOG/`: `realsense/CAMERA/image/N.jpg`, `seg/N.jpg` (255 the object, 127 the hand, 0 else), `depth.npz` (`depth`
(n, h, w), `depth_scale`); `allegro/FINGER/image|depth|mask/N.jpg`; `data.pkl`, a dict with `object.pose` (4x4 each,
world), `allegro.base_pose`, `allegro.joint_state` (16 each), `realsense.CAMERA.intrinsics` and `.pose`, `digit_info`
(`intrinsics`, `cam_dist`, `depth_scale`). The pickle is read as data (scenes.files.formats.pickles).

Two things the layout leaves open are told by the numbers, and said: whether depth_scale multiplies or divides, by which
gives distances of a table-top; whether a camera looks along its +z or -z, by where the object is. The fingers' `depth`
is how far the skin is above the lowest point the model's gel could be pressed to: counts / depth_scale metres below the
skin's highest point. Gels need the hand: without `--hand` they are dropped and counted.
"""

from __future__ import annotations

import re
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.errors import CaptureError, InputError
from scenes.files.formats import images
from scenes.files.formats.pickles import read_plain
from scenes.formats.conversion import Converted, Dropped, at_least_one, located
from scenes.geometry import poses
from scenes.geometry.cameras import Camera
from scenes.geometry.objects import ObjectModel
from scenes.recordings.captures import write_capture
from scenes.recordings.frames import Frame, GelImage
from scenes.robot.gels import MICROMETRE
from scenes.robot.hands import Hand

Array = NDArray[np.float64]

DATA, CAMERAS, FINGERS = "data.pkl", "realsense", "allegro"
# JPEG smears 255, 127 and 0 into one another: nearer to 255 than to 127 is the object.
OBJECT_ABOVE = 191
# Distances (m) at which a table-top camera sees a hand; beyond, depth_scale was meant the other way.
TABLE_TOP = (0.05, 5.0)
# Uncompressed depth of 30 s at 30 images a second in VGA is 550 MB in 16 bit, twice that in 32.
LARGEST_DEPTH = 4 * 1024**3
JOINTS = 16
# What intrinsics may say of a lens.
DISTORTION = ("k1", "k2", "p1", "p2", "k3")


def is_log(folder: str | Path) -> bool:
    """True for a folder with data.pkl and a camera."""
    return (Path(folder) / DATA).is_file() and (Path(folder) / CAMERAS).is_dir()


@dataclass(frozen=True)
class _Log:
    """What data.pkl says, checked. world_from_object (n, 4, 4) or None; world_from_hand (n or 1, 4, 4) or None; joints
    (n, 16) or None; NaN in them all where an image has none; digit: counts per metre of the fingers' depth, or None.
    """

    path: Path
    content: dict[Any, Any]
    world_from_object: Array | None
    world_from_hand: Array | None
    joints: Array | None
    digit: float | None


def convert(folder: Path, out: Path, model: ObjectModel, hand: Hand | None = None) -> Converted:
    """Write the log: OUT for one camera, OUT/CAMERA for several.

    hand: with 16 joints and, for the fingers' images, gels named like the folders in allegro/. Raises PalpateError, one
    line, for what is missing, damaged, hostile or of another shape.
    """
    log = _read(folder)
    cameras = sorted(path for path in (folder / CAMERAS).iterdir() if path.is_dir())
    if not cameras:
        raise CaptureError(f"{folder / CAMERAS}: expected a folder a camera, found none")
    described = [path for path in cameras if _entry(log.content, f"{CAMERAS}.{path.name}") is not None]
    if hand is not None and len(hand.joint_names) != JOINTS:
        raise InputError(f"hand: expected {JOINTS} joints as the log's, got {len(hand.joint_names)} of {hand.name!r}")
    dropped, written, remarks, count = Dropped(), [], [], 0
    if described:  # of none, the first says what is missing
        for path in cameras:
            if path not in described:
                dropped.add(f"{CAMERAS}/{path.name}", f"nothing about it in {DATA}")
        cameras = described
    for camera in cameras:
        target = out if len(cameras) == 1 else out / camera.name
        # what is no camera's is counted once
        frames, said = _frames(log, camera, hand, dropped if camera == cameras[0] else Dropped())
        numbers: list[int] = []
        whole = at_least_one(_counted(frames, numbers), camera, dropped)
        notes = {"source": "feelsight", "log": folder.name, "camera": camera.name}
        written.append(write_capture(target, whole, model, hand, world="robot base", notes=notes))
        remarks += said
        count += len(numbers)
    return Converted(tuple(written), count, dropped, tuple(dict.fromkeys(remarks)))


def _counted(frames: Iterator[Frame], numbers: list[int]) -> Iterator[Frame]:
    for frame in frames:
        numbers.append(frame.index)
        yield frame


def _read(folder: Path) -> _Log:
    path = folder / DATA
    if not path.is_file():
        raise CaptureError(f"{path}: expected the log's data, found none")
    content = read_plain(path)
    if not isinstance(content, dict):
        raise CaptureError(f"{path}: expected a dict, got {type(content).__name__}")
    joints = _entry(content, "allegro.joint_state")
    if joints is not None:
        joints = _array(_filled(joints, (JOINTS,)), f"{path}: allegro.joint_state", gaps=True)
        if joints.ndim != 2 or joints.shape[1] != JOINTS:
            raise CaptureError(f"{path}: allegro.joint_state: expected (n, {JOINTS}) joints, got {joints.shape}")
    scale = _entry(content, "digit_info.depth_scale")
    if scale is not None:
        scale = float(_array(scale, f"{path}: digit_info.depth_scale").ravel()[0])
        if not scale > 0:
            raise CaptureError(f"{path}: digit_info.depth_scale: expected a number above 0, got {scale:g}")
    return _Log(
        path,
        content,
        _poses(_entry(content, "object.pose"), f"{path}: object.pose"),
        _poses(_entry(content, "allegro.base_pose"), f"{path}: allegro.base_pose"),
        joints,
        scale,
    )


def _entry(content: dict[Any, Any], name: str) -> Any:
    """content[a][b]… for "a.b…", or content["a.b…"]; None when it is not there."""
    if name in content:
        return content[name]
    found: Any = content
    for part in name.split("."):
        if not isinstance(found, dict) or part not in found:
            return None
        found = found[part]
    return found


def _array(values: Any, where: str, gaps: bool = False) -> Array:
    """Finite numbers; with `gaps` rows of which nothing is finite may be among them, and become NaN."""
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise CaptureError(f"{where}: expected numbers, got {type(values).__name__}") from error
    if not array.size:
        raise CaptureError(f"{where}: expected numbers, got none")
    finite = np.isfinite(array)
    if gaps and array.ndim > 1:
        whole = finite.reshape(len(array), -1).all(axis=1)
        array[~whole] = np.nan
        finite = np.array([whole.any()])
    if not finite.all():
        raise CaptureError(f"{where}: expected finite numbers, got {int((~finite).sum())} that are not")
    return array


def _filled(values: Any, shape: tuple[int, ...]) -> Any:
    """A list's None, which loggers write for "not seen", as NaN of that shape."""
    if not isinstance(values, (list, tuple)):
        return values
    return [np.full(shape, np.nan) if value is None else value for value in values]


def _poses(values: Any, where: str) -> Array | None:
    """(n, 4, 4) rigid transforms, NaN where an image has none; None for None."""
    if values is None:
        return None
    array = _array(_filled(values, (4, 4)), where, gaps=True)
    array = array[None] if array.shape == (4, 4) else array
    if array.ndim != 3 or array.shape[1:] != (4, 4):
        raise CaptureError(f"{where}: expected 4x4 poses, got shape {array.shape}")
    for number, pose in enumerate(array):
        if np.isfinite(pose).all():
            poses.check_pose(pose, f"{where}, {number}")
    return array


def _of(values: Array | None, number: int) -> Array | None:
    """Of image `number`; one for all holds for all. None where there is none."""
    if values is None or (len(values) > 1 and number >= len(values)):
        return None
    found = np.asarray(values[min(number, len(values) - 1)])
    return found if np.isfinite(found).all() else None


def _frames(log: _Log, folder: Path, hand: Hand | None, dropped: Dropped) -> tuple[Iterator[Frame], list[str]]:
    """The frames of one camera, made as they are asked for, and what was told by the numbers."""
    where = f"{log.path}: {CAMERAS}.{folder.name}"
    matrix, size = _intrinsics(_entry(log.content, f"{CAMERAS}.{folder.name}.intrinsics"), f"{where}.intrinsics")
    world_from_camera = _poses(_entry(log.content, f"{CAMERAS}.{folder.name}.pose"), f"{where}.pose")
    if world_from_camera is None:
        raise CaptureError(f"{where}.pose: expected the camera's pose, found none")
    depth, said = _depth(folder / "depth.npz")
    colours, segments = _numbered(folder / "image"), _numbered(folder / "seg")
    world_from_camera, turned = _forward(world_from_camera, log.world_from_object)
    remarks = [said] if said else []
    lens = _entry(log.content, f"{CAMERAS}.{folder.name}.intrinsics")
    if isinstance(lens, dict) and any(np.any(lens.get(key) or 0.0) for key in DISTORTION):
        remarks.append(f"camera {folder.name} has a distortion, which is not undone")
    if turned:
        remarks.append(f"camera {folder.name} looks along its -z: turned to look along +z")
    fingers = _fingers(log, hand, dropped)
    count = len(depth) if depth is not None else max(colours, default=-1) + 1
    if not count:
        raise CaptureError(f"{folder}: expected depth.npz or image/N.jpg, found neither")

    def frames() -> Iterator[Frame]:
        for number in range(count):
            rgb = located(colours[number], images.read_rgb) if number in colours else None
            mask = None
            if number in segments:
                mask = located(segments[number], images.read_rgb)[:, :, 0] > OBJECT_ABOVE
            shapes = {
                image.shape[:2] for image in (rgb, mask, None if depth is None else depth[number]) if image is not None
            }
            if len(shapes) > 1:
                sizes = ", ".join(f"{w}x{h}" for h, w in sorted(shapes))
                raise CaptureError(f"{folder}, image {number}: expected images of one size, got {sizes}")
            shape = shapes.pop() if shapes else size
            if shape is None:
                dropped.add("images", "nothing of this number to see")
                continue
            pose = _of(world_from_camera, number)
            if pose is None:
                dropped.add("images", "no camera pose of this number")
                continue
            camera_from_world = poses.inverse(pose)
            held, joints = _of(log.world_from_hand, number), None if hand is None else _of(log.joints, number)
            truth = _of(log.world_from_object, number)
            known = hand is not None and joints is not None and held is not None
            yield Frame(
                index=number,
                where=f"{folder}, image {number}",
                camera=Camera.from_matrix(matrix, shape[1], shape[0]),
                camera_from_world=camera_from_world,
                depth=None if depth is None else depth[number],
                rgb=rgb,
                mask=mask,
                hand=hand,
                joints=dict(zip(_joint_order(hand), map(float, joints))) if hand and joints is not None else None,
                world_from_hand=held if known else None,
                gels={
                    name: _gel_image(finger, number, log.digit, hand)
                    for name, finger in fingers.items()
                    if number in finger
                }
                if known and hand is not None
                else {},
                camera_from_object_truth=None if truth is None else camera_from_world @ truth,
            )

    return frames(), remarks


def _joint_order(hand: Hand) -> list[str]:
    """The hand's joints in the log's order: index, middle, ring, thumb, which is that of the numbers in their names
    (`joint_0.0` to `joint_15.0`); a left hand's URDF lists its fingers the other way round. As listed without numbers.
    """
    found = [re.search(r"(\d+)(?:\.0)?$", name) for name in hand.joint_names]
    numbers = [int(one.group(1)) for one in found if one is not None]
    if sorted(numbers) != list(range(JOINTS)):
        return list(hand.joint_names)
    return [name for _, name in sorted(zip(numbers, hand.joint_names))]


def _intrinsics(entry: Any, where: str) -> tuple[Array, tuple[int, int] | None]:
    """K (3, 3), and (h, w) when it is said."""
    if isinstance(entry, dict) and {"fx", "fy", "cx", "cy"} <= set(entry):
        fx, fy, cx, cy = (float(_array(entry[key], where).ravel()[0]) for key in ("fx", "fy", "cx", "cy"))
        matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        size = [_side(entry, keys, where) for keys in (("h", "height"), ("w", "width"))]
        shape = (size[0], size[1]) if min(size) > 0 else None
    elif entry is not None and np.shape(entry) == (3, 3):
        matrix, shape = _array(entry, where), None
    else:
        raise CaptureError(f"{where}: expected fx, fy, cx, cy or a 3x3 matrix, got {type(entry).__name__}")
    if min(matrix[0, 0], matrix[1, 1]) <= 0:
        raise CaptureError(f"{where}: expected focal lengths above 0 pixels, got {matrix[0, 0]:g}, {matrix[1, 1]:g}")
    return matrix, shape


def _side(entry: dict[Any, Any], names: tuple[str, ...], where: str) -> int:
    """Pixels by the first of the names that is there; 0 for none."""
    found = next((entry[name] for name in names if entry.get(name) is not None), 0)
    return int(_array(found, f"{where}: {names[0]}").ravel()[0])


def _depth(path: Path) -> tuple[NDArray[np.float32] | None, str]:
    """(n, h, w) metres, 0 = no reading, and what was told by the numbers; None without the file."""
    if not path.is_file():
        return None, ""
    try:
        with zipfile.ZipFile(path) as archive:
            if sum(info.file_size for info in archive.infolist()) > LARGEST_DEPTH:
                raise CaptureError(f"{path}: expected up to {LARGEST_DEPTH >> 30} GB of depth images, got more")
        with np.load(path, allow_pickle=False) as stored:
            raw, scale = np.asarray(stored["depth"]), float(np.asarray(stored["depth_scale"]).ravel()[0])
    except (OSError, KeyError, ValueError, IndexError, TypeError, EOFError, zipfile.BadZipFile) as error:
        said = (str(error).splitlines() or ["damaged"])[0]
        raise CaptureError(f"{path}: expected arrays depth and depth_scale, got {said[:80]}") from error
    raw = raw[..., 0] if raw.ndim == 4 and raw.shape[3] == 1 else raw
    if raw.ndim != 3 or raw.dtype.kind not in "uif" or not (np.isfinite(scale) and scale > 0):
        raise CaptureError(f"{path}: expected depth (n, h, w) and depth_scale above 0, got {raw.shape}, {scale:g}")
    values = np.nan_to_num(np.abs(raw).astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)
    seen = values[values > 0]
    if not len(seen):
        raise CaptureError(f"{path}: expected depth readings, got zeros")
    middle = float(np.median(seen))
    for factor, how in ((scale, "metres per count"), (1.0 / scale, "counts per metre")):
        if TABLE_TOP[0] <= middle * factor <= TABLE_TOP[1]:
            return (values * np.float32(factor)).astype(np.float32), f"depth_scale {scale:g} taken as {how}"
    far = f"{middle * scale:.3g} or {middle / scale:.3g} m"
    raise CaptureError(
        f"{path}: expected depths of {TABLE_TOP[0]} to {TABLE_TOP[1]} m, got {far} by depth_scale {scale:g}"
    )


def _numbered(folder: Path) -> dict[int, Path]:
    """Images by their number."""
    if not folder.is_dir():
        return {}
    found = (path for path in sorted(folder.iterdir()) if path.suffix.lower() in (".jpg", ".jpeg", ".png"))
    return {int(path.stem): path for path in found if path.stem.isdecimal() and len(path.stem) <= 9}


def _forward(world_from_camera: Array, world_from_object: Array | None) -> tuple[Array, bool]:
    """The camera's poses with z into the scene, and whether they were turned: the object is before a camera."""
    if world_from_object is None:
        return world_from_camera, False
    count = max(len(world_from_camera), len(world_from_object))
    for number in range(count):  # the first image that has both
        camera, seen = _of(world_from_camera, number), _of(world_from_object, number)
        if camera is not None and seen is not None:
            if (poses.inverse(camera) @ seen)[2, 3] > 0:
                return world_from_camera, False
            break
    else:
        return world_from_camera, False
    return world_from_camera @ np.diag([1.0, -1.0, -1.0, 1.0]), True


def _fingers(log: _Log, hand: Hand | None, dropped: Dropped) -> dict[str, dict[int, Path]]:
    """Depth images of each finger's gel by the sensor's name; what cannot be used is counted."""
    root = log.path.parent / FINGERS
    out: dict[str, dict[int, Path]] = {}
    for folder in sorted(path for path in root.iterdir() if path.is_dir()) if root.is_dir() else ():
        depth, colour = _numbered(folder / "depth"), _numbered(folder / "image")
        name = f"{FINGERS}/{folder.name}"
        sensor = None if hand is None else hand.sensors.get(folder.name)
        if sensor is None or sensor.gel is None:
            dropped.add(name, "no --hand with a gel of that name", max(len(depth), len(colour)))
        elif not depth or log.digit is None:
            dropped.add(name, "colours without a background, and no depth (real logs have none)", len(colour))
        else:
            out[folder.name] = depth
    return out


def _gel_image(finger: dict[int, Path], number: int, scale: float | None, hand: Hand) -> GelImage:
    """Micrometres of indentation of a gel from the log's height image."""
    assert scale is not None
    path = finger[number]
    counts = located(path, images.read_rgb)[:, :, 0].astype(np.float64)
    gel = hand.sensors[path.parent.parent.name].gel
    assert gel is not None
    if counts.shape != (gel.height, gel.width):
        got = f"{counts.shape[1]}x{counts.shape[0]}"
        raise CaptureError(f"{path}: expected an image of {gel.width}x{gel.height} pixels as the gel's, got {got}")
    mask_path = path.parent.parent / "mask" / path.name
    touched = located(mask_path, images.read_rgb)[:, :, 0] > 127 if mask_path.is_file() else counts > 0
    if touched.shape != counts.shape:
        want, got = (f"{shape[1]}x{shape[0]}" for shape in (counts.shape, touched.shape))
        raise CaptureError(f"{mask_path}: expected an image of {want} pixels as {path.name} of depth, got {got}")
    # heights are below the skin's highest point; its own sag is no indentation
    sag = float(gel.surface.max()) - gel.surface
    depth = np.where(touched, np.clip(counts / scale - sag, 0.0, gel.thickness), 0.0)
    return np.rint(depth / MICROMETRE).astype(np.uint16)
