"""How likely each of several joint solutions is, by all that was sensed, and the modes that they make."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.search.pool import Pool
from fusion.estimation.settings import EstimateSettings
from fusion.estimation.solve.joint import JointResult
from scenes.evidence import align as alignment
from scenes.evidence.align import Alignment
from scenes.evidence.modes import Mode, distinct_modes, information_of
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Frame
from touch.arrays.ranking import pattern_costs
from touch.arrays.readings import readings_of
from touch.arrays.rows import taxel_rows
from touch.contacts import placed
from vision.look.hand.hand import HandView
from vision.sight import Sight

Array = NDArray[np.float64]


def joint_costs(
    frame: Frame,
    pool: Pool,
    solved: list[JointResult],
    starts: list[Array],
    hand: HandView | None,
    sight: Sight,
    settings: EstimateSettings,
) -> Array:
    """Costs (k,) in nats of joint solutions by all that was sensed: the estimate's whole objective. frame: with the
    touch that may be used.

    Where no hand is seen that ties calibration and depth, a solution may be costlier than its start (4, 4), which is
    the same objective's with nothing off: see `settled_share`.
    """
    poses = np.array([s.pose for s in solved])
    if pool.predictor.sees:
        # each was solved with the pixels inside its own outline: what all must show is compared instead
        costs = np.array([s.cost - s.pixel_cost for s in solved]) + pool.predictor.costs(
            np.array([s.as_seen for s in solved])
        )
        if hand is None:
            worse = np.maximum(costs - pool.costs(np.array(starts[: len(solved)])), 0.0)
            costs = costs - (1.0 - settings.settled_share) * worse
    else:
        costs = comparable(solved, settings) + sight.costs(poses)
    return np.asarray(costs + beyond_rows(frame, pool.model, solved, settings))


def guarded(
    pool: Pool, solved: list[JointResult], starts: list[Array], hand: HandView | None, settings: EstimateSettings
) -> list[JointResult]:
    """The solutions; where what must be seen of the object speaks against one more than against its start (4, 4), that
    start, with the calibration as the hand is seen, as wide as the two are apart: calibration, scale and bias may
    explain anything but the picture.
    """
    if not pool.predictor.sees:
        return solved
    after = pool.predictor.costs(np.array([s.as_seen for s in solved]))
    before = pool.predictor.costs(np.array(starts[: len(solved)]))
    out = []
    for one, start, worse in zip(solved, starts, after - before):
        if worse <= settings.most_worse:
            out.append(one)
            continue
        apart = se3.difference(one.pose, start, pool.model.centroid)
        xi = np.zeros(6) if hand is None else hand.xi
        wide = one.covariance + np.outer(apart, apart)
        out.append(replace(one, pose=start, as_seen=start, xi=xi, scale=0.0, covariance=wide))
    return out


def comparable(solved: list[JointResult], settings: EstimateSettings) -> Array:
    """Costs (k,) of joint solutions as far as they tell minima apart: pixels' count less (see pixel_temperature)."""
    shared = 1.0 - 1.0 / settings.pixel_temperature
    return np.array([s.cost - shared * s.pixel_cost for s in solved])


def rejudged(
    model: ObjectModel,
    solved: list[JointResult],
    costs: Array,
    settings: EstimateSettings,
    seen: bool,
    beside: Sequence[Mode] = (),
) -> tuple[Mode, ...]:
    """The modes after the joint solution: its poses and covariances, and costs (k,); weights as the settings have
    it for answers that have seen a picture, and for those by touch alone. beside: modes that were not solved.
    """
    told = settings.told if seen else settings.felt
    # what the solution believed of its own accord (System.width) is believed again by distinct_modes: taken out here
    weak = np.repeat([1.0, model.radius], 3) ** -2.0
    both: list[JointResult | Mode] = [*solved, *beside]
    hessians = information_of(np.array([one.covariance for one in both])) - np.diag(weak)
    poses = np.array([one.pose for one in both])
    nats = np.concatenate([costs, [mode.cost for mode in beside]])
    return distinct_modes(model, Alignment(poses, nats, hessians, np.zeros(len(both), dtype=np.int64)), told)


def led(modes: tuple[Mode, ...], solved: list[JointResult]) -> tuple[tuple[Mode, ...], int]:
    """The modes, the likeliest of those that were solved first, and which solution that is; the rest by their costs.

    Of two minima of about the same cost the narrower is the likelier (see `EstimateSettings.told`), so that the one of
    least cost need not be.
    """
    of = [next((i for i, one in enumerate(solved) if np.array_equal(one.pose, mode.pose)), -1) for mode in modes]
    known = [k for k, i in enumerate(of) if i >= 0]
    if not known:
        return modes, 0  # what was not solved is far likelier than all that was
    first = max(known, key=lambda k: modes[k].weight)
    return (modes[first], *modes[:first], *modes[first + 1 :]), of[first]


def beyond_rows(frame: Frame, model: ObjectModel, solved: list[JointResult], settings: EstimateSettings) -> Array:
    """What to add to the costs (k,) of several solutions for what taxel arrays say beyond rows of evidence: the shape
    and the pressures of their patterns, in place of their taxels' rows.
    """
    readings = readings_of(placed(frame)[0]) if settings.patterns is not None and len(solved) > 1 else []
    out = np.zeros(len(solved))
    for k, one in enumerate(solved if readings else ()):
        correction = one.correct()
        moved = [reading.moved(correction) for reading in readings]
        rows = alignment.costs(model, taxel_rows(moved), one.pose[None])
        out[k] = (pattern_costs(model, moved, one.pose[None], settings.patterns) - rows)[0]
    return out
