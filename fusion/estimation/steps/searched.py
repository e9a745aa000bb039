"""Where the object may be, by all that was sensed: the search from starts and proposals, and what a print says of it.

The step between sensing and solving for shared errors. Camera frame, metres, radians.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.answer import Estimate
from fusion.estimation.asked import Asked
from fusion.estimation.search.modes import Found, find_modes
from fusion.estimation.search.proposals import search_stages, starts_of
from fusion.estimation.search.sources import modes_anywhere, modes_near, of_both
from fusion.estimation.steps.another import another_meant
from fusion.estimation.steps.facing import Faced, Facing, faced, why_no_print
from fusion.estimation.steps.sense import Sensed
from fusion.estimation.trace import Trace
from scenes.evidence.modes import Mode
from scenes.words import counted

Array = NDArray[np.float64]


def searched(sensed: Sensed, asked: Asked, trace: Trace, before: tuple[Mode, ...] = ()) -> Faced:
    """The modes that rows and picture leave, the likeliest first, each the way round that its print has it.

    before: what a search of the same frame left that ended early.
    """
    return _printed(sensed, asked, _found(sensed, asked, trace, before), trace)


def search_on(found: Found, asked: Asked, answer: Estimate, trace: Trace) -> Asked | None:
    """What a search is asked that leaves no source out, where one that ended early was convinced of a pose, and the
    answer made of it is not `ok`: what convinces by its picture may be another thing's, or a part that looks like the
    object. None where nothing speaks for that.
    """
    why_not = ""
    if asked.prior is not None:
        why_not = "the search began at a start"
    elif not found.early:
        why_not = "no source was left out"
    elif answer.verdict == "ok":
        why_not = "the answer is ok"
    elif asked.viewed.hand is not None and another_meant(answer.modes, asked.settings.another):
        why_not = "another like it is meant"
    elif asked.or_none:
        why_not = "what is felt is asked next"
    elif trace.over_budget:
        why_not = "the time budget is spent"
    with trace.stage("search on", not why_not, why_not) as stage:
        if why_not:
            return None
        stage.note(0, f"convinced, but {answer.verdict}: all sources are asked")
        settings = asked.settings
        return replace(asked, settings=replace(settings, plan=replace(settings.plan, skipping=False)))


def searched_twice(
    sensed: Sensed, found: Found, asked: Asked, answer: Estimate, trace: Trace, on: bool = False
) -> Faced | None:
    """What two searches of a frame leave where the answer made of the first, which left `found`, is in doubt: the
    second begins from other draws and knows nothing of the first. None where it is not asked for, or ends in nothing
    new. on: whether the first was taken up again (see `search_on`).

    Where what is sensed leaves many shallow minima, chance decides in which of them one search ends.
    """
    why_not = ""
    if answer.verdict == "ok":
        why_not = "the answer is ok"
    elif not asked.settings.plan.anew:
        why_not = "it is not asked for"
    elif answer.confidence >= asked.settings.plan.anew:
        why_not = "the answer is hardly in doubt"
    elif not sensed.pool.predictor.sees:
        why_not = "nothing is seen"
    elif next((stage.ran for stage in reversed(trace.stages) if stage.name == "another in view"), False):
        why_not = "only which is meant is in doubt"
    elif on:
        why_not = "all sources were asked"
    elif asked.prior is None and not sensed.contacts and sensed.pool.predictor.told_apart:
        why_not = "neither a start nor touch says where"
    elif asked.or_none:
        why_not = "what is felt is asked next"
    elif trace.over_budget:
        why_not = "the time budget is spent"
    with trace.stage("search twice", not why_not, why_not) as stage:
        if why_not:
            return None
        both = of_both(sensed.pool, found, _found(sensed, asked, trace, ()), asked.settings.plan)
        ended = "in nothing new" if both is found else f"elsewhere, too: {both.why}"
        stage.note(0, f"{answer.verdict}; other draws end {ended}")
    return None if both is found else _printed(sensed, asked, both, trace)


def _printed(sensed: Sensed, asked: Asked, found: Found, trace: Trace) -> Faced:
    """What a search left, each mode the way round that its print has it."""
    why_not = why_no_print(sensed, asked.settings.texture)
    out = Faced(found, np.zeros(0), asked, sensed, Facing(why=why_not))
    with trace.stage("print", not why_not, why_not) as stage:
        if not why_not:
            out = faced(sensed, found, asked)
            stage.note(out.facing.pixels, out.facing.why)
    return out


def _found(sensed: Sensed, asked: Asked, trace: Trace, before: tuple[Mode, ...]) -> Found:
    settings, pool, felt, rows = asked.settings, sensed.pool, sensed.felt, sensed.rows
    model, costs, believed = pool.model, sensed.sight.costs, asked.prior
    how, blur = settings.proposals, settings.proposals.blur(model)
    with trace.stage("search", True, "") as stage:
        starts: list[Array] = []

        def begun() -> Array:
            pixels, contacts = pool.seen(), felt.contacts
            starts.append(starts_of(model, believed, pixels, contacts, rows, costs, how, pool.rng, felt.patches))
            return starts[0]

        wide = search_stages(blur, how.wide if sensed.contacts else how.sifted)
        if believed is not None:
            near = search_stages(blur, how.near)
            found = modes_near(pool, rows, sensed.seen, begun(), near, settings.plan, trace)
        elif pool.predictor.sees:
            found = modes_anywhere(pool, rows, begun, wide, settings.plan, trace, before)
        else:
            found = find_modes(model, rows, begun(), wide, None, costs, settings.plan, settings.modes)
        gels = f", by {counted(len(felt.patches), 'gel')} too" if felt.patches and believed is None else ""
        tried = f"{found.looked_at} of {len(starts[0])} starts{gels}" if starts else "pairs of pixels"
        stage.note(len(rows), f"{tried}, blur {1e3 * blur:.1f} mm; {found.why}")
    return found
