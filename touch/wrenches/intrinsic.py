"""Intrinsic contact sensing: from the wrench on a convex fingertip to the contact point (Bicchi, Salisbury & Brock
1993; T1 section 2.2.1). Spherical fingertips, rigid, in closed form here; other shapes and soft layers in `fingertips`.

A soft finger pressed at p on its surface S(p) = 0 by a force F feels the moment M = p x F + k grad S(p): only a moment
about the normal is transmitted (T1 eq. 2.3). On a sphere of radius R about the sensor's origin the normal is p / R,
and with K = 2k:   M = p x F + (K / R^2) ... p, solved by one quadratic for K.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.errors import CaptureError
from scenes.recordings.frames import DEFAULT_SIGMA_NORMAL, DEFAULT_SIGMA_POINT, Contacts, Frame
from scenes.robot.sensors import surface_hull

Array = NDArray[np.float64]


@dataclass(frozen=True)
class IntrinsicSettings:
    """When a wrench is a contact. Values by judgement."""

    # Forces below this (N) are sensor noise: a usual six-axis fingertip sensor resolves some hundredths of a newton.
    smallest_force: float = 0.05
    # Lever arms (|M| / |F|) longer than this many radii cannot come from the fingertip's surface.
    longest_lever: float = 1.2
    # Numbers beyond this (N, N m) are no measurement; their fourth powers would not be finite either.
    largest: float = 1e6
    # A force this near to the surface's tangent (cosine) does not press: round-off decides its sign.
    grazing: float = 1e-9


def sphere_contact(force: Array, torque: Array, radius: float) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Contact points on a sphere about the sensor's origin from the wrenches felt there.

    force (n, 3) N: what the object does to the finger; torque (n, 3) N m about the origin; radius m. Returns points
    (n, 3), moments about the normal (n,) N m (signed along the outward normal of the finger), and valid (n,):
    False for zero forces, for forces that pull instead of press, for moments too large for the sphere, and for what is
    not finite.

    Closed form: M = p x F + q p with p on the sphere (q: the moment about the normal over the radius). Dotting with
    F gives F.M = q F.p; with |p| = R the scalar q solves q^4 R^2 + q^2 (R^2 F^2 - M^2) - (F.M)^2 = 0, the same
    biquadratic as Bicchi's; p = (q^2 M + (F.M) F + q F x M) / (q (q^2 + F^2)), and for q -> 0 the ray of the force
    meets the sphere where it presses.
    """
    force = np.atleast_2d(np.asarray(force, dtype=np.float64))
    torque = np.atleast_2d(np.asarray(torque, dtype=np.float64))
    settings = IntrinsicSettings()
    both = np.concatenate([force, torque], axis=1)
    measured = (np.abs(both) < settings.largest).all(axis=1)  # False for NaN
    force, torque = (np.where(measured[:, None], part, 0.0) for part in (force, torque))
    f2 = np.einsum("ni,ni->n", force, force)
    m2 = np.einsum("ni,ni->n", torque, torque)
    fm = np.einsum("ni,ni->n", force, torque)
    strong = f2 > settings.smallest_force**2
    safe_f2 = np.where(strong, f2, 1.0)
    r2 = radius * radius
    b = r2 * f2 - m2
    # the positive root for q^2; written without cancellation for either sign of b
    root = np.sqrt(b * b + 4.0 * r2 * fm * fm)
    q2 = np.where(b > 0, 2.0 * fm * fm / np.maximum(b + root, 1e-300), (root - b) / (2.0 * r2))
    cross = np.cross(force, torque)
    # pressing: the force points into the finger, F.p < 0, and F.M = q F.p gives q the sign of -F.M
    q = -np.sign(fm) * np.sqrt(np.maximum(q2, 0.0))
    base = cross / safe_f2[:, None]  # the point of the force's line nearest to the origin, exact for q = 0
    along = np.sqrt(np.maximum(r2 - np.einsum("ni,ni->n", base, base), 0.0))
    straight = base - along[:, None] * force / np.sqrt(safe_f2)[:, None]
    denominator = q * (q2 + f2)
    general = np.abs(q) * radius > 1e-6 * np.sqrt(np.maximum(m2, 1e-300))
    safe = np.where(general & (np.abs(denominator) > 0), denominator, 1.0)
    twisted = (q2[:, None] * torque + fm[:, None] * force + q[:, None] * cross) / safe[:, None]
    points = np.where(general[:, None], twisted, straight)
    length = np.linalg.norm(points, axis=1)
    points = points * (radius / np.where(length > 0, length, 1.0))[:, None]
    pressing = np.einsum("ni,ni->n", force, points) < -settings.grazing * radius * np.sqrt(f2)
    reachable = m2 <= (settings.longest_lever * radius) ** 2 * f2
    return points, q * radius, measured & strong & pressing & reachable


def wrench_contacts(frame: Frame) -> Contacts:
    """Contacts (world frame) from a frame's wrenches; sensors that feel nothing (or pull) give none.

    Raises CaptureError for wrenches without a hand, joints or a surface to solve on.
    """
    from touch.wrenches.fingertips import SoftSkin, tip_contacts  # which builds on the sphere above

    if not frame.wrenches:
        return Contacts(np.zeros((0, 3)))
    if frame.hand is None or frame.joints is None or frame.world_from_hand is None:
        raise CaptureError(f"{frame.where}: wrenches need a hand, its joints and its pose to become contacts")
    hand_from_sensor = frame.hand.hand_from_sensor(frame.joints)
    points, normals, names, forces = [], [], [], []
    for wrench in frame.wrenches:
        sensor = frame.hand.sensors.get(wrench.sensor)
        if sensor is None:
            known = ", ".join(frame.hand.sensors)
            raise CaptureError(f"{frame.where}: expected a sensor of the hand ({known}), got {wrench.sensor}")
        if sensor.surface is None:
            raise CaptureError(f"{frame.where}: sensor {wrench.sensor} needs a surface to solve its wrench on")
        surface = _with_mesh(sensor.surface, f"{frame.where}: sensor {wrench.sensor}")
        found = tip_contacts(wrench.force, wrench.torque, surface, SoftSkin.parse(sensor.soft_layer))
        if not found.valid[0]:
            continue
        world_from_sensor = frame.world_from_hand @ hand_from_sensor[wrench.sensor]
        points.append(world_from_sensor[:3, :3] @ found.points[0] + world_from_sensor[:3, 3])
        # the fingertip's outward normal looks into the object: the object's looks back
        normals.append(world_from_sensor[:3, :3] @ -found.normals[0])
        forces.append(world_from_sensor[:3, :3] @ wrench.force)
        names.append(wrench.sensor)
    if not points:
        return Contacts(np.zeros((0, 3)))
    return Contacts(points, normals, np.full(len(points), DEFAULT_SIGMA_POINT), DEFAULT_SIGMA_NORMAL, names, forces)


def _with_mesh(surface: dict[str, dict[str, Any]], where: str) -> dict[str, dict[str, Any]]:
    """The surface; a mesh with its convex hull's vertices and faces beside the name of its file."""
    if "mesh" not in surface or "vertices" in surface["mesh"]:
        return surface
    return {"mesh": dict(zip(("vertices", "faces"), surface_hull(surface, where)))}
