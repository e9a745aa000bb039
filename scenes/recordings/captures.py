"""Recordings: one folder, many frames, each read when it is asked for. Metres, radians, newtons.

The layout is BOP's where BOP has one (scene_camera.json, scene_gt.json, depth/, rgb/, mask_visib/, models/), with CSVs
for what a hand knows. Every optional part may be missing. Whatever is malformed goes to a `report` with its file and
frame: reading refuses at the first, `scenes.recordings.checking.validation` collects them all by the same code.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from scenes.errors import CaptureError, InputError, PalpateError
from scenes.files.formats import images, tables
from scenes.files.framed import FramedTable
from scenes.files.inside import refuse_links_outside, stays_inside
from scenes.files.problems import Problem, Report, refuse
from scenes.geometry import poses
from scenes.geometry.cameras import Camera
from scenes.geometry.objects import ObjectModel
from scenes.recordings import bop
from scenes.recordings.beliefs import Beliefs, usual_beliefs
from scenes.recordings.frames import Contacts, EmptyRegions, Frame, GelImage, Wrench
from scenes.recordings.manifest import read_manifest, read_model
from scenes.recordings.registration import registered
from scenes.recordings.writing import write_capture
from scenes.robot.gels import image_problem
from scenes.robot.hands import Hand

__all__ = ["Capture", "read_capture", "write_capture"]

Array = NDArray[np.float64]
T = TypeVar("T")

_log = logging.getLogger(__name__)
CSV_FILES = {
    "joints.csv": tables.JOINTS,
    "hand_poses.csv": tables.HAND_POSES,
    "contacts.csv": tables.CONTACTS,
    "no_contact.csv": tables.NO_CONTACT,
    "wrenches.csv": tables.WRENCHES,
}


class Capture:
    """A folder of frames. len, iteration, capture[position] and capture.frame(number); every Frame is read anew.

    Attributes: path; manifest (capture.json); frame_ids, sorted; model and hand, read at the first use.
    """

    def __init__(self, path: str | Path, report: Report = refuse, trust_paths: bool = False) -> None:
        """Read capture.json and find the frames; use `read_capture`. Raises CaptureError for no capture at all, and for
        one that leads out of its folder unless its paths are trusted.
        """
        self.path = Path(path)
        self._within = None if trust_paths else self.path
        if self.path.is_dir() and not trust_paths:
            refuse_links_outside(self.path)
        self.report = report
        self.manifest = read_manifest(self.path, report)
        self._tables = {name: self._table(name) for name in CSV_FILES}
        self._cameras = self._by_frame("scene_camera.json")
        self._rgb_cameras = self._by_frame("rgb_camera.json")
        self._truths = self._by_frame("scene_gt.json")
        self._priors = self._by_frame("prior.json")
        self._tactile = self._tactile_files(".csv")
        self._gels = self._tactile_files(".png")
        self.frame_ids = self._find_frames()
        self._known = frozenset(self.frame_ids)
        self._check_strays()
        _log.info("%s: %s, %d of its frames", self.path, self.manifest.name, len(self.frame_ids))

    @property
    def name(self) -> str:
        """The folder's name."""
        return self.path.resolve().name

    @property
    def world(self) -> str:
        """What the world frame is: "camera" or "robot base"."""
        return self.manifest.world

    @cached_property
    def beliefs(self) -> Beliefs | None:
        """What capture.json says its sensors are worth, None where it says nothing; every frame has the same. An image
        that rgb_camera.json says another camera took is that camera's, has it colours or not.
        """
        if not self._rgb_cameras:
            return self.manifest.beliefs
        said = self.manifest.beliefs or usual_beliefs()
        return replace(said, image=said.image.of_another_camera())

    def __len__(self) -> int:
        return len(self.frame_ids)

    def __iter__(self) -> Iterator[Frame]:
        return (self.frame(number) for number in self.frame_ids)

    def __getitem__(self, position: int) -> Frame:
        if position not in range(-len(self), len(self)):
            raise IndexError(f"{self.path}: expected a place from 0 to {len(self) - 1}, got {position!r}: frame(N)?")
        return self.frame(self.frame_ids[position])

    @cached_property
    def model(self) -> ObjectModel:
        """The object, metres, with the symmetries of models_info.json."""
        stays_inside(self.path / self.manifest.model, self._within, self._file("capture.json"))
        return read_model(self.path, self.manifest)

    @cached_property
    def hand(self) -> Hand | None:
        """The hand, or None when the capture has none."""
        if self.manifest.hand is None:
            return None
        urdf, sensors = (None if part is None else self.path / part for part in self.manifest.hand)
        for part in (urdf, sensors):
            if part is not None:
                stays_inside(part, self._within, self._file("capture.json"))
        if urdf is None or not urdf.is_file():
            raise CaptureError(f"{self.path / 'capture.json'}: expected a hand URDF at {urdf}, found none")
        if sensors is not None and not sensors.is_file():
            raise CaptureError(f"{self.path / 'capture.json'}: expected the hand's sensors at {sensors}, found none")
        return Hand.load(urdf, sensors, self._within)

    def frame(self, number: int) -> Frame:
        """The frame of that number. Raises CaptureError for one that is not there or is malformed."""
        if number not in self._known:
            raise CaptureError(f"{self.path}: expected a frame of {_span(self.frame_ids)}, got {number}")
        camera, camera_from_world = None, np.eye(4)
        entry = self._attempt("scene_camera.json", number, lambda: self._camera_entry(number))
        depth = self._image("depth", number, lambda path: images.read_depth(path, entry.depth_scale if entry else 1.0))
        rgb = self._image("rgb", number, images.read_rgb)
        rgb = self._attempt("rgb_camera.json", number, lambda: self._registered(number, rgb, depth, entry))
        truth = self._attempt("scene_gt.json", number, lambda: self._truth(number))
        mask_name = f"mask_visib/{number:06d}_{truth[1] if truth else 0:06d}.png"
        # a mask's second number is its object's row: in a frame of other objects alone all are theirs
        foreign = truth is None and number in self._truths
        mask = None if foreign else self._image_file(mask_name, number, images.read_mask)
        fits = self._same_size(number, {"depth": depth, "rgb": rgb, mask_name: mask})
        rgb, mask = rgb if fits["rgb"] else None, mask if fits[mask_name] else None
        shape = next((image.shape for image in (depth, rgb, mask) if image is not None), None)
        if entry is not None:
            camera = self._attempt("scene_camera.json", number, lambda: bop.camera(entry, shape))
            camera_from_world = np.eye(4) if entry.camera_from_world is None else entry.camera_from_world
        cloud, colours = self._cloud(number)
        return Frame(
            index=number,
            where=f"{self.path}, frame {number}",
            camera=camera,
            camera_from_world=camera_from_world,
            depth=depth if camera is not None else None,  # what is wrong with its camera is reported
            rgb=rgb,
            mask=mask,
            cloud=cloud,
            cloud_colours=colours,
            hand=self._attempt("capture.json", None, lambda: self.hand),
            joints=self._joints(number),
            world_from_hand=self._hand_pose(number),
            contacts=self._contacts(number),
            no_contact=self._no_contact(number),
            wrenches=self._wrenches(number),
            tactile=self._taxels(number),
            gels=self._gel_images(number),
            prior=self._attempt("prior.json", number, lambda: self._prior(number)),
            camera_from_object_truth=truth[0] if truth else None,
            beliefs=self.beliefs,
        )

    # ---- files of the whole capture

    def _file(self, name: str) -> str:
        return str(self.path / name)

    def _attempt(self, name: str, number: int | None, read: Callable[[], T | None]) -> T | None:
        """What `read` returns, or None after a report of what it raised."""
        try:
            return read()
        except PalpateError as error:
            self.report(Problem(self._file(name), number, str(error)))
            return None

    def _table(self, name: str) -> FramedTable | tables.CsvTable:
        path = self.path / name
        return FramedTable(path, CSV_FILES[name], self.report) if path.is_file() else tables.CsvTable(str(path))

    def _by_frame(self, name: str) -> Mapping[int, Any]:
        path = self.path / name
        return bop.read_frames(path, self.report) if path.is_file() else {}

    def _numbered(self, folder: str, suffix: str) -> set[int]:
        """Frames that have a file in the folder, by its name."""
        files = (self.path / folder).glob(f"*{suffix}") if (self.path / folder).is_dir() else ()
        return {int(path.stem) for path in files if path.stem.isdecimal()}

    def _tactile_files(self, suffix: str) -> dict[str, set[int]]:
        root = self.path / "tactile"
        sensors = sorted(path.name for path in root.iterdir() if path.is_dir()) if root.is_dir() else []
        return {sensor: self._numbered(f"tactile/{sensor}", suffix) for sensor in sensors}

    def _find_frames(self) -> tuple[int, ...]:
        seen = set(self._cameras) | self._numbered("clouds", ".ply")
        seen |= self._numbered("depth", ".png") | self._numbered("rgb", ".png")
        if not seen:  # touch alone: the frames are those that feel something
            seen = {int(frame) for table in self._tables.values() for frame in table.frames()}
            seen = seen.union(*self._tactile.values(), *self._gels.values())
        if not seen:
            message = "expected frames (scene_camera.json, depth/, clouds/ or contacts.csv), found none"
            self.report(Problem(str(self.path), None, message))
        return tuple(sorted(seen))

    def _check_strays(self) -> None:
        """Whatever speaks of a frame that does not exist was meant for another capture, or numbers are off by one."""
        known = set(self.frame_ids)
        spoken = {name: set(map(int, np.unique(table.frames()))) for name, table in self._tables.items()}
        spoken |= {"scene_gt.json": set(self._truths), "prior.json": set(self._priors)}
        spoken["rgb_camera.json"] = set(self._rgb_cameras)
        spoken |= {f"tactile/{sensor}": self._gels[sensor] | frames for sensor, frames in self._tactile.items()}
        for name, frames in spoken.items():
            for frame in sorted(frames - known):
                self.report(Problem(self._file(name), frame, f"expected a frame of {_span(self.frame_ids)}"))
        for frame in sorted(self._numbered("depth", ".png") - set(self._cameras)):
            self.report(Problem(self._file("scene_camera.json"), frame, "expected a camera for the depth image"))

    # ---- parts of one frame

    def _camera_entry(self, number: int) -> bop.SceneCamera | None:
        if number not in self._cameras:
            return None
        entry = bop.camera_entry(self._cameras[number])
        moved = entry.camera_from_world
        if self.world == "camera" and moved is not None and not np.allclose(moved, np.eye(4), atol=1e-6):
            raise CaptureError('expected no cam_R_w2c, cam_t_w2c when the world is "camera", got another pose')
        return entry

    def _registered(
        self,
        number: int,
        rgb: NDArray[np.uint8] | None,
        depth: NDArray[np.float32] | None,
        entry: bop.SceneCamera | None,
    ) -> NDArray[np.uint8] | None:
        """The colour image as the depth camera has it, where rgb_camera.json says that another camera took it."""
        if number not in self._rgb_cameras or rgb is None or depth is None or entry is None:
            return rgb
        own = bop.rgb_camera_entry(self._rgb_cameras[number])
        camera, other = bop.camera(entry, depth.shape), Camera.from_matrix(own[0], rgb.shape[1], rgb.shape[0])
        return registered(rgb, other, depth, camera, own[1])

    def _truth(self, number: int) -> tuple[Array, int] | None:
        entry = self._truths.get(number)
        return None if entry is None else bop.truth_entry(entry, self.manifest.object_id)

    def _prior(self, number: int) -> Array | None:
        return bop.prior_entry(self._priors[number]) if number in self._priors else None

    def _image(self, folder: str, number: int, read: Callable[[Path], T]) -> T | None:
        name = f"{folder}/{number:06d}.png"
        # a folder of depth images that lacks one is a damaged recording, not a camera that was not there
        if folder == "depth" and (self.path / folder).is_dir() and not (self.path / name).is_file():
            self.report(Problem(self._file(name), number, "expected a depth image, found none"))
            return None
        return self._image_file(name, number, read)

    def _image_file(self, name: str, number: int, read: Callable[[Path], T]) -> T | None:
        path = self.path / name
        return self._attempt(name, number, lambda: read(path)) if path.is_file() else None

    def _same_size(self, number: int, seen: dict[str, NDArray[Any] | None]) -> dict[str, bool]:
        """Which images have the size of the first that is there; the others are reported."""
        shapes = {name: image.shape[:2] for name, image in seen.items() if image is not None}
        fits = dict.fromkeys(seen, True)
        for name, shape in shapes.items():
            first, expected = next(iter(shapes.items()))
            if shape != expected:
                fits[name] = False
                sizes = f"{expected[1]}x{expected[0]} pixels like {first}, got {shape[1]}x{shape[0]}"
                self.report(Problem(self._file(name), number, f"expected {sizes}"))
        return fits

    def _cloud(self, number: int) -> tuple[Array | None, NDArray[np.uint8] | None]:
        from scenes.files.formats.ply import read_cloud

        name = f"clouds/{number:06d}.ply"
        if not (self.path / name).is_file():
            return None, None
        return self._attempt(name, number, lambda: read_cloud(self.path / name)) or (None, None)

    def _joints(self, number: int) -> dict[str, float] | None:
        rows = self._tables["joints.csv"].of_frame(number)
        if len(rows) == 0:
            return None
        names, positions = rows.texts["joint"], rows.numbers["position"]
        joints = {name: float(position) for name, position in zip(names, positions)}
        if len(joints) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            self.report(Problem(rows.file, number, f"expected each joint once, got {twice} twice"))
        hand = self._attempt("capture.json", None, lambda: self.hand)
        if hand is not None and self._attempt("joints.csv", number, lambda: hand.joint_values(joints)) is None:
            return None
        return joints

    def _hand_pose(self, number: int) -> Array | None:
        rows = self._tables["hand_poses.csv"].of_frame(number)
        if len(rows) == 0:
            return None
        if len(rows) > 1:
            self.report(Problem(rows.file, number, f"expected one pose a frame, got {len(rows)}"))
        matrix = rows.stack(*tables.POSE_NAMES)[0].reshape(4, 4)
        where = f"line {rows.lines[0]}, world_from_hand"
        return self._attempt("hand_poses.csv", number, lambda: poses.check_pose(matrix, where))

    def _contacts(self, number: int) -> Contacts:
        rows = self._tables["contacts.csv"].of_frame(number)
        none = Contacts(np.zeros((0, 3)))
        if len(rows) == 0:
            return none
        return self._attempt("contacts.csv", number, lambda: contacts_of(rows)) or none

    def _no_contact(self, number: int) -> EmptyRegions | None:
        rows = self._tables["no_contact.csv"].of_frame(number)
        if len(rows) == 0:
            return None
        radius = rows.numbers["radius"]
        for line in rows.lines[radius <= 0]:
            self.report(Problem(rows.file, number, f"line {line}, column radius: expected a number above 0"))
        if (radius <= 0).any():
            return None
        places = rows.stack("x", "y", "z"), radius, rows.texts["sensor"]
        return self._attempt("no_contact.csv", number, lambda: EmptyRegions(*places))

    def _wrenches(self, number: int) -> tuple[Wrench, ...]:
        rows = self._tables["wrenches.csv"].of_frame(number)
        if len(rows) == 0:
            return ()
        hand = self._attempt("capture.json", None, lambda: self.hand)
        for name, line in zip(rows.texts["sensor"], rows.lines):
            if hand is None or name not in hand.sensors:
                known = "a hand" if hand is None else f"a sensor of hand {hand.name!r} ({', '.join(hand.sensors)})"
                self.report(Problem(rows.file, number, f"line {line}: expected {known}, got {name!r}"))
        both = np.hstack([rows.stack("fx", "fy", "fz"), rows.stack("mx", "my", "mz")])
        felt = zip(rows.texts["sensor"], both)  # what is no number is reported by its line
        return tuple(Wrench(name, row[:3], row[3:]) for name, row in felt if np.isfinite(row).all())

    def _taxels(self, number: int) -> dict[str, Array]:
        """Pressure by taxel number (0-based) of each array; NaN where a taxel has no row."""
        readings = {}
        for sensor in (name for name, frames in self._tactile.items() if number in frames):
            path = self.path / "tactile" / sensor / f"{number:06d}.csv"
            rows = tables.read_table(path, tables.TACTILE, self.report)
            taxel = rows.numbers["taxel"].astype(np.int64) if len(rows) else np.zeros(0, dtype=np.int64)
            count = self._taxel_count(sensor, path, number)
            if count is None:
                count = int(taxel.max()) + 1 if len(taxel) else 0
            for line in rows.lines[taxel >= count]:
                self.report(Problem(str(path), number, f"line {line}: expected a taxel from 0 to {count - 1}"))
            twice = np.setdiff1d(np.arange(len(taxel)), np.unique(taxel, return_index=True)[1])
            if len(twice):
                message = f"line {rows.lines[twice[0]]}: expected each taxel once, got {taxel[twice[0]]} twice"
                self.report(Problem(str(path), number, message))
            pressure = np.full(count, np.nan)
            inside = taxel < count
            pressure[taxel[inside]] = rows.numbers["pressure"][inside] if len(rows) else ()
            readings[sensor] = pressure
        return readings

    def _gel_images(self, number: int) -> dict[str, GelImage]:
        """What each gel saw: micrometres of indentation or colours, as the hand's sensor says it can."""
        out: dict[str, GelImage] = {}
        for name in (name for name, frames in self._gels.items() if number in frames):
            file = f"tactile/{name}/{number:06d}.png"
            hand = self._attempt("capture.json", None, lambda: self.hand)
            if hand is None:
                continue
            sensor = hand.sensors.get(name)
            if sensor is None or sensor.gel is None:
                known = ", ".join(s.name for s in hand.sensors.values() if s.gel is not None) or "none"
                message = f"expected a gel of hand {hand.name!r} ({known}), got {name!r}"
                self.report(Problem(self._file(file), number, message))
                continue
            image = self._image_file(file, number, images.read_gel_image)
            if image is None:
                continue
            problem = image_problem(image, sensor.gel)
            if problem is not None:
                self.report(Problem(self._file(file), number, problem))
                continue
            out[name] = image
        return out

    def _taxel_count(self, sensor: str, path: Path, number: int) -> int | None:
        hand = self._attempt("capture.json", None, lambda: self.hand)
        if hand is None:
            return None
        if sensor not in hand.sensors:
            names = ", ".join(hand.sensors) or "none"
            self.report(
                Problem(str(path), number, f"expected a sensor of hand {hand.name!r} ({names}), got {sensor!r}")
            )
            return None
        taxels = hand.sensors[sensor].taxels
        return None if taxels is None else len(taxels)


def read_capture(folder: str | Path, trust_paths: bool = False) -> Capture:
    """Open a capture; frames are read when they are asked for.

    trust_paths: also read files outside the folder, which capture.json, the hand's files or links may name; by default
    these are refused.

    Raises CaptureError, one line with file, frame and column, for whatever is missing or malformed: here for
    capture.json and the CSVs, when a frame is read for its images, clouds and joints.
    """
    return Capture(folder, trust_paths=trust_paths)


def contacts_of(rows: tables.CsvTable) -> Contacts:
    """Contacts from rows of a contacts.csv; raises InputError naming the line."""
    parts = {}
    for names in (("nx", "ny", "nz"), ("fx", "fy", "fz")):
        values = rows.stack(*names)
        known = np.isfinite(values)
        for line in rows.lines[known.any(axis=1) & ~known.all(axis=1)]:
            raise InputError(f"line {line}: expected all of {', '.join(names)} or none of them")
        parts[names[0][0]] = values
    sigmas = {}
    for name in ("sigma_point", "sigma_normal"):
        sigmas[name] = rows.numbers[name]
        with np.errstate(invalid="ignore"):
            wrong = rows.lines[sigmas[name] <= 0]
        for line in wrong:
            raise InputError(f"line {line}, column {name}: expected a number above 0, or nothing when unknown")
    return Contacts(
        rows.stack("x", "y", "z"),
        parts["n"],
        sigmas["sigma_point"],
        sigmas["sigma_normal"],
        rows.texts["sensor"],
        parts["f"],
    )


def _span(frames: tuple[int, ...]) -> str:
    return f"the capture's {len(frames)} ({frames[0]} to {frames[-1]})" if frames else "the capture, which has none"
