"""The search as a whole: few starts compete first, and all of them only when their best does not convince."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.pool import Pool
from fusion.estimation.search import Found, PlanSettings, find_modes
from scenes.evidence.search import SearchStage
from scenes.evidence.table import Evidence

Array = NDArray[np.float64]


def modes_near(
    pool: Pool,
    rows: Evidence,
    seen: Evidence,
    starts: Array,
    stages: tuple[SearchStage, ...],
    plan: PlanSettings,
) -> Found:
    """Modes of a frame with a prior: every sense proposes from a few of the starts (n, 4, 4); from all when the best of
    that does not convince. rows: all evidence, seen: vision's.
    """
    assert pool.prior is not None
    if not pool.predictor.sees:
        return find_modes(pool.model, rows, starts, stages, pool.prior, pool.sight.costs, plan, pool.modes)
    tried = np.zeros((0, 4, 4))
    some = [plan.first_starts, len(starts)] if plan.skipping and plan.first_starts < len(starts) else [len(starts)]
    whole = replace(plan, skipping=False)
    for count, descents in zip(some, (pool.settings.first_descents, pool.settings.descents)[-len(some) :]):
        few = starts[:count]
        found = find_modes(pool.model, rows, few, stages, pool.prior, pool.sight.costs, whole, pool.modes)
        more = pool.proposed(few, stages, seen, pool.prior.pose, descents)
        candidates = np.concatenate([np.array([m.pose for m in found.modes]), more, tried])
        modes = pool.compete(candidates)
        if pool.convinces(modes):
            return Found(modes, count, f"{len(modes)} of {len(candidates)} proposals are left and convince")
        tried = np.array([m.pose for m in modes])
    return Found(modes, len(starts), f"{len(modes)} of {len(candidates)} proposals are left, the best in doubt")


def modes_anywhere(pool: Pool, likely: Array, seen: Evidence, starts: Array, passes: tuple[SearchStage, ...]) -> Found:
    """Modes of a frame of which nothing is known: the search's (n, 4, 4), and what touch alone and each piece of the
    image propose, compete. starts (m, 4, 4): where touch looks.
    """
    more = [pool.proposed(starts, passes, seen, None, 0), pool.of_pieces()]
    candidates = np.concatenate([likely, *more])
    modes = pool.compete(candidates)
    return Found(modes, len(candidates), f"{len(modes)} of {len(candidates)} proposals are left")
