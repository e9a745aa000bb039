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
    settle,
    solve,
    strained,
)
from fusion.estimation.solve.problem import JointProblem
from fusion.estimation.solve.settings import JointSettings
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel

Array = NDArray[np.float64]

# How far (radii: turn in rad and move over the radius) rigs' answers may be from the best one to be averaged with it,
# and from which on they are another minimum, which the modes have: between, they are in doubt beside it. By judgement;
# of 23 frames of 576 with some farther than the first none was farther than 0.7, and their errors were as far.
BESIDE, ANOTHER = 0.2, 1.0


def solve_modes(problems: list[JointProblem], starts: list[Array]) -> list[JointResult]:
    """Solve each problem from its start, at least one; how large shared errors are is averaged over at the first.

    A rig weighs exp(log evidence / temperature) times how usual it is. The first answer is the rigs' weighted mean,
    with the likeliest one's covariance and as far as they end apart, so that not knowing the rig is part of its
    uncertainty; other modes use the likeliest. The mean of their covariances is mostly the widest rig's: by it the true
    errors of 211 answers of the tuning families were each 0.1 nats less likely.
    """
    problem, settings = problems[0], problems[0].settings
    pairs = list(zip(problems, starts, strict=True))
    if not problem.ties_depth:
        return [solve(problem, starts[0], 1.0), *_others(pairs, 1.0)]
    tried = _rigs(problem, starts[0])
    weights = _shares([one.log_evidence for one in tried], settings)
    likely = np.flatnonzero(weights >= settings.negligible)
    usual = tried[likely[int(np.argmax(weights[likely]))]]
    assert isinstance(usual, Settled)
    best = answered(usual)
    first = _averaged(problem.model, [tried[n].pose for n in likely], weights[likely], best)
    strain, told = strained(usual)
    first = replace(first, shares=tuple(float(share) for share in weights), strain=strain, told=told)
    return [first, *_others(pairs, usual.level)]


def _others(pairs: list[tuple[JointProblem, Array]], level: float) -> list[JointResult]:
    """Solutions of all but the first for shared errors of one level; what makes their covariances is told of the one
    that turns out to be the best (`joint.parted`).
    """
    return [marginalised(settle(problem, start, level)) for problem, start in pairs[1:]]


def _rigs(problem: JointProblem, start: Array) -> list[Settled | Expected]:
    """Where each rig ends from a start (4, 4). Where a prior holds the pose the first two are solved, and of the others
    those that count, as far as the second says where they end.
    """
    settings = problem.settings
    solved = len(settings.rigs) if problem.prior is None else settings.solved
    tried: list[Settled | Expected] = []
    last: Settled | None = None
    for n, rig in enumerate(settings.rigs):
        if last is not None and n >= solved:
            guess = expected(last, rig.level)
            if _shares([*(one.log_evidence for one in tried), guess.log_evidence], settings)[-1] < settings.counting:
                tried.append(guess)
                continue
        # from the second on they end so near to each other that pixels face the surface alike
        facing = last.system if last is not None and n > 1 else None
        last = settle(problem, start if last is None else last.pose, rig.level, last, facing)
        tried.append(last)
    return tried


def _shares(log_evidence: list[float], settings: JointSettings) -> Array:
    """(k,) shares of the mixture of the first k rigs."""
    usual = np.log([rig.share for rig in settings.rigs[: len(log_evidence)]])
    score = np.array(log_evidence) / settings.evidence_temperature + usual
    weights = np.exp(score - score.max())
    return np.asarray(weights / weights.sum())


def _averaged(model: ObjectModel, poses: list[Array], weights: Array, best: JointResult) -> JointResult:
    """The rigs' poses (4, 4) about `best`: the mean of those that ended beside it, and wider by how far all ended apart
    that are nearer than another side of the object. Turns about the object's own axes are no way apart.
    """
    ended = model.symmetries.nearest(np.array(poses), best.pose)
    delta = np.array([se3.difference(pose, best.pose, model.centroid) for pose in ended])
    moved = np.linalg.norm(delta[:, :3], axis=1) + np.linalg.norm(delta[:, 3:], axis=1) / model.radius
    beside = np.where(moved < BESIDE, weights, 0.0)
    mean = beside @ delta / beside.sum()
    shares = np.where(moved < ANOTHER, weights, 0.0)
    shares = shares / shares.sum()
    spread = delta - mean
    covariance = best.covariance + np.einsum("l,li,lj->ij", shares, spread, spread)
    return replace(best, pose=se3.perturb(best.pose, mean, model.centroid), covariance=covariance)
