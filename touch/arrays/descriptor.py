"""The descriptor of a tactile array (T1 sections 5.2.1 to 5.2.3): covariance and eigenbasis of [x, y, alpha p].

On a curved layout the points place + alpha p normal are taken in the tangent frame of the part that is pressed: origin
in the mean active taxel, z along the mean active normal, out of the finger; on a flat pad that is T1's own frame.

Degenerate readings. Signs and, where eigenvalues are equal, whole directions of eigenvectors are arbitrary. Here the
third vector always looks out of the finger, the first along the pad's x, and ties are broken towards the pad's axes.
What is compared with geometry does not depend on any of this: ||cov(E^T S) - Lambda|| = ||cov(S) - C_M||, because
Frobenius norms do not change in a rotated basis, so costs cannot jump where eigenvalues cross.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError
from scenes.geometry import poses as se3
from touch.arrays.readings import Reading, alpha_of

Array = NDArray[np.float64]

# Eigenvalues closer than this share of the largest, or of a square micrometre, count as equal.
TIE = 1e-6
SMALLEST_VARIANCE = 1e-12


@dataclass(frozen=True)
class Descriptor:
    """frame_from_tangent (4, 4): the pad's tangent frame. In it: centroid (3,) m of the pressed surface;
    covariance (3, 3) m^2 with T1's n - 1; eigenvalues (3,) m^2, descending; basis (3, 3), its columns are
    e1, e2, e3, right-handed; active: how many taxels felt something.
    """

    frame_from_tangent: Array
    centroid: Array
    covariance: Array
    eigenvalues: Array
    basis: Array
    active: int

    @property
    def slope(self) -> float:
        """Angle (rad) between the first principal axis and the tangent plane: the tilt of what is touched."""
        e1 = self.basis[:, 0]
        return float(np.arctan2(abs(e1[2]), np.hypot(e1[0], e1[1])))

    @property
    def heading(self) -> Array:
        """(2,) direction of the first principal axis in the tangent plane by its double angle, times how much longer
        the pattern is than wide (0 to 1): continuous for every pressure pattern, zero for a round one.
        """
        c = self.covariance
        total = c[0, 0] + c[1, 1]
        if total <= SMALLEST_VARIANCE:
            return np.zeros(2)
        return np.array([c[0, 0] - c[1, 1], 2.0 * c[0, 1]]) / total


def tangent_frame(reading: Reading) -> Array:
    """(4, 4) frame_from_tangent: origin and z from the active taxels, of all when none is; x along the sensor's x."""
    chosen = reading.active if reading.active.any() else np.ones(len(reading.taxels), dtype=bool)
    normal = reading.taxels[chosen, 3:].mean(axis=0)
    length = float(np.linalg.norm(normal))
    # taxels all around a finger have no mean normal: that of the one pressed most stands in
    normal = normal / length if length > 1e-6 else reading.taxels[int(np.argmax(reading.pressure)), 3:]
    # the axis of the sensor that lies best in the plane, so that x does not turn when the pressure moves a little
    axes = reading.frame_from_sensor[:3, :3]
    x = axes[:, 0] if abs(axes[:, 0] @ normal) < 0.9 else axes[:, 1]
    x = x - (x @ normal) * normal
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(normal, x), normal], axis=1)
    return se3.make_pose(rotation, reading.taxels[chosen, :3].mean(axis=0))


def describe(reading: Reading, alpha: float | None = None, power: float = 0.0) -> Descriptor:
    """The descriptor of a reading; without an active taxel all variances are zero and the basis is the pad's.

    alpha (m / Pa): default that of the pad's layer. power: taxels weigh pressure ** power; 0 is T1's descriptor, which
    counts the blurred border of a contact as much as its middle; 2 follows the middle.
    """
    frame, on = tangent_frame(reading), reading.active
    alpha = alpha_of(reading.layer) if alpha is None else alpha
    surface = reading.taxels[on, :3] + alpha * reading.pressure[on, None] * reading.taxels[on, 3:]
    points = se3.apply(se3.inverse(frame), surface)
    if not len(points):
        return Descriptor(frame, np.zeros(3), np.zeros((3, 3)), np.zeros(3), np.eye(3), 0)
    weight = (reading.pressure[on] / reading.pressure[on].max()) ** power
    weight /= weight.sum()
    centroid = weight @ points
    away = points - centroid
    # n - 1 for equal weights; a single taxel has no variance
    covariance = (away * weight[:, None]).T @ away / max(1.0 - float(weight @ weight), 1e-9)
    values, basis = eigenbasis(covariance)
    return Descriptor(frame, centroid, covariance, values, basis, len(points))


def calibrate_alpha(readings: Sequence[Reading], normals: Array, power: float = 0.0) -> float:
    """Alpha (m / Pa) of a pad from presses of known shapes at known tilts, as T1 section 5.2.2 chose its own: the one
    that turns e3 onto the surfaces' normals (n, 3), out of the object, readings' frames, best in the mean square.

    The layer's blur and the round shape of contacts make tilts look smaller than they are, by about as much for every
    shape; the stiffness alone does not know that. Raises InputError for no reading or shapes that do not fit.
    """
    from scipy.optimize import minimize_scalar

    normals = np.asarray(normals, dtype=np.float64)
    if not readings or normals.shape != (len(readings), 3):
        raise InputError(f"alpha: expected a normal for each of {len(readings)} readings, got shape {normals.shape}")
    stiff = alpha_of(readings[0].layer)

    def miss(factor: float) -> float:
        total = 0.0
        for reading, normal in zip(readings, normals):
            found = describe(reading, factor * stiff, power)
            # e3 looks out of the finger, into the object
            e3 = found.frame_from_tangent[:3, :3] @ found.basis[:, 2]
            total += float(np.arctan2(np.linalg.norm(np.cross(e3, normal)), -(e3 @ normal)) ** 2)
        return total

    return stiff * float(minimize_scalar(miss, bounds=(0.5, 3.0), method="bounded").x)


def eigenbasis(covariance: Array) -> tuple[Array, Array]:
    """Eigenvalues (3,), descending, and right-handed eigenvectors (3, 3), columns, of a covariance (3, 3).

    e3 has z > 0, e1 has x > 0 (y > 0 when x is 0). Inside a subspace of equal eigenvalues the directions nearest to
    the frame's axes are taken.
    """
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1]
    tie = max(TIE * float(values[0]), SMALLEST_VARIANCE)
    first = 0
    for last in range(1, 4):
        if last < 3 and values[last - 1] - values[last] <= tie:
            continue
        if last - first > 1:
            vectors = _toward_axes(vectors, first, last)
        first = last
    e3 = vectors[:, 2] if vectors[2, 2] >= 0 else -vectors[:, 2]
    e1 = vectors[:, 0]
    leading = e1[0] if abs(e1[0]) > 1e-9 else e1[1]
    e1 = e1 if leading >= 0 else -e1
    return values, np.stack([e1, np.cross(e3, e1), e3], axis=1)


def _toward_axes(vectors: Array, first: int, last: int) -> Array:
    """The same subspace, spanned by what is nearest to the frame's axes: z goes last, where the smallest belongs."""
    span = vectors[:, first:last]
    # orthogonal Procrustes: the rotation inside the subspace that brings its columns closest to the axes
    u, _, vt = np.linalg.svd(span.T @ np.eye(3)[:, first:last])
    out = vectors.copy()
    out[:, first:last] = span @ (u @ vt)
    return out
