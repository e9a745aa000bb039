"""Real ROS 1 and ROS 2 bags for tests, written with rosbags: a camera on a robot that holds an object."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from commands import run

from scenes.geometry import poses
from scenes.recordings.captures import Capture, read_capture

KINDS = ("ros1", "sqlite3", "mcap")
WIDTH, HEIGHT = 64, 48
MATRIX = np.array([[80.0, 0.0, 31.25], [0.0, 82.5, 23.75], [0.0, 0.0, 1.0]])
SECOND = 1_000_000_000
MS = SECOND // 1000
START = 1_700_000_000 * SECOND

TYPES = {
    "palpate_msgs/msg/Pressures": "std_msgs/Header header\nfloat32[] cells\n",
    "palpate_msgs/msg/Touch": (
        "geometry_msgs/Point position\ngeometry_msgs/Vector3 normal\nfloat64[3] force\nstring finger\n"
    ),
    "palpate_msgs/msg/Touches": "std_msgs/Header header\npalpate_msgs/Touch[] touches\n",
}
TF_TYPE = {"tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms\n"}


def typestore(kind: str) -> Any:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_HUMBLE)
    found: dict[str, Any] = {}
    for name, text in (TYPES | (TF_TYPE if kind == "ros1" else {})).items():
        found.update(get_types_from_msg(text, name))
    store.register(found)
    return store


@dataclass
class Messages:
    """Makes messages of one kind of bag."""

    kind: str
    store: Any = None
    rows: list[tuple[str, str, int, Any]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.store = typestore(self.kind)

    def make(self, name: str, /, **fields: Any) -> Any:
        return self.store.types[name](**fields)

    def header(self, stamp: int, frame: str = "") -> Any:
        time = self.make("builtin_interfaces/msg/Time", sec=stamp // SECOND, nanosec=stamp % SECOND)
        extra = {"seq": 0} if self.kind == "ros1" else {}
        return self.make("std_msgs/msg/Header", stamp=time, frame_id=frame, **extra)

    def add(self, topic: str, name: str, stamp: int, message: Any, late: int = 0) -> None:
        """late: nanoseconds between the header's time and the receipt."""
        self.rows.append((topic, name, stamp + late, message))

    def image(self, topic: str, stamp: int, array: np.ndarray, encoding: str, frame="camera", pad=0, big=False) -> None:
        array = np.ascontiguousarray(array)
        rows = array.astype(array.dtype.newbyteorder(">")) if big else array
        rows = rows.view(np.uint8).reshape(len(array), -1)
        rows = np.pad(rows, ((0, 0), (0, pad)))
        message = self.make(
            "sensor_msgs/msg/Image",
            header=self.header(stamp, frame),
            height=array.shape[0],
            width=array.shape[1],
            encoding=encoding,
            is_bigendian=int(big),
            step=rows.shape[1],
            data=rows.ravel().copy(),
        )
        self.add(topic, "sensor_msgs/msg/Image", stamp, message)

    def compressed(self, topic: str, stamp: int, data: bytes, kind: str, frame="camera") -> None:
        message = self.make(
            "sensor_msgs/msg/CompressedImage",
            header=self.header(stamp, frame),
            format=kind,
            data=np.frombuffer(data, dtype=np.uint8),
        )
        self.add(topic, "sensor_msgs/msg/CompressedImage", stamp, message)

    def camera_info(
        self,
        topic: str,
        stamp: int,
        matrix=MATRIX,
        size=(WIDTH, HEIGHT),
        distortion=(0.0,) * 5,
        binning=(0, 0),
        region=(0, 0, 0, 0),
    ) -> None:
        """region: x, y, width, height in pixels of the full image."""
        names = dict.fromkeys("dkrp") if self.kind != "ros1" else dict.fromkeys("DKRP")
        values = (
            np.array(distortion),
            matrix.ravel(),
            np.eye(3).ravel(),
            np.hstack([matrix, np.zeros((3, 1))]).ravel(),
        )
        names_of_region = ("x_offset", "y_offset", "width", "height")
        roi = self.make("sensor_msgs/msg/RegionOfInterest", **dict(zip(names_of_region, region)), do_rectify=False)
        message = self.make(
            "sensor_msgs/msg/CameraInfo",
            header=self.header(stamp, "camera"),
            height=size[1],
            width=size[0],
            distortion_model="plumb_bob",
            binning_x=binning[0],
            binning_y=binning[1],
            roi=roi,
            **dict(zip(names, values)),
        )
        self.add(topic, "sensor_msgs/msg/CameraInfo", stamp, message)

    def joints(self, topic: str, stamp: int, positions: dict[str, float]) -> None:
        nothing = np.zeros(0)
        message = self.make(
            "sensor_msgs/msg/JointState",
            header=self.header(stamp),
            name=list(positions),
            position=np.array(list(positions.values())),
            velocity=nothing,
            effort=nothing,
        )
        self.add(topic, "sensor_msgs/msg/JointState", stamp, message)

    def vector(self, values, name="Vector3") -> Any:
        x, y, z = map(float, values)
        return self.make(f"geometry_msgs/msg/{name}", x=x, y=y, z=z)

    def wrench(self, topic: str, stamp: int, force, torque) -> None:
        inner = self.make("geometry_msgs/msg/Wrench", force=self.vector(force), torque=self.vector(torque))
        message = self.make("geometry_msgs/msg/WrenchStamped", header=self.header(stamp, "tip"), wrench=inner)
        self.add(topic, "geometry_msgs/msg/WrenchStamped", stamp, message)

    def transform(self, topic: str, stamp: int, parent: str, child: str, pose, quaternion=None) -> None:
        w, x, y, z = poses.to_quaternion(pose[:3, :3]) if quaternion is None else quaternion
        rotation = self.make("geometry_msgs/msg/Quaternion", x=float(x), y=float(y), z=float(z), w=float(w))
        inner = self.make("geometry_msgs/msg/Transform", translation=self.vector(pose[:3, 3]), rotation=rotation)
        row = self.make(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(stamp, parent),
            child_frame_id=child,
            transform=inner,
        )
        self.add(topic, "tf2_msgs/msg/TFMessage", stamp, self.make("tf2_msgs/msg/TFMessage", transforms=[row]))

    def pressures(self, topic: str, stamp: int, cells) -> None:
        cells = np.array(cells, dtype=np.float32)
        message = self.make("palpate_msgs/msg/Pressures", header=self.header(stamp, "pad"), cells=cells)
        self.add(topic, "palpate_msgs/msg/Pressures", stamp, message)

    def touches(self, topic: str, stamp: int, frame: str, points, normals, forces, fingers) -> None:
        rows = [
            self.make(
                "palpate_msgs/msg/Touch",
                position=self.vector(p, "Point"),
                normal=self.vector(n),
                force=np.array(f, dtype=np.float64),
                finger=name,
            )
            for p, n, f, name in zip(points, normals, forces, fingers)
        ]
        message = self.make("palpate_msgs/msg/Touches", header=self.header(stamp, frame), touches=rows)
        self.add(topic, "palpate_msgs/msg/Touches", stamp, message)

    def write(self, path: Path) -> Path:
        """Write what was added, in the order of receipt; returns the bag's file or folder."""
        if self.kind == "ros1":
            from rosbags.rosbag1 import Writer

            path = path.with_suffix(".bag")
            writer, serialize = Writer(path), self.store.serialize_ros1
        else:
            from rosbags.rosbag2 import StoragePlugin
            from rosbags.rosbag2 import Writer as Writer2

            plugin = StoragePlugin.MCAP if self.kind == "mcap" else StoragePlugin.SQLITE3
            writer, serialize = Writer2(path, version=8, storage_plugin=plugin), self.store.serialize_cdr
        with writer:
            connections = {}
            for topic, name, stamp, message in sorted(self.rows, key=lambda row: row[2]):
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, name, typestore=self.store)
                writer.write(connections[topic], stamp, serialize(message, name))
        return path


def compressed_depth(counts: np.ndarray) -> bytes:
    """A depth image as compressed_depth_image_transport sends 16UC1: header, PNG."""
    return struct.pack("<iff", 0, 0.0, 0.0) + cv2.imencode(".png", counts)[1].tobytes()


def compressed_metres(metres: np.ndarray, furthest=10.0, quantum=100.0) -> bytes:
    """The same of 32FC1: quantised inverse depth."""
    a = quantum * (quantum + 1.0)
    b = 1.0 - a / furthest
    with np.errstate(divide="ignore"):
        counts = np.where(metres > 0, a / metres + b, 0.0).astype(np.uint16)
    return struct.pack("<iff", 0, a, b) + cv2.imencode(".png", counts)[1].tobytes()


def write_map(path: Path, topics: dict[str, Any], **rest: Any) -> Path:
    path.write_text(json.dumps({"format": "palpate-topics", "version": 1, "topics": topics, **rest}))
    return path


PLAIN = {"/depth": {"role": "depth"}, "/depth/info": {"role": "camera_info"}}


def plain(kind: str, count: int = 3) -> Messages:
    """Depth images 100 ms apart and their camera, nothing else: what PLAIN maps."""
    out = Messages(kind)
    for i in range(count):
        stamp = START + 100 * MS * i
        out.image("/depth", stamp, np.full((HEIGHT, WIDTH), 500 + i, dtype=np.uint16), "16UC1")
        out.camera_info("/depth/info", stamp)
    return out


def converted(folder: Path, out: Messages, topics: dict[str, Any] | None = None, **rest: Any) -> tuple[Capture, Any]:
    """The capture of the messages and what --json says; everything is written into `folder`."""
    folder.mkdir(exist_ok=True)
    bag = out.write(folder / "bag")
    made = write_map(folder / "topics.json", topics or PLAIN, **rest)
    argv = ("convert", bag, folder / "c", "--topics", made, "--object", "box", "--json", folder / "j.json")
    assert run(*argv) == 0
    return read_capture(folder / "c"), json.loads((folder / "j.json").read_text())
