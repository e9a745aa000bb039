"""Batches of poses through the compiled kernel: shapes checked at the door, work spread over threads by poses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError
from scenes.evidence import kernels, solver_kernels
from scenes.evidence.table import COLUMNS, Evidence
from scenes.geometry import poses as se3
from scenes.geometry import rotation_kernels
from scenes.geometry.objects import ObjectModel
from scenes.threads import run_chunks

Array = NDArray[np.float64]

# Blurs of at least so many spacings of the coarser lattice are looked up there: at 1.5 costs differ by half a nat.
COARSE = 1.5
# A prior that says nothing, as the kernels take it.
NO_PRIOR = np.eye(3), np.zeros(3), np.zeros((6, 6))
# How far (shares of the largest entry) an information may be from symmetric, and below 0: it is a rounded inverse.
INEXACT = 1e-4


@dataclass(frozen=True)
class AlignSettings:
    """One stage of alignment. Values by judgement."""

    # Added in quadrature to every row's sigma: metres on points, radians on normals. 0 is the final stage.
    blur: float = 0.0
    blur_normal: float = 0.0
    # Residuals beyond this many sigmas count linearly instead of by the rows' gates; 0 = the gates decide.
    huber: float = 0.0
    # Whether blurred costs may be looked up in the coarser lattice (no unit). Contacts alone decide between poses by
    # normals near edges, which it rounds.
    coarsely: bool = True
    # Share of a point's sigma by which its normal may have been felt elsewhere on a bent surface; 0 = normals are those
    # exactly at the point.
    bend: float = 1.0
    # Steps tried per pose.
    iterations: int = 30
    # A step below both ends the work: 1e-5 rad on a 10 cm object is a micrometre.
    tolerance_angle: float = 1e-5
    tolerance_distance: float = 1e-6
    # Longest single step, radians and shares of the object's radius: a Gauss-Newton model of a shape holds no further.
    longest_angle: float = 0.5
    longest_share: float = 0.5


# Where nobody asks for another stage: made once.
USUAL = AlignSettings()


@dataclass(frozen=True)
class Prior:
    """A Gaussian on the pose: mean (4, 4) frame_from_object, information (6, 6) in the chart of poses.perturb
    (rotation rad, displacement of the centroid m, both in the frame's axes).
    """

    pose: Array
    information: Array

    @staticmethod
    def isotropic(pose: Array, sigma_angle: float, sigma_distance: float) -> Prior:
        """From standard deviations per axis: radians and metres."""
        if not (sigma_angle > 0 and sigma_distance > 0):
            raise InputError(f"prior: expected sigmas above 0, got {sigma_angle} rad and {sigma_distance} m")
        return Prior(pose, np.diag([sigma_angle**-2] * 3 + [sigma_distance**-2] * 3))

    @cached_property
    def checked(self) -> tuple[Array, Array, Array]:
        """Rotation (3, 3), translation (3,) and information (6, 6), in order in memory."""
        shapes = np.shape(self.pose), np.shape(self.information)
        if shapes != ((4, 4), (6, 6)) or not (np.isfinite(self.pose).all() and np.isfinite(self.information).all()):
            raise InputError(f"prior: expected a finite pose (4, 4) and information (6, 6), got shapes {shapes}")
        information = np.ascontiguousarray(self.information, dtype=np.float64)
        return np.ascontiguousarray(self.pose[:3, :3]), np.ascontiguousarray(self.pose[:3, 3]), information

    def about(self, centroid: Array) -> tuple[Array, Array, Array]:
        """Rotation, place of an object's centroid (3,) and information: worked out once for one object."""
        if not self._known or self._known[0] is not centroid:
            rotation, translation, information = self.checked
            self._known[:] = centroid, (rotation, rotation @ centroid + translation, information)
        about: tuple[Array, Array, Array] = self._known[1]
        return about

    @cached_property
    def _known(self) -> list[Any]:
        """The centroid of the object last asked for, and what was told."""
        return []


def check_prior(prior: object) -> Prior:
    """The prior itself. Raises InputError for what is no Prior, a pose that is not rigid, and an information that is
    not six by six, finite, symmetric and positive semidefinite: no Gaussian has another.
    """
    if not isinstance(prior, Prior):
        raise InputError(f"prior: expected Prior (Prior.isotropic(pose, rad, m)), got {type(prior).__name__}")
    information = prior.checked[2]
    se3.check_pose(prior.pose, "prior")
    # angles and lengths differ by orders of magnitude: each in its own unit
    told = np.abs(np.diag(information))
    most = np.repeat(np.maximum(told.reshape(2, 3).max(axis=1), 1e-300), 3)
    scale = np.sqrt(np.maximum(told, INEXACT * most))
    scaled = information / scale / scale[:, None]
    largest = float(np.abs(scaled).max())
    if float(np.abs(scaled - scaled.T).max()) > INEXACT * largest:
        raise InputError("prior: expected a symmetric information (6, 6), got one that is not")
    if float(np.linalg.eigvalsh(scaled)[0]) < -INEXACT * largest:
        raise InputError("prior: expected an information (6, 6) that is negative nowhere, got one that is")
    return prior


@dataclass(frozen=True)
class Alignment:
    """Aligned poses (b, 4, 4), their costs (b,), Gauss-Newton Hessians (b, 6, 6) and steps tried (b,), same order."""

    poses: Array
    costs: Array
    hessians: Array
    iterations: NDArray[np.int64]

    def take(self, index: NDArray[np.intp]) -> Alignment:
        """The chosen poses."""
        return Alignment(self.poses[index], self.costs[index], self.hessians[index], self.iterations[index])

    def joined(self, other: Alignment) -> Alignment:
        """These poses, then the other's."""
        return Alignment(
            np.concatenate([self.poses, other.poses]),
            np.concatenate([self.costs, other.costs]),
            np.concatenate([self.hessians, other.hessians]),
            np.concatenate([self.iterations, other.iterations]),
        )


def _split(model: ObjectModel, poses: Array) -> tuple[Array, Array]:
    poses = np.ascontiguousarray(poses, dtype=np.float64).reshape(-1, 4, 4)
    rotations, middles = np.zeros((len(poses), 3, 3)), np.zeros((len(poses), 3))
    if not rotation_kernels.split(poses, model.centroid, rotations, middles):
        raise InputError("alignment: expected finite poses")
    return rotations, middles


def lattice_of(model: ObjectModel, blur: float = 0.0) -> tuple:
    """The object as the kernels take it: lattice values, origin, spacing and step (m), and the centroid. What is
    blurred (m) that much needs no finer lattice than one that stays in a processor's nearer memory.
    """
    field = model.field
    coarse = field.coarser
    field = field if coarse is None or blur < COARSE * coarse.spacing else coarse
    return *field.told, model.centroid


def prior_of(model: ObjectModel, prior: Prior | None) -> tuple:
    """A prior as the kernels take it: rotation, place of the centroid, information (zeros for None)."""
    return NO_PRIOR if prior is None else prior.about(model.centroid)


def _scene(model: ObjectModel, evidence: Evidence, prior: Prior | None, settings: AlignSettings) -> tuple:
    """The arguments that all kernels begin with: lattice, rows, stage, prior."""
    rows = np.ascontiguousarray(evidence.rows, dtype=np.float64)
    if not evidence.is_sound:
        raise InputError(f"alignment: expected finite evidence of {COLUMNS} columns, got shape {rows.shape}")
    stage = float(settings.blur), float(settings.blur_normal), float(settings.huber), float(settings.bend)
    return lattice_of(model, settings.blur if settings.coarsely else 0.0), rows, stage, prior_of(model, prior)


def align(
    model: ObjectModel,
    evidence: Evidence,
    starts: Array,
    prior: Prior | None = None,
    settings: AlignSettings | None = None,
) -> Alignment:
    """Move every start (b, 4, 4) frame_from_object to a local minimum of the evidence's cost.

    evidence and prior in the same frame. The cost of a pose never rises. Along directions that
    the evidence leaves free a pose may drift by part of the object's size; the Hessian tells which they are.
    """
    settings = settings or USUAL
    scene, limits = _scene(model, evidence, prior, settings), _limits(model, settings)

    def work(part: slice, *told: Array) -> None:
        solver_kernels.align_poses(*scene, limits, *told)  # type: ignore[call-arg]

    return _aligned(model, starts, work, len(evidence) * settings.iterations)


def align_each(
    model: ObjectModel,
    own: Sequence[Evidence],
    shared: Evidence,
    starts: Array,
    prior: Prior | None = None,
    settings: AlignSettings | None = None,
) -> Alignment:
    """`align` of starts (b, 4, 4), at least one, each by evidence of its own beside what they share."""
    settings = settings or USUAL
    rows = np.concatenate([part for mine in own for part in (mine.rows, shared.rows)])
    edges = np.zeros(len(own) + 1, dtype=np.int64)
    np.cumsum([len(mine) + len(shared) for mine in own], out=edges[1:])
    lattice, rows, *rest = _scene(model, Evidence(rows, np.zeros(len(rows), dtype=np.uint8)), prior, settings)
    limits = _limits(model, settings)

    def work(part: slice, *told: Array) -> None:
        of = edges[part.start : part.stop + 1]
        solver_kernels.align_each(lattice, rows, of, *rest, limits, *told)  # type: ignore[call-arg]

    return _aligned(model, starts, work, len(rows) // len(own) * settings.iterations)


def _limits(model: ObjectModel, settings: AlignSettings) -> tuple:
    """Of an alignment's steps, as the kernels take them."""
    return (
        int(settings.iterations),
        float(settings.tolerance_angle),
        float(settings.tolerance_distance),
        model.radius,
        float(settings.longest_angle),
        float(settings.longest_share * model.radius),
    )


def _aligned(model: ObjectModel, starts: Array, work: Callable[..., None], each: int) -> Alignment:
    """Where work(part, rotations, middles, costs, hessians, steps) moves starts (b, 4, 4); each: rows that one looks up
    at most.
    """
    rotations, middles = _split(model, starts)
    count = len(rotations)
    out_costs, hessians, used = np.zeros(count), np.zeros((count, 6, 6)), np.zeros(count, dtype=np.int64)

    def of(part: slice) -> None:
        work(part, rotations[part], middles[part], out_costs[part], hessians[part], used[part])

    run_chunks(of, count, smallest=max(1, 4000 // (each + 1)))
    poses = np.zeros((count, 4, 4))
    rotation_kernels.joined(rotations, middles, model.centroid, poses)
    return Alignment(poses, out_costs, hessians, used)


def costs(
    model: ObjectModel,
    evidence: Evidence,
    candidates: Array,
    prior: Prior | None = None,
    settings: AlignSettings | None = None,
) -> Array:
    """Costs (b,) of candidate poses (b, 4, 4) as they are."""
    settings = settings or USUAL
    rotations, middles = _split(model, candidates)
    scene = _scene(model, evidence, prior, settings)
    out = np.zeros(len(rotations))

    def work(part: slice) -> None:
        kernels.cost_poses(*scene, rotations[part], middles[part], out[part])  # type: ignore[call-arg]

    run_chunks(work, len(rotations), smallest=max(1, 8000 // (len(evidence) + 1)))
    return out


def terms(
    model: ObjectModel,
    evidence: Evidence,
    pose: Array,
    prior: Prior | None = None,
    settings: AlignSettings | None = None,
) -> tuple[float, Array, Array]:
    """Cost, gradient (6,) and Gauss-Newton Hessian (6, 6) at one pose, in the chart of poses.perturb."""
    settings = settings or USUAL
    rotations, middles = _split(model, pose)
    scene = _scene(model, evidence, prior, settings)
    hessian, gradient = np.zeros((6, 6)), np.zeros(6)
    cost = kernels.terms_at(*scene, rotations[0], middles[0], hessian, gradient)  # type: ignore[call-arg]
    return float(cost), gradient, hessian


def terms_of_each(model: ObjectModel, evidence: Evidence, pose: Array, settings: AlignSettings | None = None) -> Array:
    """(n, 6, 6) Gauss-Newton Hessians at one pose of each row of evidence as if it were alone."""
    rotations, middles = _split(model, pose)
    lattice, rows, stage, none = _scene(model, evidence, None, settings or USUAL)
    hessians, gradient = np.zeros((len(rows), 6, 6)), np.zeros(6)
    for n, hessian in enumerate(hessians):
        row = rows[n : n + 1]
        kernels.terms_at(lattice, row, stage, none, rotations[0], middles[0], hessian, gradient)
    return hessians
