"""Simulated presses of DIGITs onto objects: what the gel saw, and what a point sensor would have said there.

Each trial is another grasp of up to three presses, far apart; each sensor has lamps, reflectance and a bulge of its
own, is not quite where it says, and was calibrated on other sensors' ball presses. Metres, radians; object frame
unless said otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts
from scenes.robot.gels import Gel
from scenes.synthesis.gels import LitGel, ball_presses, lit_digit, pressed_by, see
from touch.gels.patches import Patch, patch_of
from touch.gels.skin.calibration import calibrate
from touch.gels.skin.heights import indentation_of
from touch.gels.skin.photometry import Photometry, mean_of

Array = NDArray[np.float64]

# The ball (m) and its presses that calibrate.
BALL, BALL_DEPTHS, BALL_PRESSES = 0.004, (0.0005, 0.0009), 12
# Sensors whose mean calibration all others get, none of them among these: those of one hand with four fingers.
CALIBRATED = 4


@dataclass(frozen=True)
class PressNoise:
    """What the sensors get wrong, beside their lamps and skin."""

    # How far a sensor is from where it says it is, standard deviations per axis (m, rad): finger joints.
    place: float = 0.0007
    turn: float = float(np.deg2rad(1.4))
    # Indentation (m), lowest and highest, and tilt of the sensor from the surface's normal (rad, standard deviation).
    depth: tuple[float, float] = (0.0006, 0.0013)
    tilt: float = float(np.deg2rad(8.0))
    # A point sensor's normal (rad, standard deviation per axis): T1 section 4.3.
    normal: float = float(np.deg2rad(5.0))


@dataclass(frozen=True)
class Press:
    """reported (4, 4): world_from_sensor as the robot has it; patch and contact in the world's frame."""

    reported: Array
    patch: Patch
    contact: Contacts


@cache
def calibration(seed: int = 0) -> dict[str, Any]:
    """From ball presses on one DIGIT."""
    rng = np.random.default_rng([seed, 5])
    gel = lit_digit(rng)
    images = [image for depth in BALL_DEPTHS for image in ball_presses(gel, BALL, depth, BALL_PRESSES, rng)]
    return calibrate(images, gel, BALL).to_json()


@cache
def mean_calibration() -> dict[str, Any]:
    """Of `CALIBRATED` DIGITs, for all others."""
    return mean_of([Photometry.from_json(calibration(seed), "calibration") for seed in range(CALIBRATED)]).to_json()


def calibrated_digit(rng: np.random.Generator, by: int | None = None) -> LitGel:
    """A DIGIT of its own lamps with the mean calibration of others; of one other where `by` is its number."""
    return replace(lit_digit(rng), calibration=mean_calibration() if by is None else calibration(by))


def presses(
    model: ObjectModel,
    world_from_object: Array,
    count: int,
    rng: np.random.Generator,
    noise: PressNoise | None = None,
    calibrated: bool = True,
) -> list[Press]:
    """`count` presses at places far from one another; fewer where the skin met nothing."""
    noise = noise or PressNoise()
    points, normals = model.sample_surface(200, seed=int(rng.integers(2**31)))
    chosen = [0]
    while len(chosen) < count:
        gaps = np.min([np.linalg.norm(points - points[i], axis=1) for i in chosen], axis=0)
        # one of the farther half: grasps are not always as wide as they could be
        far = np.argsort(-gaps)[: len(points) // 4]
        chosen.append(int(rng.choice(far)))
    out: list[Press] = []
    for index in chosen:
        gel: Gel = calibrated_digit(rng)
        if not calibrated:
            gel = replace(gel, calibration=None)
        object_from_sensor = place(points[index], normals[index], float(rng.uniform(*noise.depth)), noise.tilt, rng)
        depth = pressed_by(model, object_from_sensor, gel)
        if not (depth > 0).any():
            continue
        error = se3.make_pose(se3.exp_rotation(noise.turn * rng.normal(size=3)), noise.place * rng.normal(size=3))
        reported = world_from_object @ object_from_sensor @ error
        image = see(gel, depth, rng)
        pressed = indentation_of(image, gel)
        patch = patch_of(f"gel{len(out)}", pressed).moved(reported)
        if not len(patch):
            continue
        out.append(Press(reported, patch, _point(model, object_from_sensor, gel, depth, reported, noise, rng)))
    return out


def place(point: Array, normal: Array, depth: float, tilt: float, rng: np.random.Generator) -> Array:
    """(4, 4) object_from_sensor: the skin's top `depth` (m) inside the surface at a point, turned about at random."""
    z = -normal
    x = np.cross(z, np.eye(3)[int(np.argmin(np.abs(z)))])
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(z, x), z], axis=1) @ se3.exp_rotation([0.0, 0.0, rng.uniform(0.0, 2 * np.pi)])
    rotation = rotation @ se3.exp_rotation([*(tilt * rng.normal(size=2)), 0.0])
    return se3.make_pose(rotation, point - depth * normal)


def _point(
    model: ObjectModel,
    object_from_sensor: Array,
    gel: Gel,
    depth: Array,
    reported: Array,
    noise: PressNoise,
    rng: np.random.Generator,
) -> Contacts:
    """What a point sensor says of the same touch: its deepest point, and the surface's normal there with an error."""
    v, u = np.unravel_index(int(np.argmax(depth)), depth.shape)
    deepest = gel.points(depth)[v, u]
    _, normal, foot = model.surface.closest(se3.apply(object_from_sensor, deepest[None]))
    to_sensor = se3.inverse(object_from_sensor)
    felt = to_sensor[:3, :3] @ normal[0] + noise.normal * rng.normal(size=3)
    at = se3.apply(reported, se3.apply(to_sensor, foot))
    return Contacts(at, (reported[:3, :3] @ felt)[None], 0.0012, np.deg2rad(5.5))
