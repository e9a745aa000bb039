"""A robot hand: links with geometry, joints, touch sensors. The hand frame is its root link; metres, radians.

Forward kinematics runs on arrays of configurations: all joints of one depth of the tree at a time.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenes.cache import Arrays, remembered
from scenes.errors import InputError
from scenes.geometry import poses
from scenes.robot.sensors import Sensor, read_sensors, write_sensors
from scenes.robot.urdf import MOVING, Robot, read_urdf, write_urdf

__all__ = ["Hand", "Sensor"]

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

# A joint further beyond its limit than an encoder's offset explains is worth reporting.
LIMIT_TOLERANCE = np.deg2rad(5.0)
# Default distance of neighbouring surface samples: half a fingertip's radius.
SAMPLE_SPACING = 0.004
# Raised whenever the samples below change, so that old files are not read.
SAMPLES_VERSION = 1


class Hand:
    """A hand as its URDF and sensors file describe it; never changed after it is made.

    Attributes: name; robot, the description as read; link_names, root first, parents before children; joint_names,
    the movable ones that follow no other; limits (j, 2) of those, rad or m, infinite for continuous joints;
    sensors by name.
    """

    # joints and hand_from_link that were asked for last
    _last: tuple[tuple[tuple[str, float], ...], Array] | None = None

    def __init__(self, robot: Robot, sensors: dict[str, Sensor] | None = None) -> None:
        """Use `load`, or pass a description; raises InputError when a sensor sits on a link that is not there."""
        self.name = robot.name
        self.robot = robot
        self.sensors = dict(sensors or {})
        self.link_names = list(robot.links)
        index = {name: i for i, name in enumerate(self.link_names)}
        for sensor in self.sensors.values():
            if sensor.link not in index:
                raise InputError(f"sensor {sensor.name!r}: expected a link of hand {self.name!r}, got {sensor.link!r}")
        moving = [joint for joint in robot.joints if joint.kind in MOVING]
        masters = [joint for joint in moving if joint.mimic is None]
        self.joint_names = [joint.name for joint in masters]
        self.limits = np.array([[joint.lower, joint.upper] for joint in masters]).reshape(-1, 2)
        self._moving_names = {joint.name: row for row, joint in enumerate(moving)}
        self._build_coupling(moving)
        self._build_tree(index)
        self._build_mesh()

    def _build_coupling(self, moving: list) -> None:
        """Values of all moving joints = coupling @ values of the masters + coupling offset."""
        self._coupling = np.zeros((len(moving), len(self.joint_names)))
        self._coupling_offset = np.zeros(len(moving))
        by_name = {joint.name: joint for joint in moving}
        for row, joint in enumerate(moving):
            factor, offset, current = 1.0, 0.0, joint
            while current.mimic is not None:
                offset += factor * current.mimic.offset
                factor *= current.mimic.multiplier
                current = by_name[current.mimic.joint]
            self._coupling[row, self.joint_names.index(current.name)] = factor
            self._coupling_offset[row] = offset

    def _build_tree(self, index: dict[str, int]) -> None:
        joints = self.robot.joints
        # link i + 1 is the child of joint i: both are in tree order
        self._origins = np.array([joint.parent_from_joint for joint in joints]).reshape(-1, 4, 4)
        self._parents = np.array([index[joint.parent] for joint in joints], dtype=np.int64)
        self._turning = np.array([i for i, j in enumerate(joints) if j.kind in ("revolute", "continuous")], dtype=int)
        self._sliding = np.array([i for i, j in enumerate(joints) if j.kind == "prismatic"], dtype=int)
        self._turning_rows = np.array([self._moving_names[joints[i].name] for i in self._turning], dtype=int)
        self._sliding_rows = np.array([self._moving_names[joints[i].name] for i in self._sliding], dtype=int)
        axes = np.array([joint.axis for joint in joints]).reshape(-1, 3)
        self._skew = poses.skew(axes[self._turning])
        self._skew_squared = self._skew @ self._skew
        self._slide_axes = axes[self._sliding]
        depth = np.zeros(len(self.link_names), dtype=np.int64)
        for i, parent in enumerate(self._parents):
            depth[i + 1] = depth[parent] + 1
        levels = [np.nonzero(depth == d)[0] for d in range(1, int(depth.max()) + 1)]
        self._levels = [(level, self._parents[level - 1]) for level in levels]
        # which master joints move which link
        moves = np.zeros((len(self.link_names), len(self.joint_names)), dtype=bool)
        for i, joint in enumerate(joints):
            moves[i + 1] = moves[self._parents[i]]
            if joint.name in self._moving_names:
                moves[i + 1] |= self._coupling[self._moving_names[joint.name]] != 0
        self.moved_by = moves

    def _build_mesh(self) -> None:
        vertices, faces, links, vertex_links, count = [], [], [], [], 0
        for number, shapes in enumerate(self.robot.links.values()):
            for shape in shapes:
                vertices.append(shape.vertices)
                faces.append(shape.faces + count)
                links.append(np.full(len(shape.faces), number))
                vertex_links.append(np.full(len(shape.vertices), number))
                count += len(shape.vertices)
        self._vertices = np.concatenate(vertices)
        self._faces = np.concatenate(faces)
        self._face_link = np.concatenate(links)
        self._vertex_link = np.concatenate(vertex_links)

    @staticmethod
    def load(urdf_path: str | Path, sensors_path: str | Path | None = None, within: Path | None = None) -> Hand:
        """Read a URDF and its sensors file (default: sensors.json beside it, when there is one).

        within: a folder out of which no mesh that these files name may lie; by default any may be read. Raises
        CaptureError for one that does, InputError, one line with file and place, for anything malformed.
        """
        urdf_path = Path(urdf_path)
        robot = read_urdf(urdf_path, within)
        beside = urdf_path.parent / "sensors.json"
        if sensors_path is None and beside.is_file():
            sensors_path = beside
        sensors = read_sensors(sensors_path, within) if sensors_path is not None else {}
        for sensor in sensors.values():
            if sensor.link not in robot.links:
                raise InputError(
                    f"{sensors_path}: sensor {sensor.name!r}: expected a link of {urdf_path}, got {sensor.link!r}"
                )
        return Hand(robot, sensors)

    def save(self, folder: str | Path) -> Path:
        """Write hand.urdf, its meshes and sensors.json into `folder` (made when missing); returns the URDF's path."""
        path = Path(folder) / "hand.urdf"
        write_urdf(path, self.robot)
        write_sensors(path.parent / "sensors.json", self.sensors)
        return path

    def strangers(self, joints: Iterable[str]) -> list[str]:
        """Those of the names that are no movable joint of this hand, one that follows another included."""
        return [name for name in joints if name not in self._moving_names]

    def joint_values(self, joints: dict[str, float]) -> Array:
        """Values of all moving joints, couplings included; absent joints are 0.

        A value given for a coupled joint (encoders report those too) replaces what its coupling says. Raises
        InputError for names that this hand does not have and values that are not finite.
        """
        unknown = self.strangers(joints)
        if unknown:
            raise InputError(
                f"joints: expected joints of hand {self.name!r} ({', '.join(self.joint_names[:3])}, …),"
                f" got {', '.join(map(repr, unknown[:3]))}: joints for another hand?"
            )
        given = np.array([float(value) for value in joints.values()])
        if not np.isfinite(given).all():
            name = list(joints)[int(np.argmax(~np.isfinite(given)))]
            raise InputError(f"joints: expected a finite position for {name!r}, got {joints[name]}")
        values = self._coupling @ np.array([joints.get(name, 0.0) for name in self.joint_names], dtype=np.float64)
        values += self._coupling_offset
        for name, value in joints.items():
            values[self._moving_names[name]] = value
        return values

    def coupling_of(self, joint: str) -> Array:
        """(j,) how much the joint's value changes with each of joint_names; zeros for a fixed joint."""
        row = self._moving_names.get(joint)
        return np.zeros(len(self.joint_names)) if row is None else self._coupling[row].copy()

    def configuration(self, joints: dict[str, float]) -> Array:
        """(j,) values in the order of joint_names, absent ones 0; names checked as in `joint_values`."""
        self.joint_values(joints)
        return np.array([joints.get(name, 0.0) for name in self.joint_names], dtype=np.float64)

    def limit_excess(self, joints: dict[str, float], tolerance: float = LIMIT_TOLERANCE) -> dict[str, float]:
        """Joints beyond their limits by more than `tolerance` (rad or m), and by how much; empty when all is well."""
        self.joint_values(joints)
        excess = {}
        for joint in self.robot.joints:
            if joint.name in joints and joint.kind in MOVING:
                beyond = max(joint.lower - joints[joint.name], joints[joint.name] - joint.upper)
                if beyond > tolerance:
                    excess[joint.name] = float(beyond)
        return excess

    def link_poses(self, configurations: ArrayLike) -> Array:
        """hand_from_link (..., l, 4, 4), links as in link_names, of configurations (..., j) ordered as joint_names."""
        values = np.asarray(configurations, dtype=np.float64) @ self._coupling.T + self._coupling_offset
        return self._poses_of_values(values)

    def _poses_of_values(self, values: Array) -> Array:
        batch = values.shape[:-1]
        count = len(self.link_names)
        if not len(self._sliding):
            return self._turned(values).reshape(*batch, count, 4, 4)
        local = np.broadcast_to(self._origins, (*batch, count - 1, 4, 4)).copy()
        if len(self._turning):
            angle = values[..., self._turning_rows, None, None]
            half = np.sin(0.5 * angle)
            turn = np.eye(3) + np.sin(angle) * self._skew + (2.0 * half * half) * self._skew_squared
            local[..., self._turning, :3, :3] = self._origins[self._turning, :3, :3] @ turn
        if len(self._sliding):
            shift = values[..., self._sliding_rows, None] * self._slide_axes
            rotation = self._origins[self._sliding, :3, :3]
            # a slice, not a number: an index array and a number apart would put the joints before the batch
            local[..., self._sliding, :3, 3:] += rotation @ shift[..., None]
        out = np.zeros((*batch, count, 4, 4))
        out[..., 0, :, :] = np.eye(4)
        for level, parents in self._levels:
            out[..., level, :, :] = out[..., parents, :, :] @ local[..., level - 1, :, :]
        return out

    def _turned(self, values: Array) -> Array:
        """(b, l, 4, 4) of a hand none of whose joints slides: of one posture, NumPy takes ten times as long."""
        from scenes.robot.clearance_kernels import posed_links

        rows = values.reshape(math.prod(values.shape[:-1]), values.shape[-1])
        angles = np.take(rows, self._turning_rows, axis=1)
        out = np.zeros((len(angles), len(self.link_names), 4, 4))
        turn = np.sin(angles), np.sin(0.5 * angles), self._skew, self._skew_squared
        posed_links(self._origins, self._parents, self._turning, *turn, self._origins.copy(), out)
        return out

    def forward_kinematics(self, joints: dict[str, float]) -> dict[str, Array]:
        """hand_from_link (4, 4) of every link at these joint positions (rad, m); absent joints are 0.

        Raises InputError for joints that this hand does not have. Positions beyond the limits are used as given:
        `limit_excess` tells which they are.
        """
        return dict(zip(self.link_names, self._poses_at(joints)))

    def _poses_at(self, joints: dict[str, float]) -> Array:
        """hand_from_link (l, 4, 4); the last ones are kept, for one frame's joints are asked about several times."""
        if not isinstance(joints, Mapping):
            how = "dict(zip(hand.joint_names, values))"
            raise InputError(f"joints: expected positions by joint name, got {type(joints).__name__}: {how}?")
        key = tuple(joints.items())
        last = self._last
        if last is None or last[0] != key:
            last = self._last = key, self._poses_of_values(self.joint_values(joints))
        return last[1].copy()

    def vertices(self, joints: dict[str, float]) -> Array:
        """(n, 3) corners of the hand's mesh in the hand frame."""
        return _by_link(self._poses_at(joints), self._vertex_link, self._vertices)

    def mesh(self, joints: dict[str, float]) -> tuple[Array, Indices, Indices]:
        """Vertices (n, 3) in the hand frame, faces (m, 3) wound outwards, and each face's link (m,)."""
        return self.vertices(joints), self._faces.copy(), self._face_link.copy()

    def surface_samples(self, spacing: float = SAMPLE_SPACING, corners: bool = True) -> tuple[Array, Array, Indices]:
        """Points (n, 3) on the links, normals (n, 3), link (n,): every spot of a surface is within `spacing` of one.

        In the frames of the links. With `corners` every vertex of the meshes is among them. Raises InputError for a
        spacing that is not above 0.
        """
        if not spacing > 0:
            raise InputError(f"spacing: expected metres above 0, got {spacing}")
        return _surface_samples(self, float(spacing), corners)

    def points_on_surface(
        self, joints: dict[str, float], spacing: float = SAMPLE_SPACING, most: int | None = None
    ) -> Array:
        """(n, 3) samples of the whole hand's surface in the hand frame; of every so many one, for about `most`."""
        points, _, link = self.surface_samples(spacing)
        step = 1 if most is None else max(1, len(points) // most)
        return _by_link(self._poses_at(joints), link[::step], points[::step])

    def points_in_ball(self, joints: dict[str, float], target_from_hand: Array, centre: Array, radius: float) -> Array:
        """(n, 3) samples of the hand's surface in a target frame, those nearer than `radius` (m, inf for all) to
        centre (3,).
        """
        from scenes.geometry.rotation_kernels import apply_in_ball

        points, _, link = self.surface_samples()
        out = np.zeros((len(points), 3))
        target_from_link = np.ascontiguousarray(target_from_hand @ self._poses_at(joints))
        return out[: apply_in_ball(target_from_link, link, points, np.asarray(centre, np.float64), radius, out)]

    def hand_from_sensor(self, joints: dict[str, float]) -> dict[str, Array]:
        """(4, 4) pose of every sensor at these joint positions."""
        hand_from_link = self.forward_kinematics(joints)
        return {name: hand_from_link[s.link] @ s.link_from_sensor for name, s in self.sensors.items()}


def _by_link(hand_from_link: Array, link: Indices, points: Array) -> Array:
    """Each point (n, 3) by the pose of its link (n,), of hand_from_link (k, 4, 4)."""
    from scenes.geometry.rotation_kernels import apply_each

    out = np.zeros((len(points), 3))
    apply_each(np.ascontiguousarray(hand_from_link), link, points, out)
    return out


@lru_cache(maxsize=16)
def _surface_samples(hand: Hand, spacing: float, corners: bool) -> tuple[Array, Array, Indices]:
    shapes = [[(s.vertices, s.faces) for s in link] for link in hand.robot.links.values()]
    arrays = remembered(
        "hand",
        (SAMPLES_VERSION, spacing, corners, [len(link) for link in shapes]),
        [array for link in shapes for shape in link for array in shape],
        lambda: _sample_links(hand, spacing, corners),
        lambda stored: _are_samples(stored, len(shapes)),
    )
    result = arrays["points"], arrays["normals"], arrays["links"]
    for array in result:
        array.setflags(write=False)  # shared by every caller
    return result


def _are_samples(arrays: Arrays, links: int) -> bool:
    points, normals, link = arrays["points"], arrays["normals"], arrays["links"]
    if not (points.ndim == 2 and points.shape == (len(link), 3) == normals.shape and link.dtype.kind == "i"):
        return False
    return bool(np.isfinite(points).all() and np.isfinite(normals).all() and ((link >= 0) & (link < links)).all())


def _sample_links(hand: Hand, spacing: float, corners: bool) -> Arrays:
    import trimesh
    from scipy.spatial import cKDTree

    points, normals, links = [], [], []
    for number, shapes in enumerate(hand.robot.links.values()):
        for shape in shapes:
            count = len(shape.vertices)
            # old vertices come first in a subdivision; a point of the surface is within 0.29 spacing of a new one
            vertices, faces = trimesh.remesh.subdivide_to_size(shape.vertices, shape.faces, spacing / 2, max_iter=30)
            mesh = trimesh.Trimesh(np.concatenate([shape.vertices, vertices]), faces + count, process=False)
            mesh.merge_vertices()
            candidates = np.array(mesh.vertices)
            kept = np.zeros(len(candidates), dtype=bool)
            covered = np.zeros(len(candidates), dtype=bool)
            tree = cKDTree(candidates)
            own = cKDTree(shape.vertices).query(candidates, distance_upper_bound=1e-9)[0] < np.inf
            for i in np.argsort(~own, kind="stable"):
                if (corners and own[i]) or not covered[i]:
                    kept[i] = True
                    covered[tree.query_ball_point(candidates[i], 0.7 * spacing)] = True
            points.append(candidates[kept])
            normals.append(np.array(mesh.vertex_normals)[kept])
            links.append(np.full(int(kept.sum()), number))
    return {"points": np.concatenate(points), "normals": np.concatenate(normals), "links": np.concatenate(links)}
