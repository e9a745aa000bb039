"""What an estimate's own objective says of given poses, each refined as the answers of a search are.

Whether a wrong answer is the search's fault or the objective's is told by this: had the right pose been proposed, would
it have won? Camera frame, metres.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fusion.estimation.asked import Asked
from fusion.estimation.settings import EstimateSettings
from fusion.estimation.steps.sense import Sensed, look_once, sense, solve_together
from fusion.estimation.trace import Trace
from scenes.errors import InputError
from scenes.evidence.align import AlignSettings, Prior, align
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import Beliefs
from scenes.recordings.checking.validation import check_scale
from scenes.recordings.frames import Frame
from scenes.threads import one_blas_thread

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Judgement:
    """Poses (n, 4, 4) camera_from_object after refinement, in the order given, and what they cost.

    costs (n,): nats of the joint solution, the objective by which an estimate ranks its answers; fitted (n, 4, 4) and
    fitted_costs (n,): before it, by which it ranks the proposals of its search. Lower is likelier; costs of one
    judgement compare with one another only.
    """

    poses: Array
    costs: Array
    fitted: Array
    fitted_costs: Array


def judge(
    frame: Frame,
    model: ObjectModel,
    candidates: ArrayLike,
    prior: Array | Prior | None = None,
    use: Iterable[str] = ("vision", "touch"),
    seed: int = 0,
    settings: EstimateSettings | None = None,
    beliefs: Beliefs | None = None,
) -> Judgement:
    """How likely candidates (n, 4, 4) camera_from_object are, had a search proposed them, and these alone.

    The other arguments are `estimate`'s, and so is all that is done with the poses, at the first look: fits to the
    pixels inside their own outlines, then the joint solution, the likeliest first, whose rig all are solved with. At
    most settings.joint.modes of them. Raises InputError for other counts or shapes, and for a frame that tells nothing
    of the object.
    """
    asked = Asked.of(frame, prior, use, None, seed, settings, beliefs)
    shape, most = np.shape(candidates), asked.settings.joint.modes
    if len(shape) != 3 or not 1 <= shape[0] <= most:
        raise InputError(f"judge: expected 1 to {most} poses of shape (n, 4, 4), got {shape}")
    given = se3.check_pose(candidates, "candidates")
    check_scale(frame, model)
    with one_blas_thread():
        trace = Trace()
        sensed = sense(frame, model, asked, trace, look_once(model, asked, trace))
        if sensed.nothing:
            raise InputError(f"judge: {frame.where or f'frame {frame.index}'}: expected some evidence, got none")
        fitted, before = _fitted(sensed, given)
        order = np.argsort(before, kind="stable")
        solved = solve_together(sensed, list(fitted[order]), asked)
    back = np.argsort(order, kind="stable")
    poses = np.array([result.pose for result in solved.results])
    return Judgement(poses[back], solved.costs[back], fitted, before)


def _fitted(sensed: Sensed, given: Array) -> tuple[Array, Array]:
    """The poses (n, 4, 4) as a search ends with them, and their costs (n,)."""
    pool = sensed.pool
    if pool.predictor.sees:
        alone = [pool.compete(pose[None])[0] for pose in given]
        return np.array([mode.pose for mode in alone]), np.array([mode.cost for mode in alone])
    found = align(pool.model, sensed.rows, given, pool.prior, AlignSettings())
    return found.poses, found.costs + sensed.sight.costs(found.poses)
