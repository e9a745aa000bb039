"""Grasps with taxel arrays for the benchmark: six placements of four pads on four objects, after T1 section 5.3.

Pads are pressed against the object's mesh by a soft layer (scenes.robot.tactile); what is reported has the noise of
pressure, gains that differ from taxel to taxel, dead taxels, and fingers that are not quite where their joints say.
Object frame unless said; metres, newtons, pascals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.robot import tactile
from scenes.robot.sensors import Sensor
from scenes.robot.tactile import SoftLayer
from scenes.synthesis import library
from touch.arrays.readings import Reading

Array = NDArray[np.float64]

# T1's pads have 24 taxels under soft silicone (Ecoflex 00-10, about 50 kPa).
LAYER = SoftLayer(thickness=0.002, modulus=0.05e6)
FINGER, PALM = (8, 3, 0.0032, 0.025), (6, 4, 0.005, None)


@dataclass(frozen=True)
class GraspNoise:
    """Errors of a recording. Values by judgement; T1 names none."""

    # Pressure (Pa), gain of each taxel (share), dead taxels (share).
    pressure: float = 400.0
    gain: float = 0.05
    dead: float = 0.02
    # Pose of each pad per axis: (rad), (m): what a degree in a joint does 90 mm away; T1 shows a larger one.
    turn: float = float(np.deg2rad(1.5))
    move: float = 0.0015
    # Force on each pad (N), drawn evenly.
    force: tuple[float, float] = (2.0, 6.0)


@dataclass(frozen=True)
class Touch:
    """One pad: target (3,) it is moved through, approach (3,) the direction into the object, along (3,) its long axis;
    palm or finger.
    """

    target: tuple[float, float, float]
    approach: tuple[float, float, float]
    along: tuple[float, float, float]
    palm: bool = False


def _round(radius: float, angle: float, z: float, along: str = "z", palm: bool = False, tilt: float = 0.0) -> Touch:
    """A pad on a body of revolution about z: at an angle (deg), pressing inwards, tilted down by so much (deg)."""
    turn, down = np.deg2rad(angle), np.deg2rad(tilt)
    out = np.array([np.cos(turn), np.sin(turn), 0.0])
    inward = -np.cos(down) * out + np.sin(down) * np.array([0.0, 0.0, -1.0])
    axis = {"z": np.array([0.0, 0.0, 1.0]), "round": np.array([-np.sin(turn), np.cos(turn), 0.0])}[along]
    return Touch(tuple(radius * out + [0.0, 0.0, z]), tuple(inward), tuple(axis), palm)


# Name -> object, what it is, pads (three fingers and the palm).
GRASPS: dict[str, tuple[str, str, tuple[Touch, ...]]] = {
    "a": ("box", "edge, end of a face, corner's edge", (
        Touch((-0.030, -0.045, 0.0275), (0.0, 1.0, -1.0), (1.0, 0.0, 0.0)),
        Touch((0.066, 0.010, 0.0275), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0)),
        Touch((-0.070, 0.045, 0.005), (1.0, -1.0, 0.0), (0.0, 0.0, 1.0)),
        Touch((0.0, 0.0, -0.0275), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), True),
    )),
    "b": ("box", "corner, face, edge, half a palm", (
        Touch((0.068, -0.043, 0.0255), (-1.0, 1.0, -1.0), (1.0, 1.0, 0.0)),
        Touch((0.020, 0.045, 0.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0)),
        Touch((-0.070, 0.0, 0.0275), (1.0, 0.0, -1.0), (0.0, 1.0, 0.0)),
        Touch((0.0, -0.040, -0.0275), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), True),
    )),
    "c": ("bottle", "opposed, close together", (
        _round(0.034, 14.0, 0.060), _round(0.034, -14.0, 0.066), _round(0.034, 0.0, 0.092),
        _round(0.034, 180.0, 0.070, palm=True),
    )),
    "d": ("bottle", "neck and shoulder", (
        _round(0.015, 40.0, 0.205), _round(0.022, -70.0, 0.172, tilt=35.0), _round(0.034, 100.0, 0.110),
        _round(0.034, 200.0, 0.085, palm=True),
    )),
    "e": ("cylinder", "rim, side, lid", (
        _round(0.033, 20.0, 0.0575, along="round", tilt=45.0), _round(0.033, -60.0, 0.020),
        _round(0.033, 90.0, 0.052), _round(0.033, 195.0, -0.005, palm=True),
    )),
    "f": ("mug", "handle, rim, side", (
        Touch((0.072, 0.0, 0.048), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
        Touch((0.064, 0.010, 0.048), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)),
        _round(0.040, 120.0, 0.092), _round(0.040, 215.0, 0.045, palm=True),
    )),
}  # fmt: skip


def pad(rows: int, columns: int, pitch: float, bend: float | None) -> Array:
    """(k, 6) taxels in the pad's frame: x along the rows, z out of it; bend (m): radius of a pad bent about x."""
    x = (np.arange(rows) - (rows - 1) / 2) * pitch
    y = (np.arange(columns) - (columns - 1) / 2) * pitch
    x, y = (g.ravel() for g in np.meshgrid(x, y, indexing="ij"))
    if bend is None:
        return np.stack([x, y, np.zeros_like(x), np.zeros_like(x), np.zeros_like(x), np.ones_like(x)], axis=1)
    turn = y / bend
    places = np.stack([x, bend * np.sin(turn), bend * (np.cos(turn) - 1.0)], axis=1)
    return np.concatenate([places, np.stack([np.zeros_like(x), np.sin(turn), np.cos(turn)], axis=1)], axis=1)


def sensor_of(name: str, taxels: Array, layer: SoftLayer = LAYER) -> Sensor:
    """An array that sits in its own frame."""
    return Sensor(name, "link", "array", np.eye(4), None, taxels, layer.to_json())


def first_touch(model: ObjectModel, object_from_pad: Array, sensor: Sensor, direction: Array) -> Array:
    """object_from_pad (4, 4) moved along `direction` until the undeformed skin just meets the object.

    No step is longer than the room that is left, so nothing is passed; a pad that meets nothing within 0.3 m stops.
    """
    points, _, _ = tactile.skin(sensor)
    moved = object_from_pad.copy()
    gone = 0.0
    for _ in range(400):
        room = float(model.field.distance(se3.apply(moved, points)).min())
        if abs(room) < 1e-6 or gone > 0.3:
            break
        moved[:3, 3] += room * direction
        gone += room
    return moved


@dataclass(frozen=True)
class Held:
    """An object and where its pads just touch it: sensors, object_from_pad (k, 4, 4) and approach (k, 3)."""

    model: ObjectModel
    sensors: tuple[Sensor, ...]
    pads: Array
    approach: Array


@cache
def hold(name: str) -> Held:
    """A grasp of GRASPS."""
    thing, _, touches = GRASPS[name]
    model = library.make(thing)
    sensors, pads, directions = [], [], []
    for row, touch in enumerate(touches):
        sensor = sensor_of("palm" if touch.palm else f"finger{row + 1}", pad(*(PALM if touch.palm else FINGER)))
        z = np.array(touch.approach) / np.linalg.norm(touch.approach)
        x = np.array(touch.along) - (np.array(touch.along) @ z) * z
        x /= np.linalg.norm(x)
        far = se3.make_pose(np.stack([x, np.cross(z, x), z], axis=1), np.array(touch.target) - 0.12 * z)
        sensors.append(sensor)
        pads.append(first_touch(model, far, sensor, z))
        directions.append(z)
    return Held(model, tuple(sensors), np.array(pads), np.array(directions))


def record(held: Held, truth: Array, rng: np.random.Generator, noise: GraspNoise | None = None) -> list[Reading]:
    """What the pads of a grasp report with the object at truth (4, 4) frame_from_object, that frame."""
    noise = noise or GraspNoise()
    out = []
    for sensor, object_from_pad, approach in zip(held.sensors, held.pads, held.approach):
        assert sensor.taxels is not None
        felt, depth = tactile.press(held.model, object_from_pad, sensor, -approach, float(rng.uniform(*noise.force)))
        felt = felt * np.exp(noise.gain * rng.normal(size=len(felt)))
        layer = SoftLayer.from_json(sensor.soft_layer)
        read = tactile.read_out(felt, layer, noise.pressure, rng.random(len(felt)) < noise.dead, rng)
        pressed = object_from_pad.copy()
        pressed[:3, 3] += depth * approach
        middle = sensor.taxels[:, :3].mean(axis=0)
        error = np.concatenate([noise.turn * rng.normal(size=3), noise.move * rng.normal(size=3)])
        believed = se3.perturb(truth @ pressed, error, middle)
        out.append(Reading(sensor.name, sensor.taxels, read, layer, np.eye(4)).moved(believed))
    return out


def recordings(
    name: str, count: int, seeds: Sequence[int], noise: GraspNoise | None = None
) -> list[tuple[Array, list[Reading]]]:
    """`count` recordings of a grasp, the object turned at random in each: (truth, readings)."""
    held = hold(name)
    out = []
    for i in range(count):
        rng = np.random.default_rng([*seeds, i])
        truth = se3.make_pose(se3.random_rotations(1, rng)[0], 0.1 * rng.normal(size=3))
        out.append((truth, record(held, truth, rng, noise)))
    return out
