"""The search as a whole: one source of proposals after the other, until the best of all that competed convinces.

Cheap sources come first, and the trace has a line for each: run, or skipped and why. Camera frame, metres.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.pool import Pool
from fusion.estimation.search import Found, PlanSettings, find_modes
from fusion.estimation.steps.walk import walk
from fusion.estimation.trace import Trace
from scenes.evidence.modes import Mode
from scenes.evidence.search import SearchStage
from scenes.evidence.table import GATE_ABOVE, Evidence

Array = NDArray[np.float64]

CONVINCED = "what was proposed convinces"


class Competition:
    """Poses of several sources, of which the likeliest stay. trace: has a line for each source."""

    def __init__(self, pool: Pool, trace: Trace) -> None:
        """Nothing has been proposed yet."""
        self.pool, self.trace = pool, trace
        self.modes: tuple[Mode, ...] = ()
        self.convinced = False
        self.proposed = 0
        self._felt: Array | None = None

    def enter(self, source: str, propose: Callable[[], Array], why_not: str = "") -> None:
        """Let a source propose (n, 4, 4), and all that were left compete with its poses; skipped for a reason."""
        with self.trace.stage(f"propose: {source}", not why_not, why_not) as stage:
            if why_not:
                return
            poses = propose()
            self.proposed += len(poses)
            both = np.concatenate([poses, poses_of(self.modes)])
            if len(both):
                few = not self.modes
                self.modes = self.pool.compete(both, None if few else self.pool.settings.fitted_in_doubt)
                self.convinced = self.pool.convinces(self.modes)
            stage.note(
                len(poses), f"{len(self.modes)} modes are left, {'they convince' * self.convinced or 'in doubt'}"
            )

    def by_touch(self, poses: Array) -> Array:
        """The same poses (n, 4, 4), of which the first is what touch alone says: it is solved with what is left while
        there is doubt, because a calibration that is off makes right contacts look wrong until it is solved for.
        """
        if len(poses) and self.contacts >= self.pool.settings.tying_contacts:
            self._felt = poses[0]
        return poses

    @property
    def contacts(self) -> int:
        """How many are felt."""
        return int((self.pool.felt.rows[:, GATE_ABOVE] > 0).sum())

    @property
    def enough(self) -> str:
        """Why no more need be asked; "" while there is doubt."""
        return CONVINCED if self.convinced else ""

    def found(self, looked_at: int) -> Found:
        """What is left. looked_at: starts."""
        words = "and convince" if self.convinced else "the best in doubt"
        also: tuple[Array, ...] = ()
        if not self.convinced and self._felt is not None:
            also = (self.pool.compete(self._felt[None])[0].pose,)
        return Found(self.modes, looked_at, f"{len(self.modes)} of {self.proposed} proposals are left, {words}", also)


def poses_of(modes: tuple[Mode, ...]) -> Array:
    """(n, 4, 4)."""
    return np.array([mode.pose for mode in modes]).reshape(-1, 4, 4)


def modes_near(
    pool: Pool,
    rows: Evidence,
    seen: Evidence,
    starts: Array,
    stages: tuple[SearchStage, ...],
    plan: PlanSettings,
    trace: Trace,
) -> Found:
    """Modes of a frame with a prior: rows and touch propose from a few of the starts (n, 4, 4), and where the best of
    that does not convince, the whole objective walks from all of them and from between the fingers; then rows and touch
    again, in rounds of fresh starts, until the best convinces or a round ends where the one before did.
    rows: all evidence, seen: vision's.
    """
    prior, settings = pool.prior, pool.settings
    assert prior is not None
    if not pool.predictor.sees:
        return find_modes(pool.model, rows, starts, stages, prior, pool.sight.costs, plan, pool.modes)
    whole, asked = replace(plan, skipping=False), Competition(pool, trace)
    ends = [k for k in plan.rounds if k < len(starts)] if plan.skipping else []
    begin = 0

    def searched(fresh: Array) -> Array:
        rank, few = pool.sight.costs, plan.refining_rows
        found = find_modes(pool.model, rows, fresh, stages, prior, rank, whole, pool.modes, few)
        return poses_of(found.modes)

    def felt(fresh: Array, descending: int) -> Array:
        return asked.by_touch(pool.proposed(fresh, stages, seen, prior.pose, descending))

    def walked() -> Array:
        everywhere = pool.likeliest(np.concatenate([starts, pool.held_starts()]))
        return walk(pool.model, everywhere, pool.walking, pool.rng, pool.proposals.walk)

    for end, descending in zip([*ends, len(starts)], [*settings.descents[: len(ends)], settings.descents[-1]]):
        fresh, before = starts[begin:end], asked.modes
        asked.enter(f"rows, {len(fresh)} starts", partial(searched, fresh))
        clear = plan.skipping and not begin and pool.convinces(asked.modes, settings.clearly_shown)
        asked.enter(
            "touch and descents", partial(felt, fresh, descending), "what all rows say is clearly seen" if clear else ""
        )
        if not begin:
            before = asked.modes
            asked.enter(f"a walk{' and the hand' * (pool.held is not None)}", walked, asked.enough)
        begin = end
        # a walk from everywhere is a round, too
        if asked.convinced or (before and pool.is_same(asked.modes, before)):
            break
    return asked.found(begin)


def modes_anywhere(
    pool: Pool, likely: Array, seen: Evidence, starts: Array, passes: tuple[SearchStage, ...], trace: Trace
) -> Found:
    """Modes of a frame of which nothing is known: the search's (n, 4, 4), what touch alone proposes, and where the
    whole objective walks from these, from each piece of the image and from between the fingers. starts (m, 4, 4): where
    touch looks.
    """
    asked = Competition(pool, trace)
    asked.enter("rows", lambda: likely)
    felt = asked.by_touch(pool.proposed(starts, passes, seen, None, 0))
    asked.enter("touch", lambda: felt, "" if len(felt) else "nothing is felt")
    pieces = pool.looked.pieces
    begun: list[tuple[Evidence, Array]] = []

    def walked() -> Array:
        begun.extend(pool.piece_starts())
        everywhere = np.concatenate([likely, felt, *(starts for _, starts in begun), pool.held_starts()])
        return walk(pool.model, everywhere, pool.costs, pool.rng, pool.proposals.walk_far)

    sources = ["a walk", *[f"{len(pieces)} pieces"] * bool(pieces), *["the hand"] * (pool.held is not None)]
    # a picture that convinces may be that of another thing; one that touch agrees with is not
    agreed = asked.convinced and asked.contacts >= pool.settings.tying_contacts
    why_not = "seen and felt agree" if agreed else ""
    asked.enter(", ".join(sources), walked, why_not)
    if not why_not and not begun:
        why_not = "no piece stands alone"
    elif not why_not and asked.modes and pool.convinces(asked.modes, pool.settings.clearly_shown):
        why_not = "the best is clearly seen"
    asked.enter("each piece alone", lambda: pool.of_pieces(tuple(begun)), why_not)
    return asked.found(asked.proposed)
