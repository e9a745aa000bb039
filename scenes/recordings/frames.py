"""What one instant of a recording holds: plain data, no files. SI units; world frame where not said.

A `Frame` carries only what was recorded; every sensor is optional and `None` (or empty) when absent.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, field, fields
from functools import lru_cache
from numbers import Integral
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenes.errors import InputError
from scenes.geometry.cameras import Camera
from scenes.geometry.poses import FARTHEST, inverse, refuse_masked
from scenes.recordings import frame_checks as checks

if TYPE_CHECKING:
    from scenes.recordings.beliefs import Beliefs
    from scenes.robot.hands import Hand

Array = NDArray[np.float64]
# What a gel saw: (h, w) uint16 micrometres of indentation, or (h, w, 3) uint8 colours, red first.
GelImage = NDArray[np.uint16] | NDArray[np.uint8]

# What a contact is worth when the recording does not say (T1 section 4.3: 0.9 mm and 5 degrees).
DEFAULT_SIGMA_POINT = 0.9e-3
DEFAULT_SIGMA_NORMAL = np.deg2rad(5.0)
# Sigmas (m, rad) that a number may stand for: finer than an atom or wider than the Earth they are mistakes, and squares
# of what they divide overflow.
SIGMAS = (1e-12, 1e12)


def _numbers(values: ArrayLike, name: str, what: str = "contacts") -> Array:
    """The values as a float64 array of their own; raises InputError for what is none."""
    refuse_masked(values, f"{what}: {name}")
    try:
        if np.iscomplexobj(values):
            raise TypeError("got complex ones")
        return np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{what}: expected {name} as real numbers: {error}") from error


def _check_places(points: Array, what: str = "contacts") -> None:
    """Raise InputError for points (n, 3) that are no places."""
    near = np.abs(points) < FARTHEST  # NaN is not below it either
    if not near.all():
        bad = ~near.all(axis=1)
        raise InputError(f"{what}: expected finite points, got row {int(np.argmax(bad))} = {points[bad][0]}")


class Contacts:
    """Points that lie on the object's surface, sensed by touch.

    Those of a `Frame` are in the world frame, points as directions. Attributes (one row a contact): points (n, 3)
    metres; normals (n, 3) unit, out of the object, rows of NaN where unknown; sigma_point (n,) metres; sigma_normal
    (n,) radians; sensors, n names (may repeat); forces (n, 3) newtons, NaN where unknown; sigma_told (n,) whether a
    sigma_point was given, or the default stands in.
    """

    def __init__(
        self,
        points: ArrayLike,
        normals: ArrayLike | None = None,
        sigma_point: ArrayLike | None = None,
        sigma_normal: ArrayLike | None = None,
        sensors: list[str] | None = None,
        forces: ArrayLike | None = None,
        sigma_told: ArrayLike | None = None,
    ) -> None:
        """Check and keep; sigma_told: of all contacts or of each, None where the sigmas themselves say it. Raises
        InputError for wrong shapes, points that are no places or a sigma that is none.
        """
        places = _numbers(points, "points")
        if places.size and (places.ndim not in (1, 2) or places.shape[-1] != 3):
            raise InputError(f"contacts: expected points of shape (n, 3), got {places.shape}")
        self.points = places.reshape(-1, 3) if places.size else np.zeros((0, 3))
        n = len(self.points)
        _check_places(self.points)
        self.normals = self._rows(normals, n, 3, "normals")
        with np.errstate(invalid="ignore", over="ignore"):
            length = np.linalg.norm(self.normals, axis=1)
            known = np.isfinite(length) & (length > 1e-9)
        self.normals[~known] = np.nan
        self.normals[known] /= length[known, None]
        if sigma_told is None:
            sigma_told = False if sigma_point is None else ~np.isnan(_numbers(sigma_point, "sigma_point").ravel())
        self.forces = self._rows(forces, n, 3, "forces")
        if np.isinf(self.forces).any():
            raise InputError("contacts: expected finite forces, or NaN where unknown, got infinity")
        self.sigma_point = self._sigma(sigma_point, n, DEFAULT_SIGMA_POINT, "sigma_point")
        self.sigma_told = self._told(sigma_told, n)
        self.sigma_normal = self._sigma(sigma_normal, n, DEFAULT_SIGMA_NORMAL, "sigma_normal")
        self.sensors = checks.sensor_names([f"contact{i}" for i in range(n)] if sensors is None else sensors)
        if len(self.sensors) != n:
            raise InputError(f"contacts: expected {n} sensor names, got {len(self.sensors)}")

    @staticmethod
    def _rows(values: ArrayLike | None, n: int, width: int, name: str) -> Array:
        array = np.zeros(0) if values is None else _numbers(values, name)
        if array.size == 0:
            return np.full((n, width), np.nan)
        if array.shape != (n, width):
            raise InputError(f"contacts: expected {name} of shape ({n}, {width}), got {array.shape}")
        return array

    @staticmethod
    def _sigma(values: ArrayLike | None, n: int, default: float, name: str) -> Array:
        array = np.array(default) if values is None else _numbers(values, name)
        if array.ndim > 1 or array.size not in (1, n):
            raise InputError(f"contacts: expected one {name} or {n} of them, got shape {array.shape}")
        array = np.array(np.broadcast_to(array.ravel() if n else np.zeros(0), (n,)))
        array[np.isnan(array)] = default
        low, high = SIGMAS
        if not ((array >= low) & (array <= high)).all():
            wrong = array[~((array >= low) & (array <= high))][0]
            raise InputError(f"contacts: expected {name} above 0, from {low:g} to {high:g}, got {wrong:g}")
        return array

    @staticmethod
    def _told(values: ArrayLike, n: int) -> NDArray[np.bool_]:
        refuse_masked(values, "contacts: sigma_told")
        told = np.asarray(values)
        if told.dtype.kind not in "biuf" or not np.isin(told, (0, 1)).all():
            raise InputError(f"contacts: expected sigma_told true or false, of all or of each, got {values!r:.60}")
        if told.ndim > 1 or told.size not in (1, n):
            raise InputError(f"contacts: expected one sigma_told or {n} of them, got shape {told.shape}")
        return np.array(np.broadcast_to(told.ravel().astype(np.bool_) if n else np.zeros(0, np.bool_), (n,)))

    @staticmethod
    def none() -> Contacts:
        """No contacts: most frames have none of most kinds."""
        out = copy(_nothing())
        out.sensors = []
        return out

    def __len__(self) -> int:
        return len(self.points)

    @property
    def sigma_known(self) -> bool:
        """Whether every contact said its sigma."""
        return bool(self.sigma_told.all())

    @property
    def has_normal(self) -> NDArray[np.bool_]:
        """(n,) true where the outward normal is known."""
        return np.isfinite(self.normals[:, 0])

    @property
    def first_of_each(self) -> NDArray[np.intp]:
        """(k,) rows of the contacts that are not one before them over again, sensor and every number."""
        if len(np.unique(self.points[:, 0])) == len(self):  # of a million, too, the usual case at once
            return np.arange(len(self))
        sigmas = self.sigma_point[:, None], self.sigma_normal[:, None]
        numbers = np.nan_to_num(np.concatenate([self.points, self.normals, self.forces, *sigmas], axis=1), nan=np.inf)
        rows: dict[tuple[str, bytes], int] = {}
        for i, (name, row) in enumerate(zip(self.sensors, numbers)):
            rows.setdefault((name, row.tobytes()), i)
        return np.array(list(rows.values()), dtype=np.intp)

    def take(self, rows: ArrayLike) -> Contacts:
        """The chosen rows (indices or mask), in that order."""
        chosen = np.asarray(rows)
        index = np.arange(len(self))[chosen if chosen.size else chosen.astype(np.intp)]
        return Contacts(
            self.points[index],
            self.normals[index],
            self.sigma_point[index],
            self.sigma_normal[index],
            [self.sensors[i] for i in index],
            self.forces[index],
            self.sigma_told[index],
        )

    def of_unknown_worth(self, sigma: float) -> Contacts:
        """The same contacts with a sigma (m) that stands in where their recording says none."""
        out = copy(self)
        out.sigma_point = np.where(self.sigma_told, self.sigma_point, sigma)
        return out

    def moved(self, target_from_source: Array) -> Contacts:
        """The same contacts in another frame; InputError for what is no rigid transform (4, 4)."""
        out = copy(self)
        out.sensors = list(self.sensors)
        if not len(self):
            return out
        pose = checks.rigid(target_from_source, "contacts", "moved")
        rotation, translation = pose[:3, :3], pose[:3, 3]
        out.points = self.points @ rotation.T + translation
        _check_places(out.points)
        # what is checked already and turned needs its length only
        out.normals, out.forces = self.normals @ rotation.T, self.forces @ rotation.T
        out.normals /= np.linalg.norm(out.normals, axis=1, keepdims=True)
        out.sigma_point, out.sigma_normal = self.sigma_point.copy(), self.sigma_normal.copy()
        return out

    @staticmethod
    def concatenate(parts: list[Contacts]) -> Contacts:
        """All rows of all parts, in order."""
        if not parts:
            return Contacts.none()
        filled = [p for p in parts if len(p)]
        if len(filled) == 1:
            return filled[0]
        if not filled:
            return Contacts.none()
        return Contacts(
            np.concatenate([p.points for p in parts]),
            np.concatenate([p.normals for p in parts]),
            np.concatenate([p.sigma_point for p in parts]),
            np.concatenate([p.sigma_normal for p in parts]),
            [name for p in parts for name in p.sensors],
            np.concatenate([p.forces for p in parts]),
            np.concatenate([p.sigma_told for p in parts]),
        )


@lru_cache(maxsize=1)
def _nothing() -> Contacts:
    return Contacts(np.zeros((0, 3)))


@dataclass(frozen=True, eq=False)
class EmptyRegions:
    """Balls felt to be empty: points (n, 3) world, metres; radius (n,) metres; sensors, n names.

    Raises InputError for other shapes, points that are no places and radii that are none.
    """

    points: Array
    radius: Array
    sensors: list[str]

    def __post_init__(self) -> None:
        """Check and keep as float64."""
        points, radius = (_numbers(getattr(self, name), name, "no_contact") for name in ("points", "radius"))
        if points.ndim != 2 or points.shape[1] != 3 or radius.shape != points.shape[:1]:
            raise InputError(
                f"no_contact: expected points (n, 3) and a radius (n,), got {points.shape} and {radius.shape}"
            )
        _check_places(points, "no_contact")
        if not ((radius >= 0.0) & (radius < FARTHEST)).all():
            raise InputError(f"no_contact: expected radii of 0 m at least, got {radius.min():g} to {radius.max():g}")
        if len(self.sensors) != len(points):
            raise InputError(f"no_contact: expected {len(points)} sensor names, got {len(self.sensors)}")
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "radius", radius)

    def __len__(self) -> int:
        return len(self.points)


@dataclass(frozen=True, eq=False)
class Wrench:
    """Raw force (3,) N and torque (3,) N m of one force/torque sensor, in the sensor's frame.

    Raises InputError for other shapes and for what is no number: nothing could be made of it.
    """

    sensor: str
    force: Array
    torque: Array

    def __post_init__(self) -> None:
        """Check and keep as float64."""
        checks.sensor_names([self.sensor], "wrench")
        for name in ("force", "torque"):
            value = _numbers(getattr(self, name), name, f"wrench of {self.sensor}")
            if value.shape != (3,):
                raise InputError(f"wrench of {self.sensor}: expected {name} of shape (3,), got {value.shape}")
            if not np.isfinite(value).all():
                raise InputError(f"wrench of {self.sensor}: expected a finite {name}, got {value}")
            object.__setattr__(self, name, value)


@dataclass(frozen=True, eq=False)
class Frame:
    """One instant of a capture.

    camera: intrinsics, None when there is no camera. camera_from_world (4, 4).
    depth (h, w) float32 metres along z, 0 = no reading. rgb (h, w, 3) uint8. mask (h, w) bool, the object's pixels.
    cloud (n, 3) world frame. joints: name -> radians or metres. world_from_hand (4, 4).
    tactile: pressures (k,) Pa of each array. gels: the image of each gel.
    camera_from_object_truth and prior (4, 4): ground truth and coarse start, when the recording has them;
    hand_from_object_truth (4, 4): where a simulated hand really holds it.
    beliefs: what the recording says its sensors are worth; None says nothing.
    where: file and frame, for messages.

    Checked when it is made, with one InputError that says what was expected, what came and where: images and camera are
    of one size, transforms rigid, depth in floating-point metres. A mask of two values (OpenCV's 0 and 255), float64
    depth, lists, and contacts as points (n, 3) are taken as what they mean; what is masked of a depth image
    (`numpy.ma`) is no reading, elsewhere it is refused. Readings and points of a cloud that are no numbers are left to
    the estimator, which drops and counts them. A frame equals itself and no other.
    """

    index: int
    where: str = ""
    camera: Camera | None = None
    camera_from_world: Array = field(default_factory=lambda: np.eye(4))
    depth: NDArray[np.float32] | None = None
    rgb: NDArray[np.uint8] | None = None
    mask: NDArray[np.bool_] | None = None
    cloud: Array | None = None
    cloud_colours: NDArray[np.uint8] | None = None
    hand: Hand | None = None
    joints: dict[str, float] | None = None
    world_from_hand: Array | None = None
    contacts: Contacts = field(default_factory=Contacts.none)
    no_contact: EmptyRegions | None = None
    wrenches: tuple[Wrench, ...] = ()
    tactile: dict[str, Array] = field(default_factory=dict)
    gels: dict[str, GelImage] = field(default_factory=dict)
    prior: Array | None = None
    camera_from_object_truth: Array | None = None
    hand_from_object_truth: Array | None = None
    beliefs: Beliefs | None = None

    def __post_init__(self) -> None:
        """Check every part that is there and bring it to the type above."""
        where = self.where or f"frame {self.index}"
        if not isinstance(self.index, Integral) or isinstance(self.index, bool):
            raise InputError(f"frame: expected its number first, a whole one, got {type(self.index).__name__}")
        object.__setattr__(self, "index", int(self.index))  # a number of fixed size would overflow

        def put(name: str, check: Callable[..., Any], *more: Any) -> None:
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, check(value, *more))

        if self.camera_from_world is None:
            raise InputError(f"{where}: camera_from_world: expected a 4x4 transform, got None")
        put("depth", checks.depth_image, where)
        put("rgb", checks.colour_image, where)
        put("mask", checks.mask_image, where)
        put("cloud", checks.points_of, where, "cloud")
        put("cloud_colours", checks.colours_of, self.cloud, where)
        for name in (
            "camera_from_world",
            "world_from_hand",
            "prior",
            "camera_from_object_truth",
            "hand_from_object_truth",
        ):
            put(name, checks.rigid, where, name)
        put("joints", checks.joint_positions, where)
        put("tactile", checks.pressures, where)
        put("gels", checks.gel_images, where)
        if self.camera is not None or self.depth is not None:
            checks.instance(self.camera, Camera, where, "camera", "Camera.from_matrix(K, width, height)")
        if self.beliefs is not None:
            from scenes.recordings.beliefs import Beliefs

            checks.instance(self.beliefs, Beliefs, where, "beliefs", "Beliefs(depth=…)")
        sizes = {
            name: (image.shape[1], image.shape[0])
            for name, image in (("depth", self.depth), ("rgb", self.rgb), ("mask", self.mask))
            if image is not None
        }
        if sizes and self.camera is not None:
            sizes = {"camera": (self.camera.width, self.camera.height)} | sizes
        if sizes:
            checks.same_size(sizes, where)
        self._check_touch(where)
        if self.hand is not None and self.joints is None and not self.hand.joint_names:
            object.__setattr__(self, "joints", {})  # nothing is unknown of a hand that has none

    def _check_touch(self, where: str) -> None:
        if self.hand is not None:
            from scenes.robot.hands import Hand

            checks.instance(self.hand, Hand, where, "hand", "Hand.load(urdf)")
        if not isinstance(self.contacts, Contacts):
            try:
                felt = Contacts(np.zeros((0, 3)) if self.contacts is None else self.contacts)
            except InputError as error:
                raise InputError(f"{where}: {error}: Contacts(points, normals)?") from error
            object.__setattr__(self, "contacts", felt)
        if self.no_contact is not None:
            checks.instance(self.no_contact, EmptyRegions, where, "no_contact", "points, radius, sensors")
        if not isinstance(self.wrenches, tuple):
            checks.instance(self.wrenches, list, where, "wrenches", "of Wrench")
            object.__setattr__(self, "wrenches", tuple(self.wrenches))
        for wrench in self.wrenches:
            checks.instance(wrench, Wrench, where, "wrenches", "sensor, force, torque")

    def __repr__(self) -> str:
        """What there is, without its numbers."""
        parts = {f.name: getattr(self, f.name) for f in fields(self)}
        empty = [name for name, part in parts.items() if part is None or (isinstance(part, tuple | dict) and not part)]
        there = [name for name in parts if name not in ("index", "where", "camera_from_world", "contacts", *empty)]
        felt = [f"{len(self.contacts)} contacts"] if len(self.contacts) else []
        return f"Frame({self.index}: {', '.join((*there, *felt)) or 'nothing'})"

    @property
    def hand_lacks(self) -> str:
        """What is not known of the hand, "pose", "joints" or both, so that it is left out; "" for all, or no hand."""
        if self.hand is None:
            return ""
        pose, joints = self.world_from_hand is None, self.joints is None
        return " and ".join(name for name, lacks in (("pose", pose), ("joints", joints)) if lacks)

    def without_vision(self) -> Frame:
        """The frame without what a camera gave."""
        return self._with(depth=None, rgb=None, mask=None, cloud=None, cloud_colours=None)

    def without_touch(self) -> Frame:
        """The frame without what touch gave."""
        return self._with(contacts=Contacts.none(), no_contact=None, wrenches=(), tactile={}, gels={})

    def _with(self, **parts: Any) -> Frame:
        """The frame with other parts, of which there is nothing to check; what stays was checked when it came."""
        out = copy(self)
        out.__dict__.update(parts)
        return out

    def hand_from_object(self, pose: Array, correction: Array) -> Array | None:
        """(4, 4) of the object at pose (4, 4) camera_from_object, the camera-robot calibration corrected; None without
        a hand pose.
        """
        if self.world_from_hand is None:
            return None
        return inverse(correction @ self.camera_from_world @ self.world_from_hand) @ pose
