"""The likelihood of patches as what they are: one finger's error each, and a shape that is known far better than that.

Rows take each point for itself, as sure as the finger's place (a millimetre), and few of them for many. That throws
away what a gel feels best: how its points lie to one another (tenths of a millimetre). Here the distances of a patch's
n points to the surface are one Gaussian of covariance C = J S J^T + K: S (6, 6) the error of the sensor's pose and J
(n, 6) how it moves the points along their normals, K the skin's own error, of which a part is common to the whole patch
(a gain, a wrong depth) and the rest changes over a length along the skin. Neither depends on the object's pose: C is
factorised once. A patch that lies on something else must not pull for ever: C is taken times the scale, 1 or more,
under which the distances are most likely, so that beyond q = r^T C^-1 r = n the cost q / 2 goes on as
n (1 + ln(q / n)) / 2. Frame of the patches, metres, radians.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.evidence.align import Alignment, Prior, terms
from scenes.evidence.table import Evidence
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from touch.gels.patches import Patch

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ShapeSettings:
    """What a patch's shape is worth. Values by judgement, but for what is measured below."""

    # Error of the sensor's pose (m, rad), per axis: the finger's joints.
    place_sigma: float = 0.001
    turn_sigma: float = float(np.deg2rad(2.0))
    # Share of the skin's own variance that all points of a patch have in common, and length (m) over which the rest
    # changes: the width of what the integration smears and of a skin's bridge.
    common: float = 0.5
    length: float = 0.002
    # Error (m) of each point for itself: grain, skin that bridges from what it lies on, and the mesh's own roughness.
    # Of simulated presses the rotation error is the same from 0.15 to 0.6 mm and a third larger at 1.5 mm; below, the
    # minima of rough meshes are sharper than they are true.
    grain: float = 0.0006
    # Steps, and the first step's damping as a share of the Hessian's diagonal (Marquardt 1963).
    iterations: int = 15
    damping: float = 1e-2
    # Longest step (rad, share of the object's radius): a linear model of a shape holds no further.
    longest_angle: float = 0.2
    longest_share: float = 0.2


class Shapes:
    """The patches of one moment, ready to be asked."""

    def __init__(self, patches: Sequence[Patch], settings: ShapeSettings | None = None) -> None:
        """Factorises each patch's covariance."""
        self.settings = settings or ShapeSettings()
        on = [patch for patch in patches if len(patch)]
        self.points = np.concatenate([np.zeros((0, 3)), *(patch.points for patch in on)])
        ends = np.cumsum([len(patch) for patch in on], dtype=np.int64)
        self._parts = [slice(end - len(patch), end) for patch, end in zip(on, ends.tolist())]
        self._whiten = [np.linalg.inv(np.linalg.cholesky(covariance_of(patch, self.settings))) for patch in on]

    def terms(self, model: ObjectModel, poses: Array) -> tuple[Array, Array, Array]:
        """Costs (b,) nats, gradients (b, 6) and Gauss-Newton Hessians (b, 6, 6) at poses (b, 4, 4) frame_from_object,
        in the chart of poses.perturb.
        """
        rotation = poses[:, :3, :3]
        away = self.points - poses[:, None, :3, 3]
        local = away @ rotation
        distance, gradient = model.field.distance_and_gradient(local.reshape(-1, 3))
        distance, gradient = distance.reshape(local.shape[:2]), gradient.reshape(local.shape)
        outward = gradient @ np.swapaxes(rotation, 1, 2)
        arm = away - (rotation @ model.centroid)[:, None]
        # the object moves, the points stay: d' = -(arm x n) . w - n . v
        jacobian = -np.concatenate([np.cross(arm, outward), outward], axis=2)
        cost, slope = np.zeros(len(poses)), np.zeros((len(poses), 6))
        hessian = np.zeros((len(poses), 6, 6))
        for part, whiten in zip(self._parts, self._whiten):
            count = len(whiten)
            residual = distance[:, part] @ whiten.T
            jac = whiten @ jacobian[:, part]
            square = (residual**2).sum(axis=1)
            scale = np.maximum(square / count, 1.0)
            cost += 0.5 * square / scale + 0.5 * count * np.log(scale)
            weight = 1.0 / scale
            slope += weight[:, None] * (residual[:, None] @ jac)[:, 0]
            hessian += weight[:, None, None] * (np.swapaxes(jac, 1, 2) @ jac)
        return cost, slope, hessian


def covariance_of(patch: Patch, settings: ShapeSettings) -> Array:
    """(n, n) m^2 of the distances of a patch's points to the surface."""
    points, normals = patch.points, patch.normals
    arm = np.cross(points - points.mean(axis=0), normals)
    square = ((points[:, None] - points[None]) ** 2).sum(axis=2)
    alike = np.exp(-0.5 * square / settings.length**2)
    skin = np.outer(patch.sigma, patch.sigma) * (settings.common + (1.0 - settings.common) * alike)
    pose = settings.turn_sigma**2 * (arm @ arm.T) + settings.place_sigma**2 * (normals @ normals.T)
    return np.asarray(pose + skin + settings.grain**2 * np.eye(len(points)))


def fit_shapes(
    model: ObjectModel,
    shapes: Shapes,
    starts: Array,
    rows: Evidence,
    prior: Prior | None = None,
    middle: tuple[Array, float] | None = None,
) -> Alignment:
    """Move every start (b, 4, 4) to a minimum of the patches' cost, the rows', the prior's and the middle's.

    rows: of what patches do not say, in their frame. middle: a place (3,) near which the object's centroid is, and the
    standard deviation (m) of that. Levenberg-Marquardt; the cost of a pose never rises.
    """
    s = shapes.settings

    def total(poses: Array) -> tuple[Array, Array, Array]:
        cost, gradient, hessian = shapes.terms(model, poses)
        for i, pose in enumerate(poses if len(rows) or prior is not None else ()):
            one, slope, bend = terms(model, rows, pose, prior)
            cost[i], gradient[i], hessian[i] = cost[i] + one, gradient[i] + slope, hessian[i] + bend
        if middle is not None:
            away = poses[:, :3, :3] @ model.centroid + poses[:, :3, 3] - middle[0]
            cost = cost + 0.5 * (away**2).sum(axis=1) / middle[1] ** 2
            gradient[:, 3:] += away / middle[1] ** 2
            hessian[:, 3:, 3:] += np.eye(3) / middle[1] ** 2
        return cost, gradient, hessian

    poses = np.array(starts, dtype=np.float64).reshape(-1, 4, 4)
    cost, gradient, hessian = total(poses)
    damping = np.full(len(poses), s.damping)
    # lengths in radii: a Hessian of radians and metres is badly scaled
    scale = np.repeat([1.0, model.radius], 3)
    active = np.arange(len(poses))
    for _ in range(s.iterations):
        if not len(active):
            break
        scaled = hessian[active] * scale * scale[:, None]
        diagonal = np.maximum(np.einsum("nii->ni", scaled), 1e-6)
        step = -np.linalg.solve(
            scaled + (damping[active, None] * diagonal)[:, :, None] * np.eye(6), (gradient[active] * scale)[..., None]
        )[..., 0]
        longest = np.maximum(
            np.linalg.norm(step[:, :3], axis=1) / s.longest_angle, np.linalg.norm(step[:, 3:], axis=1) / s.longest_share
        )
        step /= np.maximum(longest, 1.0)[:, None]
        moved = se3.perturb(poses[active], step * scale, model.centroid)
        new_cost, new_gradient, new_hessian = total(moved)
        better = new_cost < cost[active]
        gain = cost[active] - new_cost
        taken = active[better]
        poses[taken], cost[taken] = moved[better], new_cost[better]
        gradient[taken], hessian[taken] = new_gradient[better], new_hessian[better]
        damping[active] = np.clip(np.where(better, 0.2, 8.0) * damping[active], 1e-6, 1e6)
        # done: next to nothing gained, or no way down however short the step
        done = (better & (gain < 1e-4)) | (~better & (damping[active] > 1e4))
        active = active[~done]
    poses[:, :3, :3] = se3.nearest_rotation(poses[:, :3, :3]) if len(poses) else poses[:, :3, :3]
    return Alignment(poses, cost, hessian, np.full(len(poses), s.iterations, dtype=np.int64))


def hessians_at(
    model: ObjectModel,
    rows: Evidence,
    poses: Array,
    prior: Prior | None = None,
    middle: tuple[Array, float] | None = None,
) -> Array:
    """(b, 6, 6) Gauss-Newton Hessians of rows, prior and middle (see fit_shapes) at poses (b, 4, 4)."""
    out = np.array([terms(model, rows, pose, prior)[2] for pose in poses]).reshape(-1, 6, 6)
    if middle is not None:
        out[:, 3:, 3:] += np.eye(3) / middle[1] ** 2
    return out
