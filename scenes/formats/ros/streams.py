"""What a bag holds beside its images: each topic's messages with their stamps, and the one nearest to an instant.

Joints, wrenches, pressures and contacts in SI units; stamps in nanoseconds.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.errors import CaptureError, PalpateError
from scenes.formats.conversion import Dropped
from scenes.formats.ros.bag import frame_id, numbers, pick, vectors
from scenes.formats.ros.topics import Topic
from scenes.formats.ros.transforms import TransformTree
from scenes.geometry import poses
from scenes.recordings.frames import Contacts, Wrench
from scenes.robot.hands import Hand
from scenes.robot.urdf import MOVING

Array = NDArray[np.float64]


@dataclass
class Stream:
    """Messages of one topic in time order: stamps (n,), values (whatever the role makes of them), which were used.

    What `nearest` gives is used only once `settle` says that its frame is kept.
    """

    topic: Topic
    stamps: list[int] = field(default_factory=list)
    values: list[Any] = field(default_factory=list)
    used: set[int] = field(default_factory=set)
    taken: set[int] = field(default_factory=set)

    def add(self, stamp: int, value: Any) -> None:
        """Keep one more, in any order."""
        self.stamps.append(stamp)
        self.values.append(value)

    def sort(self) -> None:
        """By stamp; of several of one stamp the first received comes first."""
        order = sorted(range(len(self.stamps)), key=self.stamps.__getitem__)
        self.stamps = [self.stamps[i] for i in order]
        self.values = [self.values[i] for i in order]

    def nearest(self, stamp: int, tolerance_ns: int | None) -> int | None:
        """Position of the message nearest to `stamp`, the earlier of two; None when it is farther than the tolerance
        (None: no matter how far).
        """
        at = nearest(self.stamps, stamp, tolerance_ns)
        if at is not None:
            self.taken.add(at)
        return at

    def settle(self, kept: bool) -> None:
        """Whether the frame that messages were taken for is kept."""
        self.used |= self.taken if kept else set()
        self.taken = set()


def nearest(stamps: list[int], stamp: int, tolerance_ns: int | None) -> int | None:
    """Position in the sorted `stamps` nearest to `stamp`, the earlier of two, None when none is near enough."""
    after = bisect_left(stamps, stamp)
    near = [i for i in (after - 1, after) if 0 <= i < len(stamps)]
    if not near:
        return None
    best = min(near, key=lambda i: abs(stamps[i] - stamp))
    return best if tolerance_ns is None or abs(stamps[best] - stamp) <= tolerance_ns else None


class Joints:
    """Positions by joint, each joint with its own times: several drivers may publish parts of a robot on one topic."""

    def __init__(self, topic: Topic, hand: Hand | None, dropped: Dropped) -> None:
        self.topic, self._dropped = topic, dropped
        self._rename: dict[str, str] = topic.options.get("names", {})
        self._known = None if hand is None else {joint.name for joint in hand.robot.joints if joint.kind in MOVING}
        self._samples: dict[str, list[tuple[int, float, int]]] = {}
        self._stamps: dict[str, list[int]] = {}
        self._messages = 0
        self._used: set[int] = set()
        self._taken: set[int] = set()

    def add(self, stamp: int, message: Any) -> None:
        """Keep the positions of a JointState, before the first `at`; raises CaptureError when they do not fit its names
        or are not finite.
        """
        names, positions = list(message.name), np.asarray(message.position, dtype=np.float64)
        if len(names) != len(positions):
            raise CaptureError(
                f"{self.topic.name}: expected a position for each of {len(names)} names, got {len(positions)}"
            )
        if not np.isfinite(positions).all():
            name = names[int(np.argmax(~np.isfinite(positions)))]
            raise CaptureError(f"{self.topic.name}: expected finite positions, got one of {name} that is not")
        for name, position in zip(names, positions.tolist()):
            own = self._rename.get(name, name)
            if self._known is not None and own not in self._known:
                self._dropped.add(self.topic.name, "positions of joints that the hand does not have")
                continue
            self._samples.setdefault(own, []).append((stamp, position, self._messages))
        self._messages += 1

    def at(self, stamp: int, tolerance_ns: int) -> dict[str, float]:
        """The position of each joint nearest in time, of those near enough."""
        found = {}
        for name, rows in self._samples.items():
            if name not in self._stamps:
                rows.sort()
                self._stamps[name] = [row[0] for row in rows]
            best = nearest(self._stamps[name], stamp, tolerance_ns)
            if best is not None:
                found[name] = rows[best][1]
                self._taken.add(rows[best][2])
        return found

    def settle(self, kept: bool) -> None:
        """Whether the frame that positions were taken for is kept."""
        self._used |= self._taken if kept else set()
        self._taken = set()

    @property
    def names(self) -> set[str]:
        """The joints that were published, as the hand calls them."""
        return set(self._samples)

    @property
    def unused(self) -> int:
        """Messages of which no frame took a position."""
        return self._messages - len(self._used)


def wrench_of(topic: Topic, message: Any) -> Wrench:
    """A Wrench of geometry_msgs WrenchStamped (or Wrench); raises CaptureError when it is not finite."""
    inner = getattr(message, "wrench", message)
    rows = vectors([inner.force, inner.torque], topic.name)
    if not np.isfinite(rows).all():
        raise CaptureError(f"{topic.name}: expected finite forces and torques, got {rows.ravel()}")
    return Wrench(topic.options["sensor"], rows[0], rows[1])


def pressures_of(topic: Topic, message: Any, taxels: int | None) -> Array:
    """(k,) pressures in pascal; raises CaptureError when their number is not the sensor's."""
    values = numbers(pick(message, topic.options["field"], topic.name), topic.name) * topic.options.get("scale", 1.0)
    if taxels is not None and len(values) != taxels:
        sensor = topic.options["sensor"]
        raise CaptureError(f"{topic.name}: expected {taxels} pressures as {sensor} has taxels, got {len(values)}")
    return values


def contacts_of(topic: Topic, message: Any, dropped: Dropped) -> list[tuple[str, Contacts]]:
    """The contacts of a message by the TF frame they are in, at least one entry; raises CaptureError for fields that do
    not fit together. Those at zero are dropped and counted where the map says that it stands for no known place.
    """
    options, where = topic.options, topic.name
    points = vectors(pick(message, options["points"], where), where)
    parts: dict[str, Array | None] = {"normals": None, "forces": None}
    for name in parts:
        if name in options:
            parts[name] = vectors(pick(message, options[name], where), where)
            if len(parts[name]) != len(points):  # type: ignore[arg-type]
                raise CaptureError(f"{where}: expected {len(points)} {name} like points, got {len(parts[name])}")  # type: ignore[arg-type]
    normals = parts["normals"]
    if normals is not None and options.get("flip_normals", False):
        normals = -normals
    names = [options.get("sensor", where.strip("/"))] * len(points)
    if "sensor_field" in options:
        names = [str(name) for name in pick(message, options["sensor_field"], where)]
        names = names * len(points) if len(names) == 1 else names
    sigmas = options.get("sigma_point"), options.get("sigma_normal")
    try:
        felt = Contacts(points, normals, *sigmas, names, parts["forces"])
    except PalpateError as error:
        raise CaptureError(f"{where}: {error}") from error
    somewhere = np.ones(len(felt), dtype=np.bool_)
    if options.get("zero_unknown", False):
        somewhere = np.asarray(points.any(axis=1), dtype=np.bool_)
    if not somewhere.all():
        dropped.add(where, "contacts at 0 0 0, which stands for no known place", int((~somewhere).sum()))
    if "frame_field" not in options or not len(felt):
        return [(options.get("frame", "").lstrip("/") or frame_id(message), felt.take(somewhere))]
    frames = [str(name).lstrip("/") for name in pick(message, options["frame_field"], where)]
    if len(frames) != len(felt):
        raise CaptureError(f"{where}: expected a frame for each of {len(felt)} contacts, got {len(frames)}")
    felt, frames = felt.take(somewhere), [name for name, kept in zip(frames, somewhere) if kept]
    if not frames:
        return [(frame_id(message), felt)]
    return [(frame, felt.take([name == frame for name in frames])) for frame in dict.fromkeys(frames)]


def marker_of(topic: Topic, message: Any) -> Array:
    """(4, 4) tracker_from_marker: the pose of that index of a PoseArray; raises CaptureError for none."""
    index = topic.options.get("index", 0)
    rows = list(getattr(message, "poses", ()))
    if index >= len(rows):
        raise CaptureError(f"{topic.name}: expected at least {index + 1} poses, got {len(rows)}")
    q, t = rows[index].orientation, rows[index].position
    quaternion = np.array([q.w, q.x, q.y, q.z], dtype=np.float64)
    place = np.array([t.x, t.y, t.z], dtype=np.float64)
    length = float(np.linalg.norm(quaternion)) if np.isfinite(quaternion).all() else 0.0
    if not np.isfinite(place).all() or abs(length - 1.0) > 1e-2:
        raise CaptureError(f"{topic.name}: expected a finite pose with a unit quaternion, got length {length:.4g}")
    return poses.make_pose(poses.from_quaternion(quaternion / length), place)


def placed(
    felt: Contacts, frame: str, stamp: int, world: str, tree: TransformTree, topic: str, dropped: Dropped
) -> Contacts:
    """Contacts of a TF frame in the world frame, at their own time; those without a transform are dropped."""
    pose = np.eye(4) if frame == world or not len(felt) else tree.lookup(world, frame, stamp)
    if pose is None:
        dropped.add(topic, f"contacts without a transform from {frame} to {world} at their time", len(felt))
        return felt.take([False] * len(felt))
    return felt.moved(pose)


def check_pose_or_none(pose: Array | None) -> Array | None:
    """The pose with its rotation made orthonormal to the last bit."""
    return None if pose is None else poses.check_pose(pose)
