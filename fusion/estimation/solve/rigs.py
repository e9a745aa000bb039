"""How large are a rig's shared errors? The joint problem solved for each kind of rig, and the answers averaged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.solve.joint import (
    Expected,
    JointResult,
    Settled,
    answered,
    expected,
    marginalised,
    rigs_beside,
    settle,
    solve,
    strained,
)
from fusion.estimation.solve.problem import JointProblem
from fusion.estimation.solve.settings import JointSettings, Level
from fusion.estimation.solve.system import POSE, XI
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel

Array = NDArray[np.float64]

# How far (radii: turn in rad and move over the radius) rigs' answers may be from the best one to be averaged with it,
# and from which on they are another minimum, which the modes have: between, they are in doubt beside it. By judgement;
# of 23 frames of 576 with some farther than the first none was farther than 0.7, and their errors were as far.
BESIDE, ANOTHER = 0.2, 1.0


def solve_modes(problems: list[JointProblem], starts: list[Array]) -> list[JointResult]:
    """Solve each problem from its start, at least one; how large shared errors are is averaged over at the first.

    A size of them weighs exp(log evidence / temperature) times how usual it is. The first answer is their weighted
    mean, with the likeliest one's covariance and as far as they end apart, so that not knowing the rig is part of its
    uncertainty; other modes use the likeliest. The mean of their covariances is mostly the widest rig's: by it the true
    errors of 211 answers of the tuning families were each 0.1 nats less likely.
    """
    problem, settings = problems[0], problems[0].settings
    pairs = list(zip(problems, starts, strict=True))
    if not problem.ties_depth:
        return [solve(problem, starts[0], Level()), *_others(pairs, Level())]
    tried = _tried(problem, starts[0])
    weights = _weights(tried, settings)
    bias, rig = np.unravel_index(int(np.argmax(weights)), weights.shape)
    usual = tried[bias][rig]
    if not isinstance(usual, Settled):
        # of a bias that was not solved nothing is, and the last that was is the nearest
        near = next(one for row in (tried[bias], *reversed(tried)) for one in row if isinstance(one, Settled))
        level = Level(settings.rigs[rig].level, settings.biases[bias].level)
        usual = tried[bias][rig] = settle(problem, near.pose, level, near, near.system)
    likely = [(n, k) for n, k in np.ndindex(weights.shape) if weights[n, k] >= settings.negligible]
    best, shares = answered(usual), np.array([weights[at] for at in likely])
    first = _averaged(problem.model, [tried[n][k].pose for n, k in likely], shares, best)
    strain, told = strained(usual)
    of_rigs, of_biases = (tuple(float(share) for share in weights.sum(axis=axis)) for axis in (0, 1))
    first = replace(first, shares=of_rigs, bias_shares=of_biases, strain=strain, told=told)
    rest = _others(pairs, usual.level)
    if problem.camera is None and problem.has_robot:
        # nothing is seen of the robot: no rig is likelier than it is usual, and each of them may be the case
        first = replace(first, covariance=first.covariance + unknown_rig(usual, of_rigs))
        rest = [replace(one, covariance=one.covariance + unknown_rig(one.ended, of_rigs)) for one in rest]
    return [first, *rest]


def unknown_rig(settled: Settled | None, shares: tuple[float, ...]) -> Array:
    """(6, 6) by how much a solution's covariance is wider for rigs of such shares than for its own; 0 without one."""
    if settled is None:
        return np.zeros((6, 6))
    settings = settled.system.problem.settings
    whole = settled.normal + np.diag(settled.system.width)
    own = np.linalg.inv(whole)[POSE, POSE]
    out = np.zeros((6, 6))
    for rig, share in zip(settings.rigs, shares, strict=True):
        beside = whole.copy()
        beside[XI, XI] += np.eye(6) * ((settled.level.rig / rig.level) ** 2 - 1.0)
        out += share * (np.linalg.inv(beside)[POSE, POSE] - own)
    return np.asarray(0.5 * (out + out.T), dtype=np.float64)


def _others(pairs: list[tuple[JointProblem, Array]], level: Level) -> list[JointResult]:
    """Solutions of all but the first for shared errors of one level; what makes their covariances is told of the one
    that turns out to be the best (`joint.parted`).
    """
    return [marginalised(settle(problem, start, level)) for problem, start in pairs[1:]]


def _tried(problem: JointProblem, start: Array) -> list[list[Settled | Expected]]:
    """Where each bias, and with it each rig, ends from a start (4, 4). With the usual rig and where a prior holds the
    pose, the first two biases are solved, and of the others those that count, as far as the second says where they end;
    without a prior all are. Other rigs end where these say.
    """
    settings = problem.settings
    rigs, biases = settings.rigs, settings.biases
    usual = int(np.argmax([rig.share for rig in rigs]))
    solved = len(biases) if problem.prior is None else settings.solved
    tried: list[Settled | Expected] = []
    last: Settled | None = None
    for n, bias in enumerate(biases):
        level = Level(rigs[usual].level, bias.level)
        if last is not None and n >= solved:
            guess = expected(last, level)
            evidence = [*(one.log_evidence for one in tried), guess.log_evidence]
            if _shares(evidence, [one.share for one in biases[: n + 1]], settings)[-1] < settings.counting:
                tried.append(guess)
                continue
        # from the second on they end so near to each other that pixels face the surface alike
        facing = last.system if last is not None and n > 1 else None
        last = settle(problem, start if last is None else last.pose, level, last, facing)
        tried.append(last)
    if len(rigs) == 1:
        return [[one] for one in tried]
    levels, centroid = [rig.level for rig in rigs], problem.model.centroid
    out: list[list[Settled | Expected]] = []
    for one in tried:
        if isinstance(one, Settled):
            # of a bias that is not solved it is as of the last that is
            steps, gained = rigs_beside(one, levels)
        beside = zip(se3.perturb(one.pose, steps, centroid), (one.log_evidence + gained).tolist())
        row: list[Settled | Expected] = [Expected(pose, log_evidence) for pose, log_evidence in beside]
        row[usual] = one
        out.append(row)
    return out


def _weights(tried: list[list[Settled | Expected]], settings: JointSettings) -> Array:
    """(biases, rigs) shares of the mixture."""
    usual = [bias.share * rig.share for bias in settings.biases for rig in settings.rigs]
    evidence = [one.log_evidence for row in tried for one in row]
    return _shares(evidence, usual, settings).reshape(len(settings.biases), len(settings.rigs))


def _shares(log_evidence: list[float], usual: list[float], settings: JointSettings) -> Array:
    """(k,) shares of a mixture whose parts are so usual before anything is seen."""
    score = np.array(log_evidence) / settings.evidence_temperature + np.log(usual)
    weights = np.exp(score - score.max())
    return np.asarray(weights / weights.sum())


def _averaged(model: ObjectModel, poses: list[Array], weights: Array, best: JointResult) -> JointResult:
    """The rigs' poses (4, 4) about `best`: the mean of those that ended beside it, and wider by how far all ended apart
    that are nearer than another side of the object. Turns about the object's own axes are no way apart.
    """
    ended = model.symmetries.nearest(np.array(poses), best.pose)
    delta = se3.difference(ended, best.pose, model.centroid)
    moved = np.linalg.norm(delta[:, :3], axis=1) + np.linalg.norm(delta[:, 3:], axis=1) / model.radius
    beside = np.where(moved < BESIDE, weights, 0.0)
    mean = beside @ delta / beside.sum()
    shares = np.where(moved < ANOTHER, weights, 0.0)
    shares = shares / shares.sum()
    spread = delta - mean
    covariance = best.covariance + np.einsum("l,li,lj->ij", shares, spread, spread)
    return replace(best, pose=se3.perturb(best.pose, mean, model.centroid), covariance=covariance)
