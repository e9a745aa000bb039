"""A ROS bag as a capture, by a topic map: every depth image becomes a frame, with what was published nearest to it.

Time is that of the messages' headers. A message goes with a depth image when no other of its topic is nearer and it is
within the map's tolerance; transforms are interpolated (`transforms`); contacts move to the world at their time.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.errors import CaptureError, InputError
from scenes.formats.conversion import (
    Converted,
    Dropped,
    at_least_one,
    check_undistorted,
    gaps_of,
    numbers_in_time,
    period_of,
)
from scenes.formats.ros.bag import Bag, frame_id, open_bag, stamp_ns
from scenes.formats.ros.pixels import IMAGES, Plan, Scale, whole_frames
from scenes.formats.ros.streams import (
    Joints,
    Stream,
    check_pose_or_none,
    contacts_of,
    marker_of,
    placed,
    pressures_of,
    wrench_of,
)
from scenes.formats.ros.topics import Topic, TopicMap
from scenes.formats.ros.transforms import TransformTree
from scenes.geometry.cameras import Camera
from scenes.geometry.objects import ObjectModel
from scenes.recordings import bop
from scenes.recordings.captures import write_capture
from scenes.recordings.frames import Contacts, Frame
from scenes.robot.hands import Hand

Array = NDArray[np.float64]

# Message types that a role can be read from; tactile and contacts may be of any type.
TYPES = {
    "depth": ("Image", "CompressedImage"),
    "rgb": ("Image", "CompressedImage"),
    "mask": ("Image", "CompressedImage"),
    "camera_info": ("CameraInfo",),
    "joints": ("JointState",),
    "wrench": ("WrenchStamped", "Wrench"),
    "marker": ("PoseArray",),
    "tf": ("TFMessage", "tfMessage"),
    "tf_static": ("TFMessage", "tfMessage"),
}


@dataclass
class _Recording:
    """Everything of a bag but the pixels."""

    tree: TransformTree
    hand: Hand | None
    streams: dict[str, Stream] = field(default_factory=dict)
    joints: list[Joints] = field(default_factory=list)
    sizes: dict[str, tuple[int, int]] = field(default_factory=dict)


def convert(path: Path, out: Path, topics: TopicMap, model: ObjectModel | None = None) -> Converted:
    """Write the bag as a capture; model: instead of the map's object.

    Frames are numbered from 0 by their stamps, in periods of the depth camera; the stamps are kept in the notes. Raises
    PalpateError, one line, for a damaged bag, a topic that is not there, a type or encoding that a role cannot be read
    from, numbers that are not finite, a frame that TF does not know.
    """
    if model is None:
        if topics.mesh is None:
            raise InputError(f'{topics.path}: expected "object" with a model, got none: name one or say --object MESH')
        model = ObjectModel.load(topics.mesh[0], unit=topics.mesh[1], name=topics.mesh[2])
    dropped = Dropped()
    missing: Counter[str] = Counter()
    with open_bag(path, topics.definitions) as bag:
        there = tuple(t for t in topics.topics if t.name in bag.types or not t.options.get("optional", False))
        topics = replace(topics, topics=there)
        _check_topics(bag, topics)
        recording = _read(bag, topics, dropped)
        plans = _plan(path, topics, recording, dropped, missing)
        period = period_of(recording.streams[topics.of_role("depth")[0].name].stamps)
        for plan, number in zip(plans, numbers_in_time([plan.stamp for plan in plans], period)):
            plan.frame = replace(plan.frame, index=number)
        scale = Scale(topics.of_role("depth")[0].options.get("depth_scale"))
        whole = whole_frames(bag, topics, plans, scale, dropped)
        frames = (replace(frame, beliefs=topics.beliefs) for frame in whole)
        stamps = {str(plan.frame.index): plan.stamp for plan in plans}
        notes = {"source": "ros", "bag": path.name, "tolerance_s": topics.tolerance_s, "stamps_ns": stamps}
        written = write_capture(
            out,
            at_least_one(frames, path, dropped),
            model,
            recording.hand,
            topics.world,
            scale.by_frame,
            notes=notes,
        )
    near = f"{1e3 * topics.tolerance_s:g} ms"
    remarks = [f"{n} of {len(plans)} frames without {what} within {near}" for what, n in missing.items()]
    remarks += scale.remarks(topics.of_role("depth")[0].name)
    remarks += [*_silent_joints(recording), *gaps_of([plan.frame.index for plan in plans], period)]
    return Converted((written,), len(plans), dropped, tuple(remarks))


def _silent_joints(recording: _Recording) -> list[str]:
    """A remark on the joints of the hand that the bag is silent about."""
    if recording.hand is None or not recording.joints:
        return []
    said = set().union(*(joints.names for joints in recording.joints))
    silent = [name for name in recording.hand.joint_names if name not in said]
    return [f"joints of the hand on no topic, taken as 0: {', '.join(silent)}"] if silent else []


def _check_topics(bag: Bag, topics: TopicMap) -> None:
    for topic in topics.topics:
        if topic.name not in bag.types:
            known = ", ".join(sorted(bag.types)) or "none"
            raise CaptureError(f"{bag.path}: expected the topic {topic.name} of {topics.path.name}, got {known}")
        kind = bag.types[topic.name].rpartition("/")[2]
        if kind not in TYPES.get(topic.role, (kind,)):
            where, expected = f"{bag.path}, {topic.name}", " or ".join(TYPES[topic.role])
            raise CaptureError(f"{where}: expected {expected} for the role {topic.role}, got {bag.types[topic.name]}")


# ---- first pass: everything but the pixels


def _read(bag: Bag, topics: TopicMap, dropped: Dropped) -> _Recording:
    tolerance = round(1e9 * topics.tolerance_s)
    hand = None if topics.hand is None else Hand.load(*topics.hand)
    recording = _Recording(TransformTree(tolerance), hand)
    for parent, child, pose in topics.static_frames:
        recording.tree.fix(parent, child, pose, str(topics.path))
    by_name = {topic.name: topic for topic in topics.topics}
    joints = {topic.name: Joints(topic, hand, dropped) for topic in topics.of_role("joints")}
    recording.joints = list(joints.values())
    for topic in topics.topics:
        if topic.role not in ("joints", "tf", "tf_static"):
            recording.streams[topic.name] = Stream(topic)
            _check_sensor(topics, topic, hand)
    counts: Counter[str] = Counter()
    for name, received, message in bag.messages(list(by_name)):
        topic, stamp = by_name[name], stamp_ns(message, received)
        if topic.role in ("tf", "tf_static"):
            recording.tree.add(message, topic.role == "tf_static", f"{bag.path}, {name}")
        elif topic.role == "joints":
            joints[name].add(stamp, message)
        elif topic.role in IMAGES:
            recording.streams[name].add(stamp, (counts[name], frame_id(message)))
            recording.sizes[name] = int(getattr(message, "width", 0)), int(getattr(message, "height", 0))
            counts[name] += 1
        else:
            recording.streams[name].add(stamp, _value(topic, message, hand, dropped))
    for stream in recording.streams.values():
        stream.sort()
    return recording


def _check_sensor(topics: TopicMap, topic: Topic, hand: Hand | None) -> None:
    sensor = topic.options.get("sensor")
    if topic.role in ("wrench", "tactile") and hand is not None and sensor not in hand.sensors:
        known = ", ".join(hand.sensors) or "none"
        raise CaptureError(f"{topics.path}: {topic.name}: expected a sensor of the hand ({known}), got {sensor}")


def _value(topic: Topic, message: Any, hand: Hand | None, dropped: Dropped) -> Any:
    if topic.role == "camera_info":
        return _intrinsics(topic, message)
    if topic.role == "wrench":
        return wrench_of(topic, message)
    if topic.role == "tactile":
        taxels = None if hand is None else hand.sensors[topic.options["sensor"]].taxels
        return pressures_of(topic, message, None if taxels is None else len(taxels))
    if topic.role == "marker":
        return marker_of(topic, message)
    return contacts_of(topic, message, dropped)


def _intrinsics(topic: Topic, message: Any) -> tuple[Array, int, int, str]:
    """K (3, 3), width, height of the images of a CameraInfo (ROS 1 writes its fields in capitals), and how they were
    made of the full image: K and P are of that, the region counts in its pixels and is then binned.
    """

    def of(name: str) -> Array:
        return np.asarray(getattr(message, name, getattr(message, name.upper(), ())), dtype=np.float64)

    matrix = of("k").reshape(3, 3)
    if topic.options.get("rectified", False):
        projection = of("p").reshape(3, 4)[:, :3]
        matrix = projection if projection[0, 0] > 0 else matrix
    else:
        check_undistorted(topic.name, of("d"), 'rectify them, and say "rectified": true')
    try:
        entry = bop.camera_entry({"cam_K": matrix.ravel().tolist()})
    except InputError as error:
        raise CaptureError(f"{topic.name}: {error}") from error
    return _as_sent(topic, message, entry.matrix)


def _as_sent(topic: Topic, message: Any, full: Array) -> tuple[Array, int, int, str]:
    """The K (3, 3) of the full image, its width and height, as the images have them, as image_geometry has it."""
    width, height = int(message.width), int(message.height)
    x, y = int(message.roi.x_offset), int(message.roi.y_offset)
    # zeros stand for the full image, and for no binning
    across, down = int(message.roi.width) or width - x, int(message.roi.height) or height - y
    bins = max(1, int(message.binning_x)), max(1, int(message.binning_y))
    if across < bins[0] or down < bins[1] or x + across > width or y + down > height:
        region = f"{across}x{down} at {x}, {y}, binned {bins[0]}x{bins[1]}"
        raise CaptureError(f"{topic.name}: expected a region of the {width}x{height} pixels, got {region}")
    if (x, y, across, down, *bins) == (0, 0, width, height, 1, 1):
        return full, width, height, ""
    matrix = full.copy()
    matrix[:2, 2] -= x, y
    matrix[:2] /= np.array(bins, dtype=np.float64)[:, None]
    cut = f" ({width}x{height}, of which {across}x{down} at {x}, {y}, binned {bins[0]}x{bins[1]})"
    return matrix, across // bins[0], down // bins[1], cut


# ---- which messages make a frame


def _plan(path: Path, topics: TopicMap, recording: _Recording, dropped: Dropped, missing: Counter[str]) -> list[Plan]:
    """The frames that the depth images make, with everything but their pixels, in time order and counted."""
    tolerance = recording.tree.tolerance_ns
    near = f"{1e3 * topics.tolerance_s:g} ms"
    depth = recording.streams[topics.of_role("depth")[0].name]
    plans: list[Plan] = []
    last = None
    for position, stamp in enumerate(depth.stamps):
        order, own_frame = depth.values[position]
        if stamp == last:
            dropped.add(depth.topic.name, "a stamp that another image has")
            continue
        last = stamp
        camera_frame = topics.frames.get("camera", own_frame)
        world_frame = topics.frames["world"] if topics.world != "camera" else camera_frame
        camera_from_world = _pose(recording.tree, camera_frame, world_frame, stamp)
        if camera_from_world is None:
            dropped.add(depth.topic.name, f"no transform from {world_frame} to {camera_frame} within {near}")
            continue
        known: dict[str, Any] = {}
        for role, (target, key) in {
            "hand": (world_frame, "world_from_hand"),
            "object": (camera_frame, "camera_from_object_truth"),
            "prior": (camera_frame, "prior"),
        }.items():
            if role in topics.frames:
                known[key] = _pose(recording.tree, target, topics.frames[role], stamp)
        if topics.marker is not None:
            known["camera_from_object_truth"] = _marked(topics, recording, stamp, tolerance)
        positions: dict[str, float] = {}
        for joints in recording.joints:
            positions |= joints.at(stamp, tolerance)
        known["joints"] = positions or None
        images = {depth.topic.name: order} | _images(topics, recording, stamp, tolerance, own_frame)
        known |= _touch(topics, recording, stamp, tolerance)
        absent = _absent(topics, known, images)
        lacking = [role for role in absent if role in topics.required]
        if lacking:
            dropped.add(depth.topic.name, f"no {lacking[0]} within {near}")
        sources: list[Stream | Joints] = [*recording.streams.values(), *recording.joints]
        for source in sources:
            source.settle(not lacking)
        if lacking:
            continue
        felt = [
            placed(found, frame or world_frame, time, world_frame, recording.tree, name, dropped)
            for name, time, frame, found in known.pop("felt")
        ]
        if felt:
            known["contacts"] = Contacts.concatenate(felt)
        missing.update(absent)
        if recording.hand is not None and known["joints"] is None:
            known["world_from_hand"] = None  # a hand whose fingers may be anywhere says nothing
        camera, cut = _camera(topics, recording, stamp)
        frame = Frame(
            index=len(plans),
            where=f"{path}, image at {stamp / 1e9:.3f} s",
            camera=camera,
            camera_from_world=camera_from_world if topics.world != "camera" else np.eye(4),
            hand=recording.hand,
            **known,
        )
        plans.append(Plan(frame, stamp, images, cut))
    _count_unused(topics, recording, dropped, near)
    return plans


def _pose(tree: TransformTree, target: str, source: str, stamp: int) -> Array | None:
    return np.eye(4) if target == source else check_pose_or_none(tree.lookup(target, source, stamp))


def _marked(topics: TopicMap, recording: _Recording, stamp: int, tolerance: int) -> Array | None:
    """camera_from_object by the tracked marker on it."""
    assert topics.marker is not None
    stream = recording.streams[topics.of_role("marker")[0].name]
    at = stream.nearest(stamp, tolerance)
    if at is None:
        return None
    camera_from_tracker, marker_from_object = topics.marker
    return camera_from_tracker @ stream.values[at] @ marker_from_object


def _images(topics: TopicMap, recording: _Recording, stamp: int, tolerance: int, own_frame: str) -> dict[str, int]:
    """Colour and mask of the same instant and the same camera, by their order in the bag."""
    found = {}
    for role in ("rgb", "mask"):
        for topic in topics.of_role(role):
            stream = recording.streams[topic.name]
            at = stream.nearest(stamp, tolerance)
            if at is None:
                continue
            order, seen_from = stream.values[at]
            if seen_from != own_frame and not topic.options.get("registered", False):
                raise CaptureError(
                    f"{topic.name}: expected images of the depth image's frame {own_frame!r}, got {seen_from!r}:"
                    ' register them, or say "registered": true when they are'
                )
            found[topic.name] = order
    return found


def _touch(topics: TopicMap, recording: _Recording, stamp: int, tolerance: int) -> dict[str, Any]:
    """wrenches, tactile, and felt: (topic, time, TF frame, contacts) of each contact message."""
    wrenches, tactile, felt = [], {}, []
    for role in ("wrench", "tactile", "contacts"):
        for topic in topics.of_role(role):
            stream = recording.streams[topic.name]
            at = stream.nearest(stamp, tolerance)
            if at is None:
                continue
            if role == "wrench":
                wrenches.append(stream.values[at])
            elif role == "tactile":
                tactile[topic.options["sensor"]] = stream.values[at]
            else:
                felt += [(topic.name, stream.stamps[at], *part) for part in stream.values[at]]
    return {"wrenches": tuple(wrenches), "tactile": tactile, "felt": felt}


def _absent(topics: TopicMap, known: dict[str, Any], images: dict[str, int]) -> list[str]:
    """What the map names and this frame does not have."""
    have = {
        "joints": known["joints"] is not None,
        "wrench": len(known["wrenches"]) == len(topics.of_role("wrench")),
        "tactile": len(known["tactile"]) == len(topics.of_role("tactile")),
        "contacts": len({part[0] for part in known["felt"]}) == len(topics.of_role("contacts")),
        "hand": known.get("world_from_hand") is not None,
        "object": known.get("camera_from_object_truth") is not None,
        "prior": known.get("prior") is not None,
        **{role: any(topic.name in images for topic in topics.of_role(role)) for role in ("rgb", "mask")},
    }
    return [role for role, there in have.items() if not there and (topics.of_role(role) or role in topics.frames)]


def _camera(topics: TopicMap, recording: _Recording, stamp: int) -> tuple[Camera, str]:
    """The camera of the depth image, and how its image was made of a larger one."""
    if topics.intrinsics is not None:
        depth = recording.streams[topics.of_role("depth")[0].name]
        width, height = recording.sizes[depth.topic.name]
        fx, fy, cx, cy = topics.intrinsics
        return Camera(fx, fy, cx, cy, width, height), ""
    topic = topics.of_role("camera_info")[0]
    stream = recording.streams[topic.name]
    at = stream.nearest(stamp, None)
    if at is None:
        raise CaptureError(f"{topic.name}: expected a camera_info, got no message")
    matrix, width, height, cut = stream.values[at]
    return Camera.from_matrix(matrix, width, height), cut


def _count_unused(topics: TopicMap, recording: _Recording, dropped: Dropped, near: str) -> None:
    why = f"nearest to no frame within {near}"
    for stream in recording.streams.values():
        if stream.topic.role not in ("depth", "camera_info"):
            dropped.add(stream.topic.name, why, len(stream.stamps) - len(stream.used))
    for joints in recording.joints:
        dropped.add(joints.topic.name, why, joints.unused)
