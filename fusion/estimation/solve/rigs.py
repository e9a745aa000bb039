"""How large are a rig's shared errors? The joint problem solved for each kind of rig, and the answers averaged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.solve.joint import JointResult, solve
from fusion.estimation.solve.problem import JointProblem
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel

Array = NDArray[np.float64]


def solve_modes(problem: JointProblem, starts: list[Array]) -> list[JointResult]:
    """Solve from each start; how large the shared errors are is averaged over at the first start.

    A rig weighs exp(log evidence) times how usual it is. The first answer is the rigs' weighted mean and mixture
    covariance, so that not knowing the rig is part of its uncertainty; other modes use the best. Where that is one
    whose pixels count more, all are solved with these.
    """
    settings = problem.settings
    tried = [solve(problem, starts[0], settings.rigs[0].level)]
    for rig in settings.rigs[1:]:
        tried.append(solve(problem, tried[-1].pose, rig.level))
    score = np.array([t.log_evidence + np.log(rig.share) for t, rig in zip(tried, settings.rigs)])
    weights = np.exp(score - score.max())
    best = int(np.argmax(score))
    rig = settings.rigs[best]
    if rig.weight > settings.least_weight:
        return [
            solve(problem, start, rig.level, rig.weight) for start in [tried[best].pose, *starts[1 : settings.modes]]
        ]
    first = _averaged(problem.model, tried, weights / weights.sum(), tried[best])
    return [first, *(solve(problem, start, rig.level) for start in starts[1 : settings.modes])]


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
