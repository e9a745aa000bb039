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

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.solve.newton_kernels import JITTER
from fusion.estimation.solve.problem import JointProblem
from fusion.estimation.solve.settings import JointSettings, Level
from fusion.estimation.solve.system import FIXED, POSE, SCALE, XI, System
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel

Array = NDArray[np.float64]

# Turns (rad), and moves as shares of the object's radius, to which a Gauss-Newton matrix holds.
FARTHEST = 0.1


@dataclass(frozen=True)
class JointResult:
    """pose (4, 4) camera_from_object; covariance (6, 6) about the centroid, all else marginalised; xi (6,)
    correction of what touch reports (camera frame, about `centre`); scale: depth scale error; cost: negative log
    posterior, pixel_cost what of it the vision rows say; log_evidence of the level of shared errors it was solved for.
    Of the frame alone, without the prior on the pose: covariances (6, 6) independent, of independent noise, and shared,
    of calibration, depth scale and bias; a direction that the frame does not tell is as wide as the object, in shared.
    as_seen (4, 4): where the uncorrected depth image shows the object, scale and mean bias put back along its ray.
    follows (6, 6): by how much xi is expected to be otherwise where the pose turns out to be otherwise.
    unsolved (6, 6): what else of the covariance pixels share, solved for by nothing: the mesh's own error, and by how
    much parts of the image disagree. biased (6, 6): what of `shared` comes of the depth bias. shares: of the mixture,
    of each rig that was tried, and bias_shares, of each bias; empty where none were. mesh_variance (m^2): of the mesh's
    own error, as blocks of the image have it, 0 where nothing is seen; strain: squares of all shared errors, in units
    of what is believed of them, and told: how many of them the frame tells; 0 where it was not asked for (`strained`).
    ended: where the solution ended, while nobody has asked it for independent, shared, biased and follows (`parted`).
    """

    pose: Array
    covariance: Array
    xi: Array
    centre: Array
    scale: float
    cost: float
    log_evidence: float
    level: Level
    pixel_cost: float = 0.0
    independent: Array = field(default_factory=lambda: np.zeros((6, 6)))
    shared: Array = field(default_factory=lambda: np.zeros((6, 6)))
    as_seen: Array = field(default_factory=lambda: np.eye(4))
    follows: Array = field(default_factory=lambda: np.zeros((6, 6)))
    unsolved: Array = field(default_factory=lambda: np.zeros((6, 6)))
    biased: Array = field(default_factory=lambda: np.zeros((6, 6)))
    shares: tuple[float, ...] = ()
    bias_shares: tuple[float, ...] = ()
    mesh_variance: float = 0.0
    strain: float = 0.0
    told: float = 0.0
    ended: Settled | None = None

    @property
    def millimetres(self) -> float:
        """How far the calibration was off at `centre`."""
        return 1e3 * float(np.linalg.norm(self.xi[3:]))

    def correct(self) -> Array:
        """camera_from_camera transform that moves what the robot reports to where it is."""
        return se3.perturb(np.eye(4), self.xi, self.centre)


@dataclass(frozen=True)
class Settled:
    """Where a solution ended: pose (4, 4) camera_from_object, the other unknowns, cost, Gauss-Newton matrix of `system`
    and the log evidence of its level of shared errors.
    """

    system: System
    pose: Array
    unknown: Array
    cost: float
    normal: Array
    log_evidence: float
    level: Level

    @property
    def free(self) -> int:
        """How many unknowns, the first, are solved for."""
        return self.system.size if self.system.problem.ties_depth else SCALE


def solve(problem: JointProblem, pose: Array, level: Level) -> JointResult:
    """The minimum near `pose` (4, 4) for shared errors as large as `level` says, and how sure it is."""
    return answered(settle(problem, pose, level))


def settle(
    problem: JointProblem, pose: Array, level: Level, after: Settled | None = None, facing: System | None = None
) -> Settled:
    """Gauss-Newton from `pose` (4, 4) for shared errors as large as `level` says.

    Where nothing of known shape ties depth's scale and bias (problem.ties_depth), they are not solved for, because a
    wrong outline is then explained by a wrong scale: they widen the covariance by what they do to the pose (a consider
    analysis, Schmidt 1966), and move nothing. after: a solution of another level of the same problem; it begins where
    that one says that this one ends. facing: a system that knows which way the surface faces each pixel.
    """
    system = System(problem, pose, level, facing)
    here, unknown = (pose, system.start(pose)) if after is None else _onwards(after, level)
    free = system.size if problem.ties_depth else SCALE
    here, unknown, cost, normal, log_det = system.descend(here, unknown, free)
    return Settled(system, here, unknown, cost, normal, -cost - 0.5 * log_det, level)


def _onwards(after: Settled, level: Level) -> tuple[Array, Array]:
    """Pose (4, 4) and unknowns (size,) of another level as a solution's own Gauss-Newton matrix has them: what was
    sensed is the same, only the shared errors' prior is as wide as the level says.
    """
    ratio, system = _ratio(after, level), after.system
    step = _step_to(after, ratio)
    if max(np.abs(step[:3]).max(), np.abs(step[3:6]).max() / system.problem.model.radius) > FARTHEST:
        return after.pose, after.unknown / ratio
    unknown = (after.unknown + np.concatenate([np.zeros(6), step[6:]])) / ratio
    return se3.perturb(after.pose, step[POSE], system.problem.model.centroid), unknown


def _ratio(after: Settled, level: Level) -> Array:
    """(size,) by how much larger than in a solution each unknown may be at another level; 1 for the pose's."""
    out = np.ones(after.system.size)
    out[6:FIXED], out[FIXED:] = level.rig / after.level.rig, level.bias / after.level.bias
    return out


def _step_to(after: Settled, ratio: Array) -> Array:
    """(size,) from a solution to that of shared errors `ratio` (size,) times as large, whitened by `after`'s level."""
    own = np.zeros(after.system.size)
    own[6:] = 1.0 - ratio[6:] ** -2.0
    # at the minimum what was sensed pulls as the prior does, the other way
    return np.asarray(np.linalg.solve(after.normal + np.diag(after.system.width - own), own * after.unknown))


@dataclass(frozen=True)
class Expected:
    """Where a solution of another level would end, not worked out: pose (4, 4) and log evidence."""

    pose: Array
    log_evidence: float


def expected(after: Settled, level: Level) -> Expected:
    """Another level as a solution's own Gauss-Newton matrix has it: rows that would change sides on the way are not
    asked.
    """
    ratio, system, free = _ratio(after, level), after.system, after.free
    own, scale = np.zeros(system.size), np.ones(system.size)
    own[6:], scale[6:] = 1.0, ratio[6:]
    step, sensed = _step_to(after, ratio), after.normal - np.diag(own)
    unknown = (own * (after.unknown + step)) / ratio
    before = own * after.unknown
    cost = after.cost + 0.5 * float(step @ sensed @ step - before @ before + unknown @ unknown) - float(before @ step)
    whole = (sensed * scale * scale[:, None] + np.diag(own + system.width))[:free, :free]
    log_det = float(np.linalg.slogdet(whole)[1])
    return Expected(se3.perturb(after.pose, step[POSE], system.problem.model.centroid), -cost - 0.5 * log_det)


def rigs_beside(after: Settled, levels: list[float]) -> tuple[Array, Array]:
    """How far (k, 6) the pose would be moved, and by how much more log evidence (k,) there would be, for each of other
    sizes of calibration and scale than a solution's: as `expected`, its bias marginalised once.
    """
    width, own = after.system.width[:FIXED], after.unknown[:FIXED]
    whole = after.normal + np.diag(after.system.width)
    ties = whole[:FIXED, FIXED:]
    kept = whole[:FIXED, :FIXED] - ties @ np.linalg.solve(whole[FIXED:, FIXED:], ties.T)
    ratios, priors = [level / after.level.rig for level in levels], np.zeros((len(levels), FIXED))
    priors[:, 6:] = np.array([ratio**-2.0 - 1.0 for ratio in ratios])[:, None]
    there = kept + priors[:, :, None] * np.eye(FIXED)
    steps = np.asarray(np.linalg.solve(there, (-priors * own)[:, :, None]), dtype=np.float64)[:, :, 0]
    costlier = np.array([s @ kept @ s - width @ s**2 + prior @ (own + s) ** 2 for s, prior in zip(steps, priors)])
    log_dets = np.linalg.slogdet(there)[1] + 2.0 * (FIXED - 6) * np.log(ratios) - np.linalg.slogdet(kept)[1]
    return steps[:, POSE], -0.5 * costlier - 0.5 * log_dets


def answered(settled: Settled) -> JointResult:
    """A solution with its covariances."""
    return parted(marginalised(settled))


def parted(one: JointResult) -> JointResult:
    """A solution with what noise and shared errors make of its covariance, and with what follows its pose."""
    if one.ended is None:
        return one
    system, settled = one.ended.system, one.ended
    misfit = system.misfit()
    independent, shared, biased, follows = _split(system, settled.pose, settled.normal)
    parts = misfit * independent, misfit * shared, misfit * biased
    return replace(one, independent=parts[0], shared=parts[1], biased=parts[2], follows=follows, ended=None)


def marginalised(settled: Settled) -> JointResult:
    """A solution with its covariance, all else marginalised; what of it noise and shared errors make is left to
    `parted`.
    """
    system, here, unknown, free = settled.system, settled.pose, settled.unknown, settled.free
    problem = system.problem
    either = system.mesh_or_bias(here, unknown)
    system.stand(here, unknown)
    misfit = system.misfit()
    whole = (settled.normal + np.diag(system.width))[:free, :free]
    variance, share = system.mesh_variance(), problem.settings.mesh_share
    surface = (1.0 - share) * variance + share * max(either, variance)
    mesh = mesh_spread(problem.model, surface, problem.settings)
    unsolved = system.excess_spread(whole, misfit) + mesh + _blunted(system, here, whole)
    return JointResult(
        here,
        misfit * as_believed(settled) + unsolved,
        system.white_xi @ unknown[XI],
        system.centre,
        float(system.white[SCALE] * unknown[SCALE]),
        settled.cost,
        settled.log_evidence,
        settled.level,
        system.seen_cost,
        as_seen=_as_seen(system, here, unknown),
        unsolved=unsolved,
        mesh_variance=variance if problem.on.any() else 0.0,
        ended=settled,
    )


def strained(settled: Settled) -> tuple[float, float]:
    """How far shared errors were moved, squared, in units of what is believed of them, and how many of them were told:
    less as much of each as is as uncertain as before. Both 0 where scale and bias are not solved for.
    """
    system = settled.system
    if settled.free != system.size:
        return 0.0, 0.0
    left = np.diag(np.linalg.inv(settled.normal + np.diag(system.width)))[6:]
    return float(np.square(settled.unknown[6:]).sum()), float(np.clip(1.0 - left, 0.0, 1.0).sum())


def as_believed(settled: Settled) -> Array:
    """(6, 6) covariance of a solution's pose, all else marginalised, where noise is as believed."""
    system, free = settled.system, settled.free
    whole = settled.normal + np.diag(system.width)
    gain = _marginal(whole[:free, :free])
    if free == system.size:
        return gain
    inverse = np.linalg.solve(whole[:free, :free], whole[:free, free:])[:6]
    return np.asarray(gain + inverse @ inverse.T)


def _blunted(system: System, pose: Array, whole: Array) -> Array:
    """(6, 6) what windows of readings, which average over the surface at pose (4, 4), make of the pose: pixels nearer
    to one another than a window is wide are off together. whole (m, m): the information on all that is solved for.
    """
    problem = system.problem
    if problem.camera is None or not problem.on.any():
        return np.zeros((6, 6))
    model, depth, s = problem.model, problem.beliefs.depth, problem.settings
    away = max(float(pose[2, :3] @ model.centroid + pose[2, 3]), 0.0)
    off = s.blunt_times * depth.blunting(away, problem.camera.fx, model.radius)
    if not off > 0.0:
        return np.zeros((6, 6))
    return off**2 * system.field_spread(whole, s.blunt_length * depth.window * away / problem.camera.fx)


def mesh_spread(model: ObjectModel, variance: float, settings: JointSettings) -> Array:
    """(6, 6) what a mesh's own error of that variance (m^2) makes of a pose: a scan is off smoothly, over whole faces,
    so that pixels do not average it out, and no more than a few parts of the surface do.
    """
    each = variance / settings.mesh_parts
    return np.diag(np.repeat([each / model.radius**2, each], 3))


def _as_seen(system: System, pose: Array, unknown: Array) -> Array:
    """The pose (4, 4) moved along its ray by what scale and bias make of depth there."""
    problem = system.problem
    if problem.camera is None or not problem.on.any():
        return pose
    middle = pose[:3, :3] @ problem.model.centroid + pose[:3, 3]
    bias = float((system.seen_white[problem.on] @ unknown[FIXED:]).mean())
    share = float(system.white[SCALE] * unknown[SCALE]) + bias / max(float(middle[2]), 1e-3)
    out = pose.copy()
    out[:3, 3] += share * middle
    return out


def _split(system: System, pose: Array, normal: Array) -> tuple[Array, Array, Array, Array]:
    """The covariance of the frame alone, in what independent noise and what shared errors make of it, and what of
    these the depth bias does; and how the calibration follows the pose: the regression of xi on delta.

    With H the evidence's information and L the priors', the estimate's covariance (H + L)^-1 is
    (H + L)^-1 H (H + L)^-1 from noise in the evidence plus (H + L)^-1 L (H + L)^-1 from errors as the priors have.
    """
    evidence = normal.copy()
    if system.problem.prior is not None:
        evidence[POSE, POSE] -= system.believed(pose)
    believed = np.where(np.arange(len(normal)) < 6, system.width, 1.0)
    evidence[np.arange(6, len(normal)), np.arange(6, len(normal))] -= 1.0
    inverse = np.linalg.solve(evidence + np.diag(believed), np.eye(len(normal))[:, :6])
    shared = inverse.T @ (believed[:, None] * inverse)
    biased = inverse[FIXED:].T @ inverse[FIXED:]
    # by its own widths the pose's block is a correlation, singular where a direction is known to the last digit
    variance = np.diag(inverse[POSE])
    width = 1.0 / np.sqrt(np.maximum(variance, 1e-12 * max(float(variance.max()), 1e-280)))
    sizes, axes = np.linalg.eigh(inverse[POSE] * width * width[:, None])
    known = np.abs(sizes) > 1e-12 * np.abs(sizes).max()
    correlation = (axes[:, known] / sizes[known]) @ axes[:, known].T
    follows = system.white_xi @ ((inverse[XI] * width) @ correlation * width)
    return inverse.T @ evidence @ inverse, shared, biased, follows


def _marginal(normal: Array) -> Array:
    """(6, 6) covariance of the pose with all else marginalised."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    scaled = normal * scale * scale[:, None]
    # unit diagonal: a billionth more keeps the factor of a singular system finite, and changes no digit of another
    factor = np.linalg.cholesky(scaled + JITTER * np.eye(len(normal)))
    half = np.linalg.solve(factor, np.eye(len(normal))[:, :6])
    return np.asarray((half.T @ half) * scale[:6] * scale[:6, None])
