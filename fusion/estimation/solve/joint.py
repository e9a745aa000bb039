"""The last step of the joint estimate: the pose together with everything that makes the senses disagree.

Each sense lives in its own slightly wrong frame. Unknowns x = (delta, xi, s, b):

    delta  of the pose (poses.perturb about the centroid)
    xi     correction of what touch reports: camera-robot calibration, about the hand's seen centre
    s      depth scale error: seen = (1 + s) true
    b      smooth depth bias: a Gaussian process over the image, exp(-|u - v|^2 / (2 length^2)), on inducing pixels

    object pixels    d(T^-1 (p - s p - b(u) p / z)) / cos  independent noise only: what they share is in s and b
    hand's pixels    h(p) - J (xi - xi_seen) - ...         the same s and b; they tie touch's frame to vision's
    touch rows       d(T^-1 E(xi) c), normals, empty points
    priors           on xi, s, b, and the pose's own

A pixel's residual is its distance from the surface along its ray, d over the cosine of the incidence: measured across
the surface, noise along the rays would shrink whenever the surface is turned away from them, and the bias would help.

One robust Gauss-Newton in whitened unknowns. How large the shared errors are is itself inferred: the system is solved
for a few rigs (one without shared errors, a usual one, a poor one), which are averaged over by their evidence
(Laplace; MacKay, Neural Computation 4, 1992). The covariance is the marginal of delta.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.solve import kernels as joint_kernels
from fusion.estimation.solve.depth_bias import DepthBias
from fusion.estimation.solve.settings import JointSettings
from scenes.evidence import row_kernels
from scenes.evidence.align import Prior, lattice_of, prior_of
from scenes.evidence.table import FACING, GATE_ABOVE, NORMAL, SIGMA, WEIGHT, Evidence
from scenes.geometry import poses as se3
from scenes.geometry.cameras import Camera
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Frame
from vision.look.hand import CalibrationModel, HandView, prior_information
from vision.look.pixels import DepthModel
from vision.look.segments import Segments

if TYPE_CHECKING:
    from fusion.estimation.stages import EstimateSettings

Array = NDArray[np.float64]

POSE, XI, SCALE = slice(0, 6), slice(6, 12), 12
FIXED = 13


@dataclass(frozen=True)
class JointResult:
    """pose (4, 4) camera_from_object; covariance (6, 6) about the centroid, all else marginalised; xi (6,)
    correction of what touch reports (camera frame, about `centre`); scale: depth scale error; cost: negative log
    posterior, pixel_cost what of it the vision rows say; log_evidence of the level of shared errors it was solved for.
    Of the frame alone, without the prior on the pose: covariances (6, 6) independent, of independent noise, and shared,
    of calibration, depth scale and bias; a direction that the frame does not tell is as wide as the object, in shared.
    """

    pose: Array
    covariance: Array
    xi: Array
    centre: Array
    scale: float
    cost: float
    log_evidence: float
    level: float
    pixel_cost: float = 0.0
    independent: Array = field(default_factory=lambda: np.zeros((6, 6)))
    shared: Array = field(default_factory=lambda: np.zeros((6, 6)))

    @property
    def millimetres(self) -> float:
        """How far the calibration was off at `centre`."""
        return 1e3 * float(np.linalg.norm(self.xi[3:]))

    def correct(self) -> Array:
        """camera_from_camera transform that moves what the robot reports to where it is."""
        return se3.perturb(np.eye(4), self.xi, self.centre)


@dataclass
class JointProblem:
    """Everything but the pose: rows, beliefs and what can be computed once per frame.

    seen: vision rows as measured; felt: touch rows as the robot reports them. camera None: the rows are a cloud without
    pixels, its bias stays in the rows' sigmas. has_robot False: touch and vision were recorded in one frame.
    """

    model: ObjectModel
    seen: Evidence
    felt: Evidence
    prior: Prior | None
    hand: HandView | None
    depth: DepthModel
    calibration: CalibrationModel
    camera: Camera | None
    has_robot: bool = True
    settings: JointSettings = field(default_factory=JointSettings)

    @staticmethod
    def of(
        model: ObjectModel,
        frame: Frame,
        looked: Segments,
        seen: Evidence,
        felt: Evidence,
        prior: Prior | None,
        hand: HandView | None,
        settings: EstimateSettings,
    ) -> JointProblem:
        """From a frame's evidence. A cloud and its contacts were recorded in one frame: no calibration between them."""
        has_image = frame.depth is not None
        return JointProblem(
            model,
            seen,
            felt,
            prior,
            hand,
            settings.depth,
            settings.calibration,
            frame.camera if has_image else None,
            has_robot=has_image,
            settings=settings.joint,
        )

    def __post_init__(self) -> None:
        """Lay the inducing pixels and the hand's constant block."""
        # without touch, too: the hand's pixels have the object's depth errors, and its shape is known
        self.hand = self.hand if self.has_robot and self.hand is not None and len(self.hand.points) else None
        hand_points = self.hand.points if self.hand is not None else np.zeros((0, 3))
        seen = self.seen.points if self.camera is not None and len(self.seen) else np.zeros((0, 3))
        reach = np.concatenate([seen, hand_points]) if len(seen) else seen
        self._bias = DepthBias.over(self.camera, reach, self.depth, self.settings.spacing, self.settings.most_inducing)
        self._seen_basis = self._bias.basis(self.seen.points)
        rows = self.seen.rows
        self._on = rows[:, GATE_ABOVE] > 0
        self._is_pixel = (rows[:, FACING] > 0) & (self.camera is not None)
        if self.camera is not None:
            independent = self.depth.independent_sigma(rows[:, 2])
            self._sigma = np.where(self._on, np.hypot(independent, self.settings.model_sigma), rows[:, SIGMA])
            self._weigh(self.settings.least_weight)
        else:
            self._sigma, self._weight = rows[:, SIGMA].copy(), rows[:, WEIGHT].copy()
        self._hand_blocks(hand_points)
        count = len(rows)
        self._lattice = lattice_of(self.model)
        self._floors = row_kernels.loss_floors(rows)
        self._room = np.zeros(count, dtype=np.int64), np.zeros((count, 7)), *np.zeros((3, count))
        self._felt_rows = row_kernels.prepare(np.ascontiguousarray(self.felt.rows), 0.0, 0.0)
        self._prior_parts, self._no_prior = prior_of(self.model, self.prior), prior_of(self.model, None)

    def _weigh(self, weight: float) -> None:
        """Let every pixel count that much."""
        if self.camera is not None:
            self._weight = np.where(self._on, weight, self.seen.rows[:, WEIGHT])

    def _hand_blocks(self, points: Array) -> None:
        """The hand's pixels, linear in (xi, s, b): their constant part, for unit sigmas of s and b."""
        if self.hand is None:
            return
        g = self.hand.directions
        sigma = np.hypot(self.depth.independent_sigma(points[:, 2]), self.settings.hand_sigma)
        # All that agree count in full: weights that fall towards the gate would hide how large the bias is
        self._hand_weight = 1.0 / sigma**2 / self.settings.hand_sharing
        ray = points / points[:, 2:]
        jac_xi = -np.concatenate([se3.cross(points - self.hand.centre, g), g], axis=1)
        along = -np.sum(g * ray, axis=1)
        jac_bias = along[:, None] * self._bias.basis(points)
        jac = np.concatenate([jac_xi, (along * points[:, 2])[:, None], jac_bias], axis=1)
        weighted = jac * self._hand_weight[:, None]
        self._hand_normal = weighted.T @ jac
        self._hand_gradient = weighted.T @ self.hand.residual

    def solve(self, pose: Array, level: float, weight: float | None = None) -> JointResult:
        """Gauss-Newton from `pose` (4, 4) for shared errors `level` times as large as believed.

        weight: of a pixel; the least of all rigs' when not told, so that log evidences of levels can be compared.
        """
        self._weigh(self.settings.least_weight if weight is None else weight)
        size = FIXED + len(self._bias)
        middle = pose[:3, :3] @ self.model.centroid + pose[:3, 3]
        self._centre = self.hand.centre if self.hand is not None else middle
        # whitening: unknown = scale * whitened, prior of the whitened is the identity
        self._white = np.ones(size)
        # a cloud has no camera to turn about: the calibration is wrong where the hand is
        lever = self._centre if self.camera is not None else np.zeros(3)
        covariance_xi = np.linalg.inv(prior_information(self.calibration, lever)) * level**2
        self._white_xi = np.linalg.cholesky(covariance_xi) if self.has_robot else 1e-9 * np.eye(6)
        self._white[SCALE] = level * self.depth.scale_sigma if len(self.seen) and self.camera is not None else 1e-9
        self._white[FIXED:] = level * self.depth.bias_sigma
        self._seen_white = self._seen_basis * self._white[FIXED:]
        unknown = np.zeros(size)
        if self.hand is not None:
            unknown[XI] = np.linalg.solve(self._white_xi, self.hand.xi)
            self._whiten_hand()
        here = pose
        width = np.zeros(size)
        width[POSE] = np.array([1.0] * 3 + [self.model.radius] * 3) ** -2.0
        self._face(here)
        cost, gradient, normal = self._system(here, unknown)
        damping = 1e-6
        for _ in range(self.settings.steps):
            step = -np.linalg.solve(normal + np.diag(damping * np.diag(normal) + width), gradient)
            shorten = min(1.0, 0.3 / max(np.abs(step[:3]).max(), 1e-12))
            shorten = min(shorten, 0.3 * self.model.radius / max(np.abs(step[3:6]).max(), 1e-12))
            step *= shorten
            if -float(step @ gradient) < 2.0 * self.settings.worth:
                break
            trial_pose = se3.perturb(here, step[POSE], self.model.centroid)
            trial_unknown = unknown + step
            trial_unknown[POSE] = 0.0
            trial = self._system(trial_pose, trial_unknown)
            if trial[0] <= cost:
                here, unknown, (cost, gradient, normal) = trial_pose, trial_unknown, trial
                damping = max(damping * 0.1, 1e-9)
                if np.abs(step[:3]).max() < 1e-5 and np.abs(step[3:6]).max() < 1e-6:
                    break
            else:
                damping = max(damping, 1e-5) * 10
        covariance, log_det = _marginal(normal + np.diag(width))
        return JointResult(
            here,
            covariance,
            self._white_xi @ unknown[XI],
            self._centre,
            float(self._white[SCALE] * unknown[SCALE]),
            float(cost),
            float(-cost - 0.5 * log_det),
            level,
            self._vision(here, unknown)[0] if len(self.seen) else 0.0,
            *self._split(here, normal, width),
        )

    def _split(self, pose: Array, normal: Array, width: Array) -> tuple[Array, Array]:
        """The covariance of the frame alone, in what independent noise and what shared errors make of it.

        With H the evidence's information and L the priors', the estimate's covariance (H + L)^-1 is
        (H + L)^-1 H (H + L)^-1 from noise in the evidence plus (H + L)^-1 L (H + L)^-1 from errors as the priors have.
        """
        evidence = normal.copy()
        if self.prior is not None:
            evidence[POSE, POSE] -= self._believed(pose)[2]
        believed = np.where(np.arange(len(normal)) < 6, width, 1.0)
        evidence[np.arange(6, len(normal)), np.arange(6, len(normal))] -= 1.0
        inverse = np.linalg.solve(evidence + np.diag(believed), np.eye(len(normal))[:, :6])
        shared = inverse.T @ (believed[:, None] * inverse)
        return inverse.T @ evidence @ inverse, shared

    def _system(self, pose: Array, unknown: Array) -> tuple[float, Array, Array]:
        """Cost, gradient and Gauss-Newton matrix about (delta, whitened xi, s, b)."""
        size = len(unknown)
        normal, gradient = np.diag(np.concatenate([np.zeros(6), np.ones(size - 6)])), unknown.copy()
        cost = 0.5 * float(unknown[6:] @ unknown[6:])
        if len(self.seen):
            part, g, h = self._vision(pose, unknown)
            cost += part
            gradient += g
            normal += h
        if len(self.felt):
            part, g, h = self._touch(pose, unknown)
            cost += part
            gradient[:12] += g
            normal[:12, :12] += h
        if self.hand is not None:
            part, g, h = self._hand_terms(unknown)
            cost += part
            gradient[6:] += g
            normal[6:, 6:] += h
        if self.prior is not None:
            part, g, h = self._believed(pose)
            cost += part
            gradient[POSE] += g
            normal[POSE, POSE] += h
        return cost, gradient, normal

    def _face(self, pose: Array) -> None:
        """Which way the surface looks where each pixel meets it at `pose`, and how much more noise a slope has there.

        Held while a system is solved, turning with the object. What lies beside a pixel, and what the mesh leaves out,
        counts along the ray.
        """
        self._normals, self._slope = np.zeros((len(self.seen), 3)), np.ones(len(self.seen))
        if self.camera is None or not len(self.seen):
            return
        _, g = self._distances(pose, self.seen.points)
        normals = g / np.maximum(np.sqrt(np.einsum("ij,ij->i", g, g)), 1e-9)[:, None]
        self._normals = np.where(self._is_pixel[:, None], normals, 0.0)
        cosine = -np.einsum("ij,ij->i", self._normals @ pose[:3, :3].T, self.seen.rows[:, NORMAL])
        cosine = np.maximum(np.where(self._is_pixel, cosine, 1.0), self.settings.least_cosine)
        noise = self.depth.sloping_sigma(self.seen.rows[:, 2], cosine, self.camera.fx)
        slope = np.hypot(noise, self.settings.model_sigma / cosine) / self._sigma
        self._slope = np.where(self._is_pixel, slope, 1.0)

    def _distances(self, pose: Array, points: Array) -> tuple[Array, Array]:
        """Signed distances (n,) of the points of the vision rows at a pose and gradients (n, 3), object frame."""
        rotation = pose[:3, :3]
        local = (points - (rotation @ self.model.centroid + pose[:3, 3])) @ rotation + self.model.centroid
        return self.model.field.seen_distance_and_gradient(
            local, self.seen.rows[:, NORMAL] @ rotation, self.seen.rows[:, FACING] > 0
        )

    def _vision(self, pose: Array, unknown: Array) -> tuple[float, Array, Array]:
        """Pixels and free space: their residuals by the kernel, their products by linear algebra."""
        scale = float(self._white[SCALE])
        index, jac_fixed, along, residual, information = self._room
        cost, k = joint_kernels.vision_rows(
            self._lattice,
            self.seen.rows,
            self._floors,
            self._is_pixel,
            self._sigma,
            self._weight,
            self._normals,
            self._slope,
            self.settings.least_cosine,
            self.camera is not None,
            np.ascontiguousarray(pose[:3, :3]),
            pose[:3, :3] @ self.model.centroid + pose[:3, 3],
            scale * float(unknown[SCALE]),
            self._seen_white @ unknown[FIXED:],
            *self._room,
        )
        jac = np.zeros((k, len(unknown)))
        jac[:, POSE] = jac_fixed[:k, :6]
        jac[:, SCALE] = jac_fixed[:k, 6] * scale
        jac[:, FIXED:] = along[:k, None] * self._seen_white[index[:k]]
        weighted = jac * information[:k, None]
        return float(cost), weighted.T @ residual[:k], weighted.T @ jac

    def _touch(self, pose: Array, unknown: Array) -> tuple[float, Array, Array]:
        """Contacts and the space that links fill, as the robot reports them and xi moves them."""
        middle = pose[:3, :3] @ self.model.centroid + pose[:3, 3]
        hessian, gradient = np.zeros((6, 6)), np.zeros(6)
        cost = joint_kernels.touch_rows(
            self._lattice,
            self._felt_rows,
            self.settings.bend,
            np.ascontiguousarray(pose[:3, :3]),
            middle,
            self._white_xi @ unknown[XI],
            self._centre,
            self._no_prior,
            hessian,
            gradient,
            np.zeros((10, 3)),
        )
        lever = np.eye(6)
        lever[3:, :3] = -se3.skew(middle - self._centre)
        chain = np.concatenate([np.eye(6), -lever @ self._white_xi], axis=1)
        return float(cost), chain.T @ gradient, chain.T @ hessian @ chain

    def _believed(self, pose: Array) -> tuple[float, Array, Array]:
        """The prior on the pose."""
        hessian, gradient = np.zeros((6, 6)), np.zeros(6)
        middle = pose[:3, :3] @ self.model.centroid + pose[:3, 3]
        rotation = np.ascontiguousarray(pose[:3, :3])
        cost = joint_kernels.prior_row(rotation, middle, self._prior_parts, hessian, gradient)
        return float(cost), gradient, hessian

    def _hand_terms(self, unknown: Array) -> tuple[float, Array, Array]:
        """The hand's pixels: quadratic in the unknowns, whitened once per level."""
        cost, gradient, normal = self._hand_white
        x = unknown[6:]
        along = normal @ x
        return cost + float(gradient @ x + 0.5 * x @ along), gradient + along, normal

    def _whiten_hand(self) -> None:
        """Terms of the hand's pixels about x = 0 in the whitened unknowns (xi, s, b)."""
        assert self.hand is not None
        scale = self._white[6:]
        normal, gradient = self._hand_normal.copy(), self._hand_gradient.copy()
        # linear about xi_seen: shift to xi = 0
        step = self.hand.xi
        constant = 0.5 * float(self._hand_weight @ self.hand.residual**2)
        constant += 0.5 * float(step @ normal[:6, :6] @ step) - float(gradient[:6] @ step)
        gradient = gradient - normal[:, :6] @ step
        normal[:6] = self._white_xi.T @ normal[:6]
        normal[:, :6] = normal[:, :6] @ self._white_xi
        gradient[:6] = self._white_xi.T @ gradient[:6]
        normal *= scale * scale[:, None]
        self._hand_white = (constant, gradient * scale, normal)


def _marginal(normal: Array) -> tuple[Array, float]:
    """(6, 6) covariance of the pose with all else marginalised, and the log-determinant of the whole system."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    scaled = normal * scale * scale[:, None]
    # unit diagonal: a billionth more keeps the factor of a singular system finite, and changes no digit of another
    factor = np.linalg.cholesky(scaled + 1e-9 * np.eye(len(normal)))
    half = np.linalg.solve(factor, np.eye(len(normal))[:, :6])
    covariance = (half.T @ half) * scale[:6] * scale[:6, None]
    return covariance, float(2.0 * np.log(np.diag(factor)).sum() - 2.0 * np.log(scale).sum())
