"""Write frames as a capture that `scenes.recordings.captures` reads back: the folder appears whole or not at all."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from scenes.errors import CaptureError, InputError, unknown
from scenes.files.formats import images, tables
from scenes.files.formats.ply import write_ply
from scenes.files.problems import refuse
from scenes.files.whole import draft_folder, put
from scenes.geometry.appearance.texture import coloured_mesh
from scenes.geometry.objects import METRES_PER_UNIT, ObjectModel
from scenes.recordings import bop
from scenes.recordings.beliefs import Beliefs
from scenes.recordings.frames import DEFAULT_SIGMA_NORMAL, Frame
from scenes.recordings.telling import Told, beliefs_json, believed
from scenes.robot.hands import Hand

FORMAT = "palpate-capture"
VERSION = 1
OBJECT_ID = 1
WORLDS = ("camera", "robot base")
# What a capture is written as, and the results that runs leave beside it: all that may be replaced by another capture.
_OWN = re.compile(
    r"(capture|scene_camera|rgb_camera|scene_gt|scene_gt_info|prior|result)\.json"
    r"|(joints|hand_poses|contacts|no_contact|wrenches|poses)\.csv"
    r"|(result|times)\.jsonl|report\.html|report/(pictures\.jsonl|[^/]+\.jpg|part_\d+\.js)"
    r"|track\.checkpoint|grasp\.(json|html)"
    r"|(depth|rgb)/\d{6,}\.png|clouds/\d{6,}\.ply|mask_visib/\d{6,}_\d{6,}\.png"
    r"|models/(obj_\d{6,}\.ply|models_info\.json)"
    r"|hand/(hand\.urdf|sensors\.json|meshes/[^/]+\.stl)"
    r"|tactile/[^/]+/\d{6,}\.(csv|png)"
    # what desktops leave in any folder that was looked at
    r"|([^/]+/)*(\.DS_Store|Thumbs\.db|desktop\.ini)"
)


def write_capture(
    folder: str | Path,
    frames: Iterable[Frame],
    model: ObjectModel,
    hand: Hand | None = None,
    world: str = "camera",
    depth_scale: float | Mapping[int, float] = 0.1,
    model_unit: str = "m",
    with_mask: bool = True,
    notes: Mapping[str, Any] | None = None,
    object_id: int = OBJECT_ID,
) -> Path:
    """Write a capture and return its folder; frames are written as they come, so an iterator may be long.

    world: "camera" or "robot base". depth_scale: millimetres per count of the depth images (0.1 reaches 6.5 m), one for
    all or by the number of every frame that has a camera. object_id: BOP's number of the object, from 0.
    model_unit: unit of the mesh file, one of m, cm, mm, inch. with_mask: write the frames' masks where they have one.
    notes: kept in capture.json (how it was made); so is what the frames say their sensors are worth, all of them the
    same. An older capture of the same name is replaced once the new one is complete, with results that lie in it;
    raises CaptureError for a folder that holds any other file, InputError for frames that do not fit.
    """
    folder = Path(folder)
    if not isinstance(model, ObjectModel):
        raise InputError(f"model: expected ObjectModel (ObjectModel.load(path)), got {type(model).__name__}")
    if not isinstance(frames, Iterable):
        raise InputError(f"frames: expected several ([frame]), got {type(frames).__name__}")
    if world not in WORLDS:
        raise unknown("world", world, WORLDS)
    _check_scales(depth_scale)
    if model_unit not in METRES_PER_UNIT:
        raise unknown("unit", model_unit, METRES_PER_UNIT)
    _check_notes(notes)
    refuse_foreign_folder(folder)
    with draft_folder(folder) as partial:
        _write_model(partial, model, model_unit, object_id)
        _write_hand(partial, hand)
        recorder = _Recorder(partial, world, depth_scale, with_mask, object_id)
        if recorder.write(frames) == 0:
            raise InputError(f"{folder}: expected at least one frame to write, got none")
        bop.write_json(
            partial / "capture.json",
            {
                "format": FORMAT,
                "version": VERSION,
                "object": {"id": object_id, "model": model_file(object_id), "unit": model_unit, "name": model.name},
                "hand": None if hand is None else {"urdf": "hand/hand.urdf", "sensors": "hand/sensors.json"},
                "world": world,
                **({"beliefs": beliefs_json(recorder.beliefs)} if recorder.beliefs is not None else {}),
                **({"notes": dict(notes)} if notes else {}),
            },
        )
        put(partial, folder)
    return folder


def tell(folder: str | Path, told: Iterable[Told]) -> None:
    """Lay tables of beliefs over those of a capture's capture.json; InputError for what has no place."""
    path = Path(folder) / "capture.json"
    content = bop.read_json(path, refuse)
    before = [("beliefs", content["beliefs"])] if "beliefs" in content else []
    content["beliefs"] = beliefs_json(believed(None, [*before, *told]))
    bop.write_json(path, content)


def model_file(object_id: int) -> str:
    """Where a capture keeps its mesh, by BOP's number of the object."""
    return f"models/obj_{object_id:06d}.ply"


def refuse_foreign_folder(folder: Path) -> None:
    """Raise CaptureError when `folder` exists and holds anything but a capture and what palpate leaves in one: the line
    names the first file that nobody here has written, for replacing the folder would lose it.
    """
    if folder.is_dir():
        plain = (folder / "capture.json").is_file()
        foreign = next((name for name in _names_below(folder) if not plain or _OWN.fullmatch(name) is None), None)
        if foreign is not None:
            expected = "expected a new, empty or capture folder to write to"
            raise CaptureError(f"{folder}: {expected}, it holds other files: {foreign}")
    elif folder.exists():
        raise CaptureError(f"{folder}: expected a folder to write to, found a file")


def _names_below(folder: Path) -> Iterator[str]:
    """Everything in the folder but folders, by its name from there; links to folders are not followed."""
    for place, folders, files in os.walk(folder):
        folders.sort()
        links = [name for name in folders if (Path(place) / name).is_symlink()]
        for name in sorted([*files, *links]):
            yield (Path(place) / name).relative_to(folder).as_posix()


def _check_scales(depth_scale: float | Mapping[int, float]) -> None:
    """Raise InputError for millimetres per count that reading would refuse."""
    for scale in depth_scale.values() if isinstance(depth_scale, Mapping) else (depth_scale,):
        low, high = bop.DEPTH_SCALES
        number = isinstance(scale, int | float | np.integer | np.floating) and not isinstance(scale, bool)
        if not (number and low <= scale <= high):
            raise InputError(f"depth_scale: expected millimetres per count from {low:g} to {high:g}, got {scale!r}")


def _check_notes(notes: Mapping[str, Any] | None) -> None:
    """Raise InputError for notes that no JSON file can hold."""
    if notes is not None and not isinstance(notes, Mapping):
        raise InputError(f"notes: expected values by name, got {type(notes).__name__}")
    for name, value in (notes or {}).items():
        if not isinstance(name, str):
            raise InputError(f"notes: expected words as names, got {name!r:.60}")
        try:
            json.dumps(value, allow_nan=False)
        except (TypeError, ValueError, RecursionError) as error:
            hint = ": tolist()?" if isinstance(value, np.ndarray | np.generic) else ""
            got = " ".join(repr(value).split())[:60]
            raise InputError(f"notes: {name}: expected what JSON can hold, got {got}{hint}") from error


def _write_model(folder: Path, model: ObjectModel, unit: str, object_id: int) -> None:
    (folder / "models").mkdir()
    vertices, faces, colours = coloured_mesh(model.vertices, model.faces, model.texture)
    write_ply(folder / model_file(object_id), vertices / METRES_PER_UNIT[unit], faces, colours)
    info = {str(object_id): bop.model_json(model.vertices, model.diameter, model.symmetries)}
    bop.write_json(folder / "models" / "models_info.json", info)


def _write_hand(folder: Path, hand: Hand | None) -> None:
    if hand is not None:
        hand.save(folder / "hand")


class _Recorder:
    """Collects the rows of the CSVs and JSONs while images and clouds go to disk frame by frame."""

    def __init__(
        self, folder: Path, world: str, depth_scale: float | Mapping[int, float], with_mask: bool, object_id: int
    ) -> None:
        self.folder, self.world, self.depth_scale, self.with_mask = folder, world, depth_scale, with_mask
        self.object_id = object_id
        self.cameras: dict[str, Any] = {}
        self.truths: dict[str, Any] = {}
        self.priors: dict[str, Any] = {}
        self.rows: dict[str, list[tuple[object, ...]]] = {}
        self.beliefs: Beliefs | None = None

    def write(self, frames: Iterable[Frame]) -> int:
        """Write them all; returns how many there were."""
        seen: set[int] = set()
        for frame in frames:
            if frame.index in seen or frame.index < 0:
                again = " again" if frame.index in seen else ""
                raise InputError(f"{self.folder}: expected frame numbers from 0, each once, got {frame.index}{again}")
            if seen and frame.beliefs != self.beliefs:
                raise InputError(f"{self.folder}: expected frames of the same beliefs, got others in {frame.index}")
            seen.add(frame.index)
            self.beliefs = frame.beliefs
            self._frame(frame)
        for name, entries in (
            ("scene_camera.json", self.cameras),
            ("scene_gt.json", self.truths),
            ("prior.json", self.priors),
        ):
            if entries:
                bop.write_json(self.folder / name, entries)
        for name, columns in (
            ("joints.csv", tables.JOINTS),
            ("hand_poses.csv", tables.HAND_POSES),
            ("contacts.csv", tables.CONTACTS),
            ("no_contact.csv", tables.NO_CONTACT),
            ("wrenches.csv", tables.WRENCHES),
        ):
            if name in self.rows:
                tables.write_table(self.folder / name, columns, self.rows[name])
        return len(seen)

    def _add(self, name: str, *rows: tuple[object, ...]) -> None:
        if rows:
            self.rows.setdefault(name, []).extend(rows)

    def _scale(self, number: int) -> float:
        """Millimetres per count of the frame's depth image."""
        if not isinstance(self.depth_scale, Mapping):
            return float(self.depth_scale)
        if number not in self.depth_scale:
            raise InputError(f"frame {number}: expected a depth_scale of every frame with a camera, found none of this")
        return float(self.depth_scale[number])

    def _frame(self, frame: Frame) -> None:
        number, key = f"{frame.index:06d}", str(frame.index)
        moved = not np.allclose(frame.camera_from_world, np.eye(4), atol=1e-9)
        if self.world == "camera" and moved:
            raise InputError(f'frame {key}: expected camera_from_world to be the identity in a world of "camera"')
        if frame.depth is not None and frame.camera is None:
            raise InputError(f"frame {key}: expected a camera for the depth image")
        if frame.camera is not None:
            scale = self._scale(frame.index)
            size = (frame.camera.width, frame.camera.height)
            pose = frame.camera_from_world if self.world != "camera" else None
            self.cameras[key] = bop.camera_json(bop.SceneCamera(frame.camera.matrix, scale, pose, size))
            if frame.depth is not None:
                images.write_depth(self.folder / "depth" / f"{number}.png", frame.depth, scale)
        if frame.rgb is not None:
            images.write_rgb(self.folder / "rgb" / f"{number}.png", frame.rgb)
        if frame.mask is not None and self.with_mask:
            images.write_mask(self.folder / "mask_visib" / f"{number}_000000.png", frame.mask)
        if frame.cloud is not None:
            (self.folder / "clouds").mkdir(exist_ok=True)
            write_ply(self.folder / "clouds" / f"{number}.ply", frame.cloud, colours=frame.cloud_colours)
        if frame.camera_from_object_truth is not None:
            self.truths[key] = bop.truth_json(frame.camera_from_object_truth, self.object_id)
        if frame.prior is not None:
            self.priors[key] = frame.prior.tolist()
        self._hand(frame)
        self._touch(frame)

    def _hand(self, frame: Frame) -> None:
        self._add("joints.csv", *((frame.index, name, float(x)) for name, x in (frame.joints or {}).items()))
        if frame.world_from_hand is not None:
            self._add("hand_poses.csv", (frame.index, *frame.world_from_hand.ravel().tolist()))

    def _touch(self, frame: Frame) -> None:
        felt = frame.contacts
        sigmas = np.stack([felt.sigma_point, felt.sigma_normal], axis=1)
        sigmas[~felt.sigma_told, 0] = np.nan
        # the default is read where nothing stands
        sigmas[~felt.sigma_told & (felt.sigma_normal == DEFAULT_SIGMA_NORMAL), 1] = np.nan
        numbers = np.concatenate([felt.points, felt.normals, felt.forces, sigmas], axis=1).tolist()
        self._add("contacts.csv", *((frame.index, name, *row) for name, row in zip(felt.sensors, numbers)))
        empty = frame.no_contact
        if empty is not None:
            numbers = np.concatenate([empty.points, empty.radius[:, None]], axis=1).tolist()
            self._add("no_contact.csv", *((frame.index, name, *row) for name, row in zip(empty.sensors, numbers)))
        self._add(
            "wrenches.csv",
            *((frame.index, w.sensor, *map(float, w.force), *map(float, w.torque)) for w in frame.wrenches),
        )
        for sensor, pressure in frame.tactile.items():
            path = self.folder / "tactile" / sensor / f"{frame.index:06d}.csv"
            path.parent.mkdir(parents=True, exist_ok=True)
            rows = [(taxel, float(p)) for taxel, p in enumerate(pressure) if np.isfinite(p)]
            tables.write_table(path, tables.TACTILE, rows)
        for sensor, image in frame.gels.items():
            path = self.folder / "tactile" / sensor / f"{frame.index:06d}.png"
            if image.ndim == 2:
                images.write_counts(path, image)
            else:
                images.write_rgb(path, image.astype(np.uint8))
