"""The rigid motions that leave an object looking the same: a finite set times continuous rotations about axes.

Same content as BOP's models_info (symmetries_discrete, symmetries_continuous), metres, object frame.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenes.errors import InputError
from scenes.geometry import poses

Array = NDArray[np.float64]

# Two axes closer than this (|cos|) are one axis; an object with two different axes turns freely.
PARALLEL_COSINE = 0.999


@dataclass(frozen=True)
class Axis:
    """A line about which the object turns without changing: point (3,) metres, direction (3,) unit."""

    point: Array
    direction: Array


@dataclass(frozen=True)
class Symmetries:
    """discrete (k, 4, 4) object_from_object, the identity first; axes of continuous rotation, often none."""

    discrete: Array = field(default_factory=lambda: np.eye(4)[None])
    axes: tuple[Axis, ...] = ()

    @staticmethod
    def none() -> Symmetries:
        """Only the identity."""
        return Symmetries()

    @staticmethod
    def about_axis(direction: ArrayLike, point: ArrayLike = (0.0, 0.0, 0.0), flip: bool = False) -> Symmetries:
        """A body of revolution; `flip` when turning it upside down changes nothing (a plain cylinder).

        Raises InputError for a direction that is none.
        """
        if np.shape(direction) != (3,) or not 0.0 < np.linalg.norm(np.asarray(direction, dtype=np.float64)) < np.inf:
            raise InputError(f"direction: expected three numbers, not all 0, like [0, 0, 1], got {direction!r}")
        axis = np.asarray(direction, dtype=np.float64)
        axis = axis / np.linalg.norm(axis)
        centre = np.asarray(point, dtype=np.float64)
        discrete = [np.eye(4)]
        if flip:
            other = np.eye(3)[np.argmin(np.abs(axis))]
            across = np.cross(axis, other)
            half_turn = poses.exp_rotation(np.pi * across / np.linalg.norm(across))
            discrete.append(poses.make_pose(half_turn, centre - half_turn @ centre))
        return Symmetries(np.array(discrete), (Axis(centre, axis),))

    @property
    def is_trivial(self) -> bool:
        """True when only the identity leaves the object unchanged."""
        return len(self.discrete) == 1 and not self.axes

    @property
    def is_spherical(self) -> bool:
        """True when the object turns freely about a point (two axes that are not parallel)."""
        return any(
            abs(float(a.direction @ b.direction)) < PARALLEL_COSINE for a in self.axes for b in self.axes if a is not b
        )

    def poses(self, steps: int = 36) -> Array:
        """(k, 4, 4) samples of the group: every discrete member times `steps` turns about the axis.

        A spherical object gives `steps` cubed turns, about three perpendicular lines through its centre.
        """
        members = self.discrete
        axes = self.axes[:1]
        if self.is_spherical:  # two declared axes say as much as three, but turns about two alone miss most rotations
            axes = tuple(Axis(self._centre(), direction) for direction in np.eye(3))
        for axis in axes:
            turns = poses.exp_rotation(np.linspace(0, 2 * np.pi, steps, endpoint=False)[:, None] * axis.direction)
            step = np.tile(np.eye(4), (steps, 1, 1))
            step[:, :3, :3] = turns
            step[:, :3, 3] = axis.point - turns @ axis.point
            members = (members[:, None] @ step[None]).reshape(-1, 4, 4)
        return members

    def nearest(self, pose: Array, reference: Array) -> Array:
        """The pose (..., 4, 4) among its equivalents whose rotation is nearest to the reference's.

        Discrete members are tried one by one; the turn about an axis is found in closed form: it maximises
        trace(R_ref^T R G A(angle)), a sine of the angle. A spherical object takes the reference's rotation.
        """
        pose = np.asarray(pose, dtype=np.float64)
        if self.is_trivial:
            return pose
        reference = np.broadcast_to(reference, pose.shape)
        candidates = pose[..., None, :, :] @ self.discrete
        target = np.swapaxes(reference[..., None, :3, :3], -1, -2)
        if self.is_spherical:
            centre = self._centre()
            turned = poses.make_pose()
            out = np.tile(turned, (*pose.shape[:-2], 1, 1))
            out[..., :3, :3] = reference[..., :3, :3]
            middle = pose[..., :3, :3] @ centre + pose[..., :3, 3]
            out[..., :3, 3] = middle - reference[..., :3, :3] @ centre
            return out
        if self.axes:
            axis = self.axes[0]
            a, k = axis.direction, poses.skew(axis.direction)
            m = target @ candidates[..., :3, :3]
            along = np.einsum("i,...ij,j->...", a, m, a)
            angle = np.arctan2(np.einsum("...ij,ji->...", m, k), np.trace(m, axis1=-2, axis2=-1) - along)
            turns = poses.exp_rotation(angle[..., None] * a)
            step = np.zeros((*turns.shape[:-2], 4, 4))
            step[..., :3, :3] = turns
            step[..., :3, 3] = axis.point - turns @ axis.point
            step[..., 3, 3] = 1.0
            candidates = candidates @ step
        traces = np.einsum("...ij,...ji->...", target, candidates[..., :3, :3])
        best = np.argmax(traces, axis=-1)
        return np.take_along_axis(candidates, best[..., None, None, None], axis=-3)[..., 0, :, :]

    def quotient(self, rotation: Array, centre: Array) -> Array:
        """(6, 6) that takes a small motion of an object that stands at `rotation` (3, 3) to the equivalent one without
        turns about its own axes: what of a covariance is a doubt, P C P^T.

        Motions as in poses.perturb about `centre` (3,), object frame: rotation, then displacement of the centre. An
        axis beside the centre carries it along.
        """
        out = np.eye(6)
        if self.is_spherical:
            lever = rotation @ (centre - self._centre())
            out[:3, :3] = 0.0
            out[3:, :3] = poses.skew(lever)
        elif self.axes:
            axis = self.axes[0]
            turn = rotation @ axis.direction
            carried = rotation @ np.cross(axis.direction, centre - axis.point)
            out[:, :3] -= np.outer(np.concatenate([turn, carried]), turn)
        return out

    def _centre(self) -> Array:
        """The point nearest to all axes (where the axes of a spherical object meet)."""
        a = np.zeros((3, 3))
        b = np.zeros(3)
        for axis in self.axes:
            across = np.eye(3) - np.outer(axis.direction, axis.direction)
            a += across
            b += across @ axis.point
        return np.asarray(np.linalg.solve(a, b), dtype=np.float64)
