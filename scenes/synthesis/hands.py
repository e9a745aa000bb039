"""A human-size five-finger right hand, made from a few lengths: for captures without anybody's hand model.

Hand frame = link "palm": origin at the wrist, x along the stretched fingers, z out of the palm's inner face (the palm
normal), y towards the little finger, so the thumb is on the side of -y. The inner face of the palm is at
z = PALM_HALF_THICKNESS; a held object of 6 cm sits near (0.075, 0, 0.043) m. Positive flexion bends
the fingers towards +z.
Lengths follow the anthropometry of an adult male hand (Buryanov and Kotiuk, "Proportions of Hand Segments", 2010).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenes.errors import InputError
from scenes.geometry import poses
from scenes.robot.hands import Hand
from scenes.robot.sensors import Sensor
from scenes.robot.tips import tip_skin
from scenes.robot.urdf import Joint, Mimic, Robot, Shape, mesh_shape

Array = NDArray[np.float64]

FINGERS = ("index", "middle", "ring", "little")
PALM_HALF_THICKNESS = 0.013
TIPS = ("sphere", "ellipsoid", "cylinder", "mesh")


@dataclass(frozen=True)
class FingerShape:
    """One finger: lengths (3,) m between joints, the last up to the centre of the tip's ball; knuckle (3,) m and
    splay (rad, about z) in the palm.
    """

    lengths: tuple[float, float, float]
    knuckle: tuple[float, float, float]
    splay: float


@dataclass(frozen=True)
class HandShape:
    """Lengths in metres, angles in radians."""

    fingers: tuple[FingerShape, ...] = (
        FingerShape((0.045, 0.027, 0.017), (0.094, -0.031, 0.0), np.deg2rad(-5.0)),
        FingerShape((0.050, 0.030, 0.018), (0.098, -0.008, 0.0), np.deg2rad(-1.0)),
        FingerShape((0.046, 0.029, 0.018), (0.093, 0.015, 0.0), np.deg2rad(4.0)),
        FingerShape((0.037, 0.022, 0.016), (0.084, 0.037, 0.0), np.deg2rad(9.0)),
    )
    # metacarpal, proximal, distal bone of the thumb
    thumb: tuple[float, float, float] = (0.048, 0.034, 0.022)
    thumb_base: tuple[float, float, float] = (0.024, -0.026, 0.004)
    # angle of the stretched thumb from x: wide open, so that an 8 cm can fits
    thumb_spread: float = np.deg2rad(65.0)
    # radii at the joints from knuckle to tip; the tip's ball is the touch sensor's surface
    finger_radii: tuple[float, float, float, float] = (0.0095, 0.0088, 0.0083, 0.0080)
    thumb_radii: tuple[float, float, float, float] = (0.0135, 0.0110, 0.0095, 0.0080)
    # the last finger joint bends with the middle one (Rijpkema and Girard 1991: two thirds)
    dip_coupling: float = 2.0 / 3.0
    # a sensor of kind "point" reports contact points; "wrench" force and torque
    sensor_kind: str = "point"
    # surface of the fingertips: one of TIPS
    tip: str = "sphere"


@cache
def five_finger_hand(shape: HandShape | None = None) -> Hand:
    """The hand with 16 driven joints, 4 coupled ones and a touch sensor `FINGER_tip` in each fingertip.

    Joints: FINGER_abduction, FINGER_mcp, FINGER_pip (FINGER_dip follows it); thumb_opposition, thumb_cmc, thumb_mcp,
    thumb_ip; radians, zero is the flat hand with the thumb to the side. The forearm is a rigid part of the hand.
    """
    shape = shape or HandShape()
    links: dict[str, tuple[Shape, ...]] = {"palm": (_palm(shape),), "forearm": (_forearm(),)}
    joints = [Joint("wrist", "fixed", "palm", "forearm", np.eye(4), np.array([1.0, 0.0, 0.0]))]
    for name, finger in zip(FINGERS, shape.fingers):
        _add_finger(name, finger, shape, links, joints)
    _add_thumb(shape, links, joints)
    # breadth first, as a URDF reader orders them: parents before children
    depth = {"palm": 0}
    for joint in joints:
        depth[joint.child] = depth[joint.parent] + 1
    joints.sort(key=lambda joint: depth[joint.child])
    ordered = {name: links[name] for name in ("palm", *(joint.child for joint in joints))}
    sensors = {}
    for name in (*FINGERS, "thumb"):
        length = shape.thumb[2] if name == "thumb" else shape.fingers[FINGERS.index(name)].lengths[2]
        radius = shape.thumb_radii[3] if name == "thumb" else shape.finger_radii[3]
        surface, turn = _tip_surface(shape.tip, radius)
        pose = poses.make_pose(turn, (length, 0.0, 0.0))
        sensor = Sensor(f"{name}_tip", f"{name}_distal", shape.sensor_kind, pose, surface)
        sensors[sensor.name] = sensor
        if shape.tip != "sphere":  # the link ends in the tip instead of a ball
            inner = shape.thumb_radii[2] if name == "thumb" else shape.finger_radii[2]
            skin = poses.apply(pose, tip_skin(sensor))
            ordered[sensor.link] = (_hull(np.concatenate([_ball_points((0.0, 0.0, 0.0), 0.9 * inner, 16), skin])),)
    return Hand(Robot("five_finger_hand", "palm", ordered, tuple(joints)), sensors)


def _tip_surface(kind: str, radius: float) -> tuple[dict[str, dict[str, Any]], Array | None]:
    """A fingertip of about this radius (m) as sensors.json has it, and how its frame is turned in the link's, x along
    the finger. Raises InputError for a kind that is none of TIPS.
    """
    if kind == "sphere":
        return {kind: {"radius": radius}}, None
    if kind == "ellipsoid":
        return {kind: {"radii": [1.4 * radius, radius, 0.9 * radius]}}, None
    if kind == "cylinder":  # along the finger
        return {kind: {"radius": radius, "length": 2.0 * radius}}, poses.exp_rotation((0.0, np.pi / 2, 0.0))
    if kind != "mesh":
        raise InputError(f"hand: expected tips of {', '.join(TIPS)}, got {kind!r}")
    # a pad: a slab with broken edges
    corners = np.stack(np.meshgrid(*([[-1.0, 1.0]] * 3), indexing="ij"), axis=-1).reshape(-1, 3)
    cuts = [np.where(np.arange(3) == i, 0.7, 1.0) for i in range(3)]
    hull = _hull(np.concatenate([corners * cut for cut in cuts]) * [1.2 * radius, radius, 0.9 * radius])
    return {kind: {"vertices": hull.vertices, "faces": hull.faces}}, None


def _add_finger(
    name: str, finger: FingerShape, shape: HandShape, links: dict[str, tuple[Shape, ...]], joints: list[Joint]
) -> None:
    radii, lengths = shape.finger_radii, finger.lengths
    knuckle = poses.make_pose(poses.exp_rotation((0.0, 0.0, finger.splay)), finger.knuckle)
    limit = np.deg2rad(20.0)
    links[f"{name}_knuckle"] = (_ball(radii[0]),)
    joints.append(
        Joint(f"{name}_abduction", "revolute", "palm", f"{name}_knuckle", knuckle, _axis(2, 1.0), -limit, limit)
    )
    # -y: turns x towards z, the palm normal
    flexion = _axis(1, -1.0)
    links[f"{name}_proximal"] = (_bone(lengths[0], radii[0], radii[1]),)
    joints.append(_flexion(f"{name}_mcp", f"{name}_knuckle", f"{name}_proximal", 0.0, flexion, (-15.0, 90.0)))
    links[f"{name}_middle"] = (_bone(lengths[1], radii[1], radii[2]),)
    joints.append(_flexion(f"{name}_pip", f"{name}_proximal", f"{name}_middle", lengths[0], flexion, (0.0, 105.0)))
    links[f"{name}_distal"] = (_bone(lengths[2], radii[2], radii[3], sections=16),)
    follow = Mimic(f"{name}_pip", shape.dip_coupling)
    bend = (0.0, 105.0 * shape.dip_coupling)
    joints.append(_flexion(f"{name}_dip", f"{name}_middle", f"{name}_distal", lengths[1], flexion, bend, follow))


def _add_thumb(shape: HandShape, links: dict[str, tuple[Shape, ...]], joints: list[Joint]) -> None:
    radii, lengths = shape.thumb_radii, shape.thumb
    base = poses.make_pose(None, shape.thumb_base)
    # -x: lifts the thumb from beside the palm (-y) to in front of it (+z)
    links["thumb_base"] = (_ball(radii[0]),)
    upper = float(np.deg2rad(120.0))
    joints.append(Joint("thumb_opposition", "revolute", "palm", "thumb_base", base, _axis(0, -1.0), 0.0, upper))
    flexion = _axis(2, 1.0)
    spread = poses.make_pose(poses.exp_rotation((0.0, 0.0, -shape.thumb_spread)))
    links["thumb_metacarpal"] = (_bone(lengths[0], radii[0], radii[1]),)
    lower, upper = (float(x) for x in np.deg2rad((-10.0, 55.0)))
    joints.append(Joint("thumb_cmc", "revolute", "thumb_base", "thumb_metacarpal", spread, flexion, lower, upper))
    links["thumb_proximal"] = (_bone(lengths[1], radii[1], radii[2]),)
    joints.append(_flexion("thumb_mcp", "thumb_metacarpal", "thumb_proximal", lengths[0], flexion, (-10.0, 70.0)))
    links["thumb_distal"] = (_bone(lengths[2], radii[2], radii[3], sections=16),)
    joints.append(_flexion("thumb_ip", "thumb_proximal", "thumb_distal", lengths[1], flexion, (-10.0, 85.0)))


def _flexion(
    name: str,
    parent: str,
    child: str,
    along: float,
    axis: Array,
    degrees: tuple[float, float],
    mimic: Mimic | None = None,
) -> Joint:
    lower, upper = (float(x) for x in np.deg2rad(degrees))
    return Joint(name, "revolute", parent, child, poses.make_pose(None, (along, 0.0, 0.0)), axis, lower, upper, mimic)


def _axis(index: int, sign: float) -> Array:
    axis = np.zeros(3)
    axis[index] = sign
    return axis


def _ball_points(centre: ArrayLike, radius: float, sections: int = 12) -> Array:
    """Latitude-longitude points of a sphere, poles on x."""
    latitude = np.linspace(-np.pi / 2, np.pi / 2, sections // 2 + 1)[1:-1]
    longitude = np.arange(sections) * 2 * np.pi / sections
    a, b = (grid.ravel() for grid in np.meshgrid(latitude, longitude, indexing="ij"))
    unit = np.stack([np.sin(a), np.cos(a) * np.cos(b), np.cos(a) * np.sin(b)], axis=1)
    return np.asarray(centre) + radius * np.concatenate([[[-1.0, 0.0, 0.0]], unit, [[1.0, 0.0, 0.0]]])


def _hull(points: Array) -> Shape:
    """Closed convex mesh about the points, in numbers that single-precision mesh files keep exactly."""
    import trimesh

    hull = trimesh.convex.convex_hull(points.astype(np.float32).astype(np.float64))
    return mesh_shape(np.array(hull.vertices, dtype=np.float64), np.array(hull.faces, dtype=np.int64))


def _bone(length: float, first_radius: float, last_radius: float, sections: int = 12) -> Shape:
    """A capsule along x from the joint to the next one, tapered."""
    start = _ball_points((0.0, 0.0, 0.0), first_radius, sections)
    return _hull(np.concatenate([start, _ball_points((length, 0.0, 0.0), last_radius, sections)]))


def _ball(radius: float) -> Shape:
    return _hull(_ball_points((0.0, 0.0, 0.0), radius))


def _palm(shape: HandShape) -> Shape:
    """A rounded plate from the wrist to the knuckles."""
    corners = [(0.008, -0.024, 0.0), (0.008, 0.024, 0.0), (0.045, 0.037, 0.0), (0.050, -0.030, 0.0)]
    corners += [(f.knuckle[0] - 0.006, f.knuckle[1], 0.0) for f in shape.fingers]
    return _hull(np.concatenate([_ball_points(c, PALM_HALF_THICKNESS, 8) for c in corners]))


def _forearm() -> Shape:
    """Wrist to elbow side: an oval cone, long enough to leave the picture."""
    wrist = [_ball_points((-0.004, y, 0.0), 0.020, 10) for y in (-0.010, 0.010)]
    elbow = [_ball_points((-0.240, y, 0.0), 0.034, 10) for y in (-0.012, 0.012)]
    return _hull(np.concatenate([*wrist, *elbow]))
