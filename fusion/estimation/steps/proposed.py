"""What the image proposes when it shows the outline elsewhere than depth has it. Camera frame, metres.

Either the image is not registered with depth, or the pose is wrong: a search by depth may have missed the right one,
which lies where the image has the outline. So that pose is fitted like any other that a sense proposes, and competes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fusion.estimation.steps.facing import Faced
from fusion.estimation.steps.finished import Finished, finished
from fusion.estimation.trace import Trace
from scenes.evidence.search import leaders


def finished_with_outline(found: Faced, trace: Trace) -> tuple[Faced, Finished | None]:
    """What `finished` makes of a search's modes, with what the image proposes where it does; and these modes."""
    end = finished(found, trace)
    more = None if end is None else by_outline(found, end, trace)
    if more is None:
        return found, end
    again = finished(more, trace)
    return (found, end) if again is None else (more, again)


def by_outline(found: Faced, end: Finished, trace: Trace) -> Faced | None:
    """The search's modes with the pose that the image shows and what a fit makes of it, to be solved like them; None
    where the image shows none elsewhere, it is hopeless, or its fit is no likelier than where depth has the object.
    """
    elsewhere, pool = end.elsewhere, found.sensed.pool
    why_not = "" if elsewhere is not None else "the image shows the outline where depth does, or not at all"
    if not why_not and trace.over_budget:
        why_not = "the time budget is spent"
    with trace.stage("outline proposes", not why_not, why_not) as stage:
        if why_not or elsewhere is None:
            return None
        here, there = pool.costs(np.array([end.here, elsewhere]))
        if there > here + pool.settings.hopeless:
            stage.note(0, f"{there - here:+.0f} nats where the image has it")
            return None
        fitted = pool.compete(elsewhere[None])[0]
        back = len(leaders(pool.model, np.array([end.here, fitted.pose]), pool.apart)[0]) == 1
        stage.note(0, f"{fitted.cost - here:+.1f} nats where the image led{', which is where it was' if back else ''}")
        if back or fitted.cost >= here:
            return None
        # from where the image has it, too: a fit by rows may lead away from it again
        return replace(found, found=replace(found.found, also=(*found.found.also, fitted.pose, elsewhere)))
