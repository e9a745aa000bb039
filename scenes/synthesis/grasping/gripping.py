"""Where a parallel gripper takes an object: two faces opposite one another, between the pads. Metres."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError
from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts
from scenes.robot.hands import Hand
from scenes.synthesis.grasping.grasps import Grasp, GraspSearchSettings, has_force_closure
from scenes.synthesis.gripper import JOINT, NAME, GripperShape

Array = NDArray[np.float64]

# Grips drawn before giving up, and samples of the object's surface with which they are held against it.
DRAWS, SAMPLES = 600, 20_000
# How far a finger reaches beyond the middle of where it touches (m).
BEYOND = (0.006, 0.022)
# The surface faces the pad to within this angle (cosine: 25 degrees, inside the friction cone of rubber).
FACING = float(np.cos(np.deg2rad(25.0)))
# Points this near to the outermost one touch the pad too (m).
PATCH = 2e-4


def has_flat_pads(hand: Hand) -> bool:
    """Whether `plan_grip` is for this hand: the generated gripper, whose pads are planes. Others, grippers with round
    tips among them, are for `plan_grasp`.
    """
    return hand.name == NAME


def plan_grip(hand: Hand, model: ObjectModel, seed: int = 0) -> Grasp:
    """A random grip of the object with the generated gripper; the same seed gives the same grip.

    Raises InputError when nothing drawn fits between the pads.
    """
    shape, settings = GripperShape(), GraspSearchSettings()
    length, _, width = shape.finger
    rng = np.random.default_rng(seed)
    points, normals = model.sample_surface(SAMPLES, seed=0)
    best: Grasp | None = None
    for _ in range(DRAWS):
        pick = int(rng.integers(SAMPLES))
        axis = normals[pick]
        ahead = np.cross(axis, poses.random_unit_vectors(1, rng)[0])
        size = float(np.linalg.norm(ahead))
        if size < 1e-6:
            continue
        ahead = ahead / size
        rotation = np.stack([ahead, axis, np.cross(ahead, axis)])
        reach = length - rng.uniform(*BEYOND)
        local = (points - points[pick]) @ rotation.T + [reach, 0.0, 0.0]
        between = (np.abs(local[:, 2]) < width / 2) & (local[:, 0] > 0) & (local[:, 0] < length)
        high, low = float(local[between, 1].max()), float(local[between, 1].min())
        half = (high - low) / 2
        middle = np.array([0.0, (high + low) / 2, 0.0])
        centred = local - middle
        inside = (centred[:, 0] < 0.002) & (np.abs(centred[:, 1:]) < np.array(shape.body[1:]) / 2).all(axis=1)
        if half > shape.travel or inside.any():
            continue
        felt = [_touched(centred, between, sign * half, sign) for sign in (1.0, -1.0)]
        own = normals[felt] @ rotation.T
        if own[0, 1] < FACING or -own[1, 1] < FACING:
            continue
        pose = poses.make_pose(rotation, [reach, 0.0, 0.0] - middle - rotation @ points[pick])
        contacts = Contacts(centred[felt], own, sensors=["left_pad", "right_pad"])
        closure = has_force_closure(points[felt], normals[felt], model, settings.friction)
        grip = Grasp({JOINT: half}, pose, contacts, "pinch", closure)
        if closure:
            return grip
        best = best or grip
    if best is None:
        raise InputError(f"grasp: expected an object that fits between the pads of {hand.name!r}, got {model.name!r}")
    return best


def _touched(local: Array, between: NDArray[np.bool_], level: float, sign: float) -> int:
    """The sample nearest to the middle of the patch that touches the pad at y = level."""
    patch = np.nonzero(between & (sign * (level - local[:, 1]) < PATCH))[0]
    away = np.linalg.norm(local[patch] - local[patch].mean(axis=0), axis=1)
    return int(patch[np.argmin(away)])
