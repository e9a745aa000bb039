"""The last micrometres: modes refined on the exact mesh, where contacts are finer than the lattice."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenes.evidence.align import Alignment, AlignSettings, terms
from scenes.evidence.modes import Mode, distinct_modes
from scenes.evidence.table import TOUCH, from_contacts
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts

Array = NDArray[np.float64]

# Gauss-Newton steps; from within a lattice cell it converges quadratically, or linearly under the linear loss.
STEPS = 25
# A sigma (m) at which a distance says nothing.
NO_DISTANCE = 1e6


def polish(
    model: ObjectModel, contacts: Contacts, modes: tuple[Mode, ...], sigma: float, huber: float = 0.0
) -> tuple[Mode, ...]:
    """Modes moved to the minimum of the exact distances, and of the normals against the lattice's.

    sigma (m) of a contact; huber (sigmas): residuals beyond count linearly, 0 = never. All modes in one batch; a mode
    whose cost would rise stays where it was. Weights are judged anew from the exact costs.
    """
    if not modes:
        return modes
    rotations = np.array([m.pose[:3, :3] for m in modes])
    middles = np.array([m.pose[:3, :3] @ model.centroid + m.pose[:3, 3] for m in modes])
    cost, hessian, gradient = _terms(model, contacts, rotations, middles, sigma, huber)
    damping = np.full(len(modes), 1e-6)
    for _ in range(STEPS):
        scale = np.einsum("mii->mi", hessian)
        damped = (
            hessian + np.eye(6) * (damping[:, None] * scale + 1e-9 * scale.max(axis=1, keepdims=True) + 1e-300)[:, None]
        )
        step = -np.linalg.solve(damped, gradient[..., None])[..., 0]
        length = np.linalg.norm(step[:, 3:], axis=1) + model.radius * np.linalg.norm(step[:, :3], axis=1)
        step *= np.minimum(1.0, model.field.spacing / np.maximum(length, 1e-300))[:, None]
        trial_rotations = se3.exp_rotation(step[:, :3]) @ rotations
        trial_middles = middles + step[:, 3:]
        trial = _terms(model, contacts, trial_rotations, trial_middles, sigma, huber)
        better = trial[0] <= cost
        rotations = np.where(better[:, None, None], trial_rotations, rotations)
        middles = np.where(better[:, None], trial_middles, middles)
        cost = np.where(better, trial[0], cost)
        hessian = np.where(better[:, None, None], trial[1], hessian)
        gradient = np.where(better[:, None], trial[2], gradient)
        damping = np.where(better, np.maximum(damping * 0.2, 1e-9), np.minimum(damping * 10.0 + 1e-6, 1e6))
    rotations = se3.nearest_rotation(rotations)
    moved = se3.make_poses(rotations, middles - rotations @ model.centroid)
    return distinct_modes(model, Alignment(moved, cost, hessian, np.full(len(modes), STEPS)))


def _terms(
    model: ObjectModel, contacts: Contacts, rotations: Array, middles: Array, sigma: float, huber: float
) -> tuple[Array, Array, Array]:
    """Costs (m,), Hessians (m, 6, 6) and gradients (m, 6) of exact distances at every mode."""
    count, n = len(rotations), len(contacts)
    y = contacts.points - middles[:, None]
    q = y @ rotations + model.centroid
    distance, normal, _ = model.surface.closest(q.reshape(-1, 3))
    r = distance.reshape(count, n) / sigma
    g = (normal.reshape(count, n, 3) @ np.swapaxes(rotations, 1, 2)) / sigma
    jac = np.concatenate([np.cross(g, y), -g], axis=2)
    size = np.abs(r)
    if huber > 0:
        w = huber / np.maximum(size, huber)
        loss = np.where(size <= huber, r * r, 2 * huber * size - huber**2)
    else:
        w, loss = np.ones_like(r), r * r
    hessian = np.einsum("mn,mni,mnj->mij", w, jac, jac)
    gradient = np.einsum("mn,mni,mn->mi", w, jac, r)
    cost = 0.5 * loss.sum(axis=1)
    if contacts.has_normal.any():
        # the same contacts with distances that weigh nothing: what remains of the compiled cost are the normals, which
        # must not be widened (bend) by a sigma that stands for no distance
        rows = from_contacts(contacts.take(contacts.has_normal)).with_sigma(NO_DISTANCE, TOUCH)
        poses = se3.make_poses(rotations, middles - rotations @ model.centroid)
        for m, pose in enumerate(poses):
            part = terms(model, rows, pose, settings=AlignSettings(huber=huber, bend=0.0))
            cost[m] += part[0]
            gradient[m] += part[1]
            hessian[m] += part[2]
    return cost, hessian, gradient
