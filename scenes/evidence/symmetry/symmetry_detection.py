"""The symmetries of a mesh, found by aligning the object with itself. Object frame, metres.

Surface samples are evidence that the object's own lattice explains where it is; started from everywhere else, the same
batched alignment that finds poses ends at the other poses that explain them as well: the symmetries. A symmetry about
whose axis any turn does as well is a continuous one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.evidence import table as evidence
from scenes.evidence.align import AlignSettings, align
from scenes.evidence.search import rotation_grid
from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel
from scenes.geometry.symmetries import PARALLEL_COSINE, Axis, Symmetries

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DetectionSettings:
    """What still counts as the same. Values by judgement, on the library's objects and scanned meshes."""

    # Distance that the surface may be off after the motion, as a share of the diameter (a facet of a 96-gon is 0.05 %),
    # and not below (m) what meshes are made to. A hexagonal pencil is 0.5 mm from a round one.
    tolerance_share: float = 0.0015
    tolerance: float = 0.0003
    # Share of the surface that must be within it: a maker's mark or a spout breaks a symmetry, a scratch does not.
    share: float = 0.995
    # Starts over all rotations, and surface samples for aligning and for checking.
    starts: int = 600
    align_samples: int = 400
    check_samples: int = 1200
    # Symmetries nearer than this (rad) are one. A polygon of more corners than 2 pi over this is taken for round.
    same_angle: float = float(np.deg2rad(8.0))
    # Turns (rad) that a round object must bear, irrational shares of a full one.
    probes: tuple[float, ...] = (0.37, 1.0, 1.618, 2.2, 2.9)
    # Discrete symmetries beyond this many mean a round object that the tolerance is too strict for; the best are kept.
    most: int = 120


def detect_symmetries(model: ObjectModel, settings: DetectionSettings | None = None) -> Symmetries:
    """Discrete and continuous rotations (no reflections: no pose is one) that leave the mesh where it was.

    The answer has the identity first among the discrete ones, and lists none that a continuous axis explains.
    """
    settings = settings or DetectionSettings()
    limit = max(settings.tolerance, settings.tolerance_share * model.diameter)
    points, _ = model.sample_surface(settings.check_samples, seed=1)
    found = _aligned(model, settings)
    # the best of each neighbourhood stands for it: exact distances are asked for a few dozen motions only
    found = _distinct(np.concatenate([np.eye(4)[None], found]), settings.same_angle)
    rough = [float(np.quantile(np.abs(model.field.distance(poses.apply(p, points))), 0.9)) for p in found[1:]]
    near = [_settled(model, points, p) for p, off in zip(found[1:], rough) if off <= 3 * limit]
    members = np.array([np.eye(4), *(p for p in near if _off(model, points, p, settings.share) <= limit)])
    axes: list[Axis] = []
    for axis in _axes_of(members, model):
        if any(abs(float(axis.direction @ a.direction)) > 0.98 for a in axes):
            continue
        turned = [_turn(axis, angle) for angle in settings.probes]
        if all(_off(model, points, pose, settings.share) <= limit for pose in turned):
            axes.append(axis)
    if len(axes) > 1 and any(abs(float(axes[0].direction @ a.direction)) < PARALLEL_COSINE for a in axes[1:]):
        centre = axes[0].point
        return Symmetries(axes=tuple(Axis(centre, direction) for direction in np.eye(3)))
    if axes:
        return Symmetries(_beside(members, axes[0], settings.same_angle), (axes[0],))
    return Symmetries(members[: settings.most])


def _aligned(model: ObjectModel, settings: DetectionSettings) -> Array:
    """Local minima (k, 4, 4) of the distance between the moved surface and the object, about the centroid."""
    points, normals = model.sample_surface(settings.align_samples, seed=0)
    rows = evidence.make(points, 0.02 * model.radius, evidence.TOUCH, normals=normals, sigma_normal=0.3)
    rotations = rotation_grid(settings.starts)
    starts = np.tile(np.eye(4), (len(rotations), 1, 1))
    starts[:, :3, :3] = rotations
    starts[:, :3, 3] = model.centroid - rotations @ model.centroid
    rough = align(model, rows, starts, settings=AlignSettings(iterations=12))
    # one of each neighbourhood first: a basin that the lattice likes a little less must not be crowded out
    best = _distinct(rough.poses[np.argsort(rough.costs, kind="stable")], 0.5 * settings.same_angle)
    best = best[: settings.starts // 2]
    exact = evidence.make(points, 1e-3 * model.radius, evidence.TOUCH)
    fine = align(model, exact, best, settings=AlignSettings(iterations=25))
    order = np.argsort(fine.costs, kind="stable")
    # samples that lie on the object after being moved by x lie there before being moved by its inverse, too
    return fine.poses[order]


def _settled(model: ObjectModel, points: Array, pose: Array, steps: int = 3) -> Array:
    """The pose after Gauss-Newton steps on exact distances: the lattice is a tenth of a millimetre off."""
    for _ in range(steps):
        moved = poses.apply(pose, points)
        distance, normal, _ = model.surface.closest(moved)
        centre = pose[:3, :3] @ model.centroid + pose[:3, 3]
        jacobian = np.concatenate([np.cross(moved - centre, normal), normal], axis=1)
        # free directions (a turn of a round body) stay where they are
        delta = -np.linalg.lstsq(jacobian, distance, rcond=1e-3)[0]
        pose = poses.perturb(pose, delta, model.centroid)
    return pose


def _off(model: ObjectModel, points: Array, pose: Array, share: float) -> float:
    """Distance (m) within which `share` of the moved surface lies from the surface."""
    # exact distances: at edges the lattice is off by as much as what is to be told apart
    distance, _, _ = model.surface.closest(poses.apply(pose, points))
    return float(np.quantile(np.abs(distance), share))


def _distinct(members: Array, same: float) -> Array:
    """The first of each group of rotations within `same` (rad) of one another."""
    kept: list[Array] = []
    for pose in members:
        if not kept:
            kept.append(pose)
            continue
        relative = np.swapaxes(np.array(kept)[:, :3, :3], -1, -2) @ pose[:3, :3]
        if poses.rotation_angle(relative).min() > same:
            kept.append(pose)
    return np.array(kept)


def _axes_of(members: Array, model: ObjectModel) -> list[Axis]:
    """Axes of the members' rotations, those of the most members first, the mean over those that share one."""
    vectors = poses.log_rotation(members[1:, :3, :3])
    if not len(vectors):
        return []
    unit = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    alike = np.abs(unit @ unit.T) > 0.995
    axes, left = [], np.ones(len(unit), dtype=bool)
    while left.any():
        lead = int(np.argmax(np.where(left, (alike & left).sum(axis=1), -1)))
        group = alike[lead] & left
        signs = np.sign(unit[group] @ unit[lead])
        # a small angle says little of its axis
        weight = np.linalg.norm(vectors[group], axis=1)
        direction = (weight * signs) @ unit[group]
        direction /= np.linalg.norm(direction)
        axes.append(Axis(_point_of(members[1:][group], direction, model), direction))
        left &= ~group
    return axes


def _point_of(members: Array, direction: Array, model: ObjectModel) -> Array:
    """(3,) the point nearest to the centroid that the members leave where it is."""
    rows = [np.eye(3) - pose[:3, :3] for pose in members] + [1e-3 * np.outer(direction, direction)]
    right = [pose[:3, 3] for pose in members] + [1e-3 * direction * float(direction @ model.centroid)]
    return np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=None)[0]


def _turn(axis: Axis, angle: float) -> Array:
    turn = poses.exp_rotation(angle * axis.direction)
    return poses.make_pose(turn, axis.point - turn @ axis.point)


def _beside(members: Array, axis: Axis, same: float) -> Array:
    """The identity, and one member that turns the axis upside down when there is one."""
    kept = [np.eye(4)]
    ends = members[:, :3, :3] @ axis.direction
    for pose, end in zip(members[1:], ends[1:]):
        if float(end @ axis.direction) < -np.cos(same):
            kept.append(pose)
            break
    return np.array(kept)
