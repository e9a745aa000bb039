"""How large are a rig's shared errors? The joint problem solved for each kind of rig, and the answers averaged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.solve.joint import JointResult, answered, marginalised, settle, solve
from fusion.estimation.solve.problem import JointProblem
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel

Array = NDArray[np.float64]


def solve_modes(problems: list[JointProblem], starts: list[Array]) -> list[JointResult]:
    """Solve each problem from its start, at least one; how large shared errors are is averaged over at the first.

    A rig weighs exp(log evidence / temperature) times how usual it is. The first answer is the rigs' weighted mean and
    mixture covariance, so that not knowing the rig is part of its uncertainty; other modes use the best.
    """
    problem, settings = problems[0], problems[0].settings
    pairs = list(zip(problems, starts))[: settings.modes]
    if not problem.ties_depth:
        return [solve(one, start, 1.0) for one, start in pairs]
    tried = [settle(problem, starts[0], settings.rigs[0].level)]
    for rig in settings.rigs[1:]:
        # from the second on they end so near to each other that pixels face the surface alike
        facing = tried[1].system if len(tried) > 1 else None
        tried.append(settle(problem, tried[-1].pose, rig.level, tried[-1], facing))
    evidence = np.array([t.log_evidence for t in tried]) / settings.evidence_temperature
    score = evidence + np.log([rig.share for rig in settings.rigs])
    weights = np.exp(score - score.max())
    weights = weights / weights.sum()
    shares = tuple(float(share) for share in weights)
    likely = np.flatnonzero(weights >= settings.negligible)
    # of the others no more than poses and covariances goes into the mean
    most = int(np.argmax(weights[likely]))
    answers = [(answered if n == most else marginalised)(tried[k]) for n, k in enumerate(likely)]
    first = replace(_averaged(problem.model, answers, weights[likely], answers[most]), shares=shares)
    rig = settings.rigs[likely[most]]
    return [first, *(solve(one, start, rig.level) for one, start in pairs[1:])]


def _averaged(model: ObjectModel, tried: list[JointResult], weights: Array, best: JointResult) -> JointResult:
    """The rigs' mixture about `best`: those that ended in another minimum do not count."""
    delta = np.array([se3.difference(t.pose, best.pose, model.centroid) for t in tried])
    moved = np.linalg.norm(delta[:, :3], axis=1) * model.radius + np.linalg.norm(delta[:, 3:], axis=1)
    weights = np.where(moved < 0.2 * model.radius, weights, 0.0)
    weights = weights / weights.sum()
    mean = weights @ delta
    spread = delta - mean
    covariance = np.einsum("l,lij->ij", weights, [t.covariance for t in tried])
    covariance += np.einsum("l,li,lj->ij", weights, spread, spread)
    return replace(best, pose=se3.perturb(best.pose, mean, model.centroid), covariance=covariance)
