"""The search as a whole: few starts compete first, and more of them only while their best does not convince."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.pool import Pool
from fusion.estimation.search import Found, PlanSettings, find_modes
from scenes.evidence.modes import Mode
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
    """Modes of a frame with a prior: every sense proposes from a few of the starts (n, 4, 4), in rounds of fresh ones
    until the best convinces, or a round ends where the one before did. rows: all evidence, seen: vision's.
    """
    assert pool.prior is not None
    if not pool.predictor.sees:
        return find_modes(pool.model, rows, starts, stages, pool.prior, pool.sight.costs, plan, pool.modes)
    whole, descents = replace(plan, skipping=False), pool.settings.descents
    ends = [k for k in plan.rounds if k < len(starts)] if plan.skipping else []
    begin = 0
    modes: tuple[Mode, ...] = ()
    for end, descending in zip([*ends, len(starts)], [*descents[: len(ends)], descents[-1]]):
        fresh, before = starts[begin:end], modes
        found = find_modes(pool.model, rows, fresh, stages, pool.prior, pool.sight.costs, whole, pool.modes)
        candidates = np.array([m.pose for m in (*found.modes, *before)])
        if plan.skipping and not begin:
            modes = pool.compete(candidates)
            if pool.convinces(modes, pool.settings.clearly_shown):
                return Found(modes, end, "what all rows say is clearly seen")
            candidates = np.array([m.pose for m in modes])
        more = pool.proposed(fresh, stages, seen, pool.prior.pose, descending)
        modes = pool.compete(np.concatenate([candidates, more]))
        if pool.convinces(modes):
            return Found(modes, end, f"{len(modes)} of {len(candidates) + len(more)} proposals are left and convince")
        if before and pool.is_same(modes, before):
            return Found(modes, end, "the best is in doubt, but fresh starts lead to it again")
        begin = end
    return Found(modes, len(starts), f"{len(modes)} of {len(candidates) + len(more)} proposals are left, in doubt")


def modes_anywhere(pool: Pool, likely: Array, seen: Evidence, starts: Array, passes: tuple[SearchStage, ...]) -> Found:
    """Modes of a frame of which nothing is known: the search's (n, 4, 4), and what touch alone and each piece of the
    image propose, compete. starts (m, 4, 4): where touch looks.
    """
    more = [pool.proposed(starts, passes, seen, None, 0), pool.of_pieces()]
    candidates = np.concatenate([likely, *more])
    modes = pool.compete(candidates)
    return Found(modes, len(candidates), f"{len(modes)} of {len(candidates)} proposals are left")
