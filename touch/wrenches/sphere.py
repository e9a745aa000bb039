"""Intrinsic contact sensing: from the wrench on a convex fingertip to the contact point (Bicchi, Salisbury & Brock
1993; T1 section 2.2.1). Spherical fingertips, rigid, in closed form here; other shapes and soft layers in `fingertips`.

A soft finger pressed at p on its surface S(p) = 0 by a force F feels the moment M = p x F + k grad S(p): only a moment
about the normal is transmitted (T1 eq. 2.3). On a sphere of radius R about the sensor's origin the normal is p / R,
and grad S is along p:   M = p x F + q p, solved in closed form below.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
