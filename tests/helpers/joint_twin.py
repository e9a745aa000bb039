"""A joint problem of a drill before a camera, and the joint solution's compiled rows again, in plain NumPy."""

from __future__ import annotations

import numpy as np

from fusion.estimation.solve.problem import JointProblem
from fusion.estimation.solve.settings import JointSettings
from fusion.estimation.solve.system import FIXED, SCALE, XI
from scenes.evidence import align as alignment
from scenes.evidence import table as evidence
from scenes.evidence.align import Prior
from scenes.evidence.table import FACING, GATE_ABOVE, GATE_BELOW, NORMAL, OFFSET, POINT, TOUCH, VISION
from scenes.geometry import poses as se3
from scenes.geometry.cameras import Camera
from scenes.recordings.beliefs import Beliefs

CAMERA = Camera(570.0, 570.0, 319.5, 239.5, 640, 480)


def robust(square, gate):
    """Loss and belonging of each row, row_kernels.robust for arrays (see scenes.evidence.table)."""
    over = np.clip(0.5 * (square - gate * gate), -40.0, 40.0)
    floor = np.log1p(np.exp(-0.5 * np.minimum(gate, 30.0) ** 2))
    loss = np.where(over >= 40.0, gate * gate, square - 2.0 * np.log1p(np.exp(over))) + 2.0 * floor
    silent = gate == 0.0
    return np.where(silent, 0.0, loss), np.where(silent, 0.0, 1.0 / (1.0 + np.exp(over)))


def vision(system, pose, unknown):
    """Cost, gradient and Gauss-Newton matrix of the vision rows about (delta, whitened xi, s, b)."""
    problem = system.problem
    rows, model = problem.seen.rows, problem.model
    rotation, middle = pose[:3, :3], pose[:3, :3] @ model.centroid + pose[:3, 3]
    p = rows[:, POINT]
    ray = p / p[:, 2:] if problem.camera is not None else p
    bias = problem.seen_basis @ (system.white[FIXED:] * unknown[FIXED:])
    moved = p - (system.white[SCALE] * unknown[SCALE]) * p - bias[:, None] * ray
    y = moved - middle
    distance, g = model.field.seen_distance_and_gradient(
        y @ rotation + model.centroid, rows[:, NORMAL] @ rotation, rows[:, FACING] > 0
    )
    distance, g = distance - rows[:, OFFSET], g @ rotation.T
    gate = np.where(distance > 0, rows[:, GATE_ABOVE], rows[:, GATE_BELOW])
    normals = system.normals @ rotation.T
    cosine = np.where(problem.is_pixel, -np.sum(normals * rows[:, NORMAL], axis=1), 1.0)
    steep = cosine < problem.settings.least_cosine
    turning = np.where((problem.is_pixel & ~steep)[:, None], -np.cross(normals, rows[:, NORMAL]), 0.0)
    cosine = np.where(steep, problem.settings.least_cosine, cosine)
    distance, g = distance / cosine, g / cosine[:, None]
    sigma = problem.sigma * system.slope
    loss, belongs = robust((distance / sigma) ** 2 + 2.0 * np.log(system.slope), gate)
    jac = np.zeros((len(rows), len(unknown)))
    jac[:, :3] = np.cross(g, y) - (distance / cosine)[:, None] * turning
    jac[:, 3:6] = -g
    jac[:, SCALE] = -np.sum(g * p, axis=1) * system.white[SCALE]
    jac[:, FIXED:] = -np.sum(g * ray, axis=1)[:, None] * problem.seen_basis * system.white[FIXED:]
    weighted = jac * (system.problem.weight * belongs / sigma**2)[:, None]
    return 0.5 * float(system.problem.weight @ loss), weighted.T @ distance, weighted.T @ jac


def touch(system, pose, unknown):
    """Touch rows moved by xi, about (delta, whitened xi)."""
    problem = system.problem
    xi = system.white_xi @ unknown[XI]
    moved = problem.felt.moved(se3.perturb(np.eye(4), xi, system.centre))
    how = alignment.AlignSettings(bend=problem.settings.bend)
    cost, g, h = alignment.terms(problem.model, moved, pose, settings=how)
    lever = np.eye(6)
    lever[3:, :3] = -se3.skew(pose[:3, :3] @ problem.model.centroid + pose[:3, 3] - system.centre)
    chain = np.concatenate([np.eye(6), -lever @ system.white_xi], axis=1)
    return cost, chain.T @ g, chain.T @ h @ chain


def hand(system, unknown):
    """The hand's pixels about (whitened xi, s, b): quadratic."""
    constant, gradient, normal = system._hand_white
    x = unknown[6:]
    return constant + gradient @ x + 0.5 * x @ normal @ x, gradient + normal @ x, normal


def terms(system, pose, unknown):
    """Cost, gradient and Gauss-Newton matrix of the whole system."""
    problem, size = system.problem, len(unknown)
    normal, gradient = np.diag(np.concatenate([np.zeros(6), np.ones(size - 6)])), unknown.copy()
    gradient[:6] = 0.0
    cost = 0.5 * unknown[6:] @ unknown[6:]
    seen = vision(system, pose, unknown)
    seen = seen if problem.pixels_tell else explained_by_a_pose(*seen)
    parts = [(slice(None), seen), (slice(0, 12), touch(system, pose, unknown))]
    if problem.hand is not None:
        parts.append((slice(6, None), hand(system, unknown)))
    if problem.prior is not None:
        parts.append((slice(0, 6), alignment.terms(problem.model, evidence.empty(), pose, problem.prior)))
    for where, (part, g, h) in parts:
        cost += part
        gradient[where] += g
        normal[where, where] += h
    return cost, gradient, normal


def explained_by_a_pose(cost, gradient, normal):
    """What pixels tell of scale and bias, their residuals projected on what the pose makes of them."""
    known, cross = np.linalg.pinv(normal[:6, :6], rcond=1e-13), normal[12:, :6]
    gradient, normal = gradient.copy(), normal.copy()
    gradient[12:], normal[12:, 12:] = cross @ known @ gradient[:6], cross @ known @ cross.T
    return cost, gradient, normal


def made_problem(drill, rng, camera=CAMERA, prior=True, hand=None, noise=0.001, pixels_tell=True):
    """A drill before a camera: pixels of its near side, contacts with normals around it."""
    pose = se3.make_pose(se3.random_rotations(1, rng)[0], [0.02, -0.03, 0.5])
    points, normals = drill.sample_surface(400, seed=int(rng.integers(2**31)))
    points, normals = se3.apply(pose, points), normals @ pose[:3, :3].T
    rays = points / np.linalg.norm(points, axis=1, keepdims=True)
    near = np.sum(normals * rays, axis=1) < -0.3
    seen_points = (points + noise * rng.normal(size=points.shape))[near][:80]
    seen = evidence.make(
        seen_points,
        0.002,
        VISION,
        gate_above=2.5,
        gate_below=5.0,
        rays=seen_points / np.linalg.norm(seen_points, axis=1, keepdims=True),
    )
    seen = away_from_kinks(drill, seen, pose)
    felt = evidence.make(
        points[~near][:8] + noise * rng.normal(size=(8, 3)), 1e-3, TOUCH, normals=normals[~near][:8], sigma_normal=0.1
    )
    felt = away_from_kinks(drill, felt, pose)
    believed = Prior.isotropic(se3.perturb(pose, 0.01 * rng.normal(size=6), drill.centroid), 0.2, 0.02)
    # the widening of normals at bent places is a weight that is not differentiated: off, derivatives are exact
    exact = JointSettings(bend=0.0)
    prior = believed if prior else None
    fingers, told = int(felt.on.sum()), {"settings": exact, "pixels_tell": pixels_tell}
    problem = JointProblem(drill, seen, felt, fingers, prior, hand, Beliefs(), camera, **told)
    return problem, pose


def away_from_kinks(model, table, pose, share=0.01):
    local = se3.apply(se3.inverse(pose), table.points)
    cell = (local - model.field.origin) / model.field.spacing
    good = (np.abs(cell - np.round(cell)) > share).all(axis=1)
    _, gradient = model.field.distance_and_gradient(local)
    turned = table.rows[:, 3:6] @ pose[:3, :3]
    good &= (table.rows[:, evidence.FACING] == 0) | (np.sum(gradient * turned, axis=1) < -1e-2)
    return table.take(good)
